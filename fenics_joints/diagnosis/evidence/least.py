"""Of many points of a hypothesis those that fit a test best, by the model itself."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fenics_joints.diagnosis.evidence.linear import whiten
from fenics_joints.diagnosis.evidence.many import ManyPredictions
from fenics_joints.reduction.forward import Forward
from fenics_joints.reduction.lean import batched

__all__ = ["least_apart", "residuals_at", "squares"]


def residuals_at(hypothesis, forward, evidence, baseline, points: np.ndarray) -> np.ndarray | None:
    """Prediction less data at points, (b, d), solved for together: (b, k), nan where the model has
    no such modes; None where they cannot be."""
    if not isinstance(forward, Forward) or not batched(forward).batches:
        return None
    many = ManyPredictions(hypothesis, batched(forward), evidence, baseline, held_out=True)
    used = evidence.fitted
    return many(points)[0][:, used] - evidence.data[used]


def least_apart(
    points: np.ndarray, size: np.ndarray, among: Sequence[int] | slice, distance: float, count: int
) -> list[np.ndarray]:
    """Some of the least points, the best first, apart from one another.

    Args:
        points: z, (b, d).
        size: Of each, such as `squares`, (b,); what is infinite is left out.
        among: Parameters in one of which they are apart.
        distance: By more than this, in standard deviations of the prior.
        count: How many at most.
    """
    found: list[np.ndarray] = []
    for i in np.argsort(size, kind="stable"):
        away = (np.max(np.abs((points[i] - z)[among]), initial=0.0) for z in found)
        apart = [d > distance for d in away]
        if np.isfinite(size[i]) and all(apart) and len(found) < count:
            found.append(points[i])
    return found


def squares(points: np.ndarray, residual: np.ndarray, lower) -> np.ndarray:
    """What a fit makes small: squared whitened residuals and distances from the prior's medians,
    (b,); infinite where the model has no such modes.

    Args:
        points: z, (b, d).
        residual: Prediction less data there, (b, k); nan where there is none.
        lower: Cholesky factor of the covariance, see `whiten`.
    """
    there = np.all(np.isfinite(residual), axis=1)
    found = np.full(len(points), np.inf)
    found[there] = np.sum(whiten(lower, residual[there].T) ** 2, axis=0)
    found[there] += np.sum(points[there] ** 2, axis=1)
    return found
