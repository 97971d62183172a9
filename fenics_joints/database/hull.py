"""Whether a point lies among others: in their convex hull, of whatever dimension that has."""

from __future__ import annotations

import numpy as np
from scipy.spatial import Delaunay

__all__ = ["Hull"]

#: Relative to the points' range, so that the outermost points themselves are inside.
_TOLERANCE = 1e-7


class Hull:
    """Convex hull of points, shape (n, d); they may lie in a plane or on a line.

    Args:
        points: At least one.
    """

    def __init__(self, points: np.ndarray):
        self._low = points.min(axis=0)
        self._range = np.where(np.ptp(points, axis=0) > 0, np.ptp(points, axis=0), 1.0)
        scaled = (points - self._low) / self._range
        self._centre = scaled.mean(axis=0)
        _, singular, self._axes = np.linalg.svd(scaled - self._centre, full_matrices=True)
        self._rank = int(np.sum(singular > 1e-9 * max(singular.max(), 1e-300)))
        own = (scaled - self._centre) @ self._axes[: self._rank].T
        self._interval = own.min(axis=0), own.max(axis=0)
        self._mesh = Delaunay(own) if self._rank > 1 else None

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Whether each of the points, shape (m, d), is inside or on the boundary; shape (m,)."""
        moved = (np.asarray(points, dtype=float) - self._low) / self._range - self._centre
        own, off = moved @ self._axes[: self._rank].T, moved @ self._axes[self._rank :].T
        inside = np.all(np.abs(off) <= _TOLERANCE, axis=1)
        low, high = self._interval
        inside &= np.all((own >= low - _TOLERANCE) & (own <= high + _TOLERANCE), axis=1)
        if self._mesh is not None:
            inside &= self._mesh.find_simplex(own, tol=_TOLERANCE) >= 0
        return inside
