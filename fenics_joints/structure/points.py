"""Values and gradients of a displacement space at arbitrary points, as rows over its DOFs.

Sensors, point masses and springs need not sit on nodes: a displacement there is a short row of
basis-function values times DOFs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import basix.ufl
import numpy as np
from dolfinx import fem, geometry
from mpi4py import MPI
from numpy.typing import ArrayLike
from petsc4py import PETSc

from fenics_joints._compat import coordinate_map, geometry_dofmap
from fenics_joints.errors import InputError, items, reals
from fenics_joints.structure.nearest import all_min, far_points, nearest, too_close_together


@dataclass(frozen=True, init=False, repr=False)
class Sensors:
    """Points and directions in which a test measured.

    Args:
        points: Positions, m, shape (n, gdim) or (gdim,).
        directions: Directions of any length, shape (n, gdim), or (gdim,) for all.
        names: What they are called in the test, n of them; or none.

    Raises:
        InputError: If a number is not finite, a direction zero, or their shapes do not fit.

    Attributes:
        points: Positions, m, shape (n, gdim).
        directions: Unit directions, shape (n, gdim).
        names: Names, n of them, or none.
    """

    points: np.ndarray
    directions: np.ndarray
    names: tuple[str, ...]

    def __init__(self, points: ArrayLike, directions: ArrayLike, names: Sequence[str] = ()):
        points = np.atleast_2d(reals("sensors.points", points, unit="m"))
        if points.ndim != 2 or (points.size and points.shape[1] not in (2, 3)):
            raise InputError(f"sensors.points has shape {points.shape}: expected (n, 2) or (n, 3).")
        directions = reals("sensors.directions", directions)
        if directions.shape not in (points.shape, (1, *points.shape[1:]), points.shape[1:]):
            raise InputError(
                f"sensors.directions has shape {directions.shape}: expected one for each of the "
                f"points, {points.shape}, or one for all, {points.shape[1:]}."
            )
        directions = np.broadcast_to(directions, points.shape)
        norms = np.linalg.norm(directions, axis=1, keepdims=True)
        if np.any(norms == 0):
            raise InputError("sensors.direction: expected non-zero vectors.")
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "directions", directions / norms)
        object.__setattr__(self, "names", items("sensors.names", names, str, "names"))

    def __len__(self) -> int:
        return len(self.points)

    def __repr__(self) -> str:
        if not len(self):
            return "Sensors(0)"
        low, high = (f(self.points, axis=0).round(4).tolist() for f in (np.min, np.max))
        return f"Sensors({len(self)}, from {low} to {high} m)"


@dataclass(frozen=True)
class PointRows:
    """Rows that evaluate a blocked space at points; a point is on exactly one rank.

    Attributes:
        index: Which of the asked points are on this rank, shape (m,).
        nodes: Local blocks (nodes) of the space, shape (m, n_basis).
        values: Basis functions there, shape (m, n_basis).
        gradients: Their gradients, 1/m, shape (m, n_basis, gdim).
        moved: How far each of the asked points was moved onto the mesh, m, shape (n,), equal on
            all ranks; or None.
    """

    index: np.ndarray
    nodes: np.ndarray
    values: np.ndarray
    gradients: np.ndarray
    moved: np.ndarray | None = None


def _owned_candidates(msh, points: np.ndarray) -> np.ndarray:
    """A cell that this rank owns around each point, or -1; shape (n,)."""
    tdim = msh.topology.dim
    owned = np.arange(msh.topology.index_map(tdim).size_local, dtype=np.int32)
    found = np.full(len(points), -1, dtype=np.int32)
    if len(owned) == 0:
        return found
    tree = geometry.bb_tree(msh, tdim, entities=owned, padding=1e-9)
    near = geometry.compute_collisions_points(tree, points)
    cells = geometry.compute_colliding_cells(msh, near, points)
    for i in range(len(points)):
        links = cells.links(i)
        if len(links):
            found[i] = links[0]
    return found


def locate(
    V: fem.FunctionSpace,
    element,
    points,
    what: str = "point",
    *,
    names: Sequence[str] = (),
    snap: bool = False,
) -> PointRows:
    """Rows that evaluate ``V`` at points. Collective.

    Args:
        V: Blocked space of displacements on a mesh with straight-sided cells.
        element: The scalar element of a block, from ``basix.ufl.element``.
        points: Positions, m, shape (n, gdim).
        what: What stands there, for the message.
        names: What the points are called, for the message; n of them, or none.
        snap: Whether points beside the mesh are moved onto it if they are within 1 mm, or half of
            the nearest cell's shortest edge; those of a test, which are measured by hand.

    Returns:
        The rows of the points that this rank owns.

    Raises:
        InputError: If points are outside the mesh, all of them in one message; on every rank.
    """
    msh = V.mesh
    gdim = msh.geometry.dim
    points = np.atleast_2d(np.asarray(points, dtype=float))
    padded = np.zeros((len(points), 3))
    padded[:, :gdim] = points
    if snap:
        too_close_together(msh, padded, what)
    candidate = _owned_candidates(msh, padded)
    rank = np.where(candidate >= 0, msh.comm.rank, msh.comm.size)
    owner, moved = all_min(msh.comm, rank), np.zeros(len(points))
    lost = np.flatnonzero(owner == msh.comm.size)
    if len(lost):
        found = nearest(msh, padded[lost])
        if not (snap and found.is_near.all()):
            far = found if snap else replace(found, reach=np.zeros(len(lost)))
            called = [names[i] if len(names) else "" for i in lost]
            raise far_points(msh, padded[lost], far, what, called, padded)
        padded[lost], moved[lost] = found.points, found.distance
        owner[lost], candidate[lost] = found.owner, found.cells
    index = np.flatnonzero(owner == msh.comm.rank)
    rows = _tabulate(V, element, padded[index, :gdim], candidate[index], index)
    return replace(rows, moved=moved)


def _tabulate(V, element, points, cells, index) -> PointRows:
    msh = V.mesh
    gdim, tdim = msh.geometry.dim, msh.topology.dim
    cmap, vertices = coordinate_map(msh), geometry_dofmap(msh)
    linear = basix.ufl.element("Lagrange", msh.topology.cell_name(), 1)
    orient = _orientation(V, element)
    nodes, values, gradients = [], [], []
    for point, cell in zip(points, cells, strict=True):
        x = msh.geometry.x[vertices[cell], :gdim]
        reference = cmap.pull_back(point[None, :], x)
        jacobian = x.T @ linear.tabulate(1, reference)[1 : tdim + 1, 0, :].T
        table = orient(element.tabulate(1, reference)[:, 0, :], cell)
        nodes.append(V.dofmap.cell_dofs(cell))
        values.append(table[0])
        gradients.append(table[1 : tdim + 1].T @ np.linalg.inv(jacobian))
    n = element.dim
    return PointRows(
        index,
        np.array(nodes, dtype=np.int32).reshape(len(index), n),
        np.array(values).reshape(len(index), n),
        np.array(gradients).reshape(len(index), n, gdim),
    )


def _orientation(V, element):
    """What turns an element's functions, (k, n), from those of the reference to those of a cell.

    Only functions of degree 3 on edges that two cells see from different ends differ.
    """
    if not V.element.needs_dof_transformations:
        return lambda table, cell: table
    V.mesh.topology.create_entity_permutations()
    seen = V.mesh.topology.get_cell_permutation_info()
    scalar = fem.functionspace(V.mesh, element).element

    def turned(table, cell):
        found = np.ascontiguousarray(table)
        for row in found:
            scalar.T_apply(row, seen[cell : cell + 1], 1)
        return found

    return turned


def observe(rows: PointRows, directions: np.ndarray, vectors: list[PETSc.Vec], V) -> np.ndarray:
    """Components of displacement vectors at points. Collective.

    Args:
        rows: From `locate`.
        directions: Unit directions, shape (n, gdim).
        vectors: Vectors over ``V``, owned entries.
        V: The space.

    Returns:
        Shape (n, len(vectors)), equal on all ranks.
    """
    bs = V.dofmap.index_map_bs
    u = fem.Function(V)
    result = np.zeros((len(directions), len(vectors)))
    owned = V.dofmap.index_map.size_local * bs
    for column, vector in enumerate(vectors):
        u.x.array[:owned] = vector.array_r
        u.x.scatter_forward()
        block = u.x.array.reshape(-1, bs)[rows.nodes]
        at_points = np.einsum("pn,pni->pi", rows.values, block)
        result[rows.index, column] = np.einsum("pi,pi->p", at_points, directions[rows.index])
    V.mesh.comm.Allreduce(MPI.IN_PLACE, result)
    return result
