"""The motion of a mesh, or of beams, in given modes, gathered on one rank for pictures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import basix
import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from fenics_joints._compat import geometry_dofmap
from fenics_joints.beams import BeamStructure
from fenics_joints.beams.cells import beam_cells

if TYPE_CHECKING:
    from fenics_joints.structure.structure import Structure

__all__ = ["corner_motion"]


def corner_motion(
    structure: Structure | BeamStructure, vectors: Sequence[PETSc.Vec] | Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Corners of all cells and how they move. Collective.

    Args:
        structure: The structure; of beams the elements are the cells.
        vectors: Displacement vectors, owned entries.

    Returns:
        On rank 0 the corners, m, shape (n_cells, n_corners, 3), and the displacements, shape
        (n_vectors, n_cells, n_corners, 3), zero in a direction that the mesh does not have; empty
        on the other ranks. Of beams the same on every rank.
    """
    if isinstance(structure, BeamStructure):
        return _beams(structure, vectors)
    V, msh = structure.V, structure.mesh
    n_owned = msh.topology.index_map(msh.topology.dim).size_local
    corners = msh.geometry.x[geometry_dofmap(msh)[:n_owned]]
    # Not every element has its corner values as DOFs, so evaluate it there.
    cell = getattr(basix.CellType, msh.topology.cell_name())
    values = structure.element.tabulate(0, basix.geometry(cell))[0]
    nodes = V.dofmap.list[:n_owned]
    u, bs = fem.Function(V), V.dofmap.index_map_bs
    owned = V.dofmap.index_map.size_local * bs
    motions = np.zeros((len(vectors), *corners.shape))
    for i, vector in enumerate(vectors):
        u.x.array[:owned] = vector.array_r
        u.x.scatter_forward()
        motions[i, :, :, :bs] = np.einsum("cn,eni->eci", values, u.x.array.reshape(-1, bs)[nodes])
    gathered = msh.comm.gather((corners, motions), root=0)
    if gathered is None:
        return np.empty((0, 0, 3)), np.empty((len(vectors), 0, 0, 3))
    return (
        np.concatenate([part[0] for part in gathered]),
        np.concatenate([part[1] for part in gathered], axis=1),
    )


def _beams(structure: BeamStructure, vectors) -> tuple[np.ndarray, np.ndarray]:
    cells = beam_cells(structure)
    corners = cells.vertices[cells.beam >= 0]
    rows = structure.displacement_rows(corners.reshape(-1, 3))
    return corners, np.array([(rows @ v).reshape(corners.shape) for v in vectors])
