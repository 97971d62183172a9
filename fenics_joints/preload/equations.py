"""Residual and Jacobian of one preload, as SNES calls them."""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from fenics_joints.preload.conditions import Pairs
from fenics_joints.preload.newton import NewtonMatrix
from fenics_joints.preload.system import PreloadSystem

#: Round-off of a residual, relative to the products of which it is the sum.
_ROUND_OFF = 10 * np.finfo(float).eps
#: Relative to the loads; never is a larger residual taken for round-off.
_LEAST_ACCURATE = 1e-6
#: Share of Coulomb's limit within which a pair is at it when a step begins.
_AT_LIMIT = 1e-6


class Equations:
    """Residual and Jacobian of one solution, as SNES calls them."""

    def __init__(self, system: PreloadSystem, pairs: Pairs, load: PETSc.Vec, start: bool):
        self.system, self.pairs, self.load = system, pairs, load
        self.start, self.first, self.iterations = start, True, 0
        self.rows = load.duplicate()
        self.pins = system.model.jumps.local(system.fixed)
        self._norm = self._atol = None
        # A slip front in a thin strip walks one vertex in an iteration.
        self.patience = 100 if any(c.friction > 0 for c in system.model.contacts) else 40

    def scale(self) -> float:
        """A force, N, to which residuals are compared: loads, or what closing the gaps takes."""
        if self._norm is None:
            closing = self.load.duplicate()
            closing.set(0.0)
            closing.array[self.pairs.numbers[:, 0]] = np.minimum(self.pairs.gap, 0.0)
            force = self.system.K * closing
            self._norm = max(self.load.norm(), force.norm(), np.finfo(float).tiny)
        return self._norm

    def allow_round_off(self, snes: PETSc.SNES, _: int) -> None:
        """Ask for no residual below round-off, which nearly rigid parts make large.

        Up to a limit, lest bodies that fly apart, whose round-off is boundless, seem to rest.
        """
        if self._atol is None:
            self._atol = snes.getTolerances()[1]
        products = self.system.held.getDiagonal()
        products.pointwiseMult(products, snes.getSolution())
        least = min(_ROUND_OFF * products.norm(), _LEAST_ACCURATE * self.scale())
        snes.setTolerances(atol=max(self._atol, least))
        products.destroy()

    def residual(self, x: PETSc.Vec, r: PETSc.Vec) -> None:
        """Rows of K x - f; of held entries x itself, times a stiffness."""
        self.system.held.mult(x, r)
        r.axpy(-1.0, self.load)
        r.array[self.pins] += self.load.array_r[self.pins]

    def function(self, snes, x: PETSc.Vec, F: PETSc.Vec) -> None:
        """SNES's function."""
        self.residual(x, F)
        values, at = F.array_r.copy(), x.array_r
        if self.start:
            left = self.pairs.closed(at, values)
        else:
            left = self.pairs.equations(at, values)
        F.array[self.pairs.numbers] = left

    def matrix(self) -> PETSc.Mat:
        """The Jacobian's matrix, A K + B, with the pattern of its rows."""
        return self.system.combine(self.pairs, *self.pairs.closed_tangent())

    def shell(self) -> PETSc.Mat:
        """The Jacobian as a product, of which nothing is assembled."""
        return NewtonMatrix(self.system.held, self.pairs.numbers).matrix()

    def jacobian(self, snes, x: PETSc.Vec, J: PETSc.Mat, P: PETSc.Mat) -> None:
        """SNES's Jacobian; the first one closes all contacts."""
        if self.start:
            A, B = self.pairs.closed_tangent()
            self.start = False
        else:
            self.residual(x, self.rows)
            # Where the step before ended in slip, a pair is at its limit but for round-off: whether
            # it goes on or sticks again is for the new load to say.
            slack = _AT_LIMIT if self.first else 0.0
            A, B = self.pairs.tangent(x.array_r, self.rows.array_r, slack)
        self.first = False
        if P.getType() == "python":
            context = P.getPythonContext()
            context.A, context.B = A, B
            P.assemble()
        else:
            self.system.combine(self.pairs, A, B, P)
        if J != P:
            J.assemble()

    def forces(self, snes, x: PETSc.Vec, F: PETSc.Vec) -> None:
        """SNES's function of method vi, whose bounds say the rest."""
        self.residual(x, F)

    def stiffness(self, snes, x: PETSc.Vec, J: PETSc.Mat, P: PETSc.Mat) -> None:
        """SNES's Jacobian of method vi: constant."""

    def bounds(self, x: PETSc.Vec) -> tuple[PETSc.Vec, PETSc.Vec]:
        """Bounds of x: openings above minus the initial gap."""
        low, high = x.duplicate(), x.duplicate()
        low.set(PETSc.NINFINITY), high.set(PETSc.INFINITY)
        low.array[self.pairs.numbers[:, 0]] = -self.pairs.gap
        return low, high

    def close(self, x: PETSc.Vec) -> None:
        """Put x into the state of bilateral contact, from which vinewtonrsls starts."""
        J, F = self.matrix(), x.duplicate()
        self.residual(x, F)
        F.array[self.pairs.numbers] = self.pairs.closed(x.array_r, F.array_r)
        ksp, step = self.system.factorised(J, "close", {}), x.duplicate()
        ksp.solve(F, step)
        x.axpy(-1.0, step)
        x.array[self.pairs.numbers[:, 0]] = -self.pairs.gap
        ksp.destroy(), J.destroy()
