"""Which causes a planned test would take for each other, and how they cancel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse.csgraph import connected_components

from fenics_joints.diagnosis.evidence.classes import APART


def groups(distances: np.ndarray, seen: Sequence[bool]) -> list[list[int]]:
    """Effects in classes: those that may be taken for each other, one way round or the other.

    Args:
        distances: D of the row's effect from what the column's can make, (n, n).
        seen: Which effects the test can see at all; the others are in no class.

    Returns:
        Indices of the members, by class, in their order.
    """
    there = np.flatnonzero(seen)
    if not len(there):
        return []
    near = np.minimum(distances, distances.T)[np.ix_(there, there)] < APART
    count, label = connected_components(near, directed=False)
    return [there[label == k].tolist() for k in range(count)]


@dataclass(frozen=True, eq=False)
class Combination:
    """The changes of effects that cancel best.

    Attributes:
        index: Collinearity index of the signatures, 1/sqrt of the least eigenvalue of their
            correlation: above about 20 they cannot be told apart whatever their sizes (Brun,
            Reichert and Kuensch, Water Resour. Res. 37, 2001).
        factors: Factor on each signature of the combination, the largest of magnitude 1, (k,).
        left: Length of what they leave, standard deviations.
    """

    index: float
    factors: np.ndarray
    left: float


def combination(signatures: Sequence[np.ndarray]) -> Combination:
    """How nearly whitened signatures (N,) depend on each other, and the combination that cancels.

    Args:
        signatures: One for each effect, none of zeros.
    """
    S = np.array(signatures).T
    length = np.linalg.norm(S, axis=0)
    eigenvalues, vectors = np.linalg.eigh((S / length).T @ (S / length))
    least = max(float(eigenvalues[0]), 1e-12)
    factors = vectors[:, 0] / length
    factors = factors / factors[np.argmax(np.abs(factors))]
    return Combination(least**-0.5, factors, float(np.linalg.norm(S @ factors)))
