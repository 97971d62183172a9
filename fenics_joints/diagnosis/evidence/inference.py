"""Fits a hypothesis to the test and weighs it: non-linear least squares, then Laplace evidence.

Every parameter is worked on as z, its distance from its prior median in prior standard deviations,
so that the prior is standard normal in all of them. The data are those of
`fenics_joints.diagnosis.evidence.evidence`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

import numpy as np
from scipy.integrate import trapezoid
from scipy.optimize import least_squares
from scipy.special import ndtri
from scipy.stats import chi2

from fenics_joints.diagnosis.evidence.between import Scales, grid, squares, weighed
from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.diagnosis.evidence.linear import evidence_about, log_evidence, whiten
from fenics_joints.diagnosis.evidence.prediction import frequencies_and_damping, predict
from fenics_joints.errors import InputError
from fenics_joints.reduction.forward import Forward

__all__ = ["Fit", "Scanned", "fit", "moved", "refreshed"]

#: Standard deviations of the prior beyond which a scanned parameter is not looked for.
_FARTHEST = 4.0
#: Of the places that are looked at so many are started from.
_STARTS = 3
#: Distance of starts from limits; times that a search goes on beyond an edge; half a squared misfit
#: per datum that is bad enough to; where it looks, in linear steps; and the gain that is worth it.
_INSIDE = np.array([[1e-6], [-1e-6]])
_LEAPS, _BAD, _WAYS, _WORTH = 6, 0.3, (1.0, 0.5, 0.25, 0.12, 0.06), 0.02
#: Step of differences, in standard deviations of the prior.
_STEP = 1e-4
#: How much less probable, in ln, another end may be, and how far away in prior standard deviations.
_CLOSE, _ELSEWHERE = 6.0, 0.3
#: Nats by which a guide may differ from the model where a fit ended, or where it was integrated.
_SAME = 0.02
#: Gain, in nats, and step, in prior standard deviations, up to which a fit to a part of the data is
#: linear about that to all of them: what is bent in between is a small part of that gain.
_NEAR, _STRIDE = 0.3, 0.5
#: Fits of one hypothesis with standard deviations between levels that the one before called for.
_ROUNDS = 3


@dataclass(frozen=True, repr=False)
class Fit:
    """A hypothesis at its most probable parameters.

    Attributes:
        hypothesis: The hypothesis.
        z: Parameters in prior standard deviations, shape (d,).
        covariance: Posterior covariance of z (Laplace), shape (d, d).
        predicted: Everything predicted, held out or not, as `Evidence.data`, shape (N,).
        shape: Numbers of conditions and modes, (n, m).
        jacobian: Derivative of `predicted` by z, shape (N, d).
        log_evidence: ln of the marginal likelihood of the fitted entries.
        misfit: Squared whitened residual of the fitted entries.
        n_data: Number of fitted entries.
        at_bound: Names of parameters at a limit of their prior.
        between: Of a test by level, the most probable standard deviations between levels.
        widening: ln of the evidence over that at those standard deviations.
        ends: Other points at which the search ended, from other starts, nearly as probable, each
            (d,).
    """

    hypothesis: Hypothesis
    z: np.ndarray
    covariance: np.ndarray
    predicted: np.ndarray
    shape: tuple[int, int]
    jacobian: np.ndarray
    log_evidence: float
    misfit: float
    n_data: int
    at_bound: tuple[str, ...] = ()
    between: Scales | None = None
    widening: float = 0.0
    ends: tuple[np.ndarray, ...] = ()

    def __repr__(self) -> str:
        label = self.hypothesis.label
        return f"Fit({label}: ln Z {self.log_evidence:.2f}, misfit {self.misfit:.1f})"

    @property
    def log_f(self) -> np.ndarray:
        """Predicted ln f, shape (n, m)."""
        n, m = self.shape
        return self.predicted[: n * m].reshape(n, m)

    @property
    def log_damping(self) -> np.ndarray | None:
        """Predicted ln of the damping ratios, shape (n, m); None if they are not predicted."""
        n, m = self.shape
        if not self.hypothesis.damped:
            return None
        return self.predicted[n * m : 2 * n * m].reshape(n, m)

    @property
    def p_value(self) -> float:
        """Probability of a misfit as large as this, if the hypothesis were right.

        In the linear-Gaussian case misfit + |z|^2 is the data's distance from the prediction in
        the metric of noise and prior together, and distributed as chi-square with n_data degrees.
        Standard deviations between levels that had to be far from what is expected count as well.
        """
        scales = 0.0 if self.between is None else squares(self.between)
        return float(chi2.sf(self.misfit + self.z @ self.z + scales, self.n_data))


def fit(
    hypothesis: Hypothesis,
    forward: Forward,
    evidence: Evidence,
    baseline: dict[str, float],
    *,
    starts: Sequence[np.ndarray] | None = None,
    tolerance: float = 1e-5,
    known: Fit | None = None,
    guide: Forward | None = None,
    scanned: Scanned | None = None,
    progress: Callable[[], None] | None = None,
) -> Fit:
    """Most probable parameters of a hypothesis and its Laplace evidence.

    The evidence is ln Z = ln N(r; 0, Sigma) - |z|^2 / 2 - ln det(J^T Sigma^-1 J + I) / 2 at the
    maximum, with the Gauss-Newton Hessian. Over a parameter that acts in steps (`Prior.scan`) it is
    integrated on a grid instead, the others linear about their medians. Over the standard
    deviations between the levels of a test it is summed, linear about the fit to the most probable.

    Args:
        hypothesis: What is fitted.
        forward: Predicts frequencies.
        evidence: The test.
        baseline: Parameter values of the nominal model.
        starts: Points z to start from; the best end counts. The prior's median by default.
        tolerance: Relative change of the sum of squares, and of z, at which the search ends.
        known: The same hypothesis at one of the starts, by this very model, to other data: it is
            not solved for there again.
        guide: Predicts nearly the same with less work (`Leans`): it shows the way, and ``forward``
            says whether its end is one, and goes on from there if it is not. None for none.
        scanned: Remembers predictions on grids, of these very models; None to remember nothing.
        progress: Called when done.
    """
    found = _fit_at(
        hypothesis, forward, evidence, baseline, starts, tolerance, known, guide, scanned
    )
    if evidence.between is not None:
        tried, ends = grid(damped=len(evidence.between) > 1), found.ends
        for again in range(_ROUNDS):
            best, over = weighed(tried, partial(_linear, found, evidence))
            if best == found.between or again == _ROUNDS - 1:
                break
            test = evidence.at(best)
            found = _fit_at(
                hypothesis, forward, test, baseline, [found.z], tolerance, found, guide, scanned
            )
        widening = over(found.between)
        found = replace(
            found, log_evidence=found.log_evidence + widening, widening=widening, ends=ends
        )
    if progress:
        progress()
    return found


def _linear(found: Fit, evidence: Evidence, between: Scales) -> float:
    """ln of the evidence with some standard deviations between levels, linear about a fit."""
    lower = np.linalg.cholesky(evidence.at(between).covariance(found.hypothesis.unknown))
    used = evidence.fitted
    residual = whiten(lower, (found.predicted - evidence.data)[used])
    return evidence_about(residual, whiten(lower, found.jacobian[used]), found.z, lower)


def refreshed(found: Fit, forward: Forward, evidence: Evidence, baseline) -> Fit:
    """A fit with what a model says at its parameters; all else stays as it is.

    Args:
        found: The fit, perhaps by an earlier model.
        forward: Predicts frequencies.
        evidence: The test.
        baseline: Parameter values of the nominal model.
    """
    problem = _Problem(found.hypothesis, forward, evidence, baseline, None)
    predicted, jacobian = problem.predict(found.z)
    return replace(found, predicted=predicted, jacobian=jacobian)


def moved(found: Fit, evidence: Evidence) -> Fit | None:
    """A fit to other data of the same test, linear about what it is; None where that is too far.

    Args:
        found: The fit, to all data.
        evidence: A part of them.
    """
    h, z = found.hypothesis, found.z
    if evidence.between is not None or any(p.scan for _, p in h.priors) or not len(z):
        return None
    used = evidence.fitted
    lower = np.linalg.cholesky(evidence.covariance(h.unknown))
    both = np.column_stack([(found.predicted - evidence.data)[used], found.jacobian[used]])
    white = whiten(lower, both)
    residual, slope = white[:, 0], white[:, 1:]
    hessian = slope.T @ slope + np.eye(len(z))
    pull = slope.T @ residual + z
    step = -np.linalg.solve(hessian, pull)
    low, high = h.limits.T
    inside = np.all((z + step > low + 1e-3) & (z + step < high - 1e-3))
    if not inside or -0.5 * pull @ step > _NEAR or np.max(np.abs(step)) > _STRIDE:
        return None
    left, z = residual + slope @ step, z + step
    return replace(
        found, z=z, covariance=np.linalg.inv(hessian),
        predicted=found.predicted + found.jacobian @ step,
        log_evidence=log_evidence(left @ left + z @ z, hessian, lower),
        misfit=float(left @ left), n_data=len(left), at_bound=(), ends=(),
    )  # fmt: skip


def _fit_at(
    hypothesis, forward, evidence, baseline, starts, tolerance, known=None, guide=None,
    scanned=None,
) -> Fit:
    """`fit` with the test's standard deviations between levels as they are."""
    lower = np.linalg.cholesky(evidence.covariance(hypothesis.unknown))
    whole = _Problem(hypothesis, forward, evidence, baseline, lower, known, scanned)
    if guide is not None:
        quick = _Problem(hypothesis, guide, evidence, baseline, lower, known, scanned, "guide")
        try:
            scan, ends = _searched(quick, starts, tolerance, known is None)
            z = min(ends, key=lambda end: end[0])[1]
            # A guide may follow another mode than the model does: no end is worse than a start.
            costs = [whole.cost(start) for start in starts or ()]
            end = whole.cost(z)
            better = [start for start, cost in zip(starts or (), costs, strict=True) if cost < end]
            if not better and whole.ends_with(quick, z, tolerance) and (
                scan is None or whole.agrees(quick, scan.start)
            ):
                return _finished(whole, scan, ends)
            starts = [z, *better]
        except (InputError, np.linalg.LinAlgError):
            pass  # beyond what the guide was made for
    return _finished(whole, *_searched(whole, starts, tolerance, known is None))


