"""Fits a hypothesis to the test and weighs it: non-linear least squares, then Laplace evidence.

Every parameter is worked on as z, its distance from its prior median in prior standard deviations,
so that the prior is standard normal in all of them. The data are the logarithms of frequencies.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.integrate import trapezoid
from scipy.optimize import least_squares
from scipy.stats import chi2

from fenics_joints.diagnosis.effects import Effect, Prior
from fenics_joints.errors import InputError
from fenics_joints.surrogate import Forward

__all__ = ["Evidence", "Fit", "Forward", "Hypothesis", "fit"]

_DIFFERENCE = 1e-5
#: Standard deviations of the prior beyond which a scanned parameter is not looked for.
_FARTHEST = 4.0

#: Stands for the scatter of the preload in tables of parameters.
_TIGHTENING = Effect("preload scatter", "bolts", (), lambda values, theta, condition: None)


@dataclass(frozen=True)
class Hypothesis:
    """The nominal model plus effects, with what is uncertain in any case.

    Attributes:
        effects: The effects; none for "no gap".
        nuisances: Effects within tolerance, free in every hypothesis.
        name: Name for people; by default the effects'.
        unknown: Whether this is the hypothesis that something else is at work: no effect of the
            library, and a wide discrepancy instead.
        scatter: Standard deviation of ln(preload / torque) from one tightening to the next, for
            effects that depend on the torque; about 0.2 with a torque wrench (VDI 2230).
        conditions: The torques of the test, each with a tightening of its own.
    """

    effects: tuple[Effect, ...]
    nuisances: tuple[Effect, ...] = ()
    name: str = ""
    unknown: bool = False
    scatter: float = 0.0
    conditions: tuple[float, ...] = ()

    @property
    def label(self) -> str:
        return self.name or " + ".join(effect.name for effect in self.effects)

    @cached_property
    def tightenings(self) -> tuple[Prior, ...]:
        """A factor on each torque, where the effects depend on it."""
        if self.scatter <= 0 or not any(e.depends_on_condition for e in self.effects):
            return ()
        return tuple(
            Prior(f"preload at {c:g}", 1.0, self.scatter, "", True, (0.2, 5.0))
            for c in self.conditions
        )

    @cached_property
    def priors(self) -> list[tuple[Effect, Prior]]:
        """Every free parameter with its effect: nuisances, effects, then tightenings."""
        own = [(e, p) for e in (*self.nuisances, *self.effects) for p in e.priors]
        return own + [(_TIGHTENING, p) for p in self.tightenings]

    def values(
        self, z: np.ndarray, condition: float, baseline: dict[str, float], row: int | None = None
    ) -> dict:
        """The model's parameter values at ``z`` and a torque.

        Args:
            z: Parameters in prior standard deviations, in the order of `priors`.
            condition: The torque.
            baseline: Parameter values of the nominal model.
            row: Which of ``conditions`` it is; None for a tightening that was not measured.
        """
        values = dict(baseline)
        tightenings = self.tightenings
        if tightenings and row is not None:
            first = len(z) - len(tightenings)
            condition = condition * tightenings[row].value(z[first + row])
        at = 0
        for effect in (*self.nuisances, *self.effects):
            theta = {}
            for prior in effect.priors:
                theta[prior.name] = prior.value(z[at])
                at += 1
            effect.apply(values, theta, condition)
        return values

    def table(self, z: np.ndarray, covariance: np.ndarray) -> list[dict]:
        """The fitted parameters for people, with one-sigma intervals."""
        rows = []
        for i, (effect, prior) in enumerate(self.priors):
            sd = float(np.sqrt(covariance[i, i]))
            low, high = prior.value(z[i] - sd), prior.value(z[i] + sd)
            rows.append(
                {
                    "effect": effect.key,
                    "name": prior.name,
                    "value": float(prior.value(z[i])),
                    "low": float(low),
                    "high": float(high),
                    "unit": prior.unit,
                    "nuisance": effect in (*self.nuisances, _TIGHTENING),
                    "prior_sigmas": float(z[i]),
                }
            )
        return rows


@dataclass(frozen=True)
class Evidence:
    """The test as the inference sees it.

    Attributes:
        conditions: Torque of each row, shape (n,).
        log_f: ln of the measured frequencies, shape (n, m); nan where missing.
        log_sd: Their standard deviations from noise and resolution, shape (n, m).
        discrepancy: Standard deviation, of ln f, of the error that every model of this structure
            has. Half of its variance is the same at all torques and half changes slowly with the
            torque, so that more torques do not average it out.
        used: Which entries are fitted, shape (n, m); the others are held out.
    """

    conditions: np.ndarray
    log_f: np.ndarray
    log_sd: np.ndarray
    discrepancy: float
    used: np.ndarray = field(default=None)

    def __post_init__(self):
        if self.used is None:
            object.__setattr__(self, "used", np.isfinite(self.log_f))

    def without(self, held_out: np.ndarray) -> Evidence:
        """The same test with some entries held out, mask of shape (n, m)."""
        used = self.used & ~held_out
        return Evidence(self.conditions, self.log_f, self.log_sd, self.discrepancy, used)

    def covariance(self, unknown: bool = False) -> np.ndarray:
        """Covariance of the fitted entries, shape (k, k)."""
        n, m = self.log_f.shape
        mode = np.tile(np.arange(m), n)
        same_mode = mode[:, None] == mode[None, :]
        total = np.diag(self.log_sd.ravel() ** 2)
        total = total + self.discrepancy**2 * _slow(self.conditions, m) * same_mode
        if unknown:
            total = total + _wide(self.conditions, m) * same_mode
        used = self.used.ravel()
        return total[np.ix_(used, used)]


#: What an unknown cause may do to each mode on its own: a shift (10 %), a trend with the logarithm
#: of the torque (5 % per factor e), and a bend of it (2 %).
_UNKNOWN = (0.10, 0.05, 0.02)


#: Change of the logarithm of the torque over which a model's error forgets itself.
_MEMORY = 0.7


def _log(conditions: np.ndarray) -> np.ndarray:
    """Centred logarithm of the conditions; zero when they are not all positive."""
    if len(conditions) < 2 or np.any(conditions <= 0):
        return np.zeros(len(conditions))
    return np.log(conditions) - np.mean(np.log(conditions))


def _slow(conditions: np.ndarray, m: int) -> np.ndarray:
    x = _log(conditions)
    rows = 0.5 + 0.5 * np.exp(-0.5 * ((x[:, None] - x[None, :]) / _MEMORY) ** 2)
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
        log_f: Predicted ln f at all conditions, held out or not, shape (n, m).
        jacobian: Derivative of all predictions by z, shape (n * m, d).
        log_evidence: ln of the marginal likelihood of the fitted entries.
        misfit: Squared whitened residual of the fitted entries.
        n_data: Number of fitted entries.
        at_bound: Names of parameters at a limit of their prior.
    """

    hypothesis: Hypothesis
    z: np.ndarray
    covariance: np.ndarray
    log_f: np.ndarray
    jacobian: np.ndarray
    log_evidence: float
    misfit: float
    n_data: int
    at_bound: tuple[str, ...] = ()

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
            values = self.hypothesis.values(z, condition, self.baseline, row)
            log_f, by_values = self.forward(values)
            rows.append(log_f)
            slopes.append(by_values @ self._chain(z, condition, row))
        self._last = (z.copy(), np.array(rows), np.concatenate(slopes))
        return self._last[1:]

    def _chain(self, z, condition, row) -> np.ndarray:
        """Derivative of the model's values by z, shape (n_parameters, d): central differences of
        formulas, no model solution."""
        names = list(self.forward.model.parameters)
        chain = np.zeros((len(names), len(z)))
        first = len(z) - len(self.hypothesis.tightenings)
        for j in range(len(z)):
            if j >= first and j != first + row:
                continue  # another tightening's scatter
            step = np.zeros(len(z))
            step[j] = _DIFFERENCE
            up = self.hypothesis.values(z + step, condition, self.baseline, row)
            down = self.hypothesis.values(z - step, condition, self.baseline, row)
            chain[:, j] = [(up[n] - down[n]) / (2 * _DIFFERENCE) for n in names]
        return chain

    def _whiten(self, a):
        return np.linalg.solve(self.lower, a)

    def residual(self, z):
        log_f, _ = self.predict(z)
        used = self.evidence.used
        return np.concatenate([self._whiten(log_f[used] - self.evidence.log_f[used]), z])

    def slope(self, z):
        _, jacobian = self.predict(z)
        whitened = self._whiten(jacobian[self.evidence.used.ravel()])
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
        log_f, jacobian = self.predict(z)
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
            self.hypothesis, z, covariance, log_f, jacobian,
            float(log_evidence), misfit, n, at_bound,
        )  # fmt: skip
