"""The lowest modes of a structure without a factorisation: LOBPCG with multigrid.

``M x = theta A x`` with ``A = K - shift M``, ``theta = 1 / (lambda - shift)``, largest theta first:
A is positive definite, so M may be singular. Knyazev's locally optimal block method (SIAM J. Sci.
Comput. 23, 2001) in the inner product of A, on eight columns, whose products take each matrix once
(`fenics_joints.modal.blocks`). Modes that have converged are locked: they leave the columns, and
everything else is kept M-orthogonal to them. The next columns come from the same basis. So the
memory beyond the modes themselves does not grow with their number. Rigid-body motions that K does
not resist are known beforehand; they are found exactly and locked at once, since A's
near-singularity would magnify round-off along them.

K is kept as the upper half of its blocks of one node's DOFs, M as a number for each pair of nodes;
A is neither made nor kept. The preconditioner is `fenics_joints.modal.multigrid`.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from fenics_joints.errors import ConvergenceError, InputError, items, real, whole
from fenics_joints.machine.memory import give_back
from fenics_joints.modal.blocks import WIDTH, Mass, SymmetricBlocks
from fenics_joints.modal.eigensolver import EigenResult
from fenics_joints.modal.multigrid import (
    Multigrid,
    StiffJoints,
    conjugate_gradients,
    structure_motions,
)
from fenics_joints.modal.options import given_options
from fenics_joints.structure.sparse import vectors_like
from fenics_joints.structure.structure import Structure

#: A rigid motion's forces, relative to the diagonal of K: round-off is 1e-13, a spring of 1 N/m on
#: a steel part 1e-9.
_NO_FORCE = 1e-11
#: Eigenvalue of the scaled Gram matrix, relative to the largest, of a direction that is in the
#: basis twice.
_DEPENDENT = 1e-12
#: Rows that are combined at once, in place: chosen.
_ROWS = 8192


class IterativeEigenSolver:
    """LOBPCG for a structure's modes; keeps its multigrid hierarchy on the mesh.

    Args:
        n: Number of modes wanted, rigid-body modes included.
        shift: Shift in (rad/s)^2, below zero.
        tol: Relative error of the shapes in the norm of A, by ``r^T B r`` of the residual r and
            the preconditioner B; an eigenvalue's is of the order of its square.
        max_iterations: Iterations before ConvergenceError.
        petsc_options: PETSc options of the preconditioner's degree 1, see
            `fenics_joints.modal.multigrid.Multigrid`.

    Raises:
        InputError: A value is out of range.
    """

    def __init__(
        self,
        n: int,
        *,
        shift: float,
        tol: float = 1e-6,
        max_iterations: int = 200,
        petsc_options: Mapping[str, object] | None = None,
    ):
        n = whole("n", n)
        if not real("shift", shift, "(rad/s)^2") < 0.0:
            raise InputError(f"shift is {shift}: expected a number below zero")
        real("tol", tol, above=0, most=1e-2)
        whole("max_iterations", max_iterations)
        self.n, self.shift, self.tol = int(n), float(shift), float(tol)
        self.max_iterations = int(max_iterations)
        self.petsc_options = given_options(petsc_options)
        self._multigrid: Multigrid | None = None
        self._op: _Operators | None = None
        self._rigid: np.ndarray | None = None

    @property
    def solver(self) -> PETSc.KSP | None:
        """What the preconditioner solves degree 1 with (None before the first solve)."""
        return None if self._multigrid is None else self._multigrid.solver

    def solve(
        self,
        structure: Structure,
        given: Mapping[str, float] | None = None,
        initial: Sequence[PETSc.Vec] | None = None,
    ) -> EigenResult:
        """Return the n lowest eigenpairs. Collective.

        Args:
            structure: The structure.
            given: Values of parameters that differ from their nominal value.
            initial: Approximate shapes to start from.

        Raises:
            InputError: The structure has fewer DOFs than n.
            ConvergenceError: Fewer than n modes converged.
        """
        if self.n > structure.n_dofs:
            raise InputError(f"n is {self.n}: the structure has {structure.n_dofs} DOFs only")
        initial = items("initial", initial or (), PETSc.Vec, "PETSc's vectors")
        begin = time.perf_counter()
        self._set_up(structure, given)
        op = self._op
        Y = op.M_orthonormal(self._rigid)
        more = self.n - Y.shape[1]
        values, X = np.zeros(min(self.n, Y.shape[1])), Y[:, : self.n]
        steps = 0
        if more > 0:
            start = _columns(initial[-more:], structure.n_local)
            theta, X, steps = _lobpcg(op, Y, start, more, self.tol, self.max_iterations)
            order = np.argsort(-theta)
            values = np.concatenate([values, self.shift + 1.0 / theta[order]])
            X[:, -more:] = X[:, -more:][:, order]
        residuals = self._residuals(op, values, X)
        if not np.all(residuals <= max(1e3 * self.tol, 1e-6)):
            raise ConvergenceError(
                f"the true residual of mode {int(np.argmax(residuals)) + 1} is "
                f"{residuals.max():.1e}: the preconditioner is not one of K - shift M"
            )
        stats = {
            "method": "LOBPCG",
            "seconds": time.perf_counter() - begin,
            "iterations": steps,
            "preconditioner_applications": op.applications,
        }
        imap, bs = structure.V.dofmap.index_map, structure.V.dofmap.index_map_bs
        like = PETSc.Vec().createMPI((imap.size_local * bs, None), bs, structure.comm)
        found = vectors_like(like, X.T)
        like.destroy()
        return EigenResult(values, found, residuals, stats)

    def _set_up(self, structure, given) -> None:
        """Matrices in blocks, one after the other, so that one whole one exists at once."""
        if self._multigrid is None or self._multigrid.structure is not structure:
            self.destroy()
            self._multigrid = Multigrid(structure, self.petsc_options)
        self._free_matrices()
        size = structure.gdim
        whole = structure.mass(given)
        M = Mass(whole, structure.held_dofs[: structure.n_local], size)
        stiff = StiffJoints.rows(structure)
        any_stiff = structure.comm.allreduce(bool(stiff.any()), op=MPI.LOR)
        own = StiffJoints.own(stiff, whole) if any_stiff else None
        whole.destroy()
        give_back()
        whole = structure.stiffness(given)
        K = SymmetricBlocks(whole, size)
        joints = StiffJoints(stiff, whole, own, self.shift) if any_stiff else None
        whole.destroy()
        give_back()
        self._op = _Operators(K, M, self.shift, self._multigrid)
        self._rigid = _unresisted(self._op, structure_motions(structure))
        self._multigrid.set_up(K, given, self.shift, joints)
        give_back()

    def inverse(self, block: np.ndarray) -> np.ndarray:
        """``(K - shift M)^-1 block`` by conjugate gradients to 1e-10. Collective.

        Args:
            block: This rank's rows of the right-hand sides, shape (n_local, n_columns).

        Raises:
            InputError: Before the first solution.
            ConvergenceError: The gradients did not converge.
        """
        if self._op is None:
            raise InputError("the solver has no preconditioner yet: expected a solution first")
        op = self._op
        Y = op.M_orthonormal(self._rigid)
        MY = op.mass(Y)
        weights = op.dot(Y, block)
        found = op.panels(
            lambda B: conjugate_gradients(op, self._multigrid, B, 500, 1e-10), block - MY @ weights
        )
        return found - Y @ op.dot(MY, found) + Y @ weights / -self.shift

    def _residuals(self, op: _Operators, values, X) -> np.ndarray:
        """Relative residuals as in EigenResult."""
        diagonal = op.K.diagonal - self.shift * op.M.diagonal
        squares = np.empty(len(values))
        for at in range(0, len(values), WIDTH):
            some = slice(at, at + WIDTH)
            r = op.panels(op.K.__matmul__, X[:, some]) - op.mass(X[:, some]) * values[some]
            squares[some] = np.sum(r**2 / diagonal[:, None], axis=0)
        return np.sqrt(op.comm.allreduce(squares, op=MPI.SUM) / (values - self.shift))

    def _free_matrices(self) -> None:
        if self._op is not None:
            self._op.K.destroy()
            self._op.M.destroy()
        self._op = None

    def destroy(self) -> None:
        """Free everything. Collective; on several ranks Python's collector cannot do it."""
        if self._multigrid is not None:
            self._multigrid.destroy()
        self._multigrid = None
        self._free_matrices()