def _searched(problem: _Problem, starts, tolerance: float, anew: bool):
    """What was found over a parameter that acts in steps, or None; and (cost, z) of each end."""
    hypothesis = problem.hypothesis
    bounds = hypothesis.limits
    scanned = [j for j, (_, p) in enumerate(hypothesis.priors) if p.scan]
    placed = any(hypothesis.priors[j][1].even for j in scanned)
    scan = None
    if placed and len(hypothesis.effects) == 1 and anew:
        # In several effects, and in a part of the data, it is where that found it.
        starts = [*problem.places(scanned), *(starts or ())]
    elif scanned and not placed:
        scan = problem.scan(scanned[0], bounds[scanned[0]])
        starts = [scan.start, *(starts or ())]
    ends: list[tuple[float, np.ndarray]] = []
    for start in starts or (np.zeros(len(bounds)),):
        if len(bounds) == 0:
            return scan, [(0.0, start)]
        ends.append(_descended(problem, problem.inside(start), bounds, tolerance))
    return scan, ends


def _descended(problem: _Problem, start, bounds, tolerance: float) -> tuple[float, np.ndarray]:
    """Where the search ends from a start, (cost, z).

    Where modes change places the residual jumps, and a search by small steps ends at the first
    edge: from an end that explains the test badly it goes on beyond, while it gets better there.
    """
    z, cost = start, np.inf
    for _ in range(_LEAPS):
        result = least_squares(
            problem.residual, z, problem.slope, bounds=tuple(bounds.T), method="trf",
            x_scale=1.0, ftol=tolerance, xtol=tolerance, gtol=tolerance, max_nfev=30,
        )  # fmt: skip
        z, cost = result.x, float(result.cost)
        if cost <= _BAD * (len(result.fun) - len(z)):
            break
        beyond = _beyond(problem, z, cost)
        if beyond is None:
            break
        z = beyond
    return cost, z


