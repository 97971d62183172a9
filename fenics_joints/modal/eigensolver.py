"""The lowest eigenpairs of ``K x = lambda M x`` for assembled PETSc matrices.

Purely algebraic: nothing here knows of meshes or joints. ``K`` and ``M`` are symmetric positive
semi-definite; ``M`` may be singular (massless DOFs: zero-density layers, constrained DOFs).

The default method is shift-and-invert block Lanczos in the M inner product, with full
reorthogonalisation and thick restart (Grimes, Lewis and Simon, SIAM J. Matrix Anal. Appl. 15, 1994,
eqs. 2.3-2.6; Wu and Simon, SIAM J. Matrix Anal. Appl. 22, 2000). SLEPc has no block Krylov method,
and a sparse triangular solve is bound by memory, not arithmetic: one with sixteen right-hand sides
costs about twice one with a single one. A block also finds every copy of an eigenvalue up to its
width, so the six rigid-body zeros or the pairs of a symmetric structure are not lost, where
single-vector Lanczos finds the second copy only through round-off. Any SLEPc solver can take its
place: ``petsc_options={"eps_type": "krylovschur"}``.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc
from scipy.linalg import eigh
from slepc4py import SLEPc

from fenics_joints.errors import ConvergenceError, InputError, items, real, whole
from fenics_joints.modal.options import (
    give_room,
    given_options,
    petsc_defaults,
    reason_of,
    say_unused,
)
from fenics_joints.structure.sparse import dense_block, product, vectors_like, without_zeros

#: Default shift in rad^2/s^2: 50 Hz below zero, for metal parts with modes from 10 Hz to 20 kHz.
DEFAULT_SHIFT = -((2.0 * np.pi * 50.0) ** 2)

_OPTIONS = {
    "st_ksp_type": "preonly",
    "st_pc_type": "cholesky",
    "st_pc_factor_mat_solver_type": "mumps",
    # Slack in MUMPS's work space, per cent: its own 5 is too little on several ranks.
    "st_mat_mumps_icntl_14": "30",
}
#: Steps of inverse iteration by which modes are refined.
_STEPS = 2
#: Share of the largest energy below which a combination of a block and its image is round-off.
_DEPENDENT = 1e-12


@dataclass(frozen=True, repr=False)
class EigenResult:
    """Eigenpairs of a pencil.

    Attributes:
        values: Eigenvalues, ascending, shape (n,); rad^2/s^2 for SI matrices.
        shapes: The n eigenvectors, M-orthonormal, laid out like the rows of K.
        residuals: Relative residuals, shape (n,): ``|K x - lambda M x|`` over ``|x|_A``, the first
            in the norm of the inverse diagonal of ``A = K - shift M``. Unlike the 2-norm it is
            not swamped by the round-off of stiff thin layers.
        statistics: ``method``, ``seconds`` and ``basis``; from block Lanczos also ``solves``
            (right-hand sides) and ``block_solves``; from SLEPc ``restarts``.
        round_off: Bound of each eigenvalue's round-off, shape (n,): the unit round-off times
            x^T D x with D the diagonal of K; that of a layer of a micrometre is large.
    """

    values: np.ndarray
    shapes: list[PETSc.Vec]
    residuals: np.ndarray
    statistics: dict[str, float | int | str] = field(default_factory=dict)
    round_off: np.ndarray | float = 0.0

    def __repr__(self) -> str:
        low, high = self.values[0], self.values[-1]
        return f"EigenResult({len(self.values)} eigenvalues from {low:.5g} to {high:.5g} (rad/s)^2)"


class EigenSolver:
    """Solver for many pencils of one sparsity pattern; ordering and symbolic analysis are kept.

    Args:
        n: Number of modes wanted, rigid-body modes included.
        shift: Shift in the unit of the eigenvalues, not above zero; below zero for a free body.
        tol: Tolerance on ``|A^-1 M x - theta x|_M / theta`` with ``theta = 1 / (lambda - shift)``;
            the eigenvalue's relative error is of the order of its square.
        block: Columns solved at once; default from n.
        max_basis: Largest Krylov basis before a restart; default from n and block.
        max_restarts: Restarts before ConvergenceError.
        petsc_options: PETSc and SLEPc options without prefix, for example ``st_pc_type``,
            ``st_mat_mumps_icntl_7`` or ``eps_type`` (which hands the problem to that SLEPc solver).
        prefix: Options prefix, so that the command line can set the same options.

    Raises:
        InputError: A value is out of range.

    Attributes:
        solver: The SLEPc solver (None before the first solve); ``.solver.getST().getKSP()`` solves.
        shifted: ``A = K - shift M`` of the last solution, the solver's own; None before the first.
    """

    def __init__(
        self,
        n: int,
        *,
        shift: float = DEFAULT_SHIFT,
        tol: float = 1e-7,
        block: int | None = None,
        max_basis: int | None = None,
        max_restarts: int = 30,
        petsc_options: Mapping[str, object] | None = None,
        prefix: str = "fenics_joints_eigen_",
    ):
        n = whole("n", n)
        if not real("shift", shift, "(rad/s)^2") <= 0.0:
            raise InputError(
                f"shift is {shift}: expected zero or less, since only a shift below every "
                "eigenvalue gives the lowest modes (and below zero for a free body)"
            )
        real("tol", tol, above=0, most=1e-2)
        for key, count in (("block", block), ("max_basis", max_basis)):
            if count is not None:
                whole(key, count)
        whole("max_restarts", max_restarts, 0)
        self.n, self.shift, self.tol = int(n), float(shift), float(tol)
        self.block, self.max_basis, self.max_restarts = block, max_basis, max_restarts
        self.petsc_options, self.prefix = given_options(petsc_options), prefix
        self.solver: SLEPc.EPS | None = None
        self.shifted: PETSc.Mat | None = None
        self._pattern: tuple | None = None

    def solve(
        self, K: PETSc.Mat, M: PETSc.Mat, initial: Sequence[PETSc.Vec] | None = None
    ) -> EigenResult:
        """Return the n lowest eigenpairs.

        Args:
            K: Stiffness, symmetric positive semi-definite.
            M: Mass, symmetric positive semi-definite, same layout.
            initial: Approximate eigenvectors to start from, such as a near pencil's ``shapes``.

        Raises:
            InputError: The matrices are not a square pencil of one layout, or smaller than n.
            ConvergenceError: The factorisation failed, or fewer than n modes converged.
        """
        _check_pencil(K, M, self.n, initial)
        begin = time.perf_counter()
        with self._options(K.comm) as options:
            first = self.shifted is None
            solve = self._solve_slepc if options.hasName("eps_type") else self._solve_block
            values, X, R, stats = solve(K, M, initial)
            if first:
                say_unused(self.prefix, self.petsc_options)
        residuals = _residuals(K, M, values, R, self.shift)
        # The recurrence's own estimate decides convergence; this catches a wrong factorisation.
        if not np.all(residuals <= max(1e3 * self.tol, 1e-6)):
            raise ConvergenceError(
                f"the true residual of mode {int(np.argmax(residuals)) + 1} is "
                f"{residuals.max():.1e}: the factorisation is inaccurate; take a shift further "
                "below zero"
            )
        stats["seconds"] = time.perf_counter() - begin
        shapes = vectors_like(K.createVecRight(), X.T)
        return EigenResult(values, shapes, residuals, stats, _round_off(K, X))

    def refine(self, K: PETSc.Mat, M: PETSc.Mat, start: np.ndarray) -> EigenResult:
        """Eigenpairs near a subspace, by two steps of inverse iteration and Rayleigh-Ritz on both.

        Two blocks of solves instead of the six or seven of `solve`. By Rayleigh's principle no
        eigenvalue comes out too low. It is too high by the square of the angle between mode and
        subspace, which each step reduces. A mode that is not near the subspace is not found.

        Args:
            K: See `solve`.
            M: See `solve`.
            start: This rank's rows of the subspace, linearly independent, (n_local, k).

        Returns:
            k eigenpairs; their residuals are not known.

        Raises:
            InputError: See `solve`.
            ConvergenceError: The factorisation or the solve failed.
        """
        _check_pencil(K, M, start.shape[1], None)
        with self._options(K.comm):
            X = start
            with self._factorised(K, M) as (A, operator):
                for _ in range(_STEPS):
                    theta, X = refined(operator, product(A, X), X)
        shapes = vectors_like(K.createVecRight(), X.T)
        unknown = np.full(len(theta), np.nan)
        statistics = {"method": "inverse iteration", "solves": operator.columns}
        return EigenResult(self.shift + 1.0 / theta, shapes, unknown, statistics, _round_off(K, X))

    def factorise(self, K: PETSc.Mat, M: PETSc.Mat) -> None:
        """Factorise ``K - shift M`` alone, for `inverse`; arguments and errors as of `solve`."""
        _check_pencil(K, M, self.n, None)
        with self._options(K.comm), self._factorised(K, M):
            pass

    def inverse(self, block: np.ndarray) -> np.ndarray:
        """``(K - shift M)^-1 block`` with the last factorisation. Collective.

        Args:
            block: This rank's rows of the right-hand sides, shape (n_local, n_columns).

        Raises:
            InputError: Before the first solution.
            ConvergenceError: The linear solve failed.
        """
        if self.shifted is None:
            raise InputError("the solver has no factorisation yet: expected a solution first")
        right, left = (dense_block(self.shifted, block.shape[1]) for _ in range(2))
        found = _solved(self.solver.getST().getKSP(), right, left, block)
        right.destroy(), left.destroy()
        return found

    def destroy(self) -> None:
        """Free the factorisation. Collective; on several ranks Python's collector cannot do it."""
        for owned in (self.solver, self.shifted):
            if owned is not None:
                owned.destroy()
        self.solver = self.shifted = self._pattern = None

    @contextmanager
    def _options(self, comm) -> Iterator[PETSc.Options]:
        """The options for a while, and the SLEPc solver, made with the first of them."""
        with petsc_defaults(self.prefix, _OPTIONS, self.petsc_options) as options:
            if self.solver is None:
                self.solver = SLEPc.EPS().create(comm)
                self.solver.setOptionsPrefix(self.prefix)
                self.solver.setProblemType(SLEPc.EPS.ProblemType.GHEP)
                self.solver.getST().setType(SLEPc.ST.Type.SINVERT)
                self.solver.getST().setShift(self.shift)
            yield options

    def _shift_matrix(self, K: PETSc.Mat, M: PETSc.Mat) -> PETSc.Mat:
        """``A = K - shift M`` in the matrix of the last call, so that its analysis is kept."""
        pattern, kinds = (K.getSize(), K.getInfo()["nz_used"]), PETSc.Mat.Structure
        if pattern == self._pattern:
            more = self.shifted.getInfo()["nz_used"] > pattern[1]
            K.copy(
                self.shifted, kinds.SUBSET_NONZERO_PATTERN if more else kinds.SAME_NONZERO_PATTERN
            )
        else:
            if self.shifted is not None:
                self.solver.getST().getKSP().reset()
                self.shifted.destroy()
            self.shifted = K.duplicate(copy=True)
            self.shifted.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
        # As if M had no entry where K has none: the few that it may have are put in.
        self.shifted.axpy(-self.shift, M, kinds.SUBSET_NONZERO_PATTERN)
        self.shifted.setOption(PETSc.Mat.Option.SPD, True)
        self._pattern = pattern
        return self.shifted

    @contextmanager
    def _factorised(self, K, M) -> Iterator[tuple[PETSc.Mat, Operator]]:
        """``K - shift M``, and the operator with its factorisation for a while."""
        ksp = self.solver.getST().getKSP()
        operator = Operator(ksp, M)
        advice = (
            "K - shift M could not be factorised: is K symmetric positive semi-definite, "
            "and the shift below zero for a free body?"
        )
        try:
            A = self._shift_matrix(K, operator.lean)
            ksp.setOperators(A)
            ksp.setFromOptions()
            try:
                ksp.setUp()
                give_room(ksp)
            except PETSc.Error as error:
                self._pattern = None
                raise ConvergenceError(advice, str(error)) from error
            if ksp.getPC().getFailedReason():
                # PETSc would leave MUMPS's failed factor as it is: the next solution begins anew.
                self._pattern = None
                raise ConvergenceError(advice, reason_of(ksp.getPC()))
            yield A, operator
        finally:
            operator.destroy()

    def _solve_block(self, K, M, initial):
        size = K.getSize()[0]
        block = min(self.block or _default_block(self.n, initial), size)
        largest = min(max(self.max_basis or 0, self.n + 6 * block), size)
        start = _start(M, block, initial)
        with self._factorised(K, M) as (A, operator):
            args = operator, start, self.n, self.tol, largest, self.max_restarts
            theta, X, basis = lanczos(*args)
            R = product(A, X) - operator.mass(X) / theta
        stats = {
            "method": "block Lanczos",
            "solves": operator.columns,
            "block_solves": operator.calls,
            "basis": basis,
        }
        return self.shift + 1.0 / theta, X, R, stats

    def _solve_slepc(self, K, M, initial):
        eps = self.solver
        eps.setOperators(K, M)
        eps.setDimensions(self.n)
        eps.setTolerances(self.tol, 1000)
        eps.setWhichEigenpairs(SLEPc.EPS.Which.TARGET_MAGNITUDE)
        eps.setTarget(self.shift)
        if initial:
            eps.setInitialSpace(list(initial))
        eps.setFromOptions()
        try:
            eps.solve()
        except PETSc.Error as error:
            raise ConvergenceError("SLEPc could not solve K x = lambda M x", str(error)) from error
        found = eps.getConverged()
        if found < self.n:
            raise ConvergenceError(f"{found} of {self.n} modes converged", reason_of(eps))
        values = np.array([np.real(eps.getEigenvalue(i)) for i in range(self.n)])
        order = np.argsort(values)
        X = np.empty((K.getLocalSize()[0], self.n), dtype=PETSc.ScalarType, order="F")
        x, Mx = K.createVecs()
        for column, i in enumerate(order):
            eps.getEigenvector(int(i), x)
            M.mult(x, Mx)
            X[:, column] = x.array_r / np.sqrt(np.real(x.dot(Mx)))
        stats = {
            "method": eps.getType(),
            "restarts": eps.getIterationNumber(),
            "basis": eps.getDimensions()[1],
        }
        values = values[order]
        return values, X, product(K, X) - product(M, X) * values, stats


