"""Joints under static loads, how they give way as one grows, and reduced bases that know it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from petsc4py import PETSc

from fenics_joints.errors import ConvergenceError, InputError, capable, real, reals, whole
from fenics_joints.interfaces.model import InterfaceModel
from fenics_joints.interfaces.sparse import FullModel
from fenics_joints.interfaces.statics import SEARCHES, Statics
from fenics_joints.modal.options import given_options, reason_of

#: Compliance over that at rest beyond which a joint is taken to have failed.
_COLLAPSED = 3.0
#: Most halvings of the step to a load that fails, and most of them while no load has succeeded.
_HALVINGS, _SEARCHED = 4, 12
#: Load, relative to the least, that gives the compliance at rest; and displacement, relative to
#: that of this compliance, from which a joint counts as failed.
_AT_REST, _LOST = 1e-3, 30.0
#: A load of which this share at most pushes a free structure as a whole is balanced.
_BALANCED = 1e-6
#: Directions with less than this share of the largest energy are dependent.
_DEPENDENT = 1e-10
#: A basis needs no exact shapes, and a load may have no equilibrium: with tight tolerances most of
#: the time would go into the search for one.
_SHAPES = {"snes_rtol": 1e-6, "snes_max_it": 10, "snes_linesearch_type": "cp"}


def static_state(
    model: InterfaceModel,
    load: np.ndarray,
    *,
    steps: int = 1,
    tolerance: float = 1e-10,
    max_iterations: int = 40,
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Equilibrium under a load that grows from zero in equal steps, by Newton's method.

    Args:
        model: The model.
        load: Static load, N, (n,).
        steps: Load steps; friction remembers the path.
        tolerance: Residual relative to the load; round-off may leave more.
        max_iterations: Newton iterations per step.

    Returns:
        (displacements (n,), states of each interface (P, E, m) by its name).

    Raises:
        InputError: If the load has the wrong size, or pushes a free structure as a whole.
        ConvergenceError: If a step does not converge.
    """
    capable("model", model, ("motion", "n_dofs"), "an InterfaceModel")
    whole("steps", steps)
    whole("max_iterations", max_iterations)
    real("tolerance", tolerance, above=0.0, most=0.1)
    load = reals("load", load, unit="N")
    if load.shape != (model.n_dofs,):
        raise InputError(f"static has shape {load.shape}: expected ({model.n_dofs},).")
    statics = Statics(model.motion(), {"snes_linesearch_type": "bt"})
    for i in range(1, steps + 1):
        statics.load.array[:] = load * i / steps
        scale = max(statics.load.norm(), np.finfo(float).tiny)
        statics.solver.setTolerances(rtol=tolerance, max_it=max_iterations)
        taken = statics.solve()
        if taken is not None and taken > _BALANCED:
            raise InputError(
                f"static: {100 * taken:.2g} % of the load would accelerate the structure, which is "
                "free; expected a load in balance with itself, or supports."
            )
        if taken is None:
            left = statics.solver.getFunctionNorm() / scale
            raise ConvergenceError(
                f"static load: no equilibrium after {statics.solver.getIterationNumber()} Newton "
                f"iterations (residual {left:.2g} of the load); try more load steps",
                reason_of(statics.solver),
            )
        statics.keep()
    u, names = statics.u.array_r.copy(), [p.name for p in model.interfaces]
    states = dict(zip(names, statics.states, strict=True))
    statics.destroy()
    return u, states


def loading_shapes(
    model: FullModel | InterfaceModel,
    load: PETSc.Vec | np.ndarray,
    factors: Sequence[float],
    *,
    petsc_options: Mapping[str, object] | None = None,
    on_load: Callable[[float], object] = lambda factor: None,
) -> list[PETSc.Vec]:
    """Displacements as a load grows from rest. Collective for a full model.

    Put into a reduced basis they show it the slip that unloading and reloading have too: by
    Masing's rule that is the same shape at half the amplitude. They end where the joint's strength
    does: near a load that no static response carries, or that meets three times the compliance
    at rest. Of a free structure's load its inertia bears what would accelerate it as a whole.

    Args:
        model: The model.
        load: Load, N.
        factors: Ascending factors of the load.
        petsc_options: Options of PETSc's SNES and KSP, without prefix.
        on_load: Called with every factor before its load is applied.

    Returns:
        A displacement for each factor up to the joint's strength, and a few more near it; if even
        the smallest factor exceeds the strength, for smaller factors.

    Raises:
        InputError: If the factors do not ascend from above zero.
        ConvergenceError: If not even a small load has an equilibrium, with PETSc's reason.
    """
    if np.any(np.diff([0.0, *factors]) <= 0):
        raise InputError(f"factors = {list(factors)}: expected ascending numbers > 0.")
    statics = Statics(model.motion(), {**_SHAPES, **given_options(petsc_options)})
    u, whole = statics.u, statics.motion.vector()
    whole.array[:] = load.array_r if isinstance(load, PETSc.Vec) else load
    last, pending = _AT_REST * factors[0], [float(f) for f in factors]
    on_load(last)
    whole.copy(statics.load)
    statics.load.scale(last)
    if statics.solve() is None:
        raise ConvergenceError(
            f"no static equilibrium was found for {last:g} times the load; expected joints that "
            "bear a small load",
            reason_of(statics.solver),
        )
    # So small a load may lie within the residual's tolerance: then the least factor gives both.
    first, reach = u.dot(whole) / last, (_LOST * u.norm() / last) or np.inf
    statics.keep()
    found, start, halvings = [], u.copy(), 0
    while pending:
        on_load(pending[0])
        whole.copy(statics.load)
        statics.load.scale(pending[0])
        statics.reach = reach * pending[0]
        statics.searches = () if found else SEARCHES
        failed = statics.solve() is None
        first = first or u.dot(whole) / pending[0]
        if failed or u.dot(whole) / pending[0] > _COLLAPSED * first:
            if halvings >= (_HALVINGS if found else _SEARCHED):
                break
            # Nearer to the joint's strength its shapes change most.
            halvings += 1
            pending.insert(0, np.sqrt(last * pending[0]))
            start.copy(u)
            continue
        if not found:
            halvings = 0
        statics.keep()
        found.append(u.copy())
        start, last = found[-1], pending.pop(0)
    statics.destroy()
    return found or [start]


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
    shift, _, modes = model.modes_at_rest()
    more = [x.array_r if isinstance(x, PETSc.Vec) else np.asarray(x) for x in shapes]
    Z = np.column_stack([modes[:, :n_modes], *more])
    gram = Z.T @ (model.stiffness_at_rest() + shift * model.M) @ Z
    norms = np.sqrt(np.diag(gram))
    values, vectors = np.linalg.eigh(gram / np.outer(norms, norms))
    keep = values > _DEPENDENT * values[-1]
    Z = (Z / norms) @ (vectors[:, keep] / np.sqrt(values[keep]))
    interfaces = tuple(replace(p, rows=p.rows @ Z) for p in model.interfaces)
    return InterfaceModel(
        M=_projected(model.M, Z),
        K=_projected(model.K, Z),
        C=_projected(model.C, Z),
        interfaces=interfaces,
        forces={n: Z.T @ f for n, f in model.forces.items()},
        sensors={n: Z.T @ f for n, f in model.sensors.items()},
    )


def _projected(A: np.ndarray, Z: np.ndarray) -> np.ndarray:
    B = Z.T @ A @ Z
    return 0.5 * (B + B.T)
