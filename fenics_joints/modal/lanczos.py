"""Block Lanczos for A^-1 M in the inner product of M, on blocks of local columns."""

from __future__ import annotations

import time

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc
from scipy.linalg import eigh

from fenics_joints.errors import ConvergenceError
from fenics_joints.modal.options import reason_of
from fenics_joints.structure.sparse import dense_block, without_zeros

#: Share of the largest energy below which a combination of a block and its image is round-off.
_DEPENDENT = 1e-12


class Operator:
    """``X -> (A^-1 X, M X)`` on blocks of local columns, shape (local rows, columns)."""

    def __init__(self, ksp: PETSc.KSP, M: PETSc.Mat):
        self._ksp, self._mass = ksp, without_zeros(M)
        self.comm = M.comm.tompi4py()
        self.calls = self.columns = 0
        self.seconds = 0.0
        self._work: dict[int, tuple[PETSc.Mat, PETSc.Mat, PETSc.Mat]] = {}

    def _buffers(self, columns: int):
        if columns not in self._work:
            right, left = dense_block(self._mass, columns), dense_block(self._mass, columns)
            self._work[columns] = (right, left, self._mass.matMult(left))
        return self._work[columns]

    def solve(self, block: np.ndarray) -> np.ndarray:
        right, left, _ = self._buffers(block.shape[1])
        right.getDenseArray()[:] = block
        begin = time.perf_counter()
        self._ksp.matSolve(right, left)
        self.seconds += time.perf_counter() - begin
        if self._ksp.getConvergedReason() < 0:
            reason = reason_of(self._ksp)
            raise ConvergenceError("the linear solve with K - shift M failed", reason)
        self.calls += 1
        self.columns += block.shape[1]
        return left.getDenseArray().copy(order="F")

    def mass(self, block: np.ndarray) -> np.ndarray:
        _, left, product = self._buffers(block.shape[1])
        left.getDenseArray()[:] = block
        self._mass.matMult(left, result=product)
        return product.getDenseArray().copy(order="F")

    def dot(self, left: np.ndarray, right: np.ndarray) -> np.ndarray:
        return self.comm.allreduce(left.conj().T @ right, op=MPI.SUM)

    def destroy(self) -> None:
        # By hand: left to Python's collector, matrices on several ranks die in no common order.
        for mats in self._work.values():
            for mat in mats:
                mat.destroy()
        self._work = {}
        self._mass.destroy()