def _residuals(K, M, values, R, shift) -> np.ndarray:
    """Relative residuals as in EigenResult, of the columns of R = K X - M X Lambda."""
    diagonal = K.getDiagonal()
    diagonal.axpy(-shift, M.getDiagonal())
    squares = np.sum(np.abs(R) ** 2 / np.abs(diagonal.array_r)[:, None], axis=0)
    squares = K.comm.tompi4py().allreduce(squares, op=MPI.SUM)
    return np.sqrt(squares / np.maximum(values - shift, np.finfo(float).tiny))


def _round_off(K: PETSc.Mat, X: np.ndarray) -> np.ndarray:
    """See `EigenResult`."""
    squares = np.abs(K.getDiagonal().array_r) @ X**2
    return np.finfo(float).eps * K.comm.tompi4py().allreduce(squares, op=MPI.SUM)


def _default_block(n: int, initial) -> int:
    """Wide enough for six rigid modes and a pair; a warm start fits in, with guard vectors."""
    return len(initial) + 4 if initial else max(8, min(n, 16))


def _start(M: PETSc.Mat, block: int, initial) -> np.ndarray:
    """Starting block: the given vectors, then random columns."""
    rows = M.getLocalSize()[0]
    rng = np.random.default_rng([M.comm.rank, 1994])
    start = np.asfortranarray(rng.standard_normal((rows, block)), dtype=PETSc.ScalarType)
    for i, vector in enumerate(list(initial or ())[:block]):
        start[:, i] = vector.array_r
    return start


