"""Newton steps of contact from few factorisations, all of them symmetric, or by multigrid.

A step solves J d = F with J = A K + B, where the blocks A and B at the pairs come from
`fenics_joints.preload.conditions` and A = 1, B = 0 elsewhere. Three kinds of entries occur:

- Known ones, where A's row is zero (openings that stay closed, slips that stick): B d = F there.
- Springs, where A has an inverse: K + A^-1 B, with the symmetric part of A^-1 B on the diagonal.
- Coulomb's limit, by which a slip's row depends on the change of the normal force: unsymmetric.

Without the last one the rest of the system, known entries moved to the right, is symmetric and
positive definite. That matrix P is what gets factorised, and serves as preconditioner of GMRES on J
otherwise: for Coulomb's limit, and when some pairs have changed their status since P was made, each
of which costs at most one iteration. So P is made anew only when many have changed.

Of large models one multigrid cycle stands for P^-1 (`fenics_joints.preload.multigrid`). It is made
anew whenever a pair has changed, which costs a few cycles.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from fenics_joints.modal.options import petsc_defaults
from fenics_joints.preload.multigrid import CYCLE, ContactMultigrid
from fenics_joints.preload.stiffness import Stiffness

#: Pairs that may have changed since P was factorised: about one Krylov iteration each. At most this
#: share of n^(2/3), in which the ratio of a factorisation to a solution grows (nested dissection in
#: 3-D), and this many, as GMRES keeps a vector for each.
_SHARE, _MOST = 1 / 40, 40
#: Stiffest spring in P relative to the bodies' stiffness there; stiffer ones count as so stiff.
#: Chosen: P is a preconditioner, so that no solution depends on it.
_STIFFEST = 1e4


class NewtonMatrix:
    """Context of PETSc's Python matrix: y = A K x + B x.

    Args:
        K: Stiffness in x.
        numbers: Local numbers of the pairs' entries, (n, gdim).
        fixed: Local numbers of entries that are held at zero.

    Attributes:
        A: Blocks that combine the rows of K, (n, gdim, gdim).
        B: Blocks that are added, (n, gdim, gdim).
    """

    def __init__(self, K: PETSc.Mat, numbers: np.ndarray, fixed: np.ndarray):
        self.K, self.numbers, self.fixed = K, numbers, fixed
        n, gdim = numbers.shape
        self.A, self.B = np.tile(np.eye(gdim), (n, 1, 1)), np.zeros((n, gdim, gdim))

    def mult(self, mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """PETSc's product."""
        self.K.mult(x, y)
        rows, at = y.array_r[self.numbers], x.array_r[self.numbers]
        y.array[self.numbers] = _times(self.A, rows) + _times(self.B, at)
        y.array[self.fixed] = x.array_r[self.fixed]

    def matrix(self) -> PETSc.Mat:
        """The PETSc matrix of this context. Collective."""
        J = PETSc.Mat().createPython(self.K.getSizes(), self, comm=self.K.comm)
        J.setUp()
        return J


