"""Joints under growing static loads, and the displacements that a reduced basis needs for them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from petsc4py import PETSc

from fenics_joints.errors import ConvergenceError, InputError, capable, reals, whole
from fenics_joints.interfaces.full import FullModel
from fenics_joints.interfaces.model import InterfaceModel
from fenics_joints.interfaces.motion import Motion
from fenics_joints.modal.options import given_options, petsc_defaults, reason_of
from fenics_joints.structure.sparse import absolute

_PREFIX = "fenics_joints_loading_"
_DEFAULTS = {"snes_type": "newtonls", "snes_max_it": 40, "ksp_type": "preonly", "pc_type": "lu"}
#: Line searches tried where another fails: round-off can mislead one by the residual, and full
#: steps can go too far.
SEARCHES = "basic", "bt"
#: Residual over the load at which an iteration has diverged; PETSc's own default.
_DIVERGED = 1e4
#: Last step over the displacement, and residual over the load, at which an iteration counts as
#: converged though round-off keeps the residual: chosen.
_STILL, _LEFT = 1e-10, 1e-4


class Statics:
    """Equilibrium of a motion under one load after another, by PETSc's SNES.

    Of a free structure, the part of the load that would accelerate it is taken off, and its mean
    displacement and rotation are zero. An iteration has converged if the residual is below
    ``snes_rtol`` times the load or below the round-off of its terms, or if steps vanish.

    Args:
        motion: The motion.
        options: PETSc options beside the defaults.

    Attributes:
        solver: The SNES.
        u: Displacement.
        load: Load of the next solution.
        states: The interfaces' states before it.
        scale: Least load, N, that residuals are measured by, for a load that passes zero.
        reach: Norm of u beyond which the search for an equilibrium ends.
        searches: Other line searches, if the first one fails.
    """

    def __init__(self, motion: Motion, options: Mapping[str, object]):
        self.motion, self.states = motion, motion.rest()
        self.u, self.load, self._still = motion.vector(), motion.vector(), motion.vector()
        self.scale, self.reach, self.searches = 0.0, np.inf, SEARCHES
        self._matrix, self._terms = motion.matrix(), motion.vector()
        self._magnitudes = _magnitudes(motion, self.u, self.states)
        self._free = motion.free()
        start, end = self.u.getOwnershipRange()
        self._pins = self._free.pins(start)
        self._own = self._pins[(self._pins >= start) & (self._pins < end)] - start
        self._matrix.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        self.solver = PETSc.SNES().create(comm=motion.comm)
        self.solver.setOptionsPrefix(_PREFIX)
        self.solver.setFunction(self._residual, motion.vector())
        self.solver.setJacobian(self._jacobian, self._matrix)
        self.solver.setConvergenceTest(self._test)
        with petsc_defaults(_PREFIX, {**_DEFAULTS, **motion.options, **options}) as found:
            self.solver.setFromOptions()
            self._search = found.getString("snes_linesearch_type", "bt")

    def _residual(self, snes, x: PETSc.Vec, f: PETSc.Vec) -> None:
        self.motion.residual(x, self._still, self._still, self.load, self.states, f)
        f.array[self._own] = 0.0

    def _jacobian(self, snes, x: PETSc.Vec, J: PETSc.Mat, P: PETSc.Mat) -> None:
        self.motion.jacobian(x, self.states, 0.0, 0.0, P)
        if len(self._pins):
            P.zeroRowsColumns(self._pins)

    def _test(self, snes, iteration: int, norms: tuple[float, float, float]):
        reason, size = PETSc.SNES.ConvergedReason, norms[2]
        if not np.isfinite(size):
            return reason.DIVERGED_FNORM_NAN
        if norms[0] > self.reach:
            return reason.DIVERGED_DTOL
        (rtol, atol), load = snes.getTolerances()[:2], max(self.load.norm(), self.scale)
        if size <= max(atol, rtol * load, self.round_off(snes.getSolution())):
            return reason.CONVERGED_FNORM_RELATIVE
        # Stress that is a difference of large numbers, as in a contact under pressure, has a large
        # round-off: a residual that steps do not reduce is that.
        if iteration and norms[1] <= _STILL * norms[0] and size <= _LEFT * load:
            return reason.CONVERGED_SNORM_RELATIVE
        return reason.DIVERGED_DTOL if size > _DIVERGED * load else reason.CONVERGED_ITERATING

    def round_off(self, u: PETSc.Vec) -> float:
        """Norm, N, that a residual at u may have by round-off alone. Collective.

        Of a sum of n terms the error is about sqrt(n) unit round-offs of the sum of magnitudes
        (Higham and Mary, SIAM J. Sci. Comput. 41, 2019).
        """
        moved = u.copy()
        moved.abs()
        self._magnitudes.mult(moved, self._terms)
        moved.destroy()
        entries = self._magnitudes.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"]
        n = entries / self._magnitudes.getSize()[0]
        return 0.5 * float(np.finfo(float).eps) * float(np.sqrt(n)) * self._terms.norm()

    def solve(self) -> float | None:
        """Move u to equilibrium with the load. Collective.

        Returns:
            Share of the load that a free structure's inertia bears; None if no equilibrium was
            found.
        """
        taken, before, found = self._free.balance(self.load), self.u.copy(), False
        for search in dict.fromkeys((self._search, *self.searches)):
            before.copy(self.u)
            with petsc_defaults(_PREFIX, {}, {"snes_linesearch_type": search}):
                self.solver.setFromOptions()
            self.solver.solve(None, self.u)
            if found := self.solver.getConvergedReason() >= 0:
                break
            if self.u.norm() > self.reach:  # another line search would end there too
                break
        before.destroy()
        self._free.take_off(self.u)
        return taken if found else None

    def keep(self) -> None:
        """Let the joints remember u as their last state. Collective."""
        self.states = [new for _, _, new, _ in self.motion.step(self.u, self.states)]

    def destroy(self) -> None:
        """Free solver and matrices. Collective."""
        self.solver.destroy(), self._matrix.destroy(), self._magnitudes.destroy()


def _magnitudes(motion: Motion, rest: PETSc.Vec, states) -> PETSc.Mat:
    """Magnitudes of the stiffness at rest, entry by entry."""
    A = motion.matrix()
    motion.jacobian(rest, states, 0.0, 0.0, A)
    if A.getType() not in ("seqdense", "mpidense"):
        found = absolute(A)
        A.destroy()
        return found
    A.getDenseArray()[:] = np.abs(A.getDenseArray())
    A.assemble()
    return A


#: Compliance over that at rest beyond which a joint counts as failed: chosen.
_COLLAPSED = 3.0
#: Most halvings of the step to a load that fails, and most while no load has succeeded: chosen.
_HALVINGS, _SEARCHED = 4, 12
#: Load, over the least, that gives the compliance at rest; and displacement, over that of this
#: compliance, beyond which a joint counts as failed: chosen.
_AT_REST, _LOST = 1e-3, 30.0
#: Residual of an equilibrium over the load; round-off may leave more.
_EQUILIBRIUM = 1e-10
#: Largest share of a load on a free structure that is out of balance: round-off of input.
_BALANCED = 1e-6
#: Options for shapes of a basis, which need not be exact: a load may have no equilibrium, and tight
#: tolerances would spend most of the time on the search for one.
_SHAPES = {"snes_rtol": 1e-6, "snes_max_it": 10, "snes_linesearch_type": "cp"}


def static_state(
    model: InterfaceModel, load: np.ndarray, *, steps: int = 1
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Equilibrium under a load that grows from zero in equal steps, by Newton's method.

    Args:
        model: The model.
        load: Static load, N, (n,).
        steps: Load steps; friction remembers the path.

    Returns:
        (displacements (n,), states of each interface (P, E, m) by its name).

    Raises:
        InputError: If the load has the wrong size, or pushes a free structure as a whole.
        ConvergenceError: If a step does not converge.
    """
    capable("model", model, ("motion", "n_dofs"), "an InterfaceModel")
    whole("steps", steps)
    load = reals("load", load, unit="N")
    if load.shape != (model.n_dofs,):
        raise InputError(f"static has shape {load.shape}: expected ({model.n_dofs},).")
    statics = Statics(model.motion(), {"snes_linesearch_type": "bt"})
    for i in range(1, steps + 1):
        statics.load.array[:] = load * i / steps
        scale = max(statics.load.norm(), np.finfo(float).tiny)
        statics.solver.setTolerances(rtol=_EQUILIBRIUM)
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

    A reduced basis that holds them holds the slip of unloading and reloading, too: by Masing's rule
    that has the same shape at half the amplitude. They end at the joint's strength: near a load
    without static equilibrium, or with three times the compliance at rest. The part of the load
    that would accelerate a free structure is borne by its inertia.

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
