"""Equilibrium of a structure with nonlinear interfaces under one load after another."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from petsc4py import PETSc

from fenics_joints.interfaces.motion import Motion
from fenics_joints.modal.options import petsc_defaults
from fenics_joints.structure.sparse import absolute

_PREFIX = "fenics_joints_loading_"
_DEFAULTS = {"snes_type": "newtonls", "snes_max_it": 40, "ksp_type": "preonly", "pc_type": "lu"}
#: Line searches that are tried where another fails: round-off can mislead one that looks at the
#: residual, and whole steps can go too far.
SEARCHES = "basic", "bt"
#: Residual over the load beyond which there is no hope; PETSc's own default.
_DIVERGED = 1e4
#: Last step over the displacement, and residual over the load, of a solution that stands still.
_STILL, _LEFT = 1e-10, 1e-4


class Statics:
    """Equilibrium of a motion under one load after another, by PETSc's SNES.

    What of a load would accelerate a free structure is taken off it, and its mean place and turn
    are none. A residual is small if it is below ``snes_rtol`` times the load, or below what
    round-off alone makes of the terms that it is the sum of, or if Newton's steps stand still.

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
        # Stress that is the difference of large ones, as of a contact under pressure, has a
        # round-off of its own: where steps no longer move anything the rest is that.
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
        """Take u as what the joints remember. Collective."""
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
