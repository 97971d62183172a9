"""Other starts for a fit that ends far from its data, and modes exchanged between two minima.

Without shapes, modes of test and model are paired by order. Where two modes exchange places, the
sum of squares has a valley on either side, each with its own minimum. A fit from one start finds
the minimum on its side, however wrong: it fits one mode to the frequency of the other.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import qmc

from fenics_joints.measurements.gap import mac, nearest
from fenics_joints.modal.modes import Modes
from fenics_joints.reduction.matched import PLACES, places_all_over
from fenics_joints.updating.prediction import Predictor
from fenics_joints.updating.target_fit import TargetFit

#: Number of trial places, half of them within the bounds and half near the start; number of the
#: best of these, and of exchanges, that become starts; seed of the places. Chosen.
_LOOKED_AT, _STARTED, _EXCHANGED, _SEED = 16, 2, 3, 1
#: Range of the places near the start, in coordinates: a factor of 10; starts differ by 2 or more.
_NEAR, _APART = float(np.log(10.0)), float(np.log(2.0))
#: Ratio of sums of squares up to which two minima count as about as good; chosen.
AS_GOOD = 4.0


def other_starts(problem: TargetFit, start: np.ndarray, end: np.ndarray) -> list[np.ndarray]:
    """Coordinates from which fits to frequencies start: beyond exchanges of neighbouring modes, and
    the best of some places within the bounds.

    Args:
        problem: The fit, solved once already.
        start: Coordinates of the fit's own start.
        end: Coordinates where the fit ended.
    """
    found = [*_beyond_exchanges(problem, end), *_scattered(problem, start)]
    return [x for x in found if np.isfinite(problem.residual(problem.inside(x))).all()]


def _beyond_exchanges(problem: TargetFit, x: np.ndarray) -> list[np.ndarray]:
    """Ends of Gauss-Newton steps with two neighbouring modes exchanged, if the test's frequencies
    fit better there, the best first."""
    (predictor,) = problem.predictors
    target, r, J = predictor.target, problem.residual(x), problem.jacobian(x)
    used = np.flatnonzero(np.isfinite(target.frequencies_hz))
    log_f, sd = np.log(target.frequencies_hz[used]), target.log_sd[used]
    order, found = np.argsort(log_f), []
    for pair in zip(order[:-1], order[1:], strict=True):
        here, there = list(pair), list(pair[::-1])
        other = r.copy()
        other[here] += (log_f[here] - log_f[there]) / sd[here]
        step = np.linalg.lstsq(J, -other, rcond=1e-10)[0]
        cost = float(np.sum((other + J @ step) ** 2))
        if cost < AS_GOOD * (r @ r):
            found.append((cost, x + step))
    return [place for _, place in sorted(found, key=lambda pair: pair[0])[:_EXCHANGED]]


def _scattered(problem: TargetFit, start: np.ndarray) -> list[np.ndarray]:
    """The best of places within the bounds and near the start, apart from each other."""
    low, high = problem.bounds
    near = np.maximum(low, start - _NEAR), np.minimum(high, start + _NEAR)
    wide = np.where(np.isfinite(low), low, near[0]), np.where(np.isfinite(high), high, near[1])
    unit = qmc.Sobol(len(start), seed=_SEED).random(_LOOKED_AT)
    half = _LOOKED_AT // 2
    places = [
        problem.inside(a + u * (b - a))
        for (a, b), part in ((wide, unit[:half]), (near, unit[half:]))
        for u in part
    ]
    costs = [float(np.sum(problem.residual(x) ** 2)) for x in places]
    chosen = [start]
    for i in np.argsort(costs, kind="stable"):
        if len(chosen) <= _STARTED and all(np.abs(places[i] - x).max() > _APART for x in chosen):
            chosen.append(places[i])
    return chosen[1:]


def exchanged(
    predictor: Predictor, one: dict[str, float], other: dict[str, float]
) -> tuple[tuple[int, int], ...]:
    """Pairs of test modes, from 0, whose order differs between two sets of values. Collective.

    Args:
        predictor: Gives the model's modes and their pairing with the test's.
        one: Values of the parameters.
        other: Other values.
    """
    (first, pairing), (second, theirs) = (predictor.modes(values) for values in (one, other))
    index = pairing.index
    elastic = np.arange(second.n_rigid, len(second))
    match = _alike(first, index, second, elastic)
    becomes = elastic[nearest(match, second.frequencies_hz[elastic], first.frequencies_hz[index])]
    place = {int(mode): j for j, mode in enumerate(theirs.index)}
    at = [place.get(int(mode)) for mode in becomes]
    return tuple(
        (i, j)
        for i in range(len(at))
        for j in range(i + 1, len(at))
        if at[i] is not None
        and at[j] is not None
        and (index[i] < index[j]) != (theirs.index[at[i]] < theirs.index[at[j]])
    )


def _alike(first: Modes, index: np.ndarray, second: Modes, elastic: np.ndarray) -> np.ndarray:
    """Similarity, 0 to 1, of a model's modes at two sets of values, (m, n): by the mass matrix of
    a small model, by places all over a meshed one."""
    model = first.model
    if model.is_meshed:
        places = places_all_over(model, PLACES)
        return mac(first.at(places)[:, index], second.at(places)[:, elastic])
    ours, theirs = first.shapes[:, index], second.shapes[:, elastic]
    return (ours.T @ model.mass(first.given) @ theirs) ** 2
