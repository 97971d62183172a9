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
from dataclasses import replace

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

__all__ = ["layer_numbers", "reduce_layers"]

#: Layers whose normal and shear stress are apart.
_SEPARATE = ("uncoupled", "constrained")


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
            ``uncoupled`` or ``constrained``.
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
    numbers = layer_numbers(structure, laws)
    found = {n: layer_points(structure, i, points_degree) for n, i in numbers.items()}
    values = structure.values(given)
    stretch = {n: structure.field.region_values(i, values)["stretch"] for n, i in numbers.items()}
    forces, force_loads = place_loads(structure, "forces", forces)
    sensors, sensor_loads = place_loads(structure, "sensors", sensors)
    strains = _LayerStrains(found, numbers, stretch, {n: law.coupled for n, law in laws.items()})
    choose = energy_share(interface_modes or None, tolerance, n_modes, strains.size)
    modes = solve_modes(structure, given, n_modes=n_modes)
    M, K = structure.mass(given), structure.stiffness(given)
    columns = free_interface(
        K, M, modes.solver,
        as_columns(modes.shapes),
        np.hstack([force_loads, sensor_loads]),
        None if interface_modes == 0 else strains.stresses(),
        strains,
        strains.tangent(structure, values),
        None if interface_modes == 0 else choose,
        as_columns(extra) if len(extra) else None,
    ).columns  # fmt: skip
    reduced = ReducedStructure(structure, as_vectors(K, columns))
    layers = {
        name: _layer_term(number, found[name], columns, laws[name])
        for name, number in numbers.items()
    }
    interfaces = [
        InterfacePoints(
            name, laws[name], layer.rows(stretch[name]), layer.volumes * stretch[name],
            laws[name].coupled, found[name].points,
        )
        for name, layer in layers.items()
    ]  # fmt: skip
    pencil = _without_stress(reduced.affine, laws, layers)
    modes.solver.destroy(), strains.destroy()
    for A in (K, M, *(B for p in found.values() for B in (p.thin, p.flat))):
        A.destroy()
    return assemble(
        columns, reduced, interfaces, pencil, layers, given,
        (forces, force_loads), (sensors, sensor_loads),
    )  # fmt: skip


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


def _layer_term(number: int, p: LayerPoints, columns: np.ndarray, law: JointLaw) -> LayerTerm:
    """Strains of a layer in a basis, without the normal one if the law leaves it."""
    first = 0 if law.coupled else 1
    thin, flat = (p.gather(product(B, columns))[:, first:] for B in (p.thin, p.flat))
    return LayerTerm(number, thin, flat, p.weights)


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


class _LayerStrains:
    """Strains of all layers as one list of components, weighted by the root of their volume."""

    def __init__(self, found: Mapping[str, LayerPoints], numbers, stretch, normal):
        self.parts, self.numbers = [], [numbers[name] for name in found]
        for name, p in found.items():
            s = stretch[name]
            B = p.thin.copy()
            B.scale(1 / s)
            B.axpy(1.0, p.flat, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
            self.parts.append((p, B, np.sqrt(p.weights * s), 0 if normal[name] else 1))
        self.size = sum(r.size * (B.getSize()[0] // len(r) - first)
                        for _, B, r, first in self.parts)  # fmt: skip

    def __call__(self, columns: np.ndarray) -> np.ndarray:
        rows = []
        for p, B, root, first in self.parts:
            strain = root[:, None, None] * p.gather(product(B, columns))[:, first:]
            rows.append(strain.reshape(-1, columns.shape[1]))
        return np.concatenate(rows)

    def tangent(self, structure: Structure, values) -> np.ndarray:
        """The linear layers' stress by strain of these components, (size, size)."""
        moduli = []
        for (p, _, _, first), number in zip(self.parts, self.numbers, strict=True):
            q = structure.field.region_values(number, values)
            # At unit stretch the first scalar of these laws is the normal modulus.
            normal = structure.regions[number].law.stiffness_terms({**q, "stretch": 1.0})[0]
            each = [normal] + [q["G"]] * (p.points.shape[1] - 1)
            moduli.append(np.tile(each[first:], len(p.points)))
        return np.diag(np.concatenate(moduli))

    def stresses(self) -> np.ndarray:
        """Loads of unit stress in every component, (n_local, size)."""
        loads = []
        for p, B, root, first in self.parts:
            gdim = p.points.shape[1]
            begin, end = B.getOwnershipRange()
            # Column of each row of B, in the order of `__call__`; -1 for components left out.
            column = np.full((len(root), gdim), -1)
            kept = np.arange(len(root) * (gdim - first)).reshape(len(root), -1)
            column[p.order, first:] = kept
            scale = np.empty(len(root))
            scale[p.order] = root
            mine = column.ravel()[begin:end]
            unit = np.zeros((end - begin, kept.size))
            rows = np.flatnonzero(mine >= 0)
            unit[rows, mine[rows]] = np.repeat(scale, gdim)[begin:end][rows]
            transposed = B.transpose(PETSc.Mat())
            loads.append(product(transposed, unit))
            transposed.destroy()
        return np.hstack(loads)

    def destroy(self) -> None:
        """Free the matrices of the rows."""
        for _, B, _, _ in self.parts:
            B.destroy()
