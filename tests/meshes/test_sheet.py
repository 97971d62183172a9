"""Plane meshes as sheets of some thickness, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mesh_measures import COMM, QUADRILATERAL, areas, skin, volumes, write_msh
from mpi4py import MPI

from fenics_joints.errors import MeshError
from fenics_joints.meshes import check_mesh, read_msh

SHELL = Path(__file__).parent / "data" / "shell.msh"
TRIANGLE, LINE = 2, 1
#: A strip of 3 x 1 with a skew middle, mirrored in its second half, and one end with a name.
NODES = [(0, 0, 7), (1.2, 0, 7), (3, 0, 7), (0, 1, 7), (0.9, 1, 7), (3, 1, 7)]
NAMES = {(2, 1): "left", (2, 2): "right", (1, 3): "end", (0, 4): "corner"}
ENDS = [(LINE, 3, [4, 1]), (15, 4, [6])]
PLANE = {
    "quadrilaterals": [(QUADRILATERAL, 1, [1, 2, 5, 4]), (QUADRILATERAL, 2, [2, 5, 6, 3])],
    "triangles": [
        (TRIANGLE, 1, [1, 2, 5]),
        (TRIANGLE, 1, [5, 4, 1]),
        (TRIANGLE, 2, [2, 6, 5]),
        (TRIANGLE, 2, [2, 3, 6]),
    ],
}


@pytest.mark.parallel
@pytest.mark.parametrize("shape", PLANE)
def test_a_sheet_has_its_volume_walls_and_points(shared_tmp_path, shape):
    path = shared_tmp_path / "mesh.msh"
    if COMM.rank == 0:
        write_msh(shared_tmp_path, elements=PLANE[shape] + ENDS, names=NAMES, nodes=NODES)
    COMM.barrier()
    tagged = read_msh(path, COMM, gdim=2, scale=0.1, thickness=0.02)
    left = 0.5 * (1.2 + 0.9)
    found = volumes(tagged)
    assert found == pytest.approx({"left": 2e-4 * left, "right": 2e-4 * (3 - left)})
    assert areas(tagged) == pytest.approx({"end": 0.1 * 0.02})
    # A cut that does not conform would add its faces.
    assert skin(tagged) == pytest.approx(2 * 0.03 + 0.02 * 0.8)
    assert check_mesh(tagged).bodies == 1
    corner = [[0.3, 0.1, -0.01], [0.3, 0.1, 0.01]]
    assert np.allclose(np.sort(tagged.points["corner"], axis=0), corner)


@pytest.mark.parametrize(
    "given, words",
    [
        ({"gdim": 3}, "gdim = 2 and its thickness"),
        ({"gdim": 3, "thickness": 0.01}, "thickness"),
        ({"gdim": 2, "thickness": 0.0}, "thickness"),
        ({"gdim": 2, "thickness": "2 mm"}, "thickness"),
    ],
)
def test_what_is_no_sheet(given, words):
    with pytest.raises(MeshError, match=words):
        read_msh(SHELL, MPI.COMM_SELF, **given)


def test_a_folded_shell_is_none(tmp_path):
    nodes = [*NODES[:5], (3, 1, 8)]
    path = write_msh(tmp_path, elements=PLANE["triangles"], names=NAMES, nodes=nodes)
    with pytest.raises(MeshError, match="folded"):
        read_msh(path, MPI.COMM_SELF, gdim=2, thickness=0.1)
