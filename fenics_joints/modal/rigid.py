"""Positions of a displacement's nodes, and rigid motions there."""

from __future__ import annotations

import basix
import numpy as np
from dolfinx import fem

from fenics_joints._compat import geometry_dofmap


def node_positions(V: fem.FunctionSpace) -> np.ndarray:
    """Positions of all local blocks, m, (n, gdim): vertices, and the middles of edges and so on.

    For elements whose DOFs are moments the middle of an edge is where a linear function takes the
    moment's value.
    """
    msh = V.mesh
    gdim, layout = msh.geometry.dim, V.dofmap.dof_layout
    topology = basix.topology(getattr(basix.CellType, msh.topology.cell_name()))
    imap, cells = V.dofmap.index_map, V.dofmap.list
    corners = msh.geometry.x[geometry_dofmap(msh)][:, :, :gdim]
    x = np.zeros((imap.size_local + imap.num_ghosts, gdim))
    for dim, entities in enumerate(topology):
        for number, vertices in enumerate(entities):
            for dof in layout.entity_dofs(dim, number):
                x[cells[:, dof]] = corners[: len(cells), vertices].mean(axis=1)
    return x


def rigid_motions(points: np.ndarray, axisymmetric: bool = False) -> np.ndarray:
    """Rigid motions at points, (n_motions, n, gdim): translations, then rotations about 0.

    Args:
        points: Positions, (n, gdim); give them relative to a centre for a good condition.
        axisymmetric: Whether x is a radius and y the axis, along which alone the body can move.
    """
    n, gdim = points.shape
    if axisymmetric:
        return np.broadcast_to([0.0, 1.0], (1, n, 2)).copy()
    shifts = [np.broadcast_to(e, (n, gdim)) for e in np.eye(gdim)]
    if gdim == 2:
        turns = [np.column_stack([-points[:, 1], points[:, 0]])]
    else:
        turns = [np.cross(e, points) for e in np.eye(3)]
    return np.array(shifts + turns)
