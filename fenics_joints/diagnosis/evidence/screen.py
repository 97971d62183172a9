"""A quick look at every pair of effects, to fit in full only those that could matter."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.fitted import Fit
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.diagnosis.evidence.linear import evidence_about, log_evidence, whiten
from fenics_joints.diagnosis.evidence.prediction import predict
from fenics_joints.reduction.forward import Forward

__all__ = [
    "linear_evidence", "near_best", "near_listed", "quick_evidence", "whitened",
    "with_other",
]  # fmt: skip


def quick_evidence(
    hypothesis: Hypothesis,
    start: np.ndarray,
    forward: Forward,
    evidence: Evidence,
    baseline: dict[str, float],
    lowers: Sequence[np.ndarray],
) -> tuple[float, np.ndarray]:
    """ln of the evidence if the hypothesis were linear about a point, and the most probable z.

    Args:
        hypothesis: The hypothesis.
        start: Point z to linearise about, (d,).
        forward: Predicts.
        evidence: The test.
        baseline: Parameter values of the nominal model.
        lowers: Cholesky factors of covariances that the evidence may have; the best counts.
    """
    used = evidence.fitted
    predicted, jacobian = predict(hypothesis, forward, evidence, start, baseline)
    residual, slope = predicted[used] - evidence.data[used], jacobian[used]
    looks = (_look(residual, slope, start, hypothesis.limits.T, lower) for lower in lowers)
    return max(looks, key=lambda look: look[0])


def _look(residual, slope, start, limits, lower) -> tuple[float, np.ndarray]:
    residual, slope = whiten(lower, residual), whiten(lower, slope)
    hessian = slope.T @ slope + np.eye(len(start))
    z = start - np.linalg.solve(hessian, slope.T @ residual + start)
    z = np.clip(z, *limits)
    left = residual + slope @ (z - start)
    return log_evidence(left @ left + z @ z, hessian, lower), z


def whitened(found: Fit, evidence: Evidence, lower: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Residual, (k,), and slopes, (k, d), of a fit in standard deviations of the fitted entries.

    Args:
        found: The fit, to whatever entries.
        evidence: The entries.
        lower: Cholesky factor of their covariance.
    """
    used = evidence.fitted
    both = np.column_stack([(found.predicted - evidence.data)[used], found.jacobian[used]])
    white = whiten(lower, both)
    return white[:, 0], white[:, 1:]


def linear_evidence(found: Fit, evidence: Evidence) -> float:
    """ln of the evidence of other entries of a test, a hypothesis linear about its fit.

    Args:
        found: The fit, to whatever entries.
        evidence: The entries.
    """
    lower = evidence.at(found.scales).lower(found.hypothesis.unknown)
    return evidence_about(*whitened(found, evidence, lower), found.z, lower)


def near_best(values: np.ndarray, margin: float, most: int) -> np.ndarray:
    """Indices of the values within a margin of the largest, at most so many, best first."""
    order = np.argsort(-values, kind="stable")
    return order[values[order] > values[order[0]] - margin][:most] if len(order) else order


def near_listed(values: np.ndarray, unknown: np.ndarray, margin: float, most: int) -> np.ndarray:
    """As `near_best`; where nothing but an unknown cause is near, the best of the others, too.

    Args:
        values: Of each.
        unknown: Which are an unknown cause, bool.
        margin: Of the largest, and of the largest of the others.
        most: Number of each at most.
    """
    near, listed = near_best(values, margin, most), np.flatnonzero(~unknown)
    if not unknown[near].all():
        return near
    return np.concatenate([near, listed[near_best(values[listed], margin, most)]])


def with_other(parent: Fit, other: Fit, white: dict, lower: np.ndarray) -> tuple[float, float]:
    """ln of a fit's evidence, and of that with another's effect besides, linear about both.

    Args:
        parent: The fit.
        other: The one of the effect alone.
        white: Whitened residuals and slopes of both, by id.
        lower: Cholesky factor of the covariance.
    """
    residual, slope = white[id(parent)]
    columns = np.hstack([slope, white[id(other)][1][:, other.hypothesis.own]])
    hessian = columns.T @ columns + np.eye(columns.shape[1])
    pull = columns.T @ residual
    pull[: len(parent.z)] += parent.z
    square = residual @ residual + parent.z @ parent.z
    before = log_evidence(square, slope.T @ slope + np.eye(slope.shape[1]), lower)
    after = log_evidence(square - pull @ np.linalg.solve(hessian, pull), hessian, lower)
    return before, after
