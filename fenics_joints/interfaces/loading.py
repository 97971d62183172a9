"""How joints give way as a static load grows, and reduced bases that know it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import scipy.linalg
from petsc4py import PETSc

from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.interfaces.model import InterfaceModel
from fenics_joints.interfaces.motion import FullModel, SparseMotion, motion_of
from fenics_joints.modal.options import petsc_defaults, reason_of

__all__ = ["condense", "loading_shapes"]

_PREFIX = "fenics_joints_loading_"
#: Compliance over that at rest beyond which a joint is taken to have failed.
_COLLAPSED = 3.0
#: How often the step to a load that is too large is halved.
_HALVINGS = 4
#: Directions with less than this share of the largest energy are dependent.
_DEPENDENT = 1e-10
_DEFAULTS = {
    "snes_type": "newtonls",
    "snes_rtol": 1e-8,
    "snes_max_it": 40,
    "snes_linesearch_type": "cp",
    "ksp_type": "preonly",
    "pc_type": "lu",
}


def loading_shapes(
    model: FullModel | InterfaceModel,
    load: PETSc.Vec | np.ndarray,
    factors: Sequence[float],
    *,
    petsc_options: Mapping[str, object] | None = None,
) -> list[PETSc.Vec]:
    """Displacements as a load grows from rest. Collective for a full model.

    Put into a reduced basis they show it the slip that unloading and reloading have too: by
    Masing's rule that is the same shape at half the amplitude. They end where the joint's strength
    does: near a load that no static response carries, or that meets three times the compliance
    at rest.

    Args:
        model: The model.
        load: Load, N.
        factors: Ascending factors of the load.
        petsc_options: Options of PETSc's SNES and KSP, without prefix.

    Returns:
        A displacement for each factor up to the joint's strength, and a few more near it.

    Raises:
        InputError: If the factors do not ascend from above zero.
        ConvergenceError: If not even the first step converges, with PETSc's reason.
    """
    if np.any(np.diff([0.0, *factors]) <= 0):
        raise InputError(f"factors = {list(factors)}: expected ascending numbers > 0.")
    motion = motion_of(model)
    still, states, u = motion.vector(), motion.rest(), motion.vector()
    whole, present = motion.vector(), motion.vector()
    whole.array[:] = load.array_r if isinstance(load, PETSc.Vec) else load
    snes = PETSc.SNES().create(comm=motion.comm)
    snes.setOptionsPrefix(_PREFIX)
    snes.setFunction(
        lambda snes, x, f: motion.residual(x, still, still, present, states, f), motion.vector()
    )
    matrix = motion.matrix()
    snes.setJacobian(lambda snes, x, J, P: motion.jacobian(x, states, 0.0, 0.0, P), matrix)
    direct = {"pc_factor_mat_solver_type": "mumps"} if isinstance(motion, SparseMotion) else {}
    with petsc_defaults(_PREFIX, {**_DEFAULTS, **direct, **(petsc_options or {})}):
        snes.setFromOptions()
    found, first, last, pending, halvings = [], None, 0.0, [float(f) for f in factors], 0
    while pending:
        whole.copy(present)
        present.scale(pending[0])
        snes.solve(None, u)
        failed = snes.getConvergedReason() < 0
        if failed and not found:
            raise ConvergenceError(
                f"the static response to {pending[0]:g} times the load was not found; expected a "
                "smaller first step", reason_of(snes),
            )  # fmt: skip
        compliance = u.dot(whole) / pending[0]
        first = first or compliance
        if failed or compliance > _COLLAPSED * first:
            if halvings == _HALVINGS:
                break
            # Nearer to the joint's strength its shapes change most.
            halvings += 1
            pending.insert(0, np.sqrt(last * pending[0]))
            found[-1].copy(u)
            continue
        states = [new for _, _, new, _ in motion.step(u, states)]
        found.append(u.copy())
        last = pending.pop(0)
    snes.destroy(), matrix.destroy()
    return found


def condense(
    model: InterfaceModel, shapes: Sequence[np.ndarray | PETSc.Vec], n_modes: int = 12
) -> InterfaceModel:
    """A model on its modes at rest and some more shapes, such as those of `loading_shapes`.

    Args:
        model: A model with many degrees of freedom, such as one that keeps all of an interface.
        shapes: Further displacements, (n,) each.
        n_modes: Modes at rest.

    Raises:
        InputError: If there are fewer degrees of freedom than modes.
    """
    if not 1 <= n_modes <= model.n_dofs:
        raise InputError(f"n_modes = {n_modes}: expected 1 to {model.n_dofs}.")
    K = model.stiffness_at_rest()
    # Inverted, since the mass may be singular and the stiffness of a held body is not.
    shift = 1e-6 * np.trace(K) / np.trace(model.M)
    last = len(K) - 1
    _, modes = scipy.linalg.eigh(
        model.M, K + shift * model.M, subset_by_index=[last - n_modes + 1, last]
    )
    more = [x.array_r if isinstance(x, PETSc.Vec) else np.asarray(x) for x in shapes]
    Z = np.column_stack([*modes.T[::-1], *more])
    gram = Z.T @ (K + shift * model.M) @ Z
    norms = np.sqrt(np.diag(gram))
    values, vectors = np.linalg.eigh(gram / np.outer(norms, norms))
    keep = values > _DEPENDENT * values[-1]
    Z = (Z / norms) @ (vectors[:, keep] / np.sqrt(values[keep]))
    interfaces = tuple(replace(p, rows=p.rows @ Z) for p in model.interfaces)
    return InterfaceModel(
        M=_projected(model.M, Z), K=_projected(model.K, Z), C=_projected(model.C, Z),
        interfaces=interfaces, forces={n: Z.T @ f for n, f in model.forces.items()},
        sensors={n: Z.T @ f for n, f in model.sensors.items()},
    )  # fmt: skip


def _projected(A: np.ndarray, Z: np.ndarray) -> np.ndarray:
    B = Z.T @ A @ Z
    return 0.5 * (B + B.T)
