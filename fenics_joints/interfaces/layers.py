"""Reduced models of structures whose thin layers are nonlinear.

A law replaces a layer's whole shear stress, and its normal stress if it is coupled, at points on
the middle plane, two in each direction of a box cell. The remaining stiffness is positive
semi-definite, so that a joint that slides freely is not unstable. With a law whose tangent at rest
is the layer's, frequencies differ from the linear structure's only by the error of that quadrature:
less than 1e-4 on cells of 40 mm in a layer of 0.5 mm between plates of 8 mm, and 2e-5 on cells of
10 mm; with a coupled law up to 7e-4 on the former, since the normal stress varies more within a
cell (``points_degree`` gives more points).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import basix
import basix.ufl
import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from fenics_joints._compat import coordinate_map, geometry_dofmap
from fenics_joints.errors import InputError
from fenics_joints.interfaces.basis import (
    as_vectors,
    assemble,
    check_uniform,
    energy_share,
    free_interface,
)
from fenics_joints.interfaces.model import InterfacePoints
from fenics_joints.interfaces.reduced import LayerTerm, ReducedInterfaceModel
from fenics_joints.joint_laws.law import JointLaw
from fenics_joints.modal.modes import solve_modes
from fenics_joints.reduction.affine import AffinePencil
from fenics_joints.reduction.reduced import ReducedStructure
from fenics_joints.structure.faces import frames
from fenics_joints.structure.sparse import as_columns, product
from fenics_joints.structure.structure import Places, Structure, place_loads

#: Lines of a box cell in reference coordinates, and the cell of a section across one of them.
_SECTIONS = {"quadrilateral": basix.CellType.interval, "hexahedron": basix.CellType.quadrilateral}
#: A cell's line and the normal are along each other if their cosine is this or more.
_ALONG = 0.9


@dataclass(frozen=True)
class LayerPoints:
    """Strain rows of a layer at its points; the same points on any number of ranks.

    The strain of a point is ``thin / stretch + flat`` times the displacement: the gradient through
    the thickness, and the rest. Rows are the normal, then the tangents, point by point.

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
    normals = structure.normals(number, cells)
    x = msh.geometry.x[geometry_dofmap(msh)[cells]][..., : structure.gdim]
    rules = _rules(structure, degree)
    axis = (
        _axes(structure, region.name, x, normals) if len(rules) > 1 else np.zeros(len(cells), int)
    )
    place, weight, gradient, nodes, turned = [], [], [], [], []
    for which, (reference, w) in enumerate(rules):
        at = axis == which
        tables = _tabulate(structure, x[at], reference)
        counts = (
            1.0 if structure.tagged.shares is None else structure.tagged.shares[cells[at], None]
        )
        place.append(tables[0]), gradient.append(tables[2])
        weight.append(tables[1] * w * counts)
        blocks = structure.V.dofmap.list[cells[at]]
        nodes.append(np.repeat(blocks[:, None], len(w), axis=1))
        turned.append(np.repeat(frames(normals[at])[:, None], len(w), axis=1))
    flat = [
        np.concatenate([a.reshape(-1, *a.shape[2:]) for a in part])
        for part in (turned, place, weight, gradient, nodes)
    ]
    return _collect(structure, region.name, *flat)


def _rules(structure: Structure, degree: int | None) -> list[tuple[np.ndarray, np.ndarray]]:
    """Reference points and weights: of box cells one rule for each line that may be the normal."""
    cell = structure.mesh.topology.cell_name()
    kind = getattr(basix.CellType, cell)
    if cell not in _SECTIONS:
        x, w = basix.make_quadrature(kind, structure.degree if degree is None else degree)
        return [(x, w)]
    x, w = basix.make_quadrature(_SECTIONS[cell], 3 if degree is None else degree)
    return [(np.insert(x, k, 0.5, axis=1), w) for k in range(x.shape[1] + 1)]


