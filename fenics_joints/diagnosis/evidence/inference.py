"""Fits a hypothesis to the test and weighs it: non-linear least squares, then Laplace evidence.

Every parameter is worked on as z, its distance from its prior median in prior standard deviations,
so that the prior is standard normal in all of them. The data are those of
`fenics_joints.diagnosis.evidence.evidence`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.optimize import least_squares

from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.fitted import Fit
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.diagnosis.evidence.linear import evidence_about, least_square, log_evidence
from fenics_joints.diagnosis.evidence.problem import Problem, Scan, Scanned
from fenics_joints.diagnosis.evidence.scales import Scales, weighed
from fenics_joints.diagnosis.evidence.screen import whitened
from fenics_joints.diagnosis.evidence.somewhere import with_somewhere
from fenics_joints.errors import InputError
from fenics_joints.reduction.forward import Forward

__all__ = ["fit", "moved", "refreshed", "settled"]

#: Times that a search goes on beyond an edge; half a squared misfit per datum that is bad enough;
#: where it looks, in linear steps; and the gain that is worth it.
_LEAPS, _BAD, _WAYS, _WORTH = 6, 0.3, (1.0, 0.5, 0.25, 0.12, 0.06), 0.02
#: How much less probable, in ln, another end may be, and how far away in prior standard deviations.
_CLOSE, _ELSEWHERE = 6.0, 0.3
#: Gain, in nats, and step, in prior standard deviations, up to which a fit to a part of the data is
#: linear about that to all of them: what is bent in between is a small part of that gain.
_NEAR, _STRIDE = 0.3, 0.5
#: Nats that a better model may change where a fit ended, and that a search from there may gain, for
#: its end to be one of that model.
_UNMOVED, _GAIN = 0.5, 0.02
#: Fits of one hypothesis with the scales that the one before called for.
_ROUNDS = 3


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
    places: bool = True,
    progress: Callable[[], None] | None = None,
) -> Fit:
    """Most probable parameters of a hypothesis and its Laplace evidence.

    The evidence is ln Z = ln N(r; 0, Sigma) - |z|^2 / 2 - ln det(J^T Sigma^-1 J + I) / 2 at the
    maximum, with the Gauss-Newton Hessian. Over a parameter that acts in steps (`Prior.scan`) of an
    effect alone it is integrated on a grid instead, the others linear about their medians. Over the
    test's `scales` it is summed, linear about the fit to the most probable.

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
        places: Whether to start from the best of all places as well, of an effect that has one, if
            nothing is known of it.
        progress: Called when done.
    """
    found = _fit_at(
        hypothesis, forward, evidence, baseline, starts, tolerance, known, guide, scanned,
        places and known is None,
    )  # fmt: skip
    if evidence.scales is not None:
        tried, ends = evidence.scales.tried(), found.ends
        for again in range(_ROUNDS):
            best, over = weighed(tried, partial(_linear, found, evidence))
            if best == found.scales or again == _ROUNDS - 1:
                break
            test = evidence.at(best)
            found = _fit_at(
                hypothesis, forward, test, baseline, [found.z], tolerance, found, guide, scanned
            )
        found = replace(_over_all(found, evidence, over), ends=ends)
    if hypothesis.unknown:
        found = with_somewhere(found, evidence)
    if progress:
        progress()
    return found


def _linear(found: Fit, evidence: Evidence, scales: Scales) -> float:
    """ln of the evidence with some standard deviations, linear about a fit."""
    lower = evidence.at(scales).lower(found.hypothesis.unknown)
    free = ~found.hypothesis.at_limit(found.z)
    return evidence_about(*whitened(found, evidence, lower), found.z, lower, free)


def _over_all(found: Fit, evidence: Evidence, over: Callable[[Scales], float]) -> Fit:
    """A fit with the evidence of all scales, and with what it would leave by what is stated."""
    widening, stated = over(found.scales), None
    if not evidence.drifts:
        scales = found.scales.stated
        lower = evidence.at(scales).lower(found.hypothesis.unknown)
        free = ~found.hypothesis.at_limit(found.z)
        stated = least_square(*whitened(found, evidence, lower), found.z, free)[0] + scales.squares
    return replace(
        found, log_evidence=found.log_evidence + widening, widening=widening, stated=stated
    )


def refreshed(found: Fit, forward: Forward, evidence: Evidence, baseline) -> Fit:
    """A fit with what a model says at its parameters; all else stays as it is.

    Args:
        found: The fit, perhaps by an earlier model.
        forward: Predicts frequencies.
        evidence: The test.
        baseline: Parameter values of the nominal model.
    """
    problem = Problem(found.hypothesis, forward, evidence, baseline, None)
    predicted, jacobian = problem.predict(found.z)
    return replace(found, predicted=predicted, jacobian=jacobian)


def settled(
    found: Fit, forward: Forward, evidence: Evidence, baseline: dict[str, float],
    tolerance: float = 1e-5,
) -> Fit | None:
    """A fit by a better model if a search by that would end where the one by the model before did,
    and about as high; None where it has to be searched for anew.

    Args:
        found: The fit by the model before.
        forward: Predicts frequencies.
        evidence: The test.
        baseline: Parameter values of the nominal model.
        tolerance: See `fit`.
    """
    h, z, test = found.hypothesis, found.z, evidence.at(found.scales)
    lower = test.lower(h.unknown)
    problem = Problem(h, forward, test, baseline, lower)
    try:
        again = problem.finish(z)
    except (InputError, np.linalg.LinAlgError):
        return None
    square = again.misfit + z @ z
    least, _ = least_square(*whitened(again, test, lower), z, ~h.at_limit(z))
    if square - least > max(2 * _GAIN, tolerance * square):
        return None
    change = square - found.misfit - z @ z
    if abs(change) > 2 * _UNMOVED:
        return None
    if len(h.effects) == 1 and any(p.scan and not p.even for _, p in h.priors):
        # All of the grid is as much better as its peak is.
        return replace(
            again, covariance=found.covariance, log_evidence=found.log_evidence - 0.5 * change,
            widening=found.widening, stated=found.stated, ends=found.ends,
        )  # fmt: skip
    if test.scales is not None:
        best, over = weighed(test.scales.tried(), partial(_linear, again, test))
        if best != again.scales:
            return None
        again = _over_all(again, test, over)
    again = replace(again, ends=found.ends)
    return with_somewhere(again, evidence) if h.unknown else again


def moved(found: Fit, evidence: Evidence) -> Fit | None:
    """A fit to other data of the same test, linear about what it is; None where that is too far.

    Args:
        found: The fit, to all data.
        evidence: A part of them.
    """
    h = found.hypothesis
    if evidence.drifts or any(p.scan for _, p in h.priors) or not len(found.z):
        return None
    near = _moved_at(found, evidence.at(found.scales))
    if near is None:
        return None
    if evidence.scales is None:
        return with_somewhere(near, evidence) if h.unknown else near
    best, over = weighed(evidence.scales.tried(), partial(_linear, near, evidence))
    if best != near.scales:
        near = _moved_at(found, evidence.at(best))
    if near is None:
        return None
    near = _over_all(near, evidence, over)
    return with_somewhere(near, evidence) if h.unknown else near


def _moved_at(found: Fit, evidence: Evidence) -> Fit | None:
    """`moved` with the test's scales as they are."""
    h, z = found.hypothesis, found.z
    lower = evidence.lower(h.unknown)
    residual, slope = whitened(found, evidence, lower)
    hessian = slope.T @ slope + np.eye(len(z))
    pull = slope.T @ residual + z
    step = -np.linalg.solve(hessian, pull)
    if h.at_limit(z + step).any() or -0.5 * pull @ step > _NEAR or np.max(np.abs(step)) > _STRIDE:
        return None
    left, z = residual + slope @ step, z + step
    return replace(
        found, z=z, covariance=np.linalg.inv(hessian),
        predicted=found.predicted + found.jacobian @ step,
        log_evidence=log_evidence(left @ left + z @ z, hessian, lower),
        misfit=float(left @ left), n_data=len(left), at_bound=(), ends=(), scales=evidence.scales,
    )  # fmt: skip


