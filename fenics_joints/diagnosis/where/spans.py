"""Spans of the data that zones can reach, and what of one lies outside the others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.linalg

__all__ = ["outside", "span", "visible_part"]

#: Directions of several bases that differ by less than this (sine) are one.
_RANK = 1e-3


def _svd(a: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    try:
        return scipy.linalg.svd(a, full_matrices=False)
    except np.linalg.LinAlgError:
        # LAPACK's divide and conquer (gesdd) does not always converge where directions are the
        # same but for round-off, as those of zones that do alike are.
        return scipy.linalg.svd(a, full_matrices=False, lapack_driver="gesvd")


def visible_part(S: np.ndarray, least: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Directions of the data, lengths and combinations of parameters that the test sees.

    Two parameters that do nearly the same are one: their difference is not seen.

    Args:
        S: Whitened change of the data by each parameter, (N, k).
        least: Length below which a combination is not seen.

    Returns:
        Orthonormal directions, (N, r); lengths, (r,), falling; combinations, (r, k).
    """
    if not S.size:
        return np.zeros((len(S), 0)), np.zeros(0), np.zeros((0, S.shape[1]))
    U, s, turn = _svd(S)
    seen = s > max(least, 1e-9 * s[0], 1e-300)
    return U[:, seen], s[seen], turn[seen]


def span(bases: Sequence[np.ndarray]) -> np.ndarray:
    """Orthonormal basis of the span of several, (N, r)."""
    U, s, _ = _svd(np.hstack(bases))
    return U[:, s > _RANK * s[0]]


def outside(Q: np.ndarray, others: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Directions of Q's span, (N, k), with the others' projected out, and sines of the angles."""
    if others:
        P = span(others)
        Q = Q - P @ (P.T @ Q)
    U, s, _ = _svd(Q)
    return U, s
