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


def o_grid(
    loop: np.ndarray,
    loop_points: np.ndarray,
    centre: np.ndarray,
    radii: tuple[float, ...],
    size: float,
    first_new: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Quadrilaterals between a round hole and the square around it.

    The square's sides map to quarters of the circle with angle in proportion to distance, so an
    even square gives a regular polygon whose corners lie on the circle. Circles of the given radii
    are followed exactly by element edges; the rings between two of them, and the last between a
    circle and the square, are cut into the fewest equal parts not longer than ``size``.

    Args:
        loop: Numbers of the square's boundary points, anticlockwise from its lower left corner,
            shape (n,).
        loop_points: Their positions, shape (n, 2), in metres.
        centre: Centre of the square and of the hole, shape (2,), in metres.
        radii: Radii of the hole and of the circles around it, ascending, in metres.
        size: Longest element along the radius, halfway along a side, in metres.
        first_new: Number of the first new point.

    Returns:
        New points, shape (n_rings * n, 2), the hole's first; cells (v00, v10, v01, v11) with v00
        to v10 outwards, ring by ring from the hole, shape (n_rings * n, 4); and the number of the
        circle inside which each cell lies, from 0 for the square, then 1 for ``radii[1]`` and so
        on, shape (n_rings * n,).
    """
    offset = loop_points - centre
    half = np.abs(offset).max()
    angle = _square_angle(offset / half)
    unit = np.column_stack([np.cos(angle), np.sin(angle)])
    curves = [radius * unit for radius in radii] + [offset]
    reach = [*radii, half]
    points, bands = [], []
    for band in range(len(radii)):
        parts = math.ceil((reach[band + 1] - reach[band]) / size * (1 - 1e-9))
        for step in np.arange(parts) / parts:
            points.append(centre + (1 - step) * curves[band] + step * curves[band + 1])
            bands.append((band + 1) % len(radii))
    n, rings = len(loop), len(points)
    number = np.vstack([first_new + np.arange(rings * n).reshape(rings, n), loop])
    turned = np.roll(number, -1, axis=1)
    cells = np.stack([number[:-1], number[1:], turned[:-1], turned[1:]], axis=-1).reshape(-1, 4)
    return np.vstack(points), cells, np.repeat(bands, n)


def _square_angle(p: np.ndarray) -> np.ndarray:
    """Angle for points on the square with corners (-1, -1) and (1, 1), linear along each side."""
    x, y = p.T
    upright = np.abs(x) >= np.abs(y)
    turned = np.where(upright, np.where(x > 0, 0, np.pi), np.where(y > 0, np.pi / 2, -np.pi / 2))
    along = np.where(upright, np.sign(x) * y, -np.sign(y) * x)
    return turned + np.pi / 4 * along
