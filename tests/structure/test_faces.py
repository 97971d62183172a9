"""Faces whose vertices match, and each way in which two faces do not."""

import re

import numpy as np
import pytest
from contact_blocks import COMM, two_bodies

from fenics_joints.errors import MeshError
from fenics_joints.meshes import box, c_beams, check_mesh, graded_lines
from fenics_joints.meshes.facets import Skin
from fenics_joints.meshes.grid import extruded, tensor_grid
from fenics_joints.meshes.tagged import distribute
from fenics_joints.parallel import on_root
from fenics_joints.preload import check_contact

X, Y = graded_lines([0, 0.5, 1], [0.1, 0.3, 0.1]), np.array([0, 0.2, 0.5, 0.6])
LOW, HIGH = np.array([-0.5, -0.2, 0]), np.array([0, 0.1, 0.3])
SMALL_BEAMS = {
    "element_size": 6e-3,
    "radial_size": 3e-3,
    "middle_size": 25e-3,
    "n_thickness": (2, 1),
}


def two_blocks(change):
    """Two blocks of tetrahedra face to face, of which ``change`` alters the upper's lists."""

    def build():
        points, quads = tensor_grid(X, Y)
        sides = []
        for tag, z in ((1, LOW[1:]), (2, HIGH[:2])):
            values = np.full((1, len(quads)), tag)
            skin = Skin(extruded(points, quads, z, values, "tetrahedron", {}))
            one = skin.named({"face": skin.at(2, 0.0)})
            rest = one.cells, one.cell_values, one.facets, tag * one.facet_values
            sides.append((one.x, *rest) if tag == 1 else change(one.x, *rest))
        return two_bodies("tetrahedron", sides, {"low": 1, "high": 2})

    return distribute(COMM, on_root(COMM, build))


def moved(x, *rest):
    x = x.copy()
    x[np.all(x == [X[2], 0.2, 0.0], axis=1), 0] += 0.01
    return x, *rest


def tilted(x, *rest):
    return x + [0, 0, 1e-3], *rest


def flipped(x, cells, *rest):
    # Mirrored at z = 0, into the lower block; the cells keep their orientation.
    cells = cells[:, [1, 0, 2, 3]]
    return x * [1, 1, -1], cells, *rest


def mirrored(x, cells, *rest):
    # The plan's lines are symmetric in x, the cut of the quadrilaterals is not.
    return np.column_stack([1 - x[:, 0], x[:, 1:]]), cells[:, [1, 0, 2, 3]], *rest


def cracked(x, cells, values, facets, tags):
    # One cell's corner on the face gets a vertex of its own.
    corner = facets[0, 0]
    cells, facets = cells.copy(), facets.copy()
    cell = np.flatnonzero(np.isin(cells, facets[0]).sum(axis=1) == 3)[0]
    cells[cell][cells[cell] == corner] = len(x)
    facets[0, 0] = len(x)
    return np.vstack([x, x[corner]]), cells, values, facets, tags


n_vertices = len(X) * len(Y)
BAD_PAIRS = {
    "moved": (moved, f"m; the worst, at [{X[2] + 0.01}, 0.2, 0.0] m, is 0.01 m from the nearest"),
    "apart": (tilted, f"{n_vertices} of {n_vertices} vertices of the smaller face have no"),
    "overlap": (flipped, "the two faces look the same way"),
    "diagonals": (mirrored, "the faces have the same vertices but other edges between them"),
    "cracked": (cracked, f"the faces have {n_vertices} and {n_vertices + 1} vertices, of which"),
}


@pytest.mark.parallel
@pytest.mark.parametrize("case", BAD_PAIRS)
def test_faces_that_do_not_match_are_refused(case):
    change, message = BAD_PAIRS[case]
    tagged = two_blocks(change)
    check_mesh(tagged)
    with pytest.raises(MeshError, match=re.escape(message)):
        check_contact(tagged, "low", "high")


@pytest.mark.parallel
def test_bonded_bodies_are_no_contact():
    tagged = c_beams(COMM, bonded=True, **SMALL_BEAMS)
    with pytest.raises(MeshError, match="face interface: some of its facets lie inside a body"):
        check_contact(tagged, "interface", "holes")
    with pytest.raises(MeshError, match="share vertices, so they are one body"):
        check_contact(box(COMM, (1.0, 1.0, 1.0), (2, 2, 2)), "x_min", "y_min")
    with pytest.raises(MeshError, match="no face named 'interface_upper'"):
        check_contact(tagged, "interface_upper", "interface")
    # Apart by more than the default tolerance, which the caller may raise.
    assert check_contact(two_blocks(tilted), "low", "high", 2e-3).gap == pytest.approx(1e-3)