class _Operators:
    """A = K - shift M, M and the preconditioner on this rank's rows of blocks of columns."""

    def __init__(self, K: SymmetricBlocks, M: Mass, shift: float, multigrid: Multigrid):
        self.K, self.M, self.shift, self._multigrid = K, M, shift, multigrid
        self.comm = K.comm
        self.applications = 0

    def panels(self, operation, X: np.ndarray) -> np.ndarray:
        """An operation on eight columns, on any number of them."""
        out = np.empty(X.shape)
        for at in range(0, X.shape[1], WIDTH):
            some = X[:, at : at + WIDTH]
            padded = np.zeros((len(X), WIDTH))
            padded[:, : some.shape[1]] = some
            out[:, at : at + WIDTH] = operation(padded)[:, : some.shape[1]]
        return out

    def __matmul__(self, X):
        """A X of eight columns."""
        return self.both(X)[0]

    def both(self, X):
        """A X and M X of eight columns."""
        AX, MX = self.K @ X, self.M @ X
        AX -= self.shift * MX
        return AX, MX

    def mass(self, X):
        """M X."""
        return self.M @ X

    def precondition(self, R):
        """The multigrid's solutions for eight right-hand sides."""
        self.applications += R.shape[1]
        return self._multigrid(R)

    def dot(self, left, right) -> np.ndarray:
        """left^T right."""
        return self.comm.allreduce(left.T @ right, op=MPI.SUM)

    def M_orthonormal(self, Y: np.ndarray) -> np.ndarray:
        """M-orthonormal basis of the motions that have mass."""
        s, Q = np.linalg.eigh(self.dot(Y, self.mass(Y)))
        good = s > 1e-12 * s.max(initial=0.0)
        return Y @ (Q[:, good] / np.sqrt(s[good]))


