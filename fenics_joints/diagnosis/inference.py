"""Fits a hypothesis to the test and weighs it: non-linear least squares, then Laplace evidence.

Every parameter is worked on as z, its distance from its prior median in prior standard deviations,
so that the prior is standard normal in all of them. The data are the logarithms of frequencies
and, of a test at several levels, those of damping ratios.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.integrate import trapezoid
from scipy.optimize import least_squares
from scipy.stats import chi2

from fenics_joints.diagnosis.amplitude import has_damping
from fenics_joints.diagnosis.hypothesis import Hypothesis
from fenics_joints.diagnosis.prediction import Prediction
from fenics_joints.errors import InputError
from fenics_joints.measurements import TestData
from fenics_joints.surrogate import Forward

__all__ = ["Evidence", "Fit", "Forward", "Hypothesis", "evidence_of", "fit"]

#: Standard deviations of the prior beyond which a scanned parameter is not looked for.
_FARTHEST = 4.0


@dataclass(frozen=True)
class Evidence:
    """The test as the inference sees it.

    Attributes:
        conditions: Torque or level of each row, shape (n,).
        log_f: ln of the measured frequencies, shape (n, m); nan where missing.
        log_sd: Their standard deviations from noise and resolution, shape (n, m).
        discrepancy: Standard deviation, of ln f, of the error that every model of this structure
            has. Part of its variance is the same at all conditions and part changes slowly with
            the condition, so that more of them do not average it out.
        used: Which entries are fitted, shape (n, m); the others are held out.
        changing: The share of the discrepancy's variance that changes with the condition: half for
            torques; next to nothing for levels, between which nobody touched the structure.
        log_damping: ln of the measured damping ratios, shape (n, m), nan where missing; None if
            they are not used.
        damping_sd: Their standard deviation from noise.
    """

    conditions: np.ndarray
    log_f: np.ndarray
    log_sd: np.ndarray
    discrepancy: float
    used: np.ndarray = field(default=None)
    changing: float = 0.5
    log_damping: np.ndarray | None = None
    damping_sd: float = 0.1

    def __post_init__(self):
        if self.used is None:
            object.__setattr__(self, "used", np.isfinite(self.log_f))

    @property
    def data(self) -> np.ndarray:
        """Everything measured: ln f, and beside it ln damping if used; (n, m) or (n, 2 m)."""
        if self.log_damping is None:
            return self.log_f
        return np.hstack([self.log_f, self.log_damping])

    @property
    def fitted(self) -> np.ndarray:
        """Which of `data` are fitted; a mode held out at a condition is so with its damping."""
        if self.log_damping is None:
            return self.used
        return np.hstack([self.used, self.used & np.isfinite(self.log_damping)])

    def without(self, held_out: np.ndarray) -> Evidence:
        """The same test with some entries held out, mask of shape (n, m)."""
        return replace(self, used=self.used & ~held_out)

    def covariance(self, unknown: bool = False) -> np.ndarray:
        """Covariance of the fitted entries, shape (k, k)."""
        n, m = self.log_f.shape
        sd, columns = self.log_sd, m
        if self.log_damping is not None:
            sd, columns = np.hstack([sd, np.full((n, m), self.damping_sd)]), 2 * m
        mode = np.tile(np.arange(columns), n)
        same_mode = mode[:, None] == mode[None, :]
        is_f = (mode < m)[:, None]
        total = np.diag(sd.ravel() ** 2)
        slow = _slow(self.conditions, columns, self.changing)
        total = total + np.where(is_f, self.discrepancy**2 * slow, 0.0) * same_mode
        if unknown:
            wide = _wide(self.conditions, columns)
            total = total + np.where(is_f, wide, _UNKNOWN_DAMPING**2 * wide) * same_mode
        used = self.fitted.ravel()
        return total[np.ix_(used, used)]


#: Share of the discrepancy that changes from level to level.
_BETWEEN_LEVELS = 0.02


def evidence_of(data: TestData, discrepancy: float) -> Evidence:
    """A test as the inference sees it: its damping only if it was measured at several levels."""
    log_f = np.log(data.frequencies_hz)
    if not data.by_level:
        return Evidence(data.conditions, log_f, data.log_sd(), discrepancy)
    log_damping = None
    if has_damping(data):
        ratios = data.damping
        log_damping = np.log(ratios, where=ratios > 0, out=np.full(ratios.shape, np.nan))
    return Evidence(
        data.conditions, log_f, data.log_sd(), discrepancy, changing=_BETWEEN_LEVELS,
        log_damping=log_damping, damping_sd=data.damping_noise,
    )  # fmt: skip


#: What an unknown cause may do to each mode on its own: a shift (10 %), a trend with the logarithm
#: of the condition (5 % per factor e), and a bend of it (2 %); and how much more to its damping.
_UNKNOWN = (0.10, 0.05, 0.02)
_UNKNOWN_DAMPING = 10.0


#: Change of the logarithm of the condition over which a model's error forgets itself.
_MEMORY = 0.7


def _log(conditions: np.ndarray) -> np.ndarray:
    """Centred logarithm of the conditions; zero when they are not all positive."""
    if len(conditions) < 2 or np.any(conditions <= 0):
        return np.zeros(len(conditions))
    return np.log(conditions) - np.mean(np.log(conditions))


def _slow(conditions: np.ndarray, m: int, changing: float) -> np.ndarray:
    x = _log(conditions)
    rows = (1 - changing) + changing * np.exp(-0.5 * ((x[:, None] - x[None, :]) / _MEMORY) ** 2)
    return np.kron(rows, np.ones((m, m)))


def _wide(conditions: np.ndarray, m: int) -> np.ndarray:
    shift, trend, bend = _UNKNOWN
    x = _log(conditions)
    rows = shift**2 + trend**2 * np.outer(x, x) + bend**2 * np.outer(x**2, x**2)
    return np.kron(rows, np.ones((m, m)))


@dataclass(frozen=True)
class Fit:
    """A hypothesis at its most probable parameters.

    Attributes:
        hypothesis: The hypothesis.
        z: Parameters in prior standard deviations, shape (d,).
        covariance: Posterior covariance of z (Laplace), shape (d, d).
        predicted: Everything predicted at all conditions, held out or not, as `Evidence.data`.
        log_f: The predicted ln f, shape (n, m).
        jacobian: Derivative of all predictions by z, shape (predicted.size, d).
        log_evidence: ln of the marginal likelihood of the fitted entries.
        misfit: Squared whitened residual of the fitted entries.
        n_data: Number of fitted entries.
        at_bound: Names of parameters at a limit of their prior.
    """

    hypothesis: Hypothesis
    z: np.ndarray
    covariance: np.ndarray
    predicted: np.ndarray
    n_modes: int
    jacobian: np.ndarray
    log_evidence: float
    misfit: float
    n_data: int
    at_bound: tuple[str, ...] = ()

    @property
    def log_f(self) -> np.ndarray:
        return self.predicted[:, : self.n_modes]

    @property
    def log_damping(self) -> np.ndarray | None:
        """Predicted ln of the damping ratios, shape (n, m); None if they are not predicted."""
        return self.predicted[:, self.n_modes :] if self.hypothesis.damped else None

    @property
    def p_value(self) -> float:
        """Probability of a misfit as large as this, if the hypothesis were right.

        In the linear-Gaussian case misfit + |z|^2 is the data's distance from the prediction in
        the metric of noise and prior together, and distributed as chi-square with n_data degrees.
        """
        return float(chi2.sf(self.misfit + self.z @ self.z, self.n_data))

    @property
    def frequencies_hz(self) -> np.ndarray:
        """Predicted frequencies, Hz, shape (n, m)."""
        return np.exp(self.log_f)


def fit(
    hypothesis: Hypothesis,
    forward: Forward,
    evidence: Evidence,
    baseline: dict[str, float],
    *,
    starts: Sequence[np.ndarray] | None = None,
    tolerance: float = 1e-5,
    progress: Callable[[], None] | None = None,
) -> Fit:
    """Most probable parameters of a hypothesis and its Laplace evidence.

    The evidence is ln Z = ln N(r; 0, Sigma) - |z|^2 / 2 - ln det(J^T Sigma^-1 J + I) / 2 at the
    maximum, with the Gauss-Newton Hessian. Over a parameter that acts in steps (`Prior.scan`) it is
    integrated on a grid instead, the others linear about their medians.

    Args:
        hypothesis: What is fitted.
        forward: Predicts frequencies.
        evidence: The test.
        baseline: Parameter values of the nominal model.
        starts: Points z to start from; the best end counts. The prior's median by default.
        tolerance: Relative change of the sum of squares, and of z, at which the search ends.
        progress: Called when done.
    """
    covariance = evidence.covariance(hypothesis.unknown)
    lower = np.linalg.cholesky(covariance)
    problem = _Problem(hypothesis, forward, evidence, baseline, lower)
    bounds = np.array([prior.limits() for _, prior in hypothesis.priors]).reshape(-1, 2)
    scanned = next((j for j, (_, p) in enumerate(hypothesis.priors) if p.scan), None)
    scan = None if scanned is None else problem.scan(scanned, bounds[scanned])
    if scan is not None:
        starts = [scan.start, *(starts or ())]
    best = None
    for start in starts or (np.zeros(len(bounds)),):
        if len(bounds) == 0:
            best = (0.0, start)
            break
        inside = np.clip(start, bounds[:, 0] + 1e-6, bounds[:, 1] - 1e-6)
        result = least_squares(
            problem.residual, inside, problem.slope, bounds=tuple(bounds.T), method="trf",
            x_scale=1.0, ftol=tolerance, xtol=tolerance, gtol=tolerance, max_nfev=30,
        )  # fmt: skip
        if best is None or result.cost < best[0]:
            best = (result.cost, result.x)
    if progress:
        progress()
    found = problem.finish(best[1], bounds)
    return found if scan is None else scan.improved(found)


@dataclass(frozen=True)
class _Scan:
    """The posterior over one parameter, on a grid.

    Attributes:
        index: Which parameter.
        start: The most probable point met, shape (d,).
        log_evidence: ln of the integral over the grid.
        variance: Posterior variance of the parameter.
    """

    index: int
    start: np.ndarray
    log_evidence: float
    variance: float

    def improved(self, found: Fit) -> Fit:
        """A fit with the evidence and the variance from the grid."""
        scale = np.ones(len(found.z))
        scale[self.index] = np.sqrt(self.variance / found.covariance[self.index, self.index])
        return replace(
            found,
            log_evidence=self.log_evidence,
            covariance=found.covariance * np.outer(scale, scale),
        )


class _Problem:
    """Residuals and slopes of one fit; remembers the last point, since both are asked for."""

    def __init__(self, hypothesis, forward, evidence, baseline, lower):
        self.hypothesis, self.forward, self.evidence = hypothesis, forward, evidence
        self.baseline, self.lower = baseline, lower
        self._last: tuple | None = None

    def predict(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if self._last is not None and np.array_equal(self._last[0], z):
            return self._last[1:]
        rows, slopes = [], []
        for row, condition in enumerate(self.evidence.conditions):
            prediction = Prediction(self.hypothesis, self.forward, z, condition, self.baseline, row)
            rows.append(prediction.data)
            slopes.append(prediction.slopes())
        self._last = (z.copy(), np.array(rows), np.concatenate(slopes))
        return self._last[1:]

    def _whiten(self, a):
        return np.linalg.solve(self.lower, a)

    def residual(self, z):
        predicted, _ = self.predict(z)
        used = self.evidence.fitted
        return np.concatenate([self._whiten(predicted[used] - self.evidence.data[used]), z])

    def slope(self, z):
        _, jacobian = self.predict(z)
        whitened = self._whiten(jacobian[self.evidence.fitted.ravel()])
        return np.concatenate([whitened, np.eye(len(z))])

    def scan(self, index: int, limits) -> _Scan:
        """The evidence's integrand over one parameter, the others optimal in a linear model."""
        count = self.hypothesis.priors[index][1].scan
        grid = np.linspace(max(limits[0], -_FARTHEST), min(limits[1], _FARTHEST), count)
        others = np.arange(len(self.hypothesis.priors)) != index
        log_density, points = [], []
        for value in grid:
            z = np.zeros(len(others))
            z[index] = value
            residual, slope = self.residual(z)[: -len(z)], self.slope(z)[: -len(z), others]
            hessian = slope.T @ slope + np.eye(slope.shape[1])
            z[others] = -np.linalg.solve(hessian, slope.T @ residual)
            residual = residual + slope @ z[others]
            log_density.append(
                -0.5 * (residual @ residual + z @ z) - 0.5 * np.linalg.slogdet(hessian)[1]
            )
            points.append(z)
        log_density = np.array(log_density)
        top = log_density.max()
        weight = np.exp(log_density - top)
        total = trapezoid(weight, grid)
        mean = trapezoid(weight * grid, grid) / total
        constant = np.sum(np.log(np.diag(self.lower))) + 0.5 * len(residual) * np.log(2 * np.pi)
        return _Scan(
            index,
            points[int(np.argmax(log_density))],
            float(top + np.log(total) - 0.5 * np.log(2 * np.pi) - constant),
            float(trapezoid(weight * (grid - mean) ** 2, grid) / total),
        )

    def finish(self, z, bounds) -> Fit:
        predicted, jacobian = self.predict(z)
        residual = self.residual(z)
        slope = self.slope(z)
        n = len(residual) - len(z)
        misfit = float(residual[:n] @ residual[:n])
        hessian = slope.T @ slope
        log_det = 2 * np.sum(np.log(np.diag(self.lower)))
        log_evidence = (
            -0.5 * misfit - 0.5 * (log_det + n * np.log(2 * np.pi)) - 0.5 * z @ z
            - 0.5 * np.linalg.slogdet(hessian)[1]
        )  # fmt: skip
        close = np.minimum(z - bounds[:, 0], bounds[:, 1] - z) < 1e-3 if len(z) else []
        at_bound = tuple(
            f"{effect.name}: {prior.name}"
            for (effect, prior), near in zip(self.hypothesis.priors, close, strict=True)
            if near
        )
        if not np.isfinite(log_evidence):
            label = self.hypothesis.label
            raise InputError(f"{label}: the evidence is not finite; check the data.")
        covariance = np.linalg.inv(hessian) if len(z) else np.zeros((0, 0))
        return Fit(
            self.hypothesis, z, covariance, predicted, self.evidence.log_f.shape[1], jacobian,
            float(log_evidence), misfit, n, at_bound,
        )  # fmt: skip