def _beyond(problem: _Problem, z, cost: float) -> np.ndarray | None:
    """The best of some points along the step that a linear model would take, if one is better."""
    residual, slope = problem.residual(z), problem.slope(z)
    step = -np.linalg.solve(slope.T @ slope, slope.T @ residual)
    points = [problem.inside(z + way * step) for way in _WAYS]
    costs = [problem.cost(point) for point in points]
    best = int(np.argmin(costs))
    return points[best] if costs[best] < (1 - _WORTH) * cost else None


def _finished(problem: _Problem, scan: _Scan | None, ends) -> Fit:
    cost, z = min(ends, key=lambda end: end[0])
    found = replace(problem.finish(z), ends=_others(ends, cost, z, problem.hypothesis.own))
    return found if scan is None else scan.improved(found)


def _others(ends, cost, z, own: slice) -> tuple[np.ndarray, ...]:
    """Ends nearly as good as the best that are elsewhere in the effects' parameters."""
    found = [z]
    for other, x in sorted(ends, key=lambda end: end[0]):
        away = min(np.max(np.abs((x - at)[own]), initial=0.0) for at in found)
        if other < cost + _CLOSE and away > _ELSEWHERE:
            found.append(x)
    return tuple(found[1:])


class Scanned:
    """Predictions at points of grids over parameters that act in steps, where all others are at
    their medians: no data move them, so that what is fitted to parts of a test asks for them again.

    Args:
        evidence: The whole test.
        baseline: Parameter values of the nominal model.
    """

    def __init__(self, evidence: Evidence, baseline: dict[str, float]):
        self._evidence, self._baseline = evidence, baseline
        self._known: dict[tuple, tuple[np.ndarray, np.ndarray]] = {}

    def __call__(
        self, hypothesis: Hypothesis, forward: Forward, z: np.ndarray, role: str
    ) -> tuple[np.ndarray, np.ndarray]:
        """See `predict`.

        Args:
            hypothesis: The hypothesis.
            forward: Predicts.
            z: The point.
            role: Which of the hypothesis' models this forward is of.
        """
        key = hypothesis.label_of_keys, role, z.tobytes()
        if key not in self._known:
            self._known[key] = predict(hypothesis, forward, self._evidence, z, self._baseline)
        return self._known[key]


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

    def __init__(self, hypothesis, forward, evidence, baseline, lower, known: Fit | None = None,
                 scanned: Scanned | None = None, role: str = "whole"):  # fmt: skip
        self._scanned, self._role = scanned, role
        self.hypothesis, self.forward, self.evidence = hypothesis, forward, evidence
        self.baseline, self.lower = baseline, lower
        self._last = None if known is None else (known.z, known.predicted, known.jacobian)
        self._slips = hypothesis.damped and any(e.by_level and e.loss for e in hypothesis.effects)

    def predict(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if self._last is None or not np.array_equal(self._last[0], z):
            found = predict(self.hypothesis, self.forward, self.evidence, z, self.baseline)
            if self._slips:
                found = found[0], self._with_differences(z, *found)
            self._last = (z.copy(), *found)
        return self._last[1:]

    def _with_differences(self, z, predicted, jacobian) -> np.ndarray:
        """Slopes in which those of damping by the effects' own parameters are differences.

        `RowPrediction` takes a joint's share of the energy for that of one spring in series: with
        compliances across and along, what slips may have the other sign.
        """
        n = self.evidence.log_f.size
        jacobian = jacobian.copy()
        for j in range(*self.hypothesis.own.indices(len(z))):
            step = np.where(np.arange(len(z)) == j, _STEP if z[j] < 0 else -_STEP, 0.0)
            moved = frequencies_and_damping(
                self.hypothesis, self.forward, self.evidence, z + step, self.baseline
            )
            jacobian[n : 2 * n, j] = (moved[n:] - predicted[n : 2 * n]) / step[j]
        return jacobian

    def residual(self, z):
        predicted, _ = self.predict(z)
        used = self.evidence.fitted
        return np.concatenate([whiten(self.lower, (predicted - self.evidence.data)[used]), z])

    def inside(self, z) -> np.ndarray:
        """The point within the limits that is nearest."""
        return np.clip(z, *(self.hypothesis.limits.T + _INSIDE))

    def cost(self, z) -> float:
        """Half the sum of squares that a search makes small, inside the limits."""
        return 0.5 * float(np.sum(self.residual(self.inside(z)) ** 2))

    def slope(self, z):
        _, jacobian = self.predict(z)
        return np.concatenate(
            [whiten(self.lower, jacobian[self.evidence.fitted]), np.eye(len(z))]
        )

    def ends_with(self, other: _Problem, z: np.ndarray, tolerance: float) -> bool:
        """Whether a search that another model ends at a point would end there, but for a small part
        of a nat, or of what the search itself leaves: its value there is one's own in any case."""
        own, slope = self.residual(z), self.slope(z)
        turn = slope.T @ own - other.slope(z).T @ other.residual(z)
        gain = turn @ np.linalg.solve(slope.T @ slope, turn)
        return bool(gain <= max(2 * _SAME, tolerance * (own @ own)))

    def agrees(self, other: _Problem, z: np.ndarray) -> bool:
        """Whether another model has the same evidence at a point, but for a small part of a nat."""
        own, residual = self.residual(z), other.residual(z)
        return bool(abs(own @ own - residual @ residual) <= 2 * _SAME)

    def scan(self, index: int, limits) -> _Scan:
        """The evidence's integrand over one parameter, the others optimal in a linear model."""
        count = self.hypothesis.priors[index][1].scan
        grid = np.linspace(max(limits[0], -_FARTHEST), min(limits[1], _FARTHEST), count)
        looks = [self._at({index: value}) for value in grid]
        log_density, points = np.array([look[0] for look in looks]), [z for _, z in looks]
        top = log_density.max()
        weight = np.exp(log_density - top)
        total = trapezoid(weight, grid)
        mean = trapezoid(weight * grid, grid) / total
        return _Scan(
            index,
            points[int(np.argmax(log_density))],
            float(top + np.log(total) - 0.5 * np.log(2 * np.pi)),
            float(trapezoid(weight * (grid - mean) ** 2, grid) / total),
        )

    def places(self, indices: Sequence[int]) -> list[np.ndarray]:
        """The most probable points over parameters that say where, and others that act in steps, at
        as many values of each as their priors say; the others optimal in a linear model."""
        priors = [self.hypothesis.priors[j][1] for j in indices]
        axes = [ndtri((np.arange(p.scan) + 0.5) / p.scan) for p in priors]
        looks = [self._at(dict(zip(indices, point, strict=True))) for point in product(*axes)]
        order = np.argsort([-value for value, _ in looks], kind="stable")
        return [looks[i][1] for i in order[:_STARTS]]

    def _at(self, fixed: dict[int, float]) -> tuple[float, np.ndarray]:
        """ln of the evidence at values of some parameters, the others linear about their medians,
        and the most probable z there."""
        z = np.zeros(len(self.hypothesis.priors))
        z[list(fixed)] = list(fixed.values())
        if self._scanned is not None and not self._slips:
            self._last = z.copy(), *self._scanned(self.hypothesis, self.forward, z, self._role)
        others = np.delete(np.arange(len(z)), list(fixed))
        residual, slope = self.residual(z)[: -len(z)], self.slope(z)[: -len(z), others]
        hessian = slope.T @ slope + np.eye(slope.shape[1])
        z[others] = -np.linalg.solve(hessian, slope.T @ residual)
        residual = residual + slope @ z[others]
        return log_evidence(residual @ residual + z @ z, hessian, self.lower), z

    def finish(self, z) -> Fit:
        predicted, jacobian = self.predict(z)
        residual, slope = self.residual(z), self.slope(z)
        n = len(self.lower)
        hessian = slope.T @ slope
        found = log_evidence(residual @ residual, hessian, self.lower)
        low, high = self.hypothesis.limits.T
        close = np.minimum(z - low, high - z) < 1e-3
        at_bound = tuple(
            f"{effect.name}: {prior.name}"
            for (effect, prior), near in zip(self.hypothesis.priors, close, strict=True)
            if near
        )
        if not np.isfinite(found):
            label = self.hypothesis.label
            raise InputError(f"{label}: the evidence is not finite; check the data.")
        return Fit(
            self.hypothesis, z, np.linalg.inv(hessian), predicted, self.evidence.shape, jacobian,
            found, float(residual[:n] @ residual[:n]), n, at_bound, self.evidence.between,
        )  # fmt: skip
