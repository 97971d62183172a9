"""Shapes of close modes, which any error of a model turns into one another."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

__all__ = ["Neighbours", "turned"]


@dataclass(frozen=True)
class Neighbours:
    """All elastic modes of the nominal model, those that the test lacks among them.

    Attributes:
        log_f: ln of their frequencies, (k,).
        shapes: Mass-normalised, at the sensors, (n_s, k).
        own: Which of them the test's are, (m,).
    """

    log_f: np.ndarray
    shapes: np.ndarray
    own: np.ndarray


def turned(
    log_f: np.ndarray, shapes: np.ndarray, by_mode: np.ndarray, least: float,
    near: Neighbours | None = None,
) -> Iterator[tuple[int, np.ndarray]]:
    """Errors of shapes by modes nearby: of which mode, and what it may have of another, (n_s,).

    An error of the model that is d in ln f of two modes turns them by d / |ln (f_i / f_j)|
    (first-order perturbation; Fox and Kapoor, AIAA J. 6, 1968): half a per cent apart, what one
    has of the other says nothing. What one has of the other is not tied to what that has of it,
    though the turn of two modes would do so: a third has a hand in it.

    Args:
        log_f: ln of the measured frequencies, (m,); nan where missing.
        shapes: Measured shapes, (n_s, m), of root mean square 1; nan where missing.
        by_mode: Standard deviation of the model's error in ln f, (m,).
        least: Turn, radians, that other errors of a shape hold already.
        near: The model's modes; None takes those of the test alone, as of one size.
    """
    for i in range(len(log_f)):
        missing = 0.0
        for apart, shape in _others(i, log_f, shapes, near):
            angle = min(by_mode[i] / max(apart, 1e-12), 1.0)
            if angle > least:
                size = np.sqrt(angle**2 - least**2)
                missing += size**2 / 2
                yield i, size * shape
        if missing:
            yield i, min(missing, 1.0) * np.nan_to_num(shapes[:, i])


def _others(i: int, log_f, shapes, near: Neighbours | None) -> Iterator[tuple[float, np.ndarray]]:
    """How far other modes are from one of the test's, in ln f, and their shapes to its scale."""
    there = np.isfinite(log_f) & np.isfinite(shapes).any(axis=0)
    sizes = np.ones(len(log_f))
    if near is not None:
        sizes = np.sqrt(np.mean(near.shapes[:, near.own] ** 2, axis=0))
        at = near.log_f[near.own[i]]
        measured = set(near.own[there].tolist()) | {int(near.own[i])}
        for k in range(len(near.log_f)):
            if k not in measured:
                yield abs(near.log_f[k] - at), near.shapes[:, k] / sizes[i]
    for j in np.flatnonzero(there):
        if j != i and np.isfinite(log_f[i]):
            yield abs(log_f[i] - log_f[j]), np.nan_to_num(shapes[:, j]) * sizes[j] / sizes[i]
