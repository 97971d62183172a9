"""Files of gmsh: named groups, and every refusal by its message."""

import re
from itertools import product
from pathlib import Path

import dolfinx
import numpy as np
import pytest
from mesh_measures import (
    COMM,
    ELEMENTS,
    HEXAHEDRON,
    LEFT,
    NODES,
    PRISM,
    QUADRATIC_TETRAHEDRON,
    QUADRILATERAL,
    RIGHT,
    TETRAHEDRON,
    areas,
    skin,
    volumes,
    write_msh,
    written,
)
from mpi4py import MPI

from fenics_joints.errors import MeshError
from fenics_joints.meshes import check_mesh, read_msh


@pytest.mark.parallel
@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0)])
def test_named_groups_are_read(shared_tmp_path, order):
    path = written(shared_tmp_path, elements=[ELEMENTS[i] for i in order])
    tagged = read_msh(path, COMM, scale=1e-3)
    assert tagged.cell_names == {"left": 1, "right": 2} and tagged.facet_names == {"interface": 3}
    assert volumes(tagged) == pytest.approx({"left": 1e-9, "right": 1e-9})
    assert areas(tagged) == pytest.approx({"interface": 1e-6})
    for cell in tagged.cell_tags.find(1):
        corners = dolfinx.mesh.entities_to_geometry(tagged.mesh, 3, np.array([cell]))
        np.testing.assert_allclose(tagged.mesh.geometry.x[corners[0]].mean(axis=0), 5e-4)


def test_what_gmsh_writes_is_read(tmp_path):
    """Two versions of the format, each as text and in binary."""
    gmsh = pytest.importorskip("gmsh")
    gmsh.initialize(interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.model.add("of_the_caller")
    ball = gmsh.model.occ.addSphere(0, 0, 0, 1)
    cube = gmsh.model.occ.addBox(-2, -2, -2, 4, 4, 4)
    gmsh.model.occ.fragment([(3, ball)], [(3, cube)])
    gmsh.model.occ.synchronize()
    inside = gmsh.model.getEntitiesInBoundingBox(-1.1, -1.1, -1.1, 1.1, 1.1, 1.1, 3)[0][1]
    outside = next(tag for _, tag in gmsh.model.getEntities(3) if tag != inside)
    sphere = [tag for _, tag in gmsh.model.getBoundary([(3, inside)], oriented=False)]
    gmsh.model.addPhysicalGroup(3, [inside], 5, "ball")
    gmsh.model.addPhysicalGroup(3, [outside], 6, "rest")
    gmsh.model.addPhysicalGroup(2, sphere, 7, "sphere")
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.4)
    gmsh.model.mesh.generate(3)
    read = []
    for version, binary in product((2.2, 4.1), (0, 1)):
        gmsh.option.setNumber("Mesh.MshFileVersion", version)
        gmsh.option.setNumber("Mesh.Binary", binary)
        gmsh.write(str(tmp_path / "ball.msh"))
        read.append(read_msh(tmp_path / "ball.msh", MPI.COMM_SELF))
    current = gmsh.model.getCurrent()
    gmsh.finalize()
    assert current == "of_the_caller"
    for tagged in read:
        found = volumes(tagged)
        # The inscribed polyhedron lacks about h^2 / 4 of the ball, and the rest has what it lacks.
        assert 4 / 3 * np.pi * (1 - 0.4**2 / 2) < found["ball"] < 4 / 3 * np.pi
        assert found["ball"] + found["rest"] == pytest.approx(64)
        assert 4 * np.pi * (1 - 0.4**2 / 2) < areas(tagged)["sphere"] < 4 * np.pi


