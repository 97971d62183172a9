"""Full finite-element models with nonlinear layers."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from petsc4py import PETSc

from fenics_joints.errors import InputError
from fenics_joints.interface_reduction import Places, layer_moduli, layer_numbers, places
from fenics_joints.joint_laws.law import JointLaw
from fenics_joints.layer_points import LayerPoints, layer_points
from fenics_joints.motion import FullModel, SparsePoints, point_blocks
from fenics_joints.structure import Structure

__all__ = ["full_layers"]


def full_layers(
    structure: Structure,
    laws: Mapping[str, JointLaw],
    *,
    forces: Places | None = None,
    sensors: Places | None = None,
    given: Mapping[str, float] | None = None,
    points_degree: int | None = None,
) -> FullModel:
    """A structure whose thin layers follow nonlinear laws, not reduced. Collective.

    Arguments as `fenics_joints.interface_reduction.reduce_layers`, which makes the reduced model of
    the same equations.

    Raises:
        InputError: As there.
    """
    numbers = layer_numbers(structure, laws)
    values = structure.values(given)
    K, M = structure.stiffness(given), structure.mass(given)
    interfaces = []
    for name, number in numbers.items():
        q, law = structure.field.region_values(number, values), laws[name]
        points = _points(name, law, layer_points(structure, number, points_degree), q["stretch"])
        moduli = layer_moduli(structure.regions[number].law, q, law.coupled)
        shear = points.n_components - law.coupled
        elastic = np.diag(np.append(moduli[:-1], np.repeat(moduli[-1], shear)))
        block = point_blocks(points, points.weights[:, None, None] * elastic)
        taken = block.ptap(points.rows)
        K.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
        K.axpy(-1.0, taken, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        taken.destroy(), block.destroy()
        interfaces.append(points)
    placed = [
        {name: _vector(K, column) for name, column in zip(found, loads.T, strict=True)}
        for found, loads in (
            places(structure, "forces", forces), places(structure, "sensors", sensors)
        )
    ]  # fmt: skip
    return FullModel(M, K, tuple(interfaces), None, *placed)


def _points(name: str, law: JointLaw, found: LayerPoints, stretch: float) -> SparsePoints:
    """This rank's points of a layer, without the rows that the law does not ask for."""
    rows = found.thin.copy()
    rows.scale(1 / stretch)
    rows.axpy(1.0, found.flat, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
    gdim = found.points.shape[1]
    first, last = (i // gdim for i in rows.getOwnershipRange())
    mine = np.argsort(found.order)[first:last]
    if law.n_points is not None:
        raise InputError(f"{law.label}: expected the same parameters at all points of a layer.")
    if not law.coupled:
        kept = np.arange(first * gdim, last * gdim)
        index = PETSc.IS().createGeneral(kept[kept % gdim > 0].astype(np.int32), comm=rows.comm)
        rows = rows.createSubMatrix(index)
    return SparsePoints(
        name, law, rows, found.weights[mine] * stretch, gdim - (not law.coupled), law.coupled,
        found.points[mine],
    )  # fmt: skip


def _vector(K: PETSc.Mat, column: np.ndarray) -> PETSc.Vec:
    v = K.createVecRight()
    v.array[:] = column
    return v
