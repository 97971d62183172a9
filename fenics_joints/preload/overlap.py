"""Where two faces with different meshes lie on one another, as points to integrate at.

Each pair of facets is cut to what both cover, seen along the upper facet's normal (Sutherland and
Hodgman, Commun. ACM 17, 1974); facets count as flat. All pairs go through each step together.
"""

from __future__ import annotations

from dataclasses import dataclass

import basix
import numpy as np
from scipy.spatial import cKDTree

#: Facets that look the same way, or across one another, are not in contact; as a cosine.
_OPPOSED = -0.5
#: Corners of facets in order around them; DOLFINx numbers quadrilaterals by rows.
_RING = {2: [0, 1], 3: [0, 1, 2], 4: [0, 1, 3, 2]}
_EDGES = {2: [(0, 1)], 3: [(1, 2), (0, 2), (0, 1)], 4: [(0, 1), (0, 2), (1, 3), (2, 3)]}
#: Degree of the quadrature: exact for products of quadratic traces on affine facets.
_DEGREE = 8
#: Pieces of a smaller share of the upper facet are round-off.
_SLIVER = 1e-12


@dataclass(frozen=True, repr=False)
class Overlap:
    """Points of quadrature over the common part of two faces.

    Attributes:
        upper: Facet of the upper face, (n,).
        lower: Facet of the lower face, (n,).
        weight: Weight, m2 (in two dimensions m), (n,); they sum to the common area.
        at_upper: Position in the upper facet's reference cell, (n, tdim).
        at_lower: Position in the lower facet's, (n, tdim).
        points: Position on the upper face, m, (n, gdim).
    """

    upper: np.ndarray
    lower: np.ndarray
    weight: np.ndarray
    at_upper: np.ndarray
    at_lower: np.ndarray
    points: np.ndarray


def facet_edges(corners: int) -> list[tuple[int, int]]:
    """Ends of the edges of a facet with so many corners, in DOLFINx's order."""
    return _EDGES[corners]


def hats(at: np.ndarray, corners: int) -> np.ndarray:
    """Linear (bilinear) hat functions at reference positions, (n, corners)."""
    x = at[:, 0]
    if corners == 2:
        return np.column_stack([1 - x, x])
    y = at[:, 1]
    if corners == 3:
        return np.column_stack([1 - x - y, x, y])
    return np.column_stack([(1 - x) * (1 - y), x * (1 - y), (1 - x) * y, x * y])


def edge_bubbles(at: np.ndarray, corners: int) -> np.ndarray:
    """Bubbles of the edges at reference positions, one at the middles, (n, n_edges)."""
    if corners < 4:
        hat = hats(at, corners)
        return np.column_stack([4 * hat[:, a] * hat[:, b] for a, b in _EDGES[corners]])
    x, y = at.T
    along, up = 4 * x * (1 - x), 4 * y * (1 - y)
    return np.column_stack([along * (1 - y), up * (1 - x), up * x, along * y])


def overlap(upper, lower, reach: float | None = None) -> Overlap:
    """The common part of two faces.

    Args:
        upper: Face (``points``, ``facets``, ``normals``) onto whose facets the other is projected.
        lower: The other face.
        reach: Farthest distance along the normal, m, at which facets lie on one another; by default
            half of the size of the upper facet.
    """
    u, v = _near(upper, lower)
    opposed = np.einsum("ij,ij->i", upper.normals[u], lower.normals[v]) < _OPPOSED
    u, v = u[opposed], v[opposed]
    flat = _flat_boundary if upper.points.shape[1] == 2 else _flat_surface
    origin, basis = _planes(upper, u)
    a = np.einsum("nki,nji->nkj", upper.points[upper.facets[u]] - origin[:, None], basis)
    b = np.einsum("nki,nji->nkj", lower.points[lower.facets[v]] - origin[:, None], basis)
    pair, x, weight = flat(a[:, :, 1:], b[:, :, 1:])
    at_upper, at_lower = _reference(a[pair][:, :, 1:], x), _reference(b[pair][:, :, 1:], x)
    height = np.einsum("nk,nk->n", hats(at_lower, b.shape[1]), b[pair][:, :, 0])
    size = np.linalg.norm(np.ptp(a[:, :, 1:], axis=1), axis=1)
    near = np.abs(height) <= (0.5 * size[pair] if reach is None else reach)
    points = origin[pair] + np.einsum("ni,nij->nj", x, basis[pair][:, 1:])
    return Overlap(*(q[near] for q in (u[pair], v[pair], weight, at_upper, at_lower, points)))


def _near(upper, lower) -> tuple[np.ndarray, np.ndarray]:
    """Facets whose surrounding spheres meet, as two columns."""
    spheres = []
    for face in (upper, lower):
        corners = face.points[face.facets]
        middle = corners.mean(axis=1)
        spheres.append((middle, np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)))
    (middle, radius), (other, size) = spheres
    # With half of the upper facet's size on either side along the normal.
    found = cKDTree(other).query_ball_point(middle, 2 * radius + size.max(initial=0.0))
    u = np.repeat(np.arange(len(middle)), [len(f) for f in found])
    v = np.array([j for f in found for j in f], dtype=np.int64)
    near = np.linalg.norm(middle[u] - other[v], axis=1) <= 2 * radius[u] + size[v]
    return u[near], v[near]


