"""The separate bodies of a mesh."""

from __future__ import annotations

import numpy as np
import scipy.sparse
from dolfinx import fem
from mpi4py import MPI
from scipy.sparse.csgraph import connected_components


def body_numbers(V: fem.FunctionSpace) -> tuple[np.ndarray, int]:
    """Number of the body of each local block of ``V``, ghosts included, and of bodies. Collective.

    A body is a set of cells connected through shared vertices.
    """
    dofmap, imap, comm = V.dofmap.list, V.dofmap.index_map, V.mesh.comm
    n = imap.size_local + imap.num_ghosts
    first = np.repeat(dofmap[:, 0], dofmap.shape[1])
    links = scipy.sparse.coo_matrix((np.ones(dofmap.size), (first, dofmap.ravel())), shape=(n, n))
    _, label = connected_components(links, directed=False)
    # Pieces of one body on several ranks hang together through blocks that are ghosts somewhere.
    counts = comm.allgather(int(label.max(initial=-1)) + 1)
    label = label + sum(counts[: comm.rank])
    ghosts = np.arange(imap.size_local, n, dtype=np.int32)
    shared = np.column_stack([imap.local_to_global(ghosts), label[ghosts]])
    shared = np.concatenate(comm.allgather(shared))
    low, high = imap.local_range
    mine = shared[(shared[:, 0] >= low) & (shared[:, 0] < high)]
    pairs = np.column_stack([label[mine[:, 0] - low], mine[:, 1]])
    pairs = np.concatenate(comm.allgather(pairs))
    total = sum(counts)
    joined = scipy.sparse.coo_matrix((np.ones(len(pairs)), pairs.T), shape=(total, total))
    n_bodies, body = connected_components(joined, directed=False)
    return body[label], n_bodies


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
