"""A box with named faces."""

from __future__ import annotations

from collections.abc import Sequence
from typing import get_args

import numpy as np
from mpi4py import MPI

from fenics_joints.meshes.arguments import Solid, holds, is_count, requirement
from fenics_joints.meshes.arguments import lengths as are_lengths
from fenics_joints.meshes.extrude import Extrusion
from fenics_joints.meshes.plane import tensor_grid
from fenics_joints.meshes.tagged import MeshLists, TaggedMesh, distribute
from fenics_joints.parallel import on_root

FACES = {"x_min": 1, "x_max": 2, "y_min": 3, "y_max": 4, "z_min": 5, "z_max": 6}


def box(
    comm: MPI.Intracomm, lengths: Sequence[float], counts: Sequence[int], cell: str = "hexahedron"
) -> TaggedMesh:
    """Mesh of the box from the origin to ``lengths``.

    The one part is ``body``; the faces are ``x_min``, ``x_max``, ``y_min`` and so on.

    Args:
        comm: Communicator; the call is collective.
        lengths: Side along x, y and z, in metres.
        counts: Elements along x, y and z.
        cell: ``"hexahedron"``, or ``"tetrahedron"`` for six of those in each hexahedron.

    Returns:
        The tagged mesh.

    Raises:
        MeshError: A length is not positive, a count is below 1, or the cell is unknown.
    """
    require = requirement("box")
    fits = are_lengths(lengths, 3)
    require(fits, "lengths", lengths, "three lengths above 0 m")
    fits = holds(lambda given: len(given) == 3 and all(map(is_count, given)), counts)
    require(fits, "counts", counts, "three whole numbers of at least 1")
    fits = isinstance(cell, str) and cell in get_args(Solid)
    require(fits, "cell", cell, " or ".join(map(repr, get_args(Solid))))
    return distribute(comm, on_root(comm, lambda: _lists(lengths, counts, cell)))


def _lists(lengths, counts, cell) -> MeshLists:
    x, y, z = (np.linspace(0.0, a, n + 1) for a, n in zip(lengths, counts, strict=True))
    points, quads = tensor_grid(x, y)
    column = Extrusion(points, quads, z, np.ones((len(z) - 1, len(quads)), dtype=int), cell)
    number = np.arange(len(points)).reshape(len(x), len(y))
    layers = np.arange(len(z) - 1)
    walls = number[0], number[-1], number[:, 0], number[:, -1]
    for value, wall in enumerate(walls, start=1):
        column.tag_wall(np.column_stack([wall[:-1], wall[1:]]), layers, value)
    everywhere = np.ones(len(quads), dtype=bool)
    column.tag_level(0, everywhere, FACES["z_min"])
    column.tag_level(len(z) - 1, everywhere, FACES["z_max"])
    return MeshLists(cell, *column.lists(), {"body": 1}, FACES)