class NewtonPreconditioner:
    """Context of PETSc's Python preconditioner: known entries, then P.

    It outlives single solutions, and so does its factorisation.

    Args:
        K: Stiffness in x.
        fixed: Local numbers of entries that are held at zero.
        prefix: Options prefix of the KSP that solves with P.
        options: PETSc options of that KSP, without prefix.
        multigrid: What a cycle for P, instead of its factorisation, is made from; None for
            that.

    Attributes:
        ksp: PETSc's solver with P.
        factorisations: How often P was made.
        solves: How often it was used.
    """

    def __init__(
        self,
        K: Stiffness,
        fixed: np.ndarray,
        prefix: str,
        options: Mapping[str, object],
        multigrid: ContactMultigrid | None = None,
    ):
        self.K, self.fixed, self.P = K, fixed, K.A
        self.options, self.multigrid = dict(options), multigrid
        self._work, self._known = self.P.createVecs()
        self._state: np.ndarray | None = None
        self.factorisations = self.solves = self._before = 0
        self.ksp = PETSc.KSP().create(self.P.comm)
        self.ksp.setOptionsPrefix(prefix)

    def setUp(self, pc: PETSc.PC) -> None:
        """Take the blocks of the Newton matrix, and make P anew where it is too far from them."""
        matrix = pc.getOperators()[0].getPythonContext()
        self.numbers, self.A, self.B = matrix.numbers, matrix.A, matrix.B
        self.held = ~self.A.any(axis=2)
        self._invert()
        state = np.where(self.held, -1, np.einsum("nii->ni", self.springs) > 0)
        slow = self.solves - self._before > 2 * _MOST
        self._before = self.solves
        if self._state is None or slow:
            changed = np.inf
        else:
            local = int(np.sum(np.any(state != self._state, axis=1)))
            changed = self.P.comm.tompi4py().allreduce(local, op=MPI.SUM)
        most = min(_MOST, _SHARE * self.P.getSize()[0] ** (2 / 3))
        if changed > (most if self.multigrid is None else 0):  # a cycle is cheap to make
            self._factorise(state)

    def _invert(self) -> None:
        """Inverses of A, normal and tangents apart, zero where held; symmetric parts of A^-1 B."""
        self.inverse, self.springs = np.zeros_like(self.A), np.zeros_like(self.A)
        diagonal = self.K.diagonal.array_r[self.numbers]
        for part in (np.s_[0:1], np.s_[1:]):
            free = np.flatnonzero(~self.held[:, part].any(axis=1))
            A, B = self.A[free, part, part], self.B[free, part, part]
            # No spring may be stiffer than a multiple of the bodies: A + e B instead of A.
            stiffest = _STIFFEST * diagonal[free, part].max(axis=1)
            inverse = np.linalg.inv(A + B / stiffest[:, None, None])
            springs = inverse @ B
            self.inverse[free, part, part] = inverse
            self.springs[free, part, part] = 0.5 * (springs + springs.transpose(0, 2, 1))

    def _factorise(self, state: np.ndarray) -> None:
        held = np.concatenate([self.fixed, self.numbers[self.held]])
        self.K.hold(held, self.numbers, self.springs)
        self.P.setOption(PETSc.Mat.Option.SPD, True)
        if self.multigrid is None:
            self._set_up()
        else:
            self._make_cycle()
        self._state = state
        self.factorisations += 1

    def _set_up(self) -> None:
        """Factorise P; with more work space, or as an indefinite matrix, if it fails."""
        reasons = PETSc.PC.FailedReason
        for slack in (None, 100, 300):
            more = {} if slack is None else {"mat_mumps_icntl_14": slack}
            with petsc_defaults(self.ksp.getOptionsPrefix(), self.options | more):
                self.ksp.setFromOptions()
                self.ksp.setOperators(self.P)
                self.ksp.setUp()
            reason = self.ksp.getPC().getFailedReason()
            if reason == reasons.NOERROR:
                return
            if reason != reasons.FACTOR_OUTMEMORY:
                self.P.setOption(PETSc.Mat.Option.SPD, False)
                self.P.setOption(PETSc.Mat.Option.SYMMETRIC, True)
            self.ksp.getPC().reset()  # PETSc keeps the error with the factor

    def _make_cycle(self) -> None:
        """A multigrid cycle for P, whose corrections leave alone what is held, or nearly so."""
        springs = np.einsum("nii->ni", self.springs)
        stiff = self.held | (springs > self.K.diagonal.array_r[self.numbers])
        with petsc_defaults(self.ksp.getOptionsPrefix(), CYCLE | self.options):
            self.ksp.setOperators(self.P)
            self.ksp.getPC().setType("mg")
            held = np.concatenate([self.fixed, self.numbers[stiff]])
            self.multigrid.attach(self.ksp.getPC(), self.K, held)
            self.ksp.setFromOptions()
            self.ksp.setUp()

    def apply(self, pc: PETSc.PC, r: PETSc.Vec, z: PETSc.Vec) -> None:
        """PETSc's application: z with P z = r up to what P leaves out."""
        known, work = self._known, self._work
        known.set(0.0)
        right = r.array_r[self.numbers]
        held, at = self.held, np.zeros(self.numbers.shape)
        at[held] = right[held] / np.einsum("nii->ni", self.B)[held]
        known.array[self.numbers] = at
        self.K.near.mult(known, work)
        work.aypx(-1.0, r)
        # Rows of K d = A^-1 (F - B d_known) - K d_known.
        rows = _times(self.inverse, right - _times(self.B, at))
        own = (work.array_r - r.array_r)[self.numbers] + rows
        work.array[self.numbers] = np.where(held, 0.0, own)
        self.ksp.solve(work, z)
        z.array[self.numbers[held]] = at[held]
        z.array[self.fixed] = r.array_r[self.fixed]
        self.solves += 1

    def destroy(self, pc: PETSc.PC | None = None) -> None:
        """Free nothing with a single PC: the factorisation serves the next solution."""

    def free(self) -> None:
        """Free the factorisation of P. Collective."""
        for owned in (self.ksp, self._work, self._known):
            owned.destroy()


def _times(blocks: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    return np.einsum("nij,nj->ni", blocks, vectors)
