"""Fits linear about where they are, and which of several values are near the best."""

from __future__ import annotations

import numpy as np

from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.fitted import Fit
from fenics_joints.diagnosis.evidence.linear import evidence_about, whiten


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
