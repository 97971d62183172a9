"""Where the fits of single effects start."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import qmc

from fenics_joints.diagnosis.evidence.fitted import Fit
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.diagnosis.evidence.least import least_apart, residuals_at, squares
from fenics_joints.diagnosis.evidence.prediction import predict
from fenics_joints.diagnosis.several import Fits
from fenics_joints.errors import InputError
from fenics_joints.parallel import spread

__all__ = ["starts_of"]

#: How far, in standard deviations of its prior, an effect of one parameter is tried either way
#: before it is fitted; how far one of several, and at how many points.
_ASIDE, _FAR, _TRIES = 1.0, 2.5, 8
#: Points at which an effect that may act strongly is solved for, and how many of them are starts.
_LOOKS, _BEST = 32, 2
#: Points that are solved for one by one, at most.
_SINGLY = 4


def starts_of(
    search: Fits, singles: Sequence[Hypothesis], none: Fit, lowers: Sequence[np.ndarray]
) -> list[list[np.ndarray]]:
    """Where the test's misfit is least, for each effect: what fits best without it, one step from
    there, or where some tries lead, since what fits best without it may have been stretched into
    another valley. Of an effect that may act strongly, of many points of its prior: modes that
    change places make of its range many valleys, of which no slope tells. Collective.

    Args:
        search: Fits hypotheses.
        singles: The hypotheses.
        none: The fit without any effect.
        lowers: Cholesky factors of covariances that the evidence may have; the best counts.
    """
    if not singles:
        return []
    from_none = [search.start(h.effects, none) for h in singles]
    steps = [z for _, z in search.looked(singles, from_none, lowers)]
    strong = [h.wide for h in singles]
    weak = [(i, z) for i, h in enumerate(singles) if not strong[i] for z in _tries(h)]
    tried = [singles[i] for i, _ in weak]
    looks = search.looked(tried, [z for _, z in weak], lowers)
    looks = search.looked(tried, [z for _, z in looks], lowers)
    ends = {i: [] for i in range(len(singles))}
    for (i, _), (_, z) in zip(weak, looks, strict=True):
        ends[i].append(z)
    tasks = [
        (h, np.array([z, step, *(_all_over(h, z) if strong[i] else ends[i])]))
        for i, (h, z, step) in enumerate(zip(singles, from_none, steps, strict=True))
    ]
    return spread(search.model.comm, tasks, lambda task: _least(search, *task, lowers[0]))


def _least(search: Fits, hypothesis: Hypothesis, points: np.ndarray, lower) -> list[np.ndarray]:
    """The points, (b, d), of the least squared residuals, apart from one another."""
    residual = _residuals(search, hypothesis, points)
    points = points[: len(residual)]
    size = squares(points, residual, lower)
    found = least_apart(points, size, hypothesis.own, 0.5 * _ASIDE, _BEST)
    return found or [points[0]]


def _residuals(search: Fits, hypothesis: Hypothesis, points: np.ndarray) -> np.ndarray:
    """Prediction less data at points, (b, k); at the first few where they are solved for one by
    one, as where each mode sees another model; nan where the model has no such modes."""
    evidence, baseline = search.model.evidence, search.model.baseline
    used = evidence.fitted
    leans = search.leans
    forward = (leans.of if hypothesis.wide else leans.known)(hypothesis) or search.model.forward
    together = residuals_at(hypothesis, forward, evidence, baseline, points)
    if together is not None:
        return together
    found = np.full((min(len(points), _SINGLY), int(used.sum())), np.nan)
    for i, z in enumerate(points[: len(found)]):
        try:
            predicted, _ = predict(hypothesis, forward, evidence, z, baseline)
        except InputError:
            continue
        found[i] = (predicted - evidence.data)[used]
    return found


def _all_over(hypothesis: Hypothesis, z: np.ndarray) -> list[np.ndarray]:
    """Points spread over the effect's parameters, and along the diagonal of those that may be of
    any size, from where it hardly acts to where it acts most; all others as they are."""
    own = hypothesis.own
    low, high = _limits(hypothesis)
    wide = np.array([p.log and p.spread > 1 for _, p in hypothesis.priors[own]])
    points = [low + (high - low) * unit for unit in _spread(len(low), _LOOKS)]
    points += [np.where(wide, low + (high - low) * t, 0.0) for t in np.linspace(0.0, 1.0, _TRIES)]
    found = np.tile(z, (len(points), 1))
    found[:, own] = points
    return list(found)


def _limits(hypothesis: Hypothesis) -> tuple[np.ndarray, np.ndarray]:
    limits = [prior.limits(_FAR) for _, prior in hypothesis.priors[hypothesis.own]]
    low, high = np.array(limits).reshape(-1, 2).T
    return low, high


def _tries(hypothesis: Hypothesis) -> list[np.ndarray]:
    """Points z spread over the effects' parameters, all others at their medians.

    One parameter to both sides; several by a Sobol sequence all over their range.
    """
    low, high = _limits(hypothesis)
    if len(low) == 1:
        points = np.clip([[-_ASIDE], [_ASIDE]], low, high)
    else:
        points = low + (high - low) * _spread(len(low), _TRIES) if len(low) else []
    return [hypothesis.at(point) for point in points]


def _spread(dimensions: int, count: int) -> np.ndarray:
    """Points inside the unit cube, (count, dimensions), always the same."""
    sequence = qmc.Sobol(dimensions, scramble=False)
    sequence.fast_forward(1)  # the first is the corner
    return sequence.random(count)
