"""Checks of a mesh: bodies that only look joined are counted."""

import pytest
from mesh_measures import COMM, HEXAHEDRON, written

from fenics_joints.meshes import check_mesh, read_msh


@pytest.mark.parallel
def test_bodies_that_only_look_joined_are_counted(shared_tmp_path):
    # Three rods along x; the first two share the vertices between them, the third has its own.
    n, nodes, elements = 8, [], []
    for rod in range(3):
        for i in range(n + 1):
            nodes += [(i, y + rod, z) for y, z in ((0, 0), (1, 0), (1, 1), (0, 1))]
        first = 4 * (n + 1) * rod
        slices = [[first + 4 * i + k for k in (1, 2, 3, 4)] for i in range(n + 1)]
        if rod == 1:
            below = [[4 * i + k for k in (2, 3)] for i in range(n + 1)]
            slices = [[b[0], s[1], s[2], b[1]] for s, b in zip(slices, below, strict=True)]
        for a, b in zip(slices[:-1], slices[1:], strict=True):
            elements.append((HEXAHEDRON, rod + 1, [a[0], b[0], b[1], a[1], a[3], b[3], b[2], a[2]]))
    names = {(3, rod + 1): f"rod_{rod + 1}" for rod in range(3)}
    path = written(shared_tmp_path, elements=elements, names=names, nodes=nodes)
    tagged = read_msh(path, COMM)
    assert check_mesh(tagged).bodies == 2