def _fit_at(
    hypothesis, forward, evidence, baseline, starts, tolerance, known=None, guide=None,
    scanned=None, places=False,
) -> Fit:
    """`fit` with the test's scales as they are."""
    lower = evidence.lower(hypothesis.unknown)
    whole = Problem(hypothesis, forward, evidence, baseline, lower, known, scanned)
    if guide is not None:
        quick = Problem(hypothesis, guide, evidence, baseline, lower, known, scanned, "guide")
        try:
            scan, ends = _searched(quick, starts, tolerance, places)
            z = min(ends, key=lambda end: end[0])[1]
            # A guide may follow another mode than the model does: no end is worse than a start.
            costs = [whole.cost(start) for start in starts or ()]
            end = 0.5 * np.sum(whole.residual(z) ** 2)
            better = [start for start, cost in zip(starts or (), costs, strict=True) if cost < end]
            if not better and whole.ends_with(quick, z, tolerance) and (
                scan is None or whole.agrees(quick, scan.start)
            ):
                return _finished(whole, scan, ends)
            starts = [z, *better]
        except (InputError, np.linalg.LinAlgError):
            pass  # beyond what the guide was made for
    return _finished(whole, *_searched(whole, starts, tolerance, places))


def _searched(problem: Problem, starts, tolerance: float, places: bool):
    """What was found over a parameter that acts in steps, or None; and (cost, z) of each end."""
    hypothesis = problem.hypothesis
    bounds = hypothesis.limits
    scanned = [j for j, (_, p) in enumerate(hypothesis.priors) if p.scan]
    placed = any(hypothesis.priors[j][1].even for j in scanned)
    scan = None
    if placed and len(hypothesis.effects) == 1 and places:
        # In several effects, and in a part of the data, it is where that found it.
        starts = [*problem.places(scanned), *(starts or ())]
    elif scanned and not placed and len(hypothesis.effects) == 1:
        scan = problem.scan(scanned[0], bounds[scanned[0]])
        starts = [scan.start, *(starts or ())]
    ends: list[tuple[float, np.ndarray]] = []
    for start in starts or (np.zeros(len(bounds)),):
        if len(bounds) == 0:
            return scan, [(0.0, start)]
        ends.append(_descended(problem, problem.inside(start), bounds, tolerance))
    return scan, ends


