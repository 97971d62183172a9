"""Fits in rounds, where one fit alone finds no answer.

A model that is wrong leaves residuals far above the noise of the test. Least squares then converge
slowly, since their curvature leaves out what residuals bend; what the data do not see is driven to
its bounds by what no values can explain; and a prior counts for nothing. And where a mode changes
partners the residuals jump, which no trust region climbs. So

- the standard deviations of each kind of data, and of each shape, are widened to what is left:
  s^2 = chi^2 / (n - p), p the parameters that these data determine, and s at least 1 (MacKay,
  Neural Comput. 4, 1992); frequencies to 1 % at most. They are first those of the start, then fall
  as the fit gets better, so that what is known best is fitted first and the prior holds the rest;
- in a round each mode is followed from step to step by its own shape; between rounds the test's
  modes are paired anew, and one that has another partner then is left out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fenics_joints.updating.residuals import Widths
from fenics_joints.updating.target_fit import TargetFit

#: Why no answer was found, in words.
OUT_OF_EVALUATIONS = "out of evaluations"
PARTNERS = "too many modes change their partners near the solution"
UNSETTLED = "the standard deviations of the residuals do not converge"
#: Most rounds from one start, and the change of a width's logarithm at which they end; chosen.
_ROUNDS, _SETTLED = 10, 0.05
#: Change of the logarithm of the density in a step at which a round ends, and the coarsest relative
#: accuracy of its sum of squares; chosen for time.
_LITTLE, _COARSEST = 0.01, 1e-3
#: Largest share of the modes that is left out: if more of them change partners, the pairs are open.
#: Chosen.
_LEFT_OUT = 0.2
#: Difference of the logarithm of the density between ends that count as equally good; chosen.
_SAME = 0.5
#: Decrease of the sum of squares, as a share of one datum's part, for which a step pays; chosen.
_WORTH = 0.05


@dataclass(frozen=True, eq=False)
class End:
    """Where rounds end.

    Attributes:
        x: Coordinates.
        widths: Factors of the standard deviations.
        misfit: Minus the logarithm of the posterior density, up to a constant.
        settled: Whether the last round converged, and neither widths nor pairs changed in it.
        why: What ended the rounds that did not settle, in words.
    """

    x: np.ndarray
    widths: Widths
    misfit: float
    settled: bool
    why: str = ""


def is_stuck(problem: TargetFit, x: np.ndarray) -> bool:
    """Whether a step of Gauss and Newton promises more than accuracy asks, and was not taken."""
    r, J = problem.residual(x), problem.jacobian(x)
    low, high = problem.bounds
    gradient = J.T @ r
    room = np.minimum(1.0, high - low)
    free = ~((x - low < 1e-5 * room) & (gradient > 0) | (high - x < 1e-5 * room) & (gradient < 0))
    step = np.linalg.lstsq(J[:, free], -r, rcond=1e-10)[0]
    promised = float(r @ r - np.sum((r + J[:, free] @ step) ** 2))
    return promised > _WORTH * max(1.0, float(r @ r) / len(r))


def in_rounds(problem: TargetFit, starts: list[np.ndarray], max_evaluations: int) -> End:
    """The best end of rounds from some starts; the problem is left with its widths.

    Args:
        problem: Of one target without FRFs.
        starts: Coordinates at which the model is solved.
        max_evaluations: Sets of values from each start.
    """
    (residuals,) = problem.residuals
    ends = [end for x in starts for end in _chain(problem, problem.inside(x), max_evaluations)]
    best = min(ends, key=lambda end: end.misfit)
    # By a mode whose partner is open an end that has not settled gains nothing that is known.
    settled = [
        end
        for end in ends
        if end.settled and end.misfit - residuals.lost(end.widths) < best.misfit + _SAME
    ]
    if settled:
        best = min(settled, key=lambda end: end.misfit)
    residuals.widths = best.widths
    return best


def _chain(problem: TargetFit, x: np.ndarray, max_evaluations: int) -> list[End]:
    """Rounds from one start, first by the test's pairs alone: with long steps none are followed."""
    (residuals,) = problem.residuals
    residuals.widths = Widths(shapes=(1.0,) * len(residuals.modes))
    residuals.widths = residuals.left(problem.predict(0, x))
    ends, left = [End(x, residuals.widths, problem.misfit(x), False)], max_evaluations
    why = UNSETTLED
    for number in range(_ROUNDS):
        done, pairs = _round(problem, x, left, number > 0)
        x, left, before = done.x, left - done.nfev, residuals.widths
        found = problem.predict(0, x)
        other = [] if pairs is None else np.flatnonzero(pairs != found.pairs).tolist()
        own = residuals.left(found, problem.jacobian(x))
        same = number > 0 and set(other) <= set(before.without)
        settled = done.status > 0 and same and own.change(before) < _SETTLED
        residuals.widths = own
        ends.append(End(x, own, problem.misfit(x), settled))
        if settled:
            break
        if left <= 1:
            why = OUT_OF_EVALUATIONS
            break
        if number > 0:
            without = tuple(sorted({*before.without, *other}))
            if len(without) > max(1, int(_LEFT_OUT * len(found.frequencies_hz))):
                why = PARTNERS
                break
            residuals.widths = replace(own, without=without)
    return [replace(end, why="" if end.settled else why) for end in ends]


def _round(problem: TargetFit, x: np.ndarray, left: int, follow: bool):
    """One fit, and the pairs with which it ends."""
    (predictor,) = problem.predictors
    size = 0.5 * float(np.sum(problem.residual(x) ** 2))
    accuracy = float(np.clip(_LITTLE / max(size, 1e-300), 1e-8, _COARSEST))
    predictor.follows = follow
    try:
        if follow:
            predictor.follow(problem.predict(0, x))
        done = problem.solve(x, left, accuracy=accuracy, still=1e-8)
        return done, problem.predict(0, done.x).pairs
    finally:
        predictor.follows = False
