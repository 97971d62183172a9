"""Bodies taken apart at named faces."""

import re
from dataclasses import replace

import numpy as np
import pytest
from matching_faces import assert_pair, corners_and_sides, faces
from mpi4py import MPI

from fenics_joints.errors import MeshError
from fenics_joints.meshes import check_mesh, separate
from fenics_joints.meshes.facets import add_faces, facets_between
from fenics_joints.meshes.grid import extruded, tensor_grid
from fenics_joints.meshes.tagged import distribute
from fenics_joints.parallel import on_root

COMM = MPI.COMM_WORLD


def three_layers(cell):
    """Two layers of cells, a third part beside the second; faces across and outside."""
    flat = cell in ("quadrilateral", "triangle")
    plan = [np.arange(4.0)] if flat else [np.arange(4.0), np.arange(3.0)]
    points, base = tensor_grid(*plan)
    right = points[base][:, :, 0].mean(axis=1) > 2
    values = np.array([np.ones(len(base), int), 2 + right])
    return extruded(points, base, np.arange(3.0), values, cell, {"a": 1, "b": 2, "c": 3})


@pytest.mark.parallel
@pytest.mark.parametrize("cell", ["quadrilateral", "triangle", "hexahedron", "tetrahedron"])
def test_three_bodies_meet_and_tags_stay(cell):
    def build():
        lists = three_layers(cell)
        names = ("a", "b"), ("a", "c"), ("b", "c")
        tags = {f"{p}{q}": facets_between(lists, p, q) for p, q in names}
        named = {("a", "b"): ("a_b", "b_a"), ("b", "c"): ("b_c", "c_b")}
        return separate(add_faces(lists, tags), lists.cell_names, named)

    tagged = distribute(COMM, on_root(COMM, build))
    depth = 1.0 if cell in ("quadrilateral", "triangle") else 2.0
    # The old tags of named pairs are replaced; that of the third pair stays, with the first body.
    expected = {"a_b": 2 * depth, "b_a": 2 * depth, "b_c": depth, "c_b": depth, "ac": depth}
    assert faces(tagged) == pytest.approx(expected)
    assert corners_and_sides(tagged, "ac")[1] == {1}
    assert check_mesh(tagged).bodies == 3
    assert_pair(tagged, "a_b", "b_a", "ab")
    assert_pair(tagged, "c_b", "b_c", "cb")


def test_separate_says_what_is_wrong():
    lists = three_layers("quadrilateral")
    for bodies, names, message in [
        (["a", "b"], {}, "bodies lacks c, expected each part in one body"),
        (["a", ("b", "a"), "c"], {}, "bodies has 'a' twice, expected one body for it"),
        (["a", "b", "d"], {}, "bodies has 'd', expected parts of: a, b, c"),
        ([("a", "b"), "c"], {("a", "b"): ("1", "2")}, "expected parts of two bodies, not of one"),
        ("abc", {("a", "d"): ("1", "2")}, "faces has ('a', 'd'), expected two parts of"),
    ]:
        with pytest.raises(MeshError, match=re.escape(message)):
            separate(lists, bodies, names)
    column = lists.x[lists.cells][:, :, 0].min(axis=1).round().astype(int)
    lists = replace(lists, cell_values=np.array([3, 1, 2])[column])
    with pytest.raises(MeshError, match=re.escape("faces has ('b', 'c'), expected parts that")):
        separate(lists, "abc", {("b", "c"): ("1", "2")})
