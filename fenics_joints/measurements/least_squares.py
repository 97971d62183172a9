"""Least squares within bounds, with a prior, and what the residuals say of the answer."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import OptimizeResult, least_squares

#: Residuals of a prior at coordinates, and their derivatives.
HeldBy = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


class LeastSquares:
    """A problem whose answer has the least sum of squared residuals, in standard deviations.

    Give the functions, or subclass it with methods `residual` and `jacobian` of the same arguments:

        line = LeastSquares(lambda x: (x[0] + x[1] * t - y) / sd)
        found = line.solve(np.zeros(2)).x
        deviations = np.sqrt(np.diag(line.covariance(found)))

    Args:
        residual: From coordinates, (n,), to residuals of the data, (r,); None in a subclass.
        jac: Their derivatives, (r, n); differences by default.
        prior: Residuals of a prior and their derivatives.
        bounds: Of the coordinates; none by default.
    """

    def __init__(
        self,
        residual: Callable[[np.ndarray], np.ndarray] | None = None,
        jac: Callable[[np.ndarray], np.ndarray] | None = None,
        prior: HeldBy | None = None,
        bounds: tuple = (-np.inf, np.inf),
    ):
        self._residual, self._jac, self.prior, self.bounds = residual, jac, prior, bounds

    def residual(self, x: np.ndarray) -> np.ndarray:
        """The residuals of the data, then of the prior."""
        held = [] if self.prior is None else [self.prior(x)[0]]
        return np.concatenate([self._residual(x), *held])

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """Their derivatives by the coordinates."""
        if self._jac is None:
            return least_squares(self.residual, x, max_nfev=1, bounds=self.bounds).jac
        held = [] if self.prior is None else [self.prior(x)[1]]
        return np.concatenate([self._jac(x), *held])

    def solve(
        self, x: np.ndarray, max_evaluations: int | None = None, **options: object
    ) -> OptimizeResult:
        """The least sum of squares from coordinates ``x``, by a trust region.

        Args:
            x: Coordinates at the start, within the bounds.
            max_evaluations: Most evaluations of the residuals.
            options: Further ones of `scipy.optimize.least_squares`.
        """
        if self._jac is not None:
            options.setdefault("jac", self.jacobian)
        return least_squares(
            self.residual, x, bounds=self.bounds, max_nfev=max_evaluations, **options
        )

    def covariance(self, x: np.ndarray) -> np.ndarray:
        """Covariance of the coordinates to first order, (n, n); very large where they are open."""
        root, _ = information_root(self.jacobian(x))
        return root @ root.T


def information_root(slope: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """R with R R^T the inverse of the information, and which of its columns the data know.

    Args:
        slope: Derivatives of the residuals by the coordinates, (r, n).
    """
    values, vectors = np.linalg.eigh(slope.T @ slope)
    floor = np.finfo(float).eps * max(values[-1], np.finfo(float).tiny)
    return vectors / np.sqrt(np.maximum(values, floor)), values > floor
