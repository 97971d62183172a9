"""A sheet from a flat surface mesh: one cell through its thickness."""

from __future__ import annotations

import numpy as np

from fenics_joints.meshes.cad_layer import prisms_to_tetrahedra
from fenics_joints.meshes.tagged import MeshLists


def thickened(flat: MeshLists, thickness: float) -> MeshLists:
    """The solid over a plane mesh, half of its thickness on either side of z = 0.

    Quadrilaterals become hexahedra, triangles three tetrahedra each. Named edges become the walls
    over them, and named points become points on both sides.

    Args:
        flat: Triangles or quadrilaterals, vertices of shape (n, 2).
        thickness: Thickness of the sheet, m.
    """
    n, half = len(flat.x), 0.5 * thickness
    x = np.vstack([np.column_stack([flat.x, np.full(n, z)]) for z in (-half, half)])
    a, b = np.sort(flat.facets, axis=1).T
    if flat.cell == "triangle":
        cell, cells = "tetrahedron", prisms_to_tetrahedra(flat.cells, flat.cells + n, flat.cells)
        values = np.tile(flat.cell_values, 3)
        # Diagonal of a side, see prisms_to_tetrahedra.
        facets = np.vstack([np.column_stack(t) for t in ((a, b, b + n), (a, a + n, b + n))])
        facet_values = np.tile(flat.facet_values, 2)
        mirrored = np.linalg.det(x[cells[:, 1:]] - x[cells[:, :1]]) < 0
        cells[mirrored] = cells[mirrored][:, [0, 1, 3, 2]]
    else:
        cell, values, facet_values = "hexahedron", flat.cell_values, flat.facet_values
        sides = flat.x[flat.cells[:, 1:3]] - flat.x[flat.cells[:, :1]]
        mirrored = np.linalg.det(sides)[:, None] < 0
        upright = np.where(mirrored, flat.cells[:, [0, 2, 1, 3]], flat.cells)
        cells = np.hstack([upright, upright + n])
        facets = np.column_stack([a, b, a + n, b + n])
    points = {
        name: np.vstack([np.column_stack([p[:, :2], np.full(len(p), z)]) for z in (-half, half)])
        for name, p in flat.points.items()
    }
    return MeshLists(
        cell, x, cells, values, facets, facet_values, flat.cell_names, flat.facet_names, points
    )
