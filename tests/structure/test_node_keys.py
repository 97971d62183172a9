"""Nodes known again on other ranks, and where two parts touch with nodes of their own."""

import numpy as np
import pytest

pytest.importorskip("dolfinx")

from dolfinx import fem  # noqa: E402
from mpi4py import MPI  # noqa: E402

from fenics_joints._compat import create_mesh  # noqa: E402
from fenics_joints.structure.node_keys import node_keys  # noqa: E402


def stacked(comm, n: int = 5):
    """Two layers of n cells of uneven length, one on the other, no node in common."""
    x = np.cumsum(1.0 + 0.1 * np.arange(n + 1)) / 64
    points, cells = [], []
    for z in (0.0, 0.25):
        first = len(points)
        points += [(a, b, z + c) for c in (0.0, 0.25) for b in (0.0, 0.5) for a in x]
        row = n + 1
        cells += [[first + i + j * row + k for j in range(4) for k in (0, 1)] for i in range(n)]
    if comm.rank:
        points, cells = [], []
    return create_mesh(
        comm,
        np.array(cells, dtype=np.int64).reshape(-1, 8),
        np.array(points).reshape(-1, 3),
        "hexahedron",
    )


@pytest.mark.parallel
@pytest.mark.parametrize("of", [("Lagrange", 1), ("Lagrange", 2), ("S", 2)])
def test_nodes_have_one_number_on_any_ranks(of):
    """A field of the place, by node, is the same field."""
    found = []
    for comm in (MPI.COMM_WORLD, MPI.COMM_SELF):
        V = fem.functionspace(stacked(comm), of)
        field = fem.Function(V)
        field.interpolate(lambda x: np.sin(40 * x[0]) + x[1] + 7 * x[2])
        owned = V.dofmap.index_map.size_local
        keys = np.concatenate(comm.allgather(node_keys(V)))
        order = np.argsort(keys)
        values = np.concatenate(comm.allgather(field.x.array[:owned]))
        found.append((keys[order], values[order]))
    (keys, values), (own, there) = found
    assert len(np.unique(own)) == len(own) > len(np.unique(np.round(there, 9)))
    assert np.array_equal(keys, own)
    assert values == pytest.approx(there, abs=1e-9)