def _columns(initial: Sequence[PETSc.Vec], rows: int) -> np.ndarray:
    """Given shapes as columns, (n_local, k)."""
    for vector in initial:
        if vector.getLocalSize() != rows:
            raise InputError(f"an initial shape has {vector.getSize()} rows: expected this model's")
    return np.array([vector.array_r for vector in initial]).reshape(len(initial), rows).T


def _unresisted(op: _Operators, R: np.ndarray) -> np.ndarray:
    """Combinations of the rigid motions R that K does not resist, as columns; none if held.

    By the singular values of the forces over the diagonal of K: a spring at one point shows,
    however stiff the body.
    """
    diagonal = np.maximum(np.abs(op.K.diagonal), np.finfo(float).tiny)
    forces = op.panels(op.K.__matmul__, R) / diagonal[:, None]
    parts = op.comm.allgather(np.linalg.qr(forces, mode="r"))
    _, s, Vt = np.linalg.svd(np.vstack(parts))
    s = np.concatenate([s, np.zeros(R.shape[1] - len(s))])
    n = op.comm.allreduce(R.shape[0], op=MPI.SUM)
    free = s <= _NO_FORCE * max(1.0, np.sqrt(n / 1e5))
    return R @ Vt[free].T


def _lobpcg(op: _Operators, Y, given, n: int, tol: float, max_iterations: int):
    """Largest n theta of ``M x = theta A x`` beside Y; returns (theta, Y and X, iterations).

    Args:
        op: The operators.
        Y: M-orthonormal motions to leave out.
        given: Columns to start from, (n_local, k).
        n: Number of eigenpairs.
        tol: See `IterativeEigenSolver`.
        max_iterations: Limit.

    Raises:
        ConvergenceError: Fewer converged, or something was not finite.
    """
    locked = _Locked(op, Y, n)
    X, spare = _start(op, locked, given), given[:, WIDTH:]
    P, W = ([np.zeros_like(X[0]) for _ in range(3)] for _ in range(2))
    for step in range(1, max_iterations + 1):
        wanted = n - locked.n
        theta, *C = _ritz(op, (X, P, W))
        if np.count_nonzero(theta) < min(wanted, WIDTH):
            exist = locked.n + np.count_nonzero(theta)
            raise ConvergenceError(f"{exist} of {n} elastic modes exist: M has no more rank")
        _advance(X, P, W, C)
        R = np.multiply(X[1], -theta, out=W[1])
        R += X[2]
        locked.leave_forces(R)
        W[0] = op.precondition(R)
        errors = op.comm.allreduce(np.einsum("ij,ij->j", R, W[0]), op=MPI.SUM)
        if not np.all(np.isfinite(errors)):
            raise ConvergenceError("the preconditioner's result was not finite")
        errors = np.sqrt(np.abs(errors)) / np.maximum(theta, np.finfo(float).tiny)
        done = int(np.argmin(np.append(errors[:wanted] <= tol, False)))
        if done == wanted:
            locked.add(X, theta, done)
            return locked.theta, locked.X, step
        for block in (*P, W[0]):
            block[:, errors <= tol] = 0.0
        if done:
            change = op.dot(X[1][:, :done], P[0])
            for x, p in zip(X, P, strict=True):
                p -= x[:, :done] @ change
            locked.add(X, theta, done)
            for x in X:
                x[:, :done] = 0.0
            count = min(done, spare.shape[1])
            W[0][:, :count], spare = spare[:, :count], spare[:, count:]
        locked.leave(W[0])
        W[0] -= X[0] @ op.dot(X[1], W[0])
        lengths = np.sqrt(op.comm.allreduce(np.einsum("ij,ij->j", W[0], W[0]), op=MPI.SUM))
        W[0] /= np.where(lengths > 0.0, lengths, 1.0)
        W[1], W[2] = op.both(W[0])
    done = locked.n + int(np.sum(errors[:wanted] <= tol))
    raise ConvergenceError(
        f"{done} of {n} elastic modes converged in {max_iterations} iterations",
        f"largest error {errors[:wanted].max():.1e}, asked {tol:.1e}: allow more iterations, or "
        "take the direct method",
    )


