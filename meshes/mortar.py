"""Faces whose meshes do not match: what the lower one does, averaged for each vertex of the upper.

With the dual basis psi_j of the upper face's hats (biorthogonal to them facet by facet), the jump
of a vertex is that of the averages

    d_j w_j = integral psi_j (u_upper - u_lower),        d_j = integral of the vertex's hat,

so that constant pressure and linear displacements pass exactly (Wohlmuth, SIAM J. Numer. Anal. 38,
2000; Popp, Gee and Wall, Int. J. Numer. Methods Eng. 79, 2009). At degree 2 the jump stays linear,
and the upper face keeps the bubbles of its own midsides (Puso, Laursen and Solberg, Comput. Methods
Appl. Mech. Eng. 197, 2008). On facets that stick out of the lower face, the dual basis is that of
the covered part (Cichosz and Bischoff, Comput. Methods Appl. Mech. Eng. 200, 2011).

For the integrals each pair of facets is cut to what both cover, seen along the upper facet's normal
(Sutherland and Hodgman, Commun. ACM 17, 1974); facets count as flat. All pairs go through each step
together.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import basix
import numpy as np
import scipy.sparse
from scipy.spatial import cKDTree

#: Least covered share of an upper facet that is in contact. Chosen: with less, the dual basis has
#: large values.
_COVERED = 0.5
#: Likewise of one that is tied, which bears tension too. Chosen: down to there, frequencies of a
#: lap whose end cuts facets come nearer to those of a matching mesh.
TIED = 0.1
#: Cosine of the normals of two facets or vertices above which they do not look at each other, 120
#: degrees. Chosen: normals of vertices at edges are off by up to 45.
OPPOSED = -0.5
#: Reference cells of facets by their number of corners.
_CELLS = {2: basix.CellType.interval, 3: basix.CellType.triangle, 4: basix.CellType.quadrilateral}
#: Corners of facets in order around them, and ends of their edges in DOLFINx's order, which numbers
#: quadrilaterals by rows.
_RING = {2: [0, 1], 3: [0, 1, 2], 4: [0, 1, 3, 2]}
_EDGES = {2: [(0, 1)], 3: [(1, 2), (0, 2), (0, 1)], 4: [(0, 1), (0, 2), (1, 3), (2, 3)]}
#: Degree of the quadrature: exact for products of quadratic traces on affine facets.
_DEGREE = 8
#: Share of an upper facet below which a piece of it is round-off.
_SLIVER = 1e-12


@dataclass(frozen=True, repr=False)
class Coupling:
    """u_upper = P u_lower - B b + w at the upper vertices, with the bubbles b of its midsides.

    Attributes:
        nodes: Global block numbers of the lower face's vertices and midsides, (m,).
        points: Their positions, m, (m, gdim).
        weights: P, sparse, (n, m); rows sum to one.
        edges: Upper vertices at the ends of edges with midsides, (n_edges, 2).
        midsides: Global block numbers there, (n_edges,).
        bubbles: B, sparse, (n, n_edges).
        facing: The lower vertices in contact, as rows of ``nodes``, (k,).
        opposite: The upper vertex nearest to each of these, (k,).
        free: Directions in which a bonded vertex follows nothing, as a support holds it, (n, gdim).
    """

    nodes: np.ndarray
    points: np.ndarray
    weights: scipy.sparse.csr_matrix
    edges: np.ndarray
    midsides: np.ndarray
    bubbles: scipy.sparse.csr_matrix
    facing: np.ndarray
    opposite: np.ndarray
    free: np.ndarray

    def partner(self, values: np.ndarray) -> np.ndarray:
        """Averages for the upper vertices, (n, k), of values at the lower nodes, (m, k)."""
        return self.weights @ values


@dataclass(frozen=True, repr=False)
class Mortar:
    """The part of the upper face that is in contact, and its coupling.

    Attributes:
        rows: Vertices of the upper face, (n,).
        facets: Which of its facets, (n_facets,).
        corners: Vertices of these, as rows of ``rows``, (n_facets, k).
        shares: Integral of each vertex's hat function over the covered part of each facet, m2,
            (n_facets, k).
        nearest: Lower vertex nearest to each upper one, (n,).
        coupling: The coupling; ``free`` has nothing yet.
    """

    rows: np.ndarray
    facets: np.ndarray
    corners: np.ndarray
    shares: np.ndarray
    nearest: np.ndarray
    coupling: Coupling


def couple(
    lower, upper, bubble: float, reach: float | None = None, weight=None, tied: bool = False
) -> Mortar | None:
    """Couple two faces; None where they do not lie on one another.

    Args:
        lower: The face that is averaged (`fenics_joints.structure.faces.Face`).
        upper: The face whose vertices carry the jumps; better the smaller and the finer one.
        bubble: Value of a midside's shape function in the middle of its edge.
        reach: Farthest distance of facets along the normal, m; see `overlap`.
        weight: Weight of the surface measure as a function of positions, or None.
        tied: Whether also facets are taken of which less than half is covered.
    """
    found = overlap(upper, lower, reach)
    if weight is not None:
        found = replace(found, weight=found.weight * weight(found.points))
    shares, duals, kept = _duals(found, upper, weight, TIED if tied else _COVERED)
    if not kept.any():
        return None
    inside = kept[found.upper]
    found = Overlap(*(getattr(found, field.name)[inside] for field in fields(found)))
    facets = np.flatnonzero(kept)
    rows, corners = np.unique(upper.facets[facets], return_inverse=True)
    corners = corners.reshape(len(facets), -1)
    areas = np.zeros(len(rows))
    np.add.at(areas, corners, shares[facets])
    coupling, nearest = _coupling(found, duals, areas, rows, facets, lower, upper, bubble)
    return Mortar(rows, facets, corners, shares[facets], nearest, coupling)


def _duals(found: Overlap, upper, weight, least: float):
    """Integrals of hats over covered parts, (n, k), dual bases, (n, k, k), and facets kept."""
    n, k = upper.facets.shape
    hat = hats(found.at_upper, k)
    shares, products = np.zeros((n, k)), np.zeros((n, k, k))
    np.add.at(shares, found.upper, found.weight[:, None] * hat)
    np.add.at(products, found.upper, (found.weight[:, None] * hat)[:, :, None] * hat[:, None, :])
    covered = np.zeros(n)
    plain = found.weight if weight is None else found.weight / weight(found.points)
    np.add.at(covered, found.upper, plain)
    kept = covered > least * hat_integrals(upper.points, upper.facets).sum(axis=1)
    duals = np.zeros((n, k, k))
    duals[kept] = shares[kept][:, :, None] * np.linalg.inv(products[kept])
    return shares, duals, kept


def _coupling(found, duals, areas, rows, facets, lower, upper, bubble):
    """The coupling of the vertices ``rows`` of the upper face, and the nearest lower vertices."""
    number = np.full(len(upper.nodes), -1)
    number[rows] = np.arange(len(rows))
    hat = hats(found.at_upper, upper.facets.shape[1])
    dual = np.einsum("qjk,qk,q->qj", duals[found.upper], hat, found.weight)
    at = number[upper.facets[found.upper]]
    dual /= areas[at]
    low, own = _edge_table(lower), _edge_table(upper)
    columns, values = _trace(lower, low, found.lower, found.at_lower, bubble)
    nodes = np.concatenate([lower.nodes, lower.midsides])
    weights = _sparse(at, dual, columns, values, (len(rows), len(nodes)))
    used = np.unique(own[facets]) if own.size else np.empty(0, int)
    place = np.full(len(upper.edges), -1)
    place[used] = np.arange(len(used))
    bumps = bubble * edge_bubbles(found.at_upper, upper.facets.shape[1])
    shape = (len(rows), len(used))
    bubbles = (
        _sparse(at, dual, place[own[found.upper]], bumps, shape)
        if len(used)
        else scipy.sparse.csr_matrix(shape)
    )
    points = np.vstack([lower.points, lower.points[lower.edges].mean(axis=1)])
    facing = np.unique(lower.facets[found.lower])
    apart = np.linalg.norm
    x = upper.points[rows]
    opposite = np.array([np.argmin(apart(x - p, axis=1)) for p in lower.points[facing]], dtype=int)
    nearest = facing[[np.argmin(apart(lower.points[facing] - p, axis=1)) for p in x]]
    ends = number[upper.edges[used]].reshape(-1, 2)
    free = np.zeros(x.shape, dtype=bool)
    return Coupling(
        nodes, points, weights, ends, upper.midsides[used], bubbles, facing, opposite, free
    ), nearest


def _edge_table(face) -> np.ndarray:
    """Edges of each facet, as rows of ``face.edges``, (n_facets, n_edges); empty at degree 1."""
    if not len(face.edges):
        return np.empty((len(face.facets), 0), dtype=int)
    n = len(face.nodes)
    keys = np.sort(face.edges, axis=1) @ [n, 1]
    order = np.argsort(keys)
    local = np.sort(face.facets[:, _EDGES[face.facets.shape[1]]], axis=2)
    return order[np.searchsorted(keys[order], local @ [n, 1])]


def _trace(face, edges: np.ndarray, facet: np.ndarray, at: np.ndarray, bubble: float):
    """Nodes and values of the shape functions at points of a face's facets, (n, k) each."""
    corners = face.facets.shape[1]
    values = hats(at, corners)
    if not edges.size:
        return face.facets[facet], values
    bumps = bubble * edge_bubbles(at, corners)
    for e, ends in enumerate(_EDGES[corners]):
        values[:, ends] -= 0.5 * bumps[:, [e]]
    columns = np.hstack([face.facets[facet], len(face.nodes) + edges[facet]])
    return columns, np.hstack([values, bumps])