def _check_pencil(K: PETSc.Mat, M: PETSc.Mat, n: int, initial) -> None:
    if K.getSize()[0] != K.getSize()[1] or K.getSizes() != M.getSizes():
        raise InputError(f"K is {K.getSize()} and M is {M.getSize()}: expected square and alike")
    if n > K.getSize()[0]:
        raise InputError(f"n is {n}: K has {K.getSize()[0]} rows only")
    for vector in items("initial", initial or (), PETSc.Vec, "PETSc's vectors"):
        if vector.getSizes() != K.getSizes()[0]:
            raise InputError(f"an initial vector has {vector.getSize()} rows, K {K.getSize()[0]}")


# -- block Lanczos for A^-1 M in the inner product of M, on blocks of local columns ------------


class Operator:
    """``X -> (A^-1 X, M X)`` on blocks of local columns, shape (local rows, columns).

    ``lean`` is M without stored zeros.
    """

    def __init__(self, ksp: PETSc.KSP, M: PETSc.Mat):
        self._ksp, self.lean = ksp, without_zeros(M)
        self.comm = M.comm.tompi4py()
        self.calls = self.columns = 0
        self._work: dict[int, tuple[PETSc.Mat, PETSc.Mat, PETSc.Mat]] = {}

    def _buffers(self, columns: int):
        if columns not in self._work:
            right, left = dense_block(self.lean, columns), dense_block(self.lean, columns)
            self._work[columns] = (right, left, self.lean.matMult(left))
        return self._work[columns]

    def solve(self, block: np.ndarray) -> np.ndarray:
        self.calls += 1
        self.columns += block.shape[1]
        return _solved(self._ksp, *self._buffers(block.shape[1])[:2], block)

    def mass(self, block: np.ndarray) -> np.ndarray:
        _, left, product = self._buffers(block.shape[1])
        left.getDenseArray()[:] = block
        self.lean.matMult(left, result=product)
        return product.getDenseArray().copy(order="F")

    def dot(self, left: np.ndarray, right: np.ndarray) -> np.ndarray:
        return self.comm.allreduce(left.conj().T @ right, op=MPI.SUM)

    def destroy(self) -> None:
        # By hand: left to Python's collector, matrices on several ranks die in no common order.
        for mats in self._work.values():
            for mat in mats:
                mat.destroy()
        self._work = {}
        self.lean.destroy()


def _solved(ksp: PETSc.KSP, right: PETSc.Mat, left: PETSc.Mat, block: np.ndarray) -> np.ndarray:
    """Solution for a block of local columns, by way of two dense matrices."""
    right.getDenseArray()[:] = block
    ksp.matSolve(right, left)
    if ksp.getConvergedReason() < 0:
        raise ConvergenceError("the linear solve with K - shift M failed", reason_of(ksp))
    return left.getDenseArray().copy(order="F")


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
        T[:k, last] = H = op.dot(MV[:, :k], W)
        W -= V[:, :k] @ H
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