def lanczos(op: Operator, start, n: int, tol: float, largest: int, max_restarts: int):
    """Block Lanczos for ``A^-1 M``, largest eigenvalues first; returns (theta, X, basis size).

    The recurrence starts from ``A^-1 M start``, which has no part in the null space of M.
    """
    W = op.solve(op.mass(start))
    W, MW, _ = _orthonormalise(op, W, op.mass(W), 0.0)
    if W.shape[1] == 0:
        raise ConvergenceError(f"0 of {n} modes exist: M is zero")
    rows, room = W.shape[0], largest + W.shape[1]
    V = np.empty((rows, room), dtype=W.dtype, order="F")
    MV = np.empty_like(V)
    T = np.zeros((room, room), dtype=W.dtype)
    k = restarts = 0
    while True:
        w = W.shape[1]
        k, last = k + w, slice(k, k + w)
        V[:, last], MV[:, last] = W, MW
        W = op.solve(MW)
        T[:k, last] = _project(op, V[:, :k], MV[:, :k], W)
        T[last, :k] = T[:k, last].conj().T
        theta, Y = _eigh(T[:k, :k])
        theta, Y = theta[::-1], Y[:, ::-1]
        W, MW, R = _orthonormalise(op, W, op.mass(W), theta[0], V[:, :k], MV[:, :k])
        residuals = np.linalg.norm(R @ Y[last], axis=0)
        converged = int(np.sum(np.cumprod(residuals[:n] <= tol * theta[:n])))
        if converged == n:
            _check_spread(theta[:n])
            return theta[:n], V[:, :k] @ Y[:, :n], k
        if W.shape[1] == 0:
            _check_spread(theta)
            raise ConvergenceError(f"{converged} of {n} modes exist: M has rank {k} only")
        if k + W.shape[1] > largest:
            if restarts == max_restarts:
                _check_spread(theta[:n])
                raise ConvergenceError(
                    f"{converged} of {n} modes converged after {restarts} restarts",
                    "restarts exhausted: allow a larger basis, or more restarts",
                )
            restarts += 1
            keep = min(n + w // 2, k - 1)
            V[:, :keep], MV[:, :keep] = V[:, :k] @ Y[:, :keep], MV[:, :k] @ Y[:, :keep]
            T[:] = 0.0
            T[range(keep), range(keep)] = theta[:keep]
            k = keep


def _eigh(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues and vectors of a symmetric matrix.

    The divide and conquer of LAPACK ends without a result for a few matrices on some processors;
    the QR algorithm is slower and does not.
    """
    try:
        return np.linalg.eigh(matrix)
    except np.linalg.LinAlgError:
        return eigh(matrix, driver="ev")


def refined(op: Operator, image: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rayleigh-Ritz for ``A^-1 M`` on a block X and A^-1 M X; (theta, vectors), largest first.

    Args:
        op: The operator.
        image: A X, (local rows, k).
        start: X, likewise.
    """
    MX = op.mass(start)
    # Not A^-1 M X itself, which is nearly X, but how it differs: round-off stays small beside it.
    R = MX - image * (np.diag(op.dot(start, MX)) / np.diag(op.dot(start, image)))
    W = op.solve(R)
    both, by_A, by_M = np.hstack([start, W]), np.hstack([image, R]), np.hstack([MX, op.mass(W)])
    stiff, heavy = op.dot(both, by_A), op.dot(both, by_M)
    size = np.sqrt(np.maximum(np.diag(stiff), np.finfo(float).tiny))
    stiff, heavy = (0.5 * (a + a.T) / np.outer(size, size) for a in (stiff, heavy))
    energy, Q = _eigh(stiff)
    kept = energy > _DEPENDENT * energy[-1]
    Q = Q[:, kept] / np.sqrt(energy[kept])
    theta, Y = _eigh(Q.T @ heavy @ Q)
    count = min(start.shape[1], len(theta))
    theta, Y = theta[::-1][:count], Y[:, ::-1][:, :count]
    _check_spread(theta)
    return theta, both @ (Q @ Y / np.sqrt(theta) / size[:, None])


def _project(op: Operator, V, MV, W) -> np.ndarray:
    """Make W M-orthogonal to V in place, twice; returns the coefficients."""
    total = 0.0
    for _ in range(2):
        H = op.dot(MV, W)
        W -= V @ H
        total = total + H
    return total


def _orthonormalise(op: Operator, W, MW, scale: float, V=None, MV=None):
    """M-orthonormal basis Q of span(W) with M Q and R, W = Q R; columns at round-off are dropped.

    Two passes of SVQB (Stathopoulos and Wu, SIAM J. Sci. Comput. 23, 2002); between them Q is made
    orthogonal to V again, since normalising a short column magnifies what is left of V in it.
    """
    R = np.eye(W.shape[1], dtype=W.dtype)
    for sweep in range(2):
        gram = op.dot(W, MW)
        if not np.all(np.isfinite(gram)):
            raise ConvergenceError("a solve with K - shift M was not finite: is a NaN in K or M?")
        norms = np.sqrt(np.maximum(np.real(np.diag(gram)), 0.0))
        floor = max(1e-14 * scale, np.finfo(float).tiny)
        live = norms > floor
        d = np.where(live, norms, 1.0)
        s, Q = _eigh((gram / np.outer(d, d))[np.ix_(live, live)])
        good = s > 1e-13 * max(s.max(initial=0.0), 1e-300)
        s, Q = s[good], Q[:, good]
        back = np.zeros((W.shape[1], s.size), dtype=W.dtype)
        back[live] = Q / np.sqrt(s) / d[live, None]
        forth = np.zeros((s.size, W.shape[1]), dtype=W.dtype)
        forth[:, live] = (np.sqrt(s) * Q.conj()).T * d[live]
        W, MW, R = W @ back, MW @ back, forth @ R
        if sweep == 0 and V is not None and s.size:
            H = op.dot(MV, W)
            W, MW = W - V @ H, MW - MV @ H
        scale = 0.0
    return W, MW, R


def _check_spread(theta: np.ndarray) -> None:
    """Raise when the shift is so near an eigenvalue that round-off hides the others."""
    if theta[-1] <= 0.0 or theta[0] > 1e10 * theta[-1]:
        raise ConvergenceError(
            "K - shift M is nearly singular: take a shift further below zero",
            f"1 / (lambda - shift) spreads from {theta[-1]:.1e} to {theta[0]:.1e}",
        )