def _planes(face, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First corners, (n, gdim), and normals and tangents as rows, (n, gdim, gdim)."""
    corners, normals = face.points[face.facets[rows]], face.normals[rows]
    along = corners[:, 1] - corners[:, 0]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    if corners.shape[2] == 2:
        return corners[:, 0], np.stack([normals, along], axis=1)
    return corners[:, 0], np.stack([normals, along, np.cross(normals, along)], axis=1)


def _flat_boundary(a: np.ndarray, b: np.ndarray):
    """Pair, position and weight of points of quadrature on common pieces of lines."""
    a, b = a[:, :, 0], b[:, :, 0]
    low = np.maximum(a.min(axis=1), b.min(axis=1))
    length = np.minimum(a.max(axis=1), b.max(axis=1)) - low
    pair = np.flatnonzero(length > _SLIVER * np.ptp(a, axis=1))
    t, w = basix.make_quadrature(basix.CellType.interval, _DEGREE)
    x = low[pair, None] + length[pair, None] * t[:, 0]
    return np.repeat(pair, len(w)), x.reshape(-1, 1), np.outer(length[pair], w).ravel()


def _flat_surface(a: np.ndarray, b: np.ndarray):
    """Pair, position and weight of points of quadrature on common polygons."""
    polygon, count = _clipped(_around(a), _around(b))
    corner = np.arange(polygon.shape[1] - 2)
    pair, i = np.nonzero(corner < count[:, None] - 2)
    first = polygon[pair, 0]
    sides = polygon[pair, i + 1] - first, polygon[pair, i + 2] - first
    double = sides[0][:, 0] * sides[1][:, 1] - sides[0][:, 1] * sides[1][:, 0]
    size = np.prod(np.ptp(a, axis=1), axis=1)
    kept = double > _SLIVER * size[pair]
    t, w = basix.make_quadrature(basix.CellType.triangle, _DEGREE)
    one, two = (side[kept][:, None] for side in sides)
    x = first[kept][:, None] + t[:, :1] * one + t[:, 1:] * two
    return np.repeat(pair[kept], len(w)), x.reshape(-1, 2), np.outer(double[kept], w).ravel()


def _around(corners: np.ndarray) -> np.ndarray:
    """Corners in order around the polygon, counterclockwise."""
    ring = corners[:, _RING[corners.shape[1]]]
    x, y = np.moveaxis(ring, 2, 0)
    area = np.sum(x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1), axis=1)
    ring[area < 0] = ring[area < 0, ::-1]
    return ring


def _clipped(subject: np.ndarray, window: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What convex windows, (n, m, 2), leave of convex polygons, (n, k, 2), and its corners."""
    polygon, count = subject, np.full(len(subject), subject.shape[1])
    for i in range(window.shape[1]):
        start, end = window[:, i], window[:, (i + 1) % window.shape[1]]
        polygon, count = _cut(polygon, count, start, end - start)
    return polygon, count


def _cut(polygon: np.ndarray, count: np.ndarray, start: np.ndarray, along: np.ndarray):
    """What lies to the left of a line."""
    n, k = polygon.shape[:2]
    i = np.arange(k)
    there = i < count[:, None]
    following = np.where(i + 1 < count[:, None], i + 1, 0)
    arm = polygon - start[:, None]
    side = along[:, None, 0] * arm[:, :, 1] - along[:, None, 1] * arm[:, :, 0]
    after = np.take_along_axis(side, following, axis=1)
    inside = (side >= 0) & there
    crosses = there & ((side >= 0) != (after >= 0))
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.where(crosses, side / (side - after), 0.0)[:, :, None]
    other = np.take_along_axis(polygon, following[:, :, None], axis=1)
    points = np.stack([polygon, polygon + t * (other - polygon)], axis=2).reshape(n, 2 * k, 2)
    kept = np.stack([inside, crosses], axis=2).reshape(n, 2 * k)
    order = np.argsort(~kept, axis=1, kind="stable")[:, : k + 1]
    return np.take_along_axis(points, order[:, :, None], axis=1), kept.sum(axis=1)


def _reference(corners: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Reference positions of points, (n, tdim), in facets of these corners, (n, k, tdim)."""
    first, k = corners[:, 0], corners.shape[1]
    if k == 2:
        return (x - first) / (corners[:, 1] - first)
    sides = np.stack([corners[:, 1] - first, corners[:, 2] - first], axis=2)
    at = np.linalg.solve(sides, (x - first)[:, :, None])[:, :, 0]
    if k == 3:
        return at
    bend = corners[:, 3] - corners[:, 1] - corners[:, 2] + first
    # Newton from the parallelogram's; on a parallelogram that is the answer.
    for _ in range(8):
        r, s = at[:, :1], at[:, 1:]
        left = first + r * sides[:, :, 0] + s * sides[:, :, 1] + r * s * bend - x
        slope = sides + np.stack([s * bend, r * bend], axis=2)
        at = at - np.linalg.solve(slope, left[:, :, None])[:, :, 0]
    return at