class _Locked:
    """Modes that have been found, rigid ones first, M-orthonormal."""

    def __init__(self, op: _Operators, Y: np.ndarray, n: int):
        self._op, self._rigid, self.n = op, Y.shape[1], 0
        self.X, self._MX = (np.zeros((len(Y), Y.shape[1] + n), order="F") for _ in range(2))
        self.X[:, : self._rigid] = Y
        self._MX[:, : self._rigid] = op.mass(Y)
        self.theta = np.empty(0)

    def add(self, X, theta: np.ndarray, count: int) -> None:
        """Lock the first columns of a group, A-orthonormal."""
        at = self._rigid + self.n
        more = slice(at, at + count)
        self.X[:, more] = X[0][:, :count] / np.sqrt(theta[:count])
        self._MX[:, more] = X[2][:, :count] / np.sqrt(theta[:count])
        self.theta = np.append(self.theta, theta[:count])
        self.n += count

    def leave(self, W: np.ndarray) -> None:
        """Make columns M-orthogonal to the modes, in place."""
        have = slice(self._rigid + self.n)
        W -= self.X[:, have] @ self._op.dot(self._MX[:, have], W)

    def leave_forces(self, R: np.ndarray) -> None:
        """Make forces orthogonal to the rigid motions, in place."""
        have = slice(self._rigid)
        R -= self._MX[:, have] @ self._op.dot(self.X[:, have], R)


def _start(op: _Operators, locked: _Locked, given: np.ndarray) -> list[np.ndarray]:
    """Starting columns with their products: the given ones and smoothed noise."""
    count = min(given.shape[1], WIDTH)
    X = np.zeros((len(given), WIDTH))
    if count < WIDTH:
        rng = np.random.default_rng([op.comm.rank, 2001])
        X[:, count:] = op.mass(rng.standard_normal((len(X), WIDTH - count)))
        locked.leave_forces(X)
        X = op.precondition(X)
    X[:, :count] = given[:, :count]
    locked.leave(X)
    return [X, *op.both(X)]


def _ritz(op: _Operators, groups):
    """Rayleigh-Ritz in the span of groups: theta and coefficients of each group's columns.

    Where the span has fewer directions than a group has columns, theta and coefficients are zero.
    """
    size = len(groups) * WIDTH
    both = np.zeros((2, size, size))
    for i, left in enumerate(groups):
        for j, right in enumerate(groups[i:], start=i):
            at = slice(i * WIDTH, (i + 1) * WIDTH), slice(j * WIDTH, (j + 1) * WIDTH)
            for k in range(2):
                both[k][at] = left[0].T @ right[k + 1]
    both = op.comm.allreduce(both, op=MPI.SUM)
    if not np.all(np.isfinite(both)):
        raise ConvergenceError("K or M times a vector was not finite: is a NaN in K or M?")
    G, H = (np.triu(A) + np.triu(A, 1).T for A in both)
    diagonal = np.diag(G)
    d = np.where(diagonal > 0.0, 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0)), 0.0)
    G, H = (A * np.outer(d, d) for A in (G, H))
    s, Q = np.linalg.eigh(G)
    good = s > _DEPENDENT * s[-1]
    T = Q[:, good] / np.sqrt(s[good])
    found, Z = np.linalg.eigh(T.T @ H @ T)
    keep = np.flatnonzero(found > 1e-14 * found[-1])[::-1][:WIDTH]
    theta, C = np.zeros(WIDTH), np.zeros((size, WIDTH))
    theta[: len(keep)] = found[keep]
    C[:, : len(keep)] = d[:, None] * (T @ Z[:, keep])
    return theta, *np.split(C, len(groups))


def _advance(X, P, W, C) -> None:
    """The Ritz vectors and their last change, each with its products by A and M, in place."""
    for at in range(0, len(X[0]), _ROWS):
        rows = slice(at, at + _ROWS)
        for x, p, w in zip(X, P, W, strict=True):
            step = p[rows] @ C[1]
            step += w[rows] @ C[2]
            x[rows] = x[rows] @ C[0] + step
            p[rows] = step
