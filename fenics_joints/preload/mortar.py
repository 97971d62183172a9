"""Faces whose meshes do not match: what the lower one does, averaged for each vertex of the upper.

With the dual basis psi_j of the upper face's hats (biorthogonal to them facet by facet), the jump
of a vertex is that of the averages

    d_j w_j = integral psi_j (u_upper - u_lower),        d_j = integral of the vertex's hat,

so that constant pressure and linear displacements pass exactly (Wohlmuth, SIAM J. Numer. Anal. 38,
2000; Popp, Gee and Wall, Int. J. Numer. Methods Eng. 79, 2009). At degree 2 the jump stays linear,
and the upper face keeps the bubbles of its own midsides (Puso, Laursen and Solberg, Comput. Methods
Appl. Mech. Eng. 197, 2008). On facets that stick out of the lower face, the dual basis is that of
the covered part (Cichosz and Bischoff, Comput. Methods Appl. Mech. Eng. 200, 2011).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse

from fenics_joints.preload.overlap import Overlap, edge_bubbles, facet_edges, hats, overlap

#: Upper facets of which a smaller share is covered are not in contact.
_COVERED = 0.5


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


def couple(lower, upper, bubble: float, reach: float | None = None, weight=None) -> Mortar | None:
    """Couple two faces; None where they do not lie on one another.

    Args:
        lower: The face that is averaged (`fenics_joints.preload.faces.Face`).
        upper: The face whose vertices carry the jumps; better the smaller and the finer one.
        bubble: Value of a midside's shape function in the middle of its edge.
        reach: Farthest distance of facets along the normal, m; see `overlap`.
        weight: Weight of the surface measure as a function of positions, or None.
    """
    found = overlap(upper, lower, reach)
    if weight is not None:
        found = Overlap(
            found.upper,
            found.lower,
            found.weight * weight(found.points),
            found.at_upper,
            found.at_lower,
            found.points,
        )
    shares, duals, kept = _duals(found, upper, weight)
    if not kept.any():
        return None
    inside = kept[found.upper]
    found = Overlap(*(getattr(found, name)[inside] for name in Overlap.__dataclass_fields__))
    facets = np.flatnonzero(kept)
    rows, corners = np.unique(upper.facets[facets], return_inverse=True)
    corners = corners.reshape(len(facets), -1)
    areas = np.zeros(len(rows))
    np.add.at(areas, corners, shares[facets])
    coupling, nearest = _coupling(found, duals, areas, rows, facets, lower, upper, bubble)
    return Mortar(rows, facets, corners, shares[facets], nearest, coupling)


def _duals(found: Overlap, upper, weight):
    """Integrals of hats over covered parts, (n, k), dual bases, (n, k, k), and facets kept."""
    n, k = upper.facets.shape
    hat = hats(found.at_upper, k)
    shares, products = np.zeros((n, k)), np.zeros((n, k, k))
    np.add.at(shares, found.upper, found.weight[:, None] * hat)
    np.add.at(products, found.upper, (found.weight[:, None] * hat)[:, :, None] * hat[:, None, :])
    covered = np.zeros(n)
    plain = found.weight if weight is None else found.weight / weight(found.points)
    np.add.at(covered, found.upper, plain)
    kept = covered > _COVERED * _sizes(upper)
    duals = np.zeros((n, k, k))
    duals[kept] = shares[kept][:, :, None] * np.linalg.inv(products[kept])
    return shares, duals, kept


def _sizes(face) -> np.ndarray:
    """Areas (lengths) of a face's facets, (n,)."""
    x = face.points[face.facets]
    sides = [x[:, i] - x[:, 0] for i in range(1, x.shape[1])]
    if len(sides) == 1:
        return np.linalg.norm(sides[0], axis=1)
    area = 0.5 * np.linalg.norm(np.cross(sides[0], sides[1]), axis=1)
    if len(sides) == 3:
        area = area + 0.5 * np.linalg.norm(np.cross(x[:, 1] - x[:, 3], x[:, 2] - x[:, 3]), axis=1)
    return area


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
    local = np.sort(face.facets[:, facet_edges(face.facets.shape[1])], axis=2)
    return order[np.searchsorted(keys[order], local @ [n, 1])]


def _trace(face, edges: np.ndarray, facet: np.ndarray, at: np.ndarray, bubble: float):
    """Nodes and values of the shape functions at points of a face's facets, (n, k) each."""
    corners = face.facets.shape[1]
    values = hats(at, corners)
    if not edges.size:
        return face.facets[facet], values
    bumps = bubble * edge_bubbles(at, corners)
    for e, ends in enumerate(facet_edges(corners)):
        values[:, ends] -= 0.5 * bumps[:, [e]]
    columns = np.hstack([face.facets[facet], len(face.nodes) + edges[facet]])
    return columns, np.hstack([values, bumps])


def _sparse(rows, left, columns, right, shape) -> scipy.sparse.csr_matrix:
    """Sum over points of left_j right_k at (rows_j, columns_k)."""
    i, j, v = np.broadcast_arrays(
        rows[:, :, None], columns[:, None, :], left[:, :, None] * right[:, None, :]
    )
    return scipy.sparse.coo_matrix((v.ravel(), (i.ravel(), j.ravel())), shape=shape).tocsr()
