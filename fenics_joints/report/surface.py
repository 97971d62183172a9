"""The outside of a mesh as few vertices and faces, for a view in three dimensions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fenics_joints.report import geometry

#: Corners are one vertex if their motions differ by less than this share of the largest; chosen.
_ALIKE = 1e-3


@dataclass(frozen=True, repr=False)
class Surface:
    """Faces of cells that are outside, and their corners, each once.

    Attributes:
        points: Positions, m, (n, 3).
        faces: Corners of each face in order around it, (m, 3) or (m, 4); a triangle among
            quadrilaterals names its last corner twice.
        pick: Row of each vertex among all corners of all cells, one cell after the other, (n,).
        group: Group of the cells that each vertex belongs to, (n,).
        level: Level of these cells, (n,).
        whole: Faces before they were coarsened.
    """

    points: np.ndarray
    faces: np.ndarray
    pick: np.ndarray
    group: np.ndarray
    level: np.ndarray
    whole: int

    def __repr__(self) -> str:
        return f"Surface({len(self.points)} vertices, {len(self.faces)} of {self.whole} faces)"


def surface(
    vertices: np.ndarray,
    group: np.ndarray | None = None,
    level: np.ndarray | None = None,
    motions: Sequence[np.ndarray] = (),
) -> Surface:
    """The outside of cells, level by level.

    Cells that touch share their vertices where they are of one group and level and move alike.

    Args:
        vertices: Corners of all cells, m, (n_cells, n_corners, 3).
        group: Group of each cell, (n_cells,); by default one.
        level: Level of each cell, (n_cells,), lowest 0; by default one.
        motions: How the corners move, each as ``vertices``.

    Raises:
        InputError: If cells have a shape that the suite does not use.
    """
    x = np.asarray(vertices, dtype=float)
    n, corners = x.shape[:2]
    group = np.zeros(n, dtype=np.int64) if group is None else np.asarray(group, dtype=np.int64)
    level = np.zeros(n, dtype=np.int64) if level is None else np.asarray(level, dtype=np.int64)
    local = geometry.face_corners(x)
    ids = geometry.vertex_ids(x)
    apart = ids * (int(level.max(initial=0)) + 1) + level[:, None]
    outer = geometry.bounding(apart[:, local].reshape(-1, local.shape[1]))
    rows = (np.arange(n)[:, None, None] * corners + local).reshape(-1, local.shape[1])[outer]
    used, back = np.unique(rows, return_inverse=True)
    key = [ids.ravel()[used], group[used // corners], level[used // corners]]
    for motion in motions:
        flat = np.asarray(motion, dtype=float).reshape(-1, 3)
        size = _ALIKE * (np.abs(flat).max(initial=0.0) or 1.0)
        key += list(np.round(flat[used] / size).astype(np.int64).T)
    _, first, vertex = np.unique(np.array(key).T, axis=0, return_index=True, return_inverse=True)
    pick = used[first]
    cell = pick // corners
    faces = vertex.ravel()[back].reshape(rows.shape)
    return Surface(x.reshape(-1, 3)[pick], faces, pick, group[cell], level[cell], len(faces))


def coarsened(s: Surface, most: int) -> Surface:
    """A surface of at most so many vertices: those in a cube of space are one of them.

    A vertex that stays is one that was there, so that what it carries is true of it.
    """
    if len(s.points) <= most:
        return s
    size = np.ptp(s.points, axis=0).max() / 2
    edge = size / np.sqrt(most)
    while True:
        whole = np.floor((s.points - s.points.min(axis=0)) / edge).astype(np.int64)
        key = np.column_stack([whole, s.group, s.level])
        _, cluster = np.unique(key, axis=0, return_inverse=True)
        cluster = cluster.ravel()
        count = int(cluster.max()) + 1
        if count <= most:
            break
        edge *= max(1.05, np.sqrt(count / most) * 0.98)
    middle = np.zeros((count, 3))
    np.add.at(middle, cluster, s.points)
    middle /= np.bincount(cluster)[:, None]
    off = np.sum((s.points - middle[cluster]) ** 2, axis=1)
    kept = np.lexsort((off, cluster))
    kept = kept[np.unique(cluster[kept], return_index=True)[1]]
    faces = _tidied(cluster[s.faces])
    return Surface(s.points[kept], faces, s.pick[kept], s.group[kept], s.level[kept], s.whole)


def _tidied(faces: np.ndarray) -> np.ndarray:
    """Faces of three corners or more, each once; equal corners last."""
    if faces.shape[1] == 4:
        # A corner that is its neighbour is dropped: the others close up, the last stands twice.
        for i in range(3):
            same = faces[:, i] == faces[:, i + 1]
            faces[same, i:-1] = faces[same, i + 1 :]
        ends = faces[:, 3] == faces[:, 0]
        faces[ends, 3] = faces[ends, 2]
    distinct = (np.diff(np.sort(faces, axis=1), axis=1) > 0).sum(axis=1) >= 2
    faces = faces[distinct]
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    return faces[np.sort(first)]
