"""The separate bodies of a mesh, by the blocks of a function space."""

from __future__ import annotations

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from fenics_joints.meshes import check


def body_numbers(V: fem.FunctionSpace) -> tuple[np.ndarray, int]:
    """Number of the body of each local block of ``V``, ghosts included, and of bodies. Collective.

    A body is a set of cells that are connected through shared vertices.
    """
    return check.body_numbers(V.dofmap.index_map, V.dofmap.list, V.mesh.comm)


def at_blocks(V: fem.FunctionSpace, values: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Values of this rank's blocks, (n_owned, ...), at global block numbers, on every rank.

    Collective.
    """
    low, high = V.dofmap.index_map.local_range
    mine = (nodes >= low) & (nodes < high)
    found = np.zeros((len(nodes), *values.shape[1:]), dtype=values.dtype)
    found[mine] = values[nodes[mine] - low]
    V.mesh.comm.Allreduce(MPI.IN_PLACE, found)
    return found
