"""Points on the middle plane of a thin layer, and the rows that make its strains there.

Through the thickness one point is enough: the jump between the faces over the thickness is the
strain that a joint law speaks of.
"""

from __future__ import annotations

from dataclasses import dataclass

import basix
import basix.ufl
import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from fenics_joints._compat import coordinate_map, geometry_dofmap
from fenics_joints.errors import InputError
from fenics_joints.preload.interface import frames
from fenics_joints.structure.structure import Structure

#: Lines of a box cell in reference coordinates, and the cell of a section across one of them.
_SECTIONS = {"quadrilateral": basix.CellType.interval, "hexahedron": basix.CellType.quadrilateral}
#: A cell's line and the normal are along each other if their cosine is this or more.
_ALONG = 0.9


@dataclass(frozen=True)
class LayerPoints:
    """Strain rows of a layer at its points; the same points on any number of ranks.

    The strain of a point is ``thin / stretch + flat`` times the displacement: what has to do with
    the gradient through the thickness, and the rest. Rows go normal, tangents, point by point.

    Attributes:
        points: Positions, m, (P, gdim), ordered by their coordinates.
        weights: Volume as meshed of each point, m3, (P,).
        thin: Sparse rows, (P * gdim, n_dofs), in the ranks' own order of points.
        flat: The same for the in-plane gradient.
        order: Row block of each point in that order, (P,).
    """

    points: np.ndarray
    weights: np.ndarray
    thin: PETSc.Mat
    flat: PETSc.Mat
    order: np.ndarray

    def rows(self, stretch: float) -> PETSc.Mat:
        """Sparse rows of the strain at a stretch, ordered as `thin`. Collective."""
        rows = self.thin.copy()
        rows.scale(1 / stretch)
        rows.axpy(1.0, self.flat, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        return rows

    def gather(self, rows: np.ndarray) -> np.ndarray:
        """Rows of all ranks in the order of `points`, (P, gdim, m), from this rank's."""
        gdim = self.points.shape[1]
        parts = self.thin.comm.tompi4py().allgather(rows)
        return np.concatenate(parts).reshape(-1, gdim, rows.shape[1])[self.order]


def layer_points(structure: Structure, number: int, degree: int | None = None) -> LayerPoints:
    """Points of one region and its strain rows there. Collective.

    Args:
        structure: The structure.
        number: Index of the region in ``structure.regions``.
        degree: Polynomials of this degree in the plane are integrated exactly. By default 3 on
            quadrilaterals and hexahedra, two points in each direction; on triangles and tetrahedra
            1, one point, or 2 where the displacement is quadratic.

    Raises:
        InputError: If the layer has no cells, or box cells that do not stand on it.
    """
    region, cells = structure.field.regions[number]
    msh = structure.mesh
    imap = msh.topology.index_map(msh.topology.dim)
    cells = cells[cells < imap.size_local]
    normal = np.asarray(region.normal[: structure.gdim], dtype=float)
    x = msh.geometry.x[geometry_dofmap(msh)[cells]][..., : structure.gdim]
    rules = _rules(structure, degree)
    axis = _axes(structure, region.name, x, normal) if len(rules) > 1 else np.zeros(len(cells), int)
    place, weight, gradient, nodes = [], [], [], []
    for which, (reference, w) in enumerate(rules):
        at = axis == which
        tables = _tabulate(structure, x[at], reference)
        place.append(tables[0]), weight.append(tables[1] * w), gradient.append(tables[2])
        blocks = structure.V.dofmap.list[cells[at]]
        nodes.append(np.repeat(blocks[:, None], len(w), axis=1))
    flat = [
        np.concatenate([a.reshape(-1, *a.shape[2:]) for a in part])
        for part in (place, weight, gradient, nodes)
    ]
    return _collect(structure, region.name, frames(normal[None])[0], *flat)


def _rules(structure: Structure, degree: int | None) -> list[tuple[np.ndarray, np.ndarray]]:
    """Reference points and weights: of box cells one rule for each line that may be the normal."""
    cell = structure.mesh.topology.cell_name()
    kind = getattr(basix.CellType, cell)
    if cell not in _SECTIONS:
        x, w = basix.make_quadrature(kind, structure.degree if degree is None else degree)
        return [(x, w)]
    x, w = basix.make_quadrature(_SECTIONS[cell], 3 if degree is None else degree)
    return [(np.insert(x, k, 0.5, axis=1), w) for k in range(x.shape[1] + 1)]


def _axes(structure: Structure, name: str, x: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Which line of each cell is along the layer's normal, (n_cells,)."""
    tdim = structure.mesh.topology.dim
    J = _jacobians(structure, x, np.full((1, tdim), 0.5))[:, 0]
    along = np.abs(np.einsum("i,cik->ck", normal, J)) / np.linalg.norm(J, axis=1)
    bad = bool(len(along)) and float(along.max(axis=1).min()) < _ALONG
    if structure.comm.allreduce(bad, op=MPI.LOR):
        raise InputError(
            f"{name}: its cells do not stand along its normal {normal.tolist()}; expected a layer "
            "one cell thick, extruded along its normal."
        )
    return np.argmax(along, axis=1)


def _jacobians(structure: Structure, x: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Derivative of position by reference coordinates, (n_cells, n_points, gdim, tdim)."""
    cell = structure.mesh.topology.cell_name()
    linear = basix.ufl.element("Lagrange", cell, 1)
    table = linear.tabulate(1, reference)[1 : reference.shape[1] + 1]
    return np.einsum("cvi,kqv->cqik", x, table)


def _tabulate(structure: Structure, x: np.ndarray, reference: np.ndarray):
    """Positions, measures and gradients of basis functions, by cell and reference point."""
    cmap = coordinate_map(structure.mesh)
    J = _jacobians(structure, x, reference)
    positions = [cmap.push_forward(reference, corners) for corners in x]
    positions = np.array(positions).reshape(len(x), len(reference), structure.gdim)
    table = structure.element.tabulate(1, reference)[1 : reference.shape[1] + 1]
    gradients = np.einsum("kqn,cqki->cqni", table, np.linalg.inv(J))
    return positions, np.abs(np.linalg.det(J)), gradients


def _collect(structure, name, axes, points, weights, gradients, nodes) -> LayerPoints:
    comm = structure.comm
    order = _order(np.concatenate(comm.allgather(points)))
    if not len(order):
        raise InputError(f"{name}: the region has no cells; expected a layer.")
    everywhere = np.concatenate(comm.allgather(points))[order]
    measure = np.concatenate(comm.allgather(weights))[order]
    thin, flat = _strain_rows(axes, gradients)
    return LayerPoints(
        everywhere, measure, _sparse(structure, thin, nodes), _sparse(structure, flat, nodes), order
    )


def _order(points: np.ndarray) -> np.ndarray:
    """Order by the coordinates, the same on any number of ranks: first by the first one."""
    if not len(points):
        return np.empty(0, dtype=int)
    extent = max(float(np.ptp(points, axis=0).max()), 1e-300)
    keys = np.round(points / (1e-7 * extent)).astype(np.int64)
    return np.lexsort(keys.T[::-1])


def _strain_rows(axes: np.ndarray, gradients: np.ndarray):
    """Rows of `forms.layer_strain` of a stretched gradient, two of (p, gdim, n_basis, gdim).

    With G the meshed gradient the stretched one is G t in the plane and G n / s along the normal:
    eps = n.G n / s, gamma_t = t.G n / s + n.G t.
    """
    normal, tangents = axes[0], axes[1:]
    across = gradients @ normal
    thin = np.einsum("pn,di->pdni", across, axes)
    flat = np.zeros_like(thin)
    along = np.einsum("pni,ti->ptn", gradients, tangents)
    flat[:, 1:] = along[..., None] * normal
    return thin, flat


def _sparse(structure: Structure, rows: np.ndarray, nodes: np.ndarray) -> PETSc.Mat:
    """Rows over the displacement DOFs as a matrix; held DOFs, which are zero, are left out."""
    V, gdim = structure.V, structure.gdim
    imap = V.dofmap.index_map
    local = nodes[:, :, None] * gdim + np.arange(gdim)
    blocks = imap.local_to_global(nodes.ravel().astype(np.int32)).reshape(nodes.shape)
    # A rank may have no cell of the layer.
    width = nodes.shape[1] * gdim
    columns = (blocks[:, :, None] * gdim + np.arange(gdim)).reshape(len(nodes), width)
    values = np.where(structure.held_dofs[local][:, None], 0.0, rows)
    n_rows = len(nodes) * gdim
    columns = np.repeat(columns[:, None], gdim, axis=1)
    matrix = PETSc.Mat().createAIJ(
        ((n_rows, None), (imap.size_local * gdim, imap.size_global * gdim)),
        csr=(
            (np.arange(n_rows + 1) * width).astype(PETSc.IntType),
            columns.ravel().astype(PETSc.IntType),
            values.ravel(),
        ),
        comm=structure.comm,
    )
    matrix.assemble()
    return matrix
