"""Cells for VTK, and tables for notebooks."""

from __future__ import annotations

import numpy as np
import pytest
from dolfinx import mesh
from mpi4py import MPI

from fenics_joints._compat import geometry_dofmap
from fenics_joints.formatting import html_table
from fenics_joints.meshes import box
from fenics_joints.modal import solve_modes
from fenics_joints.structure import Structure, part
from fenics_joints.structure.grids import cell_arrays, facet_mesh

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="about one process")


@pytest.mark.parametrize(
    ("cell", "kind"), [(mesh.CellType.hexahedron, 12), (mesh.CellType.tetrahedron, 10)]
)
def test_cells_are_vtks_and_share_points_that_carry_the_same(cell, kind):
    msh = mesh.create_unit_cube(MPI.COMM_SELF, 2, 1, 1, cell)
    corners = msh.geometry.x[geometry_dofmap(msh)]
    cells, kinds, points, values = cell_arrays(corners, 3, {"x": corners})
    assert set(kinds) == {kind} and len(points) == 12
    np.testing.assert_allclose(values["x"], points)
    rows = cells.reshape(len(corners), -1)
    assert set(rows[:, 0]) == {corners.shape[1]}
    if kind == 12:  # VTK: around the bottom, then around the top
        x = points[rows[:, 1:]]
        along = np.roll(x[:, :4], -1, axis=1) - x[:, :4]
        np.testing.assert_allclose(np.sum(along * np.roll(along, 1, axis=1), axis=2), 0, atol=1e-12)
        np.testing.assert_allclose(x[:, 4:] - x[:, :4], np.broadcast_to([0, 0, 1.0], (2, 4, 3)))
    # What differs from cell to cell keeps its points apart.
    number = np.broadcast_to(np.arange(len(corners))[:, None], corners.shape[:2])
    assert len(cell_arrays(corners, 3, {"cell": number})[2]) == corners.shape[0] * corners.shape[1]


def test_tables_of_notebooks_are_escaped():
    table = html_table("<b>", ("a", "<i>"), [("&", "</table><script>")])
    assert "<b>" not in table and "<script>" not in table and "&lt;script&gt;" in table


def test_structures_modes_and_facets_are_pyvistas():
    pytest.importorskip("pyvista", reason="optional")
    body = part("beam", "body", E=2e11, nu=0.3, rho=7800.0)
    plate = Structure(box(MPI.COMM_SELF, (0.3, 0.05, 0.01), (6, 1, 1)), [body])
    grid = plate.to_pyvista()
    volume = grid.compute_cell_sizes()["Volume"].sum()
    assert volume == pytest.approx(plate.volumes().sum()) and set(grid["region"]) == {0}
    modes = solve_modes(plate, n_modes=8)
    shape = modes.to_pyvista(7)
    size = np.linalg.norm(shape["displacement"], axis=1)
    assert shape.n_points == grid.n_points and size.max() > 0
    assert "elastic" in getattr(modes, "_repr" + "_html_")()  # as notebooks ask for it
    x = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.0]])
    square = facet_mesh(x, np.array([[0, 1, 2, 3]]), {"p": x[:, 0]}, {"q": [1.0]})
    assert square.area == pytest.approx(1.0)