def _sparse(rows, left, columns, right, shape) -> scipy.sparse.csr_matrix:
    """Sum over points of left_j right_k at (rows_j, columns_k)."""
    i, j, v = np.broadcast_arrays(
        rows[:, :, None], columns[:, None, :], left[:, :, None] * right[:, None, :]
    )
    return scipy.sparse.coo_matrix((v.ravel(), (i.ravel(), j.ravel())), shape=shape).tocsr()


# -- where two faces with different meshes lie on one another ----------------------------------


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


def hats(at: np.ndarray, corners: int) -> np.ndarray:
    """Linear (bilinear) hat functions at reference positions, (n, corners)."""
    x = at[:, 0]
    if corners == 2:
        return np.column_stack([1 - x, x])
    y = at[:, 1]
    if corners == 3:
        return np.column_stack([1 - x - y, x, y])
    return np.column_stack([(1 - x) * (1 - y), x * (1 - y), (1 - x) * y, x * y])


def hat_integrals(
    points: np.ndarray, facets: np.ndarray, weight: Callable | None = None
) -> np.ndarray:
    """Integrals of the vertices' hat functions over each facet, (n_facets, k), in closed rules."""
    x, w = basix.make_quadrature(_CELLS[facets.shape[1]], 4)
    element = basix.create_element(basix.ElementFamily.P, _CELLS[facets.shape[1]], 1)
    hat, *by_axis = element.tabulate(1, x)[:, :, :, 0]
    at, *slopes = (np.einsum("qk,fki->fqi", table, points[facets]) for table in (hat, *by_axis))
    scale = np.linalg.norm(slopes[0] if len(slopes) == 1 else np.cross(*slopes), axis=2)
    if weight is not None:
        scale = scale * weight(at.reshape(-1, at.shape[2])).reshape(scale.shape)
    return np.einsum("q,fq,qk->fk", w, scale, hat)


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
    opposed = np.einsum("ij,ij->i", upper.normals[u], lower.normals[v]) < OPPOSED
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
