"""Derivatives of contact pressures and areas, by the adjoint of the converged active set.

At a solution x, F(x, q) = 0 with F = r = K x - f, at the pairs C(r, x) of
`fenics_joints.preload.conditions`. With the converged Jacobian J = A K + B, a quantity Q(r) with
slope g = dQ/dr at the contacts has the adjoint J^T psi = K^T g and

    dQ/dq = y^T (dK/dq x - df/dq) - psi^T dC/dq,        y = g - A^T psi,

(differentiate F = 0 and put dx/dq into dQ/dq). One factorisation serves all quantities, one
transposed solution all q of a quantity.

The derivative holds as long as no pair changes its status; where one is about to, it is that of the
side on which the solution was found. The history of friction (the slips of ``initial``) counts as
given: it does not vary with q.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.modal.options import last_line
from fenics_joints.preload.hold import dots
from fenics_joints.preload.patch import contour_area
from fenics_joints.preload.solve import PreloadResult
from fenics_joints.structure.sparse import product

#: Residual, relative to the right-hand side, above which the tangent counts as singular. A sound
#: factorisation leaves 1e-12 or so.
_ACCURACY = 1e-8


@dataclass(frozen=True)
class Gradient:
    """A quantity of a preload state and its derivatives; equal on all ranks.

    Attributes:
        value: The quantity.
        forces: By each bolt's force, per N, and each load's factor. ``nan`` for one that would by
            itself push a part along a motion that nothing resists.
        friction: By Coulomb's coefficient of each contact that has one above 0 and not infinite.
        parameters: By each parameter of the structure, per its SI unit.
    """

    value: float
    forces: dict[str, float]
    friction: dict[str, float]
    parameters: dict[str, float]


class PreloadAdjoint:
    """The adjoint of one preload state: a factorisation for any number of quantities. Collective.

    In a ``with`` statement it frees what it holds at the end.

    Args:
        result: The state; its solver must not have been destroyed. PETSc options for the
            factorisation are the solver's, or stand under its prefix followed by ``adjoint_``.

    Raises:
        InputError: If the solver's matrices are gone.
    """

    def __init__(self, result: PreloadResult):
        self.result, self.solver, self.model = result, result.solver, result.model
        self.jumps, self.pairs = self.model.jumps, result.pairs
        if not self.solver.K.handle:
            raise InputError(
                "the solver of this result was destroyed; expected one that still has its matrices."
            )
        self._x, self._r = result.x.array_r.copy(), result.reactions.array_r.copy()
        self._A, B = self.pairs.tangent(self._x, self._r)
        self._J = self.solver.combine(self.pairs, self._A, B)
        given = {k: v for k, v in self.solver.petsc_options.items() if not k.startswith("snes")}
        self._ksp = self.solver.factorised(self._J, "adjoint", given)

    def __enter__(self) -> PreloadAdjoint:
        return self

    def __exit__(self, *_) -> None:
        self.destroy()

    def destroy(self) -> None:
        """Free the matrix and its factorisation. Collective."""
        self._ksp.destroy(), self._J.destroy()

    # -- quantities --------------------------------------------------------------------------

    def pressure(self, contact: str, weights) -> Gradient:
        """Weighted sum of a contact's pressures.

        Args:
            contact: Name of the contact.
            weights: Weight of the pressure at each pair, (n,).

        Raises:
            InputError: For another contact or shape.
            ConvergenceError: If the adjoint system cannot be solved.
        """
        state = self.result[contact]
        weights = np.asarray(weights, dtype=float)
        if weights.shape != (len(state.interface),) or not np.isfinite(weights).all():
            raise InputError(
                f"weights of shape {weights.shape}: expected {len(state.interface)} finite "
                f"numbers, one for each pair of {contact}."
            )
        return self._gradient(float(weights @ state.pressure), state, weights)

    def force(self, contact: str) -> Gradient:
        """Force, N, with which the bodies press on one another in a contact."""
        return self.pressure(contact, self.result[contact].interface.areas)

    def area(self, contact: str, limit: float) -> Gradient:
        """Area, m2, where a contact presses with at least ``limit``, Pa: `ContactState.area_above`.

        Raises:
            InputError: If the limit is not above zero: the area where it is zero or more is all.
            ConvergenceError: If the adjoint system cannot be solved.
        """
        if not limit > 0:
            raise InputError(f"limit = {limit}: expected a pressure > 0, Pa.")
        state = self.result[contact]
        value, slope = contour_area(state.interface, state.pressure, limit)
        return self._gradient(value, state, slope)

    # -- adjoint -----------------------------------------------------------------------------

    def _gradient(self, value: float, state, slope: np.ndarray) -> Gradient:
        """Derivatives of a quantity with ``slope`` by the pressures of one contact."""
        g = self._slope(state, slope)
        psi = self._solve(g)
        y = self._left(g, psi)
        gradient = Gradient(
            value, self._by_forces(y), self._by_friction(psi), self._by_parameters(y)
        )
        g.destroy(), psi.destroy(), y.destroy()
        return gradient

    def _slope(self, state, slope: np.ndarray) -> PETSc.Vec:
        """The slope by r; pressures of open pairs are zero, whatever happens to r there."""
        g = self.result.x.duplicate()
        g.set(0.0)
        values = np.where(state.closed, slope, 0.0) / state.interface.areas
        self.jumps.put(g.array, self.jumps.numbers(state.interface)[:, 0], values)
        return g

    def _solve(self, g: PETSc.Vec) -> PETSc.Vec:
        right, psi = g.duplicate(), g.duplicate()
        self.solver.K.mult(g, right)
        right.array[self.solver.pins] = 0.0
        try:
            self._ksp.solveTranspose(right, psi)
        except PETSc.Error as error:
            raise ConvergenceError(
                "the adjoint of the preload was not solved: the tangent of the contact is "
                "singular, as where a friction limit leaves a part without hold.",
                last_line(error),
            ) from error
        # A factorisation that fails leaves infinities, not an exception.
        off = g.duplicate()
        self._J.multTranspose(psi, off)
        off.axpy(-1.0, right)
        bad = not off.norm() <= _ACCURACY * max(right.norm(), np.finfo(float).tiny)
        right.destroy(), off.destroy()
        if bad:
            raise ConvergenceError(
                "the adjoint of the preload was not solved: the tangent of the contact is "
                "singular or nearly so.",
                str(self._ksp.getConvergedReason()),
            )
        return psi

    def _left(self, g: PETSc.Vec, psi: PETSc.Vec) -> PETSc.Vec:
        """y = g - A^T psi, zero at entries that are held."""
        y = g.copy()
        y.axpy(-1.0, psi)
        numbers = self.pairs.numbers
        at = np.einsum("nij,ni->nj", self._A, psi.array_r[numbers])
        y.array[numbers] = g.array_r[numbers] - at
        y.array[self.jumps.local(self.solver.fixed)] = 0.0
        return y

    def _by_forces(self, y: PETSc.Vec) -> dict[str, float]:
        """-y^T df/dq, with the load balanced as that of the state is."""
        found = {}
        for name in self.model.forces:
            unit = self.solver.unit_load(name)
            try:
                self.solver.hold.balance(unit, lambda: self.model.mass(self.solver.given))
                found[name] = -float(y.dot(unit))
            except InputError:
                found[name] = float("nan")
            unit.destroy()
        return found

    def _by_friction(self, psi: PETSc.Vec) -> dict[str, float]:
        slope = self.pairs.friction_slope(self._x, self._r)
        work = -np.sum(slope * psi.array_r[self.pairs.numbers], axis=1)
        found, first = {}, 0
        for contact, interface in zip(self.model.contacts, self.jumps.contacts, strict=True):
            last = first + int(self.jumps.owned(self.jumps.numbers(interface)[:, 0]).sum())
            if 0 < contact.friction < np.inf:
                local = float(work[first:last].sum())
                found[contact.name] = self.model.comm.allreduce(local, op=MPI.SUM)
            first = last
        return found

    def _by_parameters(self, y: PETSc.Vec) -> dict[str, float]:
        """y^T (dK/dq x - df/dq), where f varies with q only by the inertia that balances it."""
        structure = self.model.structure
        if not structure.parameters:
            return {}
        gradient = self._bilinear(y, self.result.x, 0.0)
        if self.result.balance > 0:
            gradient = gradient + self._by_inertia(y)
        return dict(zip(structure.parameters, gradient.tolist(), strict=True))

    def _by_inertia(self, y: PETSc.Vec) -> np.ndarray:
        """-y^T df/dq of the load f - M V (V^T M V)^-1 V^T f, with V the motions of the whole."""
        hold, comm = self.solver.hold, self.model.comm
        V = hold.motions[:, : hold.n_whole]
        load = self.model.load(self.result.forces)
        M = self.model.mass(self.solver.given)
        heavy = product(M, V)
        gram = dots(comm, V, heavy)
        rate, left = y.duplicate(), y.copy()
        rate.array[:] = V @ np.linalg.solve(gram, dots(comm, V, load.array_r))
        left.array[:] -= V @ np.linalg.solve(gram, dots(comm, heavy, y.array_r))
        # The form of K - lambda M at the difference of two lambda is that of M; this lambda, in
        # (rad/s)^2, makes the two of one size.
        scale = self.solver.stiffness.diagonal.norm() / M.getDiagonal().norm()
        slope = self._bilinear(left, rate, scale) - self._bilinear(left, rate, 0.0)
        for owned in (load, M, rate, left):
            owned.destroy()
        return -slope / scale

    def _bilinear(self, a: PETSc.Vec, b: PETSc.Vec, eigenvalue: float) -> np.ndarray:
        """(T a)^T d(K - lambda M)/dq (T b) by every parameter, by polarisation."""
        u, v = self._displacement(a), self._displacement(b)
        size = u.norm(), v.norm()
        if not min(size) > 0:
            u.destroy(), v.destroy()
            return np.zeros(len(self.model.structure.parameters))
        u.scale(size[1] / size[0])
        total = u.copy()
        total.axpy(1.0, v)
        u.axpy(-1.0, v)
        forms = [
            self.model.structure.pencil_gradients([w], [eigenvalue], self.solver.given)[0]
            for w in (total, u)
        ]
        for owned in (u, v, total):
            owned.destroy()
        return (forms[0] - forms[1]) / 4 * (size[0] / size[1])

    def _displacement(self, x: PETSc.Vec) -> PETSc.Vec:
        """T x, zero where supports hold: the stiffness there is the identity, for all q."""
        u = self.jumps.T * x
        u.array[self.model.structure.held_dofs[: u.getLocalSize()]] = 0.0
        return u
