"""Meshes of separate bodies: matching by an independent route."""

import re

import numpy as np
import pytest
from matching_faces import assert_pair, faces, parts
from mpi4py import MPI

from fenics_joints.errors import MeshError
from fenics_joints.meshes import (
    bolted_plates,
    bolted_plates_section,
    box,
    c_beams,
    check_contact,
    check_mesh,
    graded_lines,
    stacked_blocks,
)
from fenics_joints.meshes.facets import Skin
from fenics_joints.meshes.grid import extruded, tensor_grid
from fenics_joints.meshes.tagged import MeshLists, distribute
from fenics_joints.parallel import on_root

COMM = MPI.COMM_WORLD
X, Y = graded_lines([0, 0.5, 1], [0.1, 0.3, 0.1]), np.array([0, 0.2, 0.5, 0.6])
LOW, HIGH = np.array([-0.5, -0.2, 0]), np.array([0, 0.1, 0.3])
SMALL_BEAMS = {
    "element_size": 6e-3,
    "radial_size": 3e-3,
    "middle_size": 25e-3,
    "n_thickness": (2, 1),
}


@pytest.mark.parallel
@pytest.mark.parametrize("cell", ["quadrilateral", "triangle", "hexahedron", "tetrahedron"])
def test_a_small_block_on_a_big_one(cell):
    plan = [X] if cell in ("quadrilateral", "triangle") else [X, Y]
    x0, x1, y1 = X[1], X[-3], Y[2]
    span = (x0, x1) if len(plan) == 1 else ((x0, x1), (0.0, y1))
    tagged = stacked_blocks(COMM, lower=(*plan, LOW), upper=HIGH, upper_span=span, cell=cell)
    width, depth = x1 - x0, (1.0, 1.0) if len(plan) == 1 else (0.6, y1)
    big, small = depth
    assert parts(tagged) == pytest.approx({"lower": 0.5 * big, "upper": 0.3 * width * small})
    ends = 0.5 * big + 0.3 * small
    expected = {"interface_lower": width * small, "interface_upper": width * small, "bottom": big}
    expected |= {"top": width * small, "left": ends, "right": ends}
    if len(plan) == 2:
        expected |= dict.fromkeys(("front", "back"), 0.5 + 0.3 * width)
    assert faces(tagged) == pytest.approx(expected)
    assert check_mesh(tagged).bodies == 2
    assert_pair(tagged, "interface_lower", "interface_upper", ("lower", "upper"))


def test_lines_grow_from_size_to_size():
    lines = graded_lines([1.0, 3.0, 4.0], [0.05, 0.4, 0.4])
    steps = np.diff(lines)
    assert {1.0, 3.0, 4.0} <= set(lines) and steps.max() <= 0.4 + 1e-12
    first = steps[lines[1:] <= 3.0]
    np.testing.assert_allclose(first[1:] / first[:-1], first[1] / first[0])
    assert 0.04 < first[0] < 0.06 and 0.35 < first[-1] <= 0.4
    np.testing.assert_allclose(graded_lines([0, 1], [0.25, 0.25]), np.linspace(0, 1, 5))


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
        (x0, c0, v0, f0, t0), (x1, c1, v1, f1, t1) = sides
        names = {"lower": 1, "upper": 2}, {"low": 1, "high": 2}
        return MeshLists(
            "tetrahedron",
            np.vstack([x0, x1]),
            np.vstack([c0, c1 + len(x0)]),
            np.append(v0, v1),
            np.vstack([f0, f1 + len(x0)]),
            np.append(t0, t1),
            *names,
        )

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
    "moved": (
        moved,
        f"face 'low' has 1 of {n_vertices} vertices without a partner on 'high'; the "
        f"farthest off is at ({X[2]:.6g}, 0.2, 0) m, its nearest neighbour 0.01 m",
    ),
    "apart": (tilted, f"face 'low' has {n_vertices} of {n_vertices} vertices without a partner"),
    "overlap": (flipped, "the bodies overlap; check the faces' names"),
    "diagonals": (
        mirrored,
        f"have matching vertices, but {4 * (len(X) - 1) * (len(Y) - 1)} facets without a partner",
    ),
    "cracked": (cracked, "has vertices that coincide, so it is cracked"),
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
    with pytest.raises(MeshError, match="216 of 216 facets between two cells: it is inside one"):
        check_contact(tagged, "interface", "holes")
    cube = box(COMM, (1.0, 1.0, 1.0), (2, 2, 2))
    with pytest.raises(MeshError, match=re.escape("share 3 vertices, the first at (0, 0, ")):
        check_contact(cube, "x_min", "y_min")
    with pytest.raises(MeshError, match="no face named 'interface_upper'"):
        check_contact(tagged, "interface", "interface_upper")
    # Apart by more than the default tolerance, which the caller may raise.
    assert check_contact(two_blocks(tilted), "low", "high", 0.02).distance == pytest.approx(1e-3)


SECTION, PLATES = bolted_plates_section, bolted_plates
WITH_BOLT = {"parts": "bolt"}


@pytest.mark.parametrize(
    ("builder", "arguments", "message"),
    [
        (stacked_blocks, {"lower": (X,), "upper": HIGH}, "expected lines (x, height), or"),
        (stacked_blocks, {"lower": (X, -HIGH), "upper": HIGH}, "lower[1] is [-0.0, -0.1, -0.3], "),
        (stacked_blocks, {"lower": (X, HIGH), "upper": HIGH}, "expected heights that end at 0 m"),
        (stacked_blocks, {"lower": (X, LOW), "upper": LOW}, "expected heights that start at 0 m"),
        (
            stacked_blocks,
            {"lower": (X, LOW), "upper": HIGH, "upper_span": (0.1234, 1)},
            "upper_span is (0.1234, 1), expected two ascending lines of lower[0]",
        ),
        (
            stacked_blocks,
            {"lower": (X, LOW), "upper": HIGH, "cell": "hexahedron"},
            "cell is 'hexahedron', expected one of quadrilateral, triangle in 2-D",
        ),
        (c_beams, {"thickness": 0.02}, "thickness is 0.02, expected less than pad_thickness"),
        (c_beams, {"zone": 0.04}, "zone is 0.04, expected less than width = 0.0318 m"),
        (c_beams, {"washer_diameter": 0.023}, "expected less than 0.9 * zone = 0.0216 m"),
        (c_beams, {"n_thickness": 3}, "n_thickness is 3, expected two whole numbers"),
        (SECTION, {"parts": "nut"}, "parts is 'nut', expected one of plates, washers, bolt"),
        (SECTION, {"thickness": 0.02}, "thickness is 0.02, expected two lengths above 0 m"),
        (SECTION, {"fine_radius": 0.2}, "fine_radius is 0.2, expected from half washer_diameter"),
        (SECTION, {"growth": 1.0}, "growth is 1.0, expected a ratio above 1"),
        (SECTION, WITH_BOLT | {"bolt_diameter": 0.013}, "expected less than the holes, 0.013 m"),
        (SECTION, WITH_BOLT | {"head_diameter": 0.03}, "head_diameter is 0.03, expected above"),
        (SECTION, WITH_BOLT | {"seats": "glued"}, "seats is 'glued', expected 'contact' or"),
        (PLATES, WITH_BOLT | {"n_around": 12}, "n_around is 12, expected a multiple of 8"),
    ],
)
def test_impossible_dimensions_are_refused(builder, arguments, message):
    with pytest.raises(MeshError, match=re.escape(message)):
        builder(MPI.COMM_SELF, **arguments)
