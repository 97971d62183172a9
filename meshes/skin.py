"""Facets of a whole mesh on one rank, found from its cells, and names for them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from fenics_joints.meshes.tagged import MeshLists

# Corners of a cell's facets, each facet's in DOLFINx's order.
FACETS = {
    "triangle": np.array([[1, 2], [0, 2], [0, 1]]),
    "quadrilateral": np.array([[0, 1], [0, 2], [1, 3], [2, 3]]),
    "tetrahedron": np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]),
    "hexahedron": np.array(
        [[0, 1, 2, 3], [0, 1, 4, 5], [0, 2, 4, 6], [1, 3, 5, 7], [2, 3, 6, 7], [4, 5, 6, 7]]
    ),
}


def row_numbers(rows: np.ndarray) -> np.ndarray:
    """A number for each row, the same for rows of the same entries in any order.

    Args:
        rows: Whole numbers, such as the vertices of facets; shape (n, m).

    Returns:
        Numbers from 0, shape (n,).
    """
    rows = np.sort(rows, axis=1)
    order = np.lexsort(rows.T[::-1])
    changes = np.any(np.diff(rows[order], axis=0, prepend=rows[order[:1]]) != 0, axis=1)
    numbers = np.empty(len(rows), dtype=np.int64)
    numbers[order] = np.cumsum(changes)
    return numbers


def exterior_facets(lists: MeshLists) -> tuple[np.ndarray, np.ndarray]:
    """Facets of one cell alone.

    Returns:
        Vertices of each facet in DOLFINx's order, shape (n, n_corners); its cell, shape (n,).
    """
    facets = lists.cells[:, FACETS[lists.cell]]
    n_sides = facets.shape[1]
    facets = facets.reshape(-1, facets.shape[2])
    numbers = row_numbers(facets)
    alone = np.flatnonzero(np.bincount(numbers)[numbers] == 1)
    return facets[alone], alone // n_sides


def facets_between(lists: MeshLists, part: str, other: str) -> np.ndarray:
    """Vertices of the facets that a cell of one part shares with one of the other.

    Returns:
        Vertices of each facet in DOLFINx's order, shape (n, n_corners).
    """
    sides = []
    for name in (part, other):
        cells = lists.cells[lists.cell_values == lists.cell_names[name]]
        corners = FACETS[lists.cell].shape[1]
        sides.append(cells[:, FACETS[lists.cell]].reshape(-1, corners))
    numbers = row_numbers(np.vstack(sides))
    first = len(sides[0])
    return sides[0][np.isin(numbers[:first], numbers[first:])]


def add_faces(lists: MeshLists, faces: Mapping[str, np.ndarray]) -> MeshLists:
    """The same mesh with more named faces.

    Args:
        lists: The mesh.
        faces: Vertices of each face's facets, each of shape (n, n_corners). A name that the mesh
            has already is extended; facets must not have a tag yet, since they have but one.

    Returns:
        The mesh, with tags above its own for names that are new.
    """
    names = dict(lists.facet_names)
    facets, values = [lists.facets], [lists.facet_values]
    for name, new in faces.items():
        tag = names.setdefault(name, max(names.values(), default=0) + 1)
        facets.append(np.asarray(new).reshape(-1, lists.facets.shape[1]))
        values.append(np.full(len(new), tag, dtype=np.int32))
    return replace(
        lists, facets=np.vstack(facets), facet_values=np.concatenate(values), facet_names=names
    )
