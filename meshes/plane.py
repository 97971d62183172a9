"""Plane grids of quadrilaterals: graded tensor grids, and O-grids around round holes."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

__all__ = ["grid_lines", "o_grid", "tensor_grid"]


def grid_lines(edges: Iterable[float], size: float) -> np.ndarray:
    """Grid lines that pass through every edge exactly, at most ``size`` apart.

    Each interval between neighbouring edges is cut into the fewest equal parts that are not longer
    than ``size``, so a grid whose edges lie on multiples of ``size`` comes out uniform.

    Args:
        edges: Positions that must be lines, in any order, in metres.
        size: Longest distance between two lines, in metres.

    Returns:
        Ascending positions, shape (n_lines,).
    """
    edges = np.sort(np.fromiter(edges, dtype=float))
    span = edges[-1] - edges[0]
    # Edges that differ by round-off are one line.
    edges = edges[np.concatenate([[True], np.diff(edges) > 1e-9 * span])]
    parts = [
        np.linspace(a, b, math.ceil((b - a) / size * (1 - 1e-9)), endpoint=False)
        for a, b in zip(edges[:-1], edges[1:], strict=True)
    ]
    return np.concatenate([*parts, edges[-1:]])


def tensor_grid(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points and quadrilaterals of the grid with lines ``x`` and ``y``.

    Returns:
        Points, shape (len(x) * len(y), 2), point (i, j) in row ``i * len(y) + j``; and cells
        (v00, v10, v01, v11), shape (n_cells, 4).
    """
    points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    number = np.arange(len(points)).reshape(len(x), len(y))
    corners = number[:-1, :-1], number[1:, :-1], number[:-1, 1:], number[1:, 1:]
    return points, np.stack(corners, axis=-1).reshape(-1, 4)
