"""Numbers by which the nodes of a space are known again, on whichever ranks they lie."""

from __future__ import annotations

import hashlib

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from fenics_joints._compat import geometry_dofmap
from fenics_joints.meshes.tagged import mixed

#: Degree up to which the nodes of a cell are numbered as its corners are, in the mesh's input.
_ORDERED = 2
#: Digits of a place, relative to the body.
_DIGITS = 9
#: Of the last digit: places on a grid are far from where rounding jumps then.
_ASIDE = 0.3183098861837907
_LARGEST = np.iinfo(np.uint64).max


def node_keys(V: fem.FunctionSpace) -> np.ndarray:
    """A number of each node that this rank owns, (n_owned,), the same however the mesh is parted.

    It is made of the place of a cell around the node and of the node's number in that cell. Nodes
    of the third degree change these numbers with the mesh's parts; theirs are known again only
    where the mesh was parted alike. Collective.

    Args:
        V: A space on a mesh, blocked or not.
    """
    comm, x = V.mesh.comm, V.mesh.geometry.x
    size = comm.allreduce(float(np.abs(x).max(initial=0.0)), op=MPI.MAX) or 1.0
    middles = x[geometry_dofmap(V.mesh)].mean(axis=1)
    cells = _hashed(middles / size)
    if V.element.basix_element.degree > _ORDERED:
        alike = hashlib.sha256(cells.tobytes() + V.dofmap.list.tobytes()).digest()
        cells = cells ^ np.frombuffer(alike, dtype=np.uint64)[0]
    return _least_around(V, cells)


def _least_around(V: fem.FunctionSpace, cells: np.ndarray) -> np.ndarray:
    """The least number that the cells around it give each owned node, those of other ranks among
    them, (n_owned,)."""
    imap, nodes = V.dofmap.index_map, V.dofmap.list
    least = np.full(imap.size_local + imap.num_ghosts, _LARGEST)
    inside = mixed(np.arange(nodes.shape[1], dtype=np.uint64))
    np.minimum.at(least, nodes.ravel(), mixed(cells[: len(nodes), None] ^ inside).ravel())
    told = V.mesh.comm.allgather((imap.ghosts, least[imap.size_local :]))
    first, last = imap.local_range
    for ghosts, numbers in told:
        own = (ghosts >= first) & (ghosts < last)
        np.minimum.at(least, ghosts[own] - first, numbers[own])
    return least[: imap.size_local]


def _hashed(places: np.ndarray) -> np.ndarray:
    """Places, (n, 3), in units of the body's size, as numbers, (n,)."""
    digits = np.floor(places * 10.0**_DIGITS + _ASIDE + 0.5).astype(np.int64).astype(np.uint64)
    found = np.zeros(len(places), dtype=np.uint64)
    for column in digits.T:
        found = mixed(found ^ column)
    return found