FLAT = [(x, y, z) if x < 2 else (1, y + 1, z) for x, y, z in NODES]
BAD_FILES = {
    "unnamed group": (
        {"names": {(3, 1): "left", (2, 3): "interface"}},
        "volume group 2 has no name",
    ),
    "cells in no group": (
        {"elements": [*ELEMENTS[:1], (HEXAHEDRON, 0, RIGHT), ELEMENTS[2]]},
        "1 cells (volume 10) are in no named group, expected every cell in one; groups of "
        "dimension 3: left",
    ),
    "no cells": ({"elements": ELEMENTS[2:]}, "no cells of dimension 3"),
    "cell in two groups": (
        {"elements": [(HEXAHEDRON, 1, LEFT, 11), (HEXAHEDRON, 2, RIGHT, 11)]},
        "volume 11 is in 'left' and 'right', expected one group",
    ),
    "inverted": (
        {"elements": [ELEMENTS[0], (HEXAHEDRON, 2, RIGHT[4:] + RIGHT[:4]), ELEMENTS[2]]},
        "1 inverted and 0 flat cells; the first has its centre at (1.5, 0.5, 0.5) m in part "
        "'right'",
    ),
    "flat": (
        {"nodes": FLAT},
        "0 inverted and 1 flat cells; the first has its centre at (1, 1, 0.5) m in part 'right'",
    ),
    "mixed shapes": (
        {"elements": [ELEMENTS[0], (TETRAHEDRON, 2, [5, 9, 6, 8]), ELEMENTS[2]]},
        "the elements of dimension 3 are hexahedron and tetrahedron, expected one shape",
    ),
    "prisms": (
        {"elements": [ELEMENTS[0], (PRISM, 2, [5, 9, 10, 8, 12, 11]), ELEMENTS[2]]},
        "group 'right' has Prism 6 elements, expected",
    ),
    "second order": (
        {"elements": [(QUADRATIC_TETRAHEDRON, 1, range(1, 11)), ELEMENTS[1]]},
        "group 'left' has elements of order 2 (Tetrahedron 10), expected order 1",
    ),
    "face that is no facet": (
        {"elements": [*ELEMENTS[:2], (QUADRILATERAL, 3, [5, 6, 11, 12])]},
        "0 of 1 facets of face 'interface' are facets of the cells",
    ),
    "face off the cells": (
        {
            "nodes": [*NODES, (5, 5, 5)],
            "elements": [*ELEMENTS[:2], (QUADRILATERAL, 3, [5, 6, 7, 13])],
        },
        "a face has vertices that no cell has",
    ),
}


@pytest.mark.parallel
@pytest.mark.parametrize("case", BAD_FILES)
def test_bad_files_are_refused_on_every_rank(shared_tmp_path, case):
    content, message = BAD_FILES[case]
    path = written(shared_tmp_path, **content)
    with pytest.raises(MeshError, match=re.escape(message)) as caught:
        read_msh(path, COMM)
    assert str(path) in str(caught.value)


def test_what_is_no_msh_file_is_refused(tmp_path):
    with pytest.raises(MeshError, match="no such file"):
        read_msh(tmp_path / "absent.msh", MPI.COMM_SELF)
    # gmsh would run this as its script.
    script = tmp_path / "script.msh"
    script.write_text("SetFactory('OpenCASCADE'); Box(1) = {0, 0, 0, 1, 1, 1};")
    with pytest.raises(MeshError, match="not a gmsh .msh file"):
        read_msh(script, MPI.COMM_SELF)
    whole = write_msh(tmp_path).read_text()
    (tmp_path / "mesh.msh").write_text(whole[: whole.index("$Elements") - 40])
    with pytest.raises(MeshError, match="mesh.msh: "):
        read_msh(tmp_path / "mesh.msh", MPI.COMM_SELF)


SHELL = Path(__file__).parent / "data" / "shell.msh"
TRIANGLE, LINE = 2, 1
#: A strip of 3 x 1 with a skew middle, mirrored in its second half, and one end with a name.
STRIP = [(0, 0, 7), (1.2, 0, 7), (3, 0, 7), (0, 1, 7), (0.9, 1, 7), (3, 1, 7)]
STRIP_NAMES = {(2, 1): "left", (2, 2): "right", (1, 3): "end", (0, 4): "corner"}
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
        write_msh(shared_tmp_path, elements=PLANE[shape] + ENDS, names=STRIP_NAMES, nodes=STRIP)
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


def test_what_is_no_sheet(tmp_path):
    for given, words in (
        ({"gdim": 3}, "gdim = 2 and its thickness"),
        ({"gdim": 3, "thickness": 0.01}, "thickness"),
        ({"gdim": 2, "thickness": 0.0}, "thickness"),
        ({"gdim": 2, "thickness": "2 mm"}, "thickness"),
    ):
        with pytest.raises(MeshError, match=words):
            read_msh(SHELL, MPI.COMM_SELF, **given)
    nodes = [*STRIP[:5], (3, 1, 8)]
    path = write_msh(tmp_path, elements=PLANE["triangles"], names=STRIP_NAMES, nodes=nodes)
    with pytest.raises(MeshError, match="folded"):
        read_msh(path, MPI.COMM_SELF, gdim=2, thickness=0.1)
