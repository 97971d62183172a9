"""Reduced models of structures whose thin layers are nonlinear.

A law takes the place of a layer's whole shear stress, and of its normal stress if it is coupled, at
points on the middle plane, two in each direction of a box cell. What is left is positive
semi-definite, so that a joint that slides freely is not unstable. With a law whose tangent at rest
is the layer's the frequencies are the linear structure's, but for what one point through the
thickness and two along a cell do not see: less than 1e-4 of a frequency on cells of 40 mm in a
layer of 0.5 mm between plates of 8 mm, 2e-5 on cells of 10 mm; up to 7e-4 on the former with a
coupled law, since the normal stress varies more within a cell (more points: ``points_degree``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from petsc4py import PETSc

from fenics_joints.errors import InputError
from fenics_joints.interfaces.assembly import as_columns, as_vectors, assemble, check_uniform
from fenics_joints.interfaces.basis import energy_share, free_interface
from fenics_joints.interfaces.layer_points import LayerPoints, layer_points
from fenics_joints.interfaces.model import InterfacePoints
from fenics_joints.interfaces.reduced import LayerTerm, ReducedInterfaceModel
from fenics_joints.joint_laws.law import JointLaw
from fenics_joints.modal.modes import solve_modes
from fenics_joints.reduction.affine import AffinePencil
from fenics_joints.reduction.reduced import ReducedStructure
from fenics_joints.structure.loads import Places, place_loads
from fenics_joints.structure.sparse import product
from fenics_joints.structure.structure import Structure

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

    The basis is of free interfaces: the modes of the structure with its layers as linear as they
    are in it (so give them the laws' stiffness at rest), what is missing of the static response to
    loads at ``forces`` and ``sensors``, and interface modes, see
    `fenics_joints.interfaces.basis.free_interface`. A fixed-interface basis has no place here: an
    elastic layer has no state in which its strains are held.

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
        points_degree: See `fenics_joints.interfaces.layer_points.layer_points`.
        extra: Displacements to keep in the basis, such as
            `fenics_joints.interfaces.loading.loading_shapes`: a dozen of those show it how
            the layer gives way, which takes interface modes by the hundred.

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
    """Actual over meshed thickness of a layer with these properties; of springs there is none."""
    return q.get("stretch", 1.0)


def _without_stress(
    pencil: AffinePencil, laws: Mapping[str, JointLaw], layers: Mapping[str, LayerTerm]
) -> AffinePencil:
    """The pencil without the stress that laws take over.

    Of the normal stress a coupled law takes what its points see. Strain that varies through the
    thickness stays elastic: without that, nodes within the layer would shape themselves, in a basis
    that lets them, so that there is no shear.
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
