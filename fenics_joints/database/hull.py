"""Whether a point lies among others: in their convex hull, of whatever dimension that has."""

from __future__ import annotations

import numpy as np

#: Relative to the points' range, so that the outermost points themselves are inside.
_TOLERANCE = 1e-7


class Hull:
    """Convex hull of points, shape (n, d); they may lie in a plane or on a line.

    Args:
        points: At least one.
        facets: Of a `Hull` of the same points, so that they need not be found again.

    Attributes:
        facets: Each the normal and offset of a half-space n·x + c <= 0 that holds the points, in
            coordinates of the points' range about their centre; shape (k, d + 1), k = 0 if the
            points lie on a line.

    Raises:
        ValueError: If the facets are not of these points.
    """

    def __init__(self, points: np.ndarray, facets: np.ndarray | None = None):
        self._low = points.min(axis=0)
        self._range = np.where(np.ptp(points, axis=0) > 0, np.ptp(points, axis=0), 1.0)
        scaled = (points - self._low) / self._range
        self._centre = scaled.mean(axis=0)
        _, singular, self._axes = np.linalg.svd(scaled - self._centre, full_matrices=True)
        self._rank = int(np.sum(singular > 1e-9 * max(singular.max(), 1e-300)))
        own = (scaled - self._centre) @ self._axes[: self._rank].T
        self._interval = own.min(axis=0), own.max(axis=0)
        found = self._found(own) if facets is None else np.array(facets, dtype=float)
        self.facets = found.reshape(-1, points.shape[1] + 1)
        if not self.contains(points).all():
            raise ValueError(f"facets that do not hold the {len(points)} points")

    def _found(self, own: np.ndarray) -> np.ndarray:
        if self._rank < 2:
            return np.empty((0, self._axes.shape[1] + 1))
        from scipy.spatial import ConvexHull

        equations = ConvexHull(own).equations
        normals, offsets = equations[:, :-1], equations[:, -1:]
        # Several triangles may lie in one facet.
        return np.unique(np.hstack([normals @ self._axes[: self._rank], offsets]).round(12), axis=0)

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Whether each of the points, shape (m, d), is inside or on the boundary; shape (m,)."""
        moved = (np.asarray(points, dtype=float) - self._low) / self._range - self._centre
        own, off = moved @ self._axes[: self._rank].T, moved @ self._axes[self._rank :].T
        inside = np.all(np.abs(off) <= _TOLERANCE, axis=1)
        low, high = self._interval
        inside &= np.all((own >= low - _TOLERANCE) & (own <= high + _TOLERANCE), axis=1)
        distances = moved @ self.facets[:, :-1].T + self.facets[:, -1]
        return inside & np.all(distances <= _TOLERANCE, axis=1)
