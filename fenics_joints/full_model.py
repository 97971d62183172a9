"""Full finite-element models with nonlinear layers, and how they give way under static loads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from petsc4py import PETSc

from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.interface_reduction import Places, layer_moduli, layer_numbers, places
from fenics_joints.joint_laws.law import JointLaw
from fenics_joints.layer_points import LayerPoints, layer_points
from fenics_joints.motion import FullModel, SparseMotion, SparsePoints, point_blocks
from fenics_joints.preload.options import petsc_defaults
from fenics_joints.structure import Structure

__all__ = ["full_layers", "loading_shapes"]

_PREFIX = "fenics_joints_loading_"
#: Compliance over that at rest beyond which a joint is taken to have failed.
_COLLAPSED = 3.0
_DEFAULTS = {
    "snes_type": "newtonls",
    "snes_rtol": 1e-8,
    "snes_max_it": 25,
    "snes_linesearch_type": "bt",
    "ksp_type": "preonly",
    "pc_type": "lu",
    "pc_factor_mat_solver_type": "mumps",
}


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


def loading_shapes(
    model: FullModel,
    load: PETSc.Vec,
    factors: Sequence[float],
    *,
    petsc_options: Mapping[str, object] | None = None,
) -> list[PETSc.Vec]:
    """Displacements as a load grows from rest: how the joints give way. Collective.

    Put into a reduced basis they show it the slip that unloading and reloading have too: by
    Masing's rule that is the same shape at half the amplitude. They end where the joint's strength
    does: at a load that no static response carries, or one that takes `_COLLAPSED` times the work
    of an elastic joint.

    Args:
        model: The full model.
        load: Load, N.
        factors: Ascending factors of the load.
        petsc_options: Options of PETSc's SNES and KSP, without prefix.

    Returns:
        A displacement for each factor up to the joint's strength.

    Raises:
        ConvergenceError: If not even the first step converges, with PETSc's reason.
    """
    motion = SparseMotion(model)
    still, states, u = motion.vector(), motion.rest(), motion.vector()
    present = motion.vector()
    snes = PETSc.SNES().create(comm=motion.comm)
    snes.setOptionsPrefix(_PREFIX)
    snes.setFunction(
        lambda snes, x, f: motion.residual(x, still, still, present, states, f), motion.vector()
    )
    matrix = motion.matrix()
    snes.setJacobian(lambda snes, x, J, P: motion.jacobian(x, states, 0.0, 0.0, P), matrix)
    with petsc_defaults(_PREFIX, {**_DEFAULTS, **(petsc_options or {})}):
        snes.setFromOptions()
    found, first = [], None
    for factor in factors:
        load.copy(present)
        present.scale(float(factor))
        snes.solve(None, u)
        if snes.getConvergedReason() < 0:
            if found:
                break
            raise ConvergenceError(
                f"the static response to {factor:g} times the load was not found; expected a "
                "smaller first step", _reason(snes),
            )  # fmt: skip
        states = [new for _, _, new, _ in motion.step(u, states)]
        found.append(u.copy())
        flexibility = u.dot(load) / factor
        if flexibility > _COLLAPSED * (first := first or flexibility):
            break
    snes.destroy(), matrix.destroy()
    return found


def _reason(snes: PETSc.SNES) -> str:
    for name, value in vars(PETSc.SNES.ConvergedReason).items():
        if value == snes.getConvergedReason() and not name.startswith("_"):
            return name.lower().replace("_", " ")
    return str(snes.getConvergedReason())
