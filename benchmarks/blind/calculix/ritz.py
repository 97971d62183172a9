"""Masses, springs and resonators on a specimen, from its modes alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import eigh


def with_attached(
    hz: np.ndarray,
    u: np.ndarray,
    masses: Sequence[tuple] = (),
    springs: Sequence[tuple] = (),
    tuned: Sequence[tuple] = (),
) -> tuple[np.ndarray, np.ndarray]:
    """Modes of a structure with things attached, in the span of its own modes.

    Args:
        hz: All its frequencies up to some beyond those of interest, rigid motions too, Hz, (m,).
        u: Mass-normalised shapes at the nodes looked at, (m, n, 3).
        masses: (node among these, kg).
        springs: (node, axis, N/m) to the ground.
        tuned: (node, kg, Hz): a mass on a spring, alike in all directions.

    Returns:
        Frequencies, Hz, (m,), the lowest, and shapes (m, n, 3).
    """
    m, more = len(hz), 3 * len(tuned)
    K, M = np.zeros((m + more, m + more)), np.eye(m + more)
    K[range(m), range(m)] = (2 * np.pi * hz) ** 2
    for node, kg in masses:
        M[:m, :m] += kg * u[:, node] @ u[:, node].T
    for node, axis, k in springs:
        K[:m, :m] += k * np.outer(u[:, node, axis], u[:, node, axis])
    for i, (node, kg, own) in enumerate(tuned):
        k = kg * (2 * np.pi * own) ** 2
        for axis in range(3):
            row = m + 3 * i + axis
            way = np.zeros(m + more)
            way[:m], way[row] = u[:, node, axis], -1.0
            K += k * np.outer(way, way)
            M[row, row] = kg
    values, vectors = eigh(K, M)
    shapes = np.einsum("ij,inc->jnc", vectors[:m], u)
    return np.sqrt(np.clip(values[:m], 0, None)) / (2 * np.pi), shapes[:m]
