"""Values of displacements at points of plane faces: rows of sparse matrices."""

from __future__ import annotations

import numpy as np
from scipy import sparse

#: Barycentric points and weights, exact to degree 4 (Strang and Fix 1973; Dunavant 1985).
_A, _B = 0.445948490915965, 0.091576213509771
_WEIGHTS = np.repeat([0.223381589678011, 0.109951743655322], 3)
_POINTS = np.array([np.roll([1 - 2 * a, a, a], shift) for a in (_A, _B) for shift in range(3)])


def quadrature(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 2) and weights (n,), m2, of a rule on triangles with these corners (k, 3, 2)."""
    points = np.einsum("qi,kid->kqd", _POINTS, corners)
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2
    return points.reshape(-1, 2), np.outer(area, _WEIGHTS).ravel()


def shape_functions(bary: np.ndarray) -> np.ndarray:
    """Quadratic shape functions, (n, 6), at barycentric coordinates (n, 3)."""
    corner = bary * (2 * bary - 1)
    side = np.stack([4 * bary[:, (i + 1) % 3] * bary[:, (i + 2) % 3] for i in range(3)], axis=1)
    return np.concatenate([corner, side], axis=1)


def locate(corners: np.ndarray, points: np.ndarray):
    """The triangle of each point, barycentric coordinates in it, and how far outside it is.

    Args:
        corners: (k, 3, 2).
        points: (n, 2).

    Returns:
        Triangles (n,), coordinates (n, 3), and the least coordinate of each, negative outside.
    """
    t = np.stack([corners[:, 0] - corners[:, 2], corners[:, 1] - corners[:, 2]], axis=2)
    local = np.einsum("kij,nkj->nki", np.linalg.inv(t), points[:, None] - corners[None, :, 2])
    bary = np.concatenate([local, 1 - local.sum(axis=2, keepdims=True)], axis=2)
    worst = bary.min(axis=2)
    best = worst.argmax(axis=1)
    every = np.arange(len(points))
    return best, bary[every, best], worst[every, best]


def rows(face, points: np.ndarray, n_nodes: int, start: int, n_dofs: int):
    """Rows that give u_x, u_y, u_z at points of a face, three matrices (n, n_dofs).

    Args:
        face: Corners and nodes of its triangles.
        points: In the plane of the face, (n, 2).
        n_nodes: Nodes of the body.
        start: First unknown of the body in the whole.
        n_dofs: Unknowns of the whole.
    """
    triangle, bary, _ = locate(face[0], points)
    values = shape_functions(bary)
    nodes = face[1][triangle]
    i = np.repeat(np.arange(len(points)), 6)
    scalar = (values.ravel(), nodes.ravel())
    return [
        sparse.csr_matrix((scalar[0], (i, start + 3 * scalar[1] + c)), shape=(len(points), n_dofs))
        for c in range(3)
    ]
