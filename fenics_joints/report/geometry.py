"""Faces of a mesh's cells for pictures: which are outside, which pieces and levels there are."""

from __future__ import annotations

import numpy as np
import scipy.sparse
from scipy.sparse.csgraph import connected_components

from fenics_joints.errors import InputError

#: Corners of each face in DOLFINx's (tensor-product) order.
_FACES = {
    "hexahedron": [
        (0, 1, 3, 2),
        (4, 5, 7, 6),
        (0, 1, 5, 4),
        (2, 3, 7, 6),
        (0, 2, 6, 4),
        (1, 3, 7, 5),
    ],
    "tetrahedron": [(0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)],
    "quadrilateral": [(0, 1, 3, 2)],
    "triangle": [(0, 1, 2)],
}
#: How far the oblique view is turned to the right, and seen from above.
TURN, TILT = np.radians(-28.0), np.radians(28.0)
#: More levels than this are no exploded view any more.
_MOST_LEVELS = 6


def _cell_name(vertices: np.ndarray) -> str:
    n = vertices.shape[1]
    if n == 4:
        edges = vertices[:, 1:] - vertices[:, :1]
        volume = np.abs(np.linalg.det(edges)).max()
        return "tetrahedron" if volume > 1e-9 * np.abs(edges).max() ** 3 else "quadrilateral"
    names = {8: "hexahedron", 3: "triangle"}
    if n not in names:
        raise InputError(f"cells with {n} corners: expected 3, 4 or 8.")
    return names[n]


def face_corners(vertices: np.ndarray) -> np.ndarray:
    """Corners of all faces of all cells, shape (n_cells, n_faces, n_face_corners), as indices."""
    return np.array(_FACES[_cell_name(vertices)])


def vertex_ids(vertices: np.ndarray) -> np.ndarray:
    """Number of each corner, equal where corners coincide, shape (n_cells, n_corners)."""
    flat = vertices.reshape(-1, 3)
    size = np.ptp(flat, axis=0).max() or 1.0
    _, ids = np.unique(np.round(flat / size * 1e7).astype(np.int64), axis=0, return_inverse=True)
    return ids.reshape(vertices.shape[:2])


def pieces_of(ids: np.ndarray, region: np.ndarray) -> np.ndarray:
    """Number of the connected piece of one region that each cell belongs to, shape (n_cells,)."""
    piece = np.empty(len(ids), dtype=np.int64)
    n = 0
    for r in np.unique(region):
        cells = np.flatnonzero(region == r)
        rows = np.repeat(np.arange(len(cells)), ids.shape[1])
        graph = scipy.sparse.coo_matrix(
            (np.ones(len(rows)), (rows, len(cells) + ids[cells].ravel())),
            shape=(len(cells) + ids.max() + 1,) * 2,
        )
        _, label = connected_components(graph, directed=False)
        _, label = np.unique(label[: len(cells)], return_inverse=True)
        piece[cells] = n + label
        n += label.max() + 1
    return piece


def levels_of(height: np.ndarray, piece: np.ndarray) -> list[np.ndarray]:
    """Cells by level, highest first: pieces whose heights overlap by half are on one level."""
    spans = []
    for p in range(piece.max() + 1):
        h = height[piece == p]
        spans.append((h.min(), h.max(), p))
    levels: list[list] = []
    for low, high, p in sorted(spans, key=lambda s: (s[0] + s[1]) / 2):
        if levels:
            l0, h0, members = levels[-1]
            overlap = min(high, h0) - max(low, l0)
            if overlap >= 0.5 * min(high - low, h0 - l0) - 1e-12:
                levels[-1] = [min(low, l0), max(high, h0), [*members, p]]
                continue
        levels.append([low, high, [p]])
    if len(levels) > _MOST_LEVELS:
        return [np.arange(len(piece))]
    return [np.flatnonzero(np.isin(piece, members)) for _, _, members in reversed(levels)]


def stacked(height: np.ndarray, piece: np.ndarray) -> np.ndarray:
    """Level of each cell, the lowest 0, as `levels_of` finds them, (n_cells,)."""
    level = np.zeros(len(piece), dtype=np.int64)
    for k, members in enumerate(reversed(levels_of(height, piece))):
        level[members] = k
    return level


def upright(x: np.ndarray) -> np.ndarray:
    """Rotation, (3, 3), that takes the longest direction to x and the thinnest to z."""
    order = np.argsort(-np.ptp(x.reshape(-1, 3), axis=0), kind="stable")
    turn = np.eye(3)[order]
    if np.linalg.det(turn) < 0:
        turn[1] *= -1
    return turn


def bounding(ids: np.ndarray) -> np.ndarray:
    """Rows of vertices, in any order, that no other row has: what bounds cells or polygons."""
    _, first, count = np.unique(np.sort(ids, axis=1), axis=0, return_index=True, return_counts=True)
    return first[count == 1]


def outline(ids: np.ndarray, flat: np.ndarray) -> np.ndarray:
    """Edges, shape (n, 2, 2), where a group of quadrilaterals ends; ``ids`` number the corners."""
    edges = np.stack([ids, np.roll(ids, -1, axis=1)], axis=2).reshape(-1, 2)
    ends = np.stack([flat, np.roll(flat, -1, axis=1)], axis=2).reshape(-1, 2, 2)
    return ends[bounding(edges)]


def outer_faces(vertices, motion) -> tuple[np.ndarray, np.ndarray]:
    """Outer faces and their motion: those that belong to one cell only."""
    faces = face_corners(vertices)
    ids = vertex_ids(vertices)[:, faces].reshape(-1, faces.shape[1])
    outer = bounding(ids)
    shape = (-1, faces.shape[1], 3)
    return vertices[:, faces].reshape(shape)[outer], motion[:, faces].reshape(shape)[outer]


def oblique(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Parallel projection from the front, the right and above; and how near each face is."""
    right = np.array([np.cos(TURN), -np.sin(TURN), 0.0])
    into = np.array([np.sin(TURN), np.cos(TURN), 0.0]) * np.cos(TILT)
    into[2] = -np.sin(TILT)
    upward = np.cross(right, into)
    return np.stack([x @ right, x @ upward], axis=-1), -(x @ into).mean(axis=1)


def oblique_points(points: np.ndarray) -> np.ndarray:
    """Points, (n, 3), in the oblique view, (n, 2)."""
    return oblique(np.asarray(points, dtype=float)[:, None, :])[0][:, 0]