def _descended(problem: Problem, start, bounds, tolerance: float) -> tuple[float, np.ndarray]:
    """Where the search ends from a start, (cost, z).

    Where modes change places the residual jumps, and a search by small steps ends at the first
    edge: from an end that explains the test badly it goes on beyond, while it gets better there.
    From where a search has ended before it does not: that one looked.
    """
    z, cost = start, np.inf
    for left in reversed(range(1 if problem.knows else _LEAPS)):
        result = least_squares(
            problem.residual, z, problem.slope, bounds=tuple(bounds.T), method="trf",
            x_scale=1.0, ftol=tolerance, xtol=tolerance, gtol=tolerance, max_nfev=30,
        )  # fmt: skip
        z, cost = result.x, float(result.cost)
        if not left or cost <= _BAD * (len(result.fun) - len(z)):
            break
        beyond = _beyond(problem, z, cost)
        if beyond is None:
            break
        z = beyond
    return cost, z


def _beyond(problem: Problem, z, cost: float) -> np.ndarray | None:
    """The best of some points along the step that a linear model would take, if one is better."""
    residual, slope = problem.residual(z), problem.slope(z)
    step = -np.linalg.solve(slope.T @ slope, slope.T @ residual)
    points = [problem.inside(z + way * step) for way in _WAYS]
    costs = [problem.cost(point) for point in points]
    best = int(np.argmin(costs))
    return points[best] if costs[best] < (1 - _WORTH) * cost else None


def _finished(problem: Problem, scan: Scan | None, ends) -> Fit:
    cost, z = min(ends, key=lambda end: end[0])
    found = replace(problem.finish(z), ends=_others(ends, cost, z, problem.hypothesis.own))
    return found if scan is None else problem.scan_near(scan, found).improved(found)


def _others(ends, cost, z, own: slice) -> tuple[np.ndarray, ...]:
    """Ends nearly as good as the best that are elsewhere in the effects' parameters."""
    found = [z]
    for other, x in sorted(ends, key=lambda end: end[0]):
        away = min(np.max(np.abs((x - at)[own]), initial=0.0) for at in found)
        if other < cost + _CLOSE and away > _ELSEWHERE:
            found.append(x)
    return tuple(found[1:])