def _axes(structure: Structure, name: str, x: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Which line of each cell is along the layer's normal there, (n_cells,)."""
    tdim = structure.mesh.topology.dim
    J = _jacobians(structure, x, np.full((1, tdim), 0.5))[:, 0]
    along = np.abs(np.einsum("ci,cik->ck", normals, J)) / np.linalg.norm(J, axis=1)
    bad = bool(len(along)) and float(along.max(axis=1).min()) < _ALONG
    if structure.comm.allreduce(bad, op=MPI.LOR):
        raise InputError(
            f"{name}: its cells do not stand along its normal; expected a layer one cell thick, "
            "extruded along its normal."
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
    """Rows of `forms.layer_strain` of a stretched gradient, two of (p, gdim, n_basis, gdim), with a
    normal and tangents for each point, (p, gdim, gdim).

    With G the meshed gradient the stretched one is G t in the plane and G n / s along the normal:
    eps = n.G n / s, gamma_t = t.G n / s + n.G t.
    """
    normal, tangents = axes[:, 0], axes[:, 1:]
    across = np.einsum("pni,pi->pn", gradients, normal)
    thin = np.einsum("pn,pdi->pdni", across, axes)
    flat = np.zeros_like(thin)
    along = np.einsum("pni,pti->ptn", gradients, tangents)
    flat[:, 1:] = along[..., None] * normal[:, None, None]
    return thin, flat


def _sparse(structure: Structure, rows: np.ndarray, nodes: np.ndarray) -> PETSc.Mat:
    """Rows over the free DOFs as a matrix; held ones, which are zero, are left out."""
    V, gdim = structure.V, structure.gdim
    imap = V.dofmap.index_map
    local = nodes[:, :, None] * gdim + np.arange(gdim)
    blocks = imap.local_to_global(nodes.ravel().astype(np.int32)).reshape(nodes.shape)
    # A rank may have no cell of the layer.
    width = nodes.shape[1] * gdim
    columns = (blocks[:, :, None] * gdim + np.arange(gdim)).reshape(len(nodes), width)
    ties = structure.ties
    values = rows if ties else np.where(structure.held_dofs[local][:, None], 0.0, rows)
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
    if not ties:
        return matrix
    found = matrix.matMult(ties.T)
    matrix.destroy()
    return found


#: Layers whose normal and shear stress are apart.
_SEPARATE = ("uncoupled", "constrained", "springs")


def reduce_layers(
    structure: Structure,
    laws: Mapping[str, JointLaw],
    *,
    n_modes: int = 20,
    interface_modes: int | None = None,
    tolerance: float | None = None,
    forces: Places | None = None,
    sensors: Places | None = None,
    given: Mapping[str, float] | None = None,
    points_degree: int | None = None,
    extra: Sequence[PETSc.Vec] = (),
) -> ReducedInterfaceModel:
    """Reduced model of a structure whose thin layers follow nonlinear laws. Collective.

    The basis is one of free interfaces: modes of the structure with its layers linear (so give them
    the laws' stiffness at rest), residual static responses to loads at ``forces`` and ``sensors``,
    and interface modes, see `fenics_joints.interfaces.basis.free_interface`. A fixed-interface
    basis is impossible: the strains of an elastic layer cannot be held.

    Args:
        structure: The structure; every region's properties uniform, its nonlinear layers
            ``uncoupled``, ``constrained`` or ``springs`` (per area, whose strain is the jump over
            the thickness as meshed).
        laws: Law of each layer that becomes nonlinear, by its region's name. A law that is not
            `coupled` takes the shear stress, a coupled one the normal stress too.
        n_modes: Modes of the linear structure, rigid-body modes included.
        interface_modes: Number of interface modes, 0 for none; by default as many as modes.
        tolerance: Instead of a number, the least energy of an interface mode under unit stress,
            relative to the largest.
        forces: Position, m, and direction of each force, by name.
        sensors: Those of each sensor.
        given: Parameters that differ from their nominal value; the basis is best there.
        points_degree: See `fenics_joints.interfaces.layers.layer_points`.
        extra: Displacements to keep in the basis, such as
            `fenics_joints.interfaces.loading.loading_shapes`: a dozen of them replace some hundred
            interface modes.

    Raises:
        InputError: For an unknown layer, graded properties, a place outside the mesh, or a number
            out of range.
    """
    strains = _LayerStrains(structure, laws, given, points_degree)
    forces, sensors = (
        place_loads(structure, "forces", forces),
        place_loads(structure, "sensors", sensors),
    )
    choose = energy_share(interface_modes or None, tolerance, n_modes, strains.size)
    modes = solve_modes(structure, given, n_modes=n_modes)
    M, K = structure.mass(given), structure.stiffness(given)
    columns = free_interface(
        K,
        M,
        modes.solver,
        as_columns(modes.shapes),
        np.hstack([forces[1], sensors[1]]),
        strains,
        None if interface_modes == 0 else choose,
        as_columns(extra) if len(extra) else None,
    ).columns
    reduced = ReducedStructure(structure, as_vectors(K, columns))
    terms = {layer.name: layer.term(columns) for layer in strains.layers}
    pencil = _without_stress(reduced.pencil, laws, terms)
    interfaces = [layer.interface(terms[layer.name]) for layer in strains.layers]
    modes.solver.destroy(), strains.destroy(), K.destroy(), M.destroy()
    return assemble(columns, reduced, interfaces, pencil, terms, given, forces, sensors)


def layer_numbers(structure: Structure, laws: Mapping[str, JointLaw]) -> dict[str, int]:
    """Index in ``structure.regions`` of each layer that a law is for, by name.

    Raises:
        InputError: For no laws, a name that is no thin layer, a layer whose law has no shear stress
            of its own, or properties that vary in space.
    """
    names = {r.name: i for i, r in enumerate(structure.regions) if r.is_joint}
    if not laws:
        raise InputError(f"laws: expected a law for one of the layers {', '.join(names)}.")
    for name in laws:
        if name not in names:
            raise InputError(
                f"laws: {name!r} is no thin layer; expected: {', '.join(names) or 'none'}."
            )
        linear = structure.regions[names[name]].law.name
        if linear not in _SEPARATE:
            raise InputError(
                f"{name}: a layer with the law {linear!r} has no shear stress of its own that a "
                f"nonlinear law could replace; expected {' or '.join(_SEPARATE)}."
            )
    check_uniform(structure)
    return {name: names[name] for name in laws}


def linear_moduli(structure: Structure, number: int, q: Mapping[str, float]) -> tuple[float, float]:
    """Moduli, Pa, of a linear layer's normal and shear strain, unstretched.

    Args:
        structure: The structure.
        number: Index of the layer in ``structure.regions``.
        q: Values of its properties.
    """
    terms = structure.regions[number].law.stiffness_terms({**q, "stretch": 1.0})
    return float(terms[0]), float(terms[1])


def layer_stretch(q: Mapping[str, float]) -> float:
    """Actual over meshed thickness of a layer with these properties; 1 for springs."""
    return q.get("stretch", 1.0)


def _without_stress(
    pencil: AffinePencil, laws: Mapping[str, JointLaw], layers: Mapping[str, LayerTerm]
) -> AffinePencil:
    """The pencil without the stress that laws replace.

    A coupled law replaces the normal stress at its points. Strain that varies through the thickness
    stays elastic: otherwise nodes within the layer would be free to move so that there is no shear.
    """
    regions = list(pencil.regions)
    for name, layer in layers.items():
        # Of these layers the first scalar is the normal modulus', the others the shear modulus'.
        stiffness = np.zeros_like(regions[layer.region].stiffness)
        stiffness[0] = regions[layer.region].stiffness[0]
        if laws[name].coupled:
            normal = layer.thin[:, 0]
            stiffness[0] -= (normal * layer.volumes[:, None]).T @ normal
        regions[layer.region] = replace(regions[layer.region], stiffness=stiffness)
    return replace(pencil, regions=regions)


@dataclass(frozen=True)
class _Layer:
    """Strains of one layer that its law takes, weighted by the root of their volume.

    Attributes:
        name: Its name.
        number: Its index in the structure's regions.
        law: Its law.
        found: Its points.
        stretch: Actual over meshed thickness.
        moduli: The linear layer's modulus of each component, Pa, (d,).
        rows: Rows of all components, (P gdim, n_dofs).
    """

    name: str
    number: int
    law: JointLaw
    found: LayerPoints
    stretch: float
    moduli: np.ndarray
    rows: PETSc.Mat

    @property
    def shape(self) -> tuple[int, int]:
        """Points, and components that the law takes: (P, d)."""
        return len(self.found.weights), len(self.moduli)

    @property
    def root(self) -> np.ndarray:
        """Root of the points' volumes, (P,)."""
        return np.sqrt(self.found.weights * self.stretch)

    def gather(self, rows: PETSc.Mat, columns: np.ndarray) -> np.ndarray:
        """The law's components of columns, (P, d, m). Collective."""
        return self.found.gather(product(rows, columns))[:, -self.shape[1] :]

    def strain(self, columns: np.ndarray) -> np.ndarray:
        """Weighted components of columns, (P d, m). Collective."""
        found = self.root[:, None, None] * self.gather(self.rows, columns)
        return found.reshape(-1, columns.shape[1])

    def stresses(self) -> np.ndarray:
        """Loads of unit stress in every component, (n_local, P d). Collective."""
        (P, d), gdim = self.shape, self.found.points.shape[1]
        # Column of each of this rank's rows, in the order of `strain`; -1 if left out.
        column, scale = np.full((P, gdim), -1), np.empty((P, gdim))
        column[self.found.order, gdim - d :] = np.arange(P * d).reshape(P, d)
        scale[self.found.order] = self.root[:, None]
        mine = slice(*self.rows.getOwnershipRange())
        here = column.ravel()[mine, None] == np.arange(P * d)
        transposed = self.rows.transpose(PETSc.Mat())
        loads = product(transposed, here * scale.ravel()[mine, None])
        transposed.destroy()
        return loads

    def term(self, columns: np.ndarray) -> LayerTerm:
        """Its strains in a basis. Collective."""
        thin, flat = (self.gather(B, columns) for B in (self.found.thin, self.found.flat))
        return LayerTerm(self.number, thin, flat, self.found.weights)

    def interface(self, term: LayerTerm) -> InterfacePoints:
        """Its points in that basis."""
        return InterfacePoints(
            self.name,
            self.law,
            term.rows(self.stretch),
            term.volumes * self.stretch,
            self.law.coupled,
            self.found.points,
        )


class _LayerStrains:
    """Strains of all layers as one list of components: `basis.Strains`."""

    def __init__(self, structure: Structure, laws, given, degree: int | None):
        self.layers, values = [], structure.values(given)
        for name, number in layer_numbers(structure, laws).items():
            q, law = structure.field.region_values(number, values), laws[name]
            normal, shear = linear_moduli(structure, number, q)
            moduli = [normal] + [shear] * (structure.gdim - 1)
            moduli = np.array(moduli[0 if law.coupled else 1 :])
            found, s = layer_points(structure, number, degree), layer_stretch(q)
            self.layers.append(_Layer(name, number, law, found, s, moduli, found.rows(s)))
        self.size = sum(int(np.prod(layer.shape)) for layer in self.layers)

    def __call__(self, columns: np.ndarray) -> np.ndarray:
        return np.concatenate([layer.strain(columns) for layer in self.layers])

    def tangent(self) -> np.ndarray:
        """The linear layers' stress by strain of these components, (size, size)."""
        return np.diag(np.concatenate([np.tile(y.moduli, y.shape[0]) for y in self.layers]))

    def stresses(self) -> np.ndarray:
        """Loads of unit stress in every component, (n_local, size)."""
        return np.hstack([layer.stresses() for layer in self.layers])

    def destroy(self) -> None:
        """Free the matrices of the rows."""
        for layer in self.layers:
            for rows in (layer.rows, layer.found.thin, layer.found.flat):
                rows.destroy()
