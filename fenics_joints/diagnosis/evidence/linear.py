"""Whitened residuals, and the evidence of what is linear in parameters z ~ N(0, I)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import solve_triangular

if TYPE_CHECKING:
    from fenics_joints.diagnosis.evidence.evidence import Evidence
    from fenics_joints.diagnosis.evidence.fitted import Fit


def whiten(lower: np.ndarray, array: np.ndarray) -> np.ndarray:
    """Rows, (k,) or (k, n), in standard deviations; ``lower`` factors their covariance."""
    return solve_triangular(lower, array, lower=True, check_finite=False)


def log_constant(lower: np.ndarray) -> float:
    """-ln of the density at the mean of a normal distribution with this Cholesky factor, (k, k)."""
    return float(np.sum(np.log(np.diag(lower))) + 0.5 * len(lower) * np.log(2 * np.pi))


def marginal(residual: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """ln of the marginal likelihood but for the data's constant, of residuals (k, t), whitened,
    with parameters z ~ N(0, I) about 0: (t,).

    Args:
        residual: At z = 0.
        slope: Derivatives by z, whitened, (k, p).
    """
    hessian, pull = slope.T @ slope + np.eye(slope.shape[1]), slope.T @ residual
    gain = np.sum(pull * np.linalg.solve(hessian, pull), axis=0)
    return 0.5 * (gain - np.sum(residual**2, axis=0) - np.linalg.slogdet(hessian)[1])


def log_evidence(square: float, slope: np.ndarray, lower: np.ndarray) -> float:
    """ln of the marginal likelihood: ln N(r; 0, Sigma) - |z|^2 / 2 - ln det(H) / 2 at the maximum.

    Args:
        square: |r|^2 + |z|^2 there, r whitened.
        slope: Whitened slopes J by z, (k, d), of which H = J^T J + I.
        lower: Cholesky factor of Sigma, (k, k).
    """
    hessian = slope.T @ slope + np.eye(slope.shape[1])
    return float(-0.5 * square - 0.5 * np.linalg.slogdet(hessian)[1] - log_constant(lower))


@dataclass(frozen=True)
class LinearFit:
    """A hypothesis linear about a point, whitened, to be held against any data of the same test.

    Attributes:
        lower: Cholesky factor of the covariance of the fitted entries, (k, k).
        residual: Prediction less data at the point, (k,).
        slope: Derivatives by z, (k, d).
        z: The point, (d,), which need not be the best one.
        free: Which of z may move, (d,), bool: those at a limit may not.
    """

    lower: np.ndarray
    residual: np.ndarray
    slope: np.ndarray
    z: np.ndarray
    free: np.ndarray

    @classmethod
    def of(cls, found: Fit, test: Evidence, lower: np.ndarray | None = None) -> LinearFit:
        """A fit, to any data, as a linear model of the fitted entries of a test.

        Args:
            found: The fit.
            test: The test.
            lower: Cholesky factor of the covariance; by default that of the fit's hypothesis.
        """
        used = test.fitted
        lower = test.lower(found.hypothesis.unknown) if lower is None else lower
        both = np.column_stack([(found.predicted - test.data)[used], found.jacobian[used]])
        white = whiten(lower, both)
        return cls(lower, white[:, 0], white[:, 1:], found.z, ~found.hypothesis.at_limit(found.z))

    def beside(self, *slopes: np.ndarray) -> LinearFit:
        """The same with further parameters, at their medians, by their whitened slopes, (k, q)."""
        slope = np.hstack([self.slope, *slopes])
        more = (0, slope.shape[1] - len(self.z))
        free = np.pad(self.free, more, constant_values=True)
        return replace(self, slope=slope, z=np.pad(self.z, more), free=free)

    def released(self) -> LinearFit:
        """The same with parameters at a limit free: other data may move them away from it."""
        return replace(self, free=np.ones_like(self.free))

    @cached_property
    def _root(self) -> np.ndarray:
        """Inverse of the Cholesky factor of J^T J + I of what is free."""
        slope = self.slope[:, self.free]
        return np.linalg.inv(np.linalg.cholesky(slope.T @ slope + np.eye(slope.shape[1])))

    def squares(self, changes: np.ndarray) -> np.ndarray:
        """Least |r|^2 + |z|^2, (n,), with whitened changes of the residual, (k, n)."""
        residual = self.residual[:, None] + changes
        pull = self.slope[:, self.free].T @ residual + self.z[self.free][:, None]
        gain = np.sum((self._root @ pull) ** 2, axis=0)
        return np.sum(residual**2, axis=0) + self.z @ self.z - gain

    @property
    def square(self) -> float:
        """Least |r|^2 + |z|^2."""
        return float(self.squares(np.zeros((len(self.lower), 1)))[0])

    @property
    def log_evidence(self) -> float:
        """ln of the marginal likelihood."""
        return log_evidence(self.square, self.slope, self.lower)


def left_by_stated(found: Fit, test: Evidence) -> float | None:
    """Misfit with the errors that are stated as limits at these limits; see `Fit.stated`.

    Args:
        found: The fit.
        test: The test.
    """
    if found.scales is None or test.drifts:
        return None
    scales = found.scales.stated
    return LinearFit.of(found, test.at(scales)).square + scales.squares
