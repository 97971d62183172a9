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
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc
from slepc4py import SLEPc

from fenics_joints.errors import ConvergenceError, InputError, items, real, whole
from fenics_joints.modal.lanczos import Operator, lanczos, refined
from fenics_joints.modal.options import (
    give_room,
    given_options,
    petsc_defaults,
    reason_of,
    say_unused,
)
from fenics_joints.structure.sparse import dense_block, product, vectors_like

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


@dataclass(frozen=True, repr=False)
class EigenResult:
    """Eigenpairs of a pencil.

    Attributes:
        values: Eigenvalues, ascending, shape (n,); rad^2/s^2 for SI matrices.
        shapes: The n eigenvectors, M-orthonormal, laid out like the rows of K.
        residuals: Relative residuals, shape (n,): ``|K x - lambda M x|`` over ``|x|_A``, the first
            in the norm of the inverse diagonal of ``A = K - shift M``. Unlike the 2-norm it is
            not swamped by the round-off of stiff thin layers.
        statistics: ``method``, ``seconds``, of which ``factor_seconds``, and ``basis``; from block
            Lanczos also ``solve_seconds``, ``solves`` (right-hand sides) and ``block_solves``.
        round_off: What round-off may make of each eigenvalue, shape (n,): the unit round-off times
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
        self._eps: SLEPc.EPS | None = None
        self._shifted: PETSc.Mat | None = None
        self._pattern: tuple | None = None

    @property
    def solver(self) -> SLEPc.EPS | None:
        """The SLEPc solver (None before the first solve); ``.solver.getST().getKSP()`` solves."""
        return self._eps

    @property
    def shifted(self) -> PETSc.Mat | None:
        """``A = K - shift M`` of the last solution, the solver's own; None before the first."""
        return self._shifted

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
        with petsc_defaults(self.prefix, _OPTIONS, self.petsc_options) as options:
            first = self._eps is None
            if first:
                self._create(K.comm)
            solve = self._solve_slepc if options.hasName("eps_type") else self._solve_block
            values, X, stats = solve(K, M, initial)
            if first:
                say_unused(self.prefix, self.petsc_options)
        residuals = _residuals(K, M, values, X, self.shift)
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
        eigenvalue comes out too low, and what it is too high is a small part of what it is in the
        subspace itself: there by the square of the angle, and a step shrinks the angle. A mode
        that is not near the subspace is not found.

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
        with petsc_defaults(self.prefix, _OPTIONS, self.petsc_options):
            if self._eps is None:
                self._create(K.comm)
            A, ksp, _ = self._factorised(K, M)
            operator, X = Operator(ksp, M), start
            try:
                for _ in range(_STEPS):
                    theta, X = refined(operator, product(A, X), X)
            finally:
                operator.destroy()
        shapes = vectors_like(K.createVecRight(), X.T)
        unknown = np.full(len(theta), np.nan)
        statistics = {"method": "inverse iteration", "solves": operator.columns}
        return EigenResult(self.shift + 1.0 / theta, shapes, unknown, statistics, _round_off(K, X))

    def factorise(self, K: PETSc.Mat, M: PETSc.Mat) -> None:
        """Factorise ``K - shift M`` alone, for `inverse`; arguments and errors as of `solve`."""
        _check_pencil(K, M, self.n, None)
        with petsc_defaults(self.prefix, _OPTIONS, self.petsc_options):
            if self._eps is None:
                self._create(K.comm)
            self._factorised(K, M)

    def inverse(self, block: np.ndarray) -> np.ndarray:
        """``(K - shift M)^-1 block`` with the last factorisation. Collective.

        Args:
            block: This rank's rows of the right-hand sides, shape (n_local, n_columns).

        Raises:
            InputError: Before the first solution.
            ConvergenceError: The linear solve failed.
        """
        if self._shifted is None:
            raise InputError("the solver has no factorisation yet: expected a solution first")
        right, left = (dense_block(self._shifted, block.shape[1]) for _ in range(2))
        right.getDenseArray()[:] = block
        ksp = self._eps.getST().getKSP()
        ksp.matSolve(right, left)
        if ksp.getConvergedReason() < 0:
            raise ConvergenceError("the linear solve with K - shift M failed", reason_of(ksp))
        found = left.getDenseArray().copy(order="F")
        right.destroy(), left.destroy()
        return found

    def destroy(self) -> None:
        """Free the factorisation. Collective; on several ranks Python's collector cannot do it."""
        for owned in (self._eps, self._shifted):
            if owned is not None:
                owned.destroy()
        self._eps = self._shifted = self._pattern = None

    def _create(self, comm) -> None:
        self._eps = SLEPc.EPS().create(comm)
        self._eps.setOptionsPrefix(self.prefix)
        self._eps.setProblemType(SLEPc.EPS.ProblemType.GHEP)
        self._eps.getST().setType(SLEPc.ST.Type.SINVERT)
        self._eps.getST().setShift(self.shift)

    def _shift_matrix(self, K: PETSc.Mat, M: PETSc.Mat) -> PETSc.Mat:
        """``A = K - shift M`` in the matrix of the last call, so that its analysis is kept."""
        pattern = (K.getSize(), K.getInfo()["nz_used"], M.getInfo()["nz_used"])
        same = K.comm.tompi4py().allreduce(pattern == self._pattern, op=MPI.LAND)
        structure = PETSc.Mat.Structure
        if not same:
            if self._shifted is not None:
                self._eps.getST().getKSP().reset()
                self._shifted.destroy()
            self._shifted = K.duplicate(copy=True)
            self._shifted.axpy(-self.shift, M, structure.UNKNOWN_NONZERO_PATTERN)
        else:
            self._shifted.zeroEntries()
            self._shifted.axpy(1.0, K, structure.SUBSET_NONZERO_PATTERN)
            self._shifted.axpy(-self.shift, M, structure.SUBSET_NONZERO_PATTERN)
        self._shifted.setOption(PETSc.Mat.Option.SPD, True)
        self._pattern = pattern
        return self._shifted

    def _factorised(self, K, M) -> tuple[PETSc.Mat, PETSc.KSP, float]:
        """``K - shift M``, what solves with it, and the seconds that its factorisation took."""
        A, ksp = self._shift_matrix(K, M), self._eps.getST().getKSP()
        ksp.setOperators(A)
        ksp.setFromOptions()
        return A, ksp, _set_up(ksp)

    def _solve_block(self, K, M, initial):
        _, ksp, factor_seconds = self._factorised(K, M)
        operator = Operator(ksp, M)
        size = K.getSize()[0]
        block = min(self.block or _default_block(self.n, initial), size)
        largest = min(max(self.max_basis or 0, self.n + 6 * block), size)
        start = _start(M, block, initial)
        try:
            args = operator, start, self.n, self.tol, largest, self.max_restarts
            theta, X, basis = lanczos(*args)
        finally:
            operator.destroy()
        stats = {
            "method": "block Lanczos",
            "factor_seconds": factor_seconds,
            "solve_seconds": operator.seconds,
            "solves": operator.columns,
            "block_solves": operator.calls,
            "basis": basis,
        }
        return self.shift + 1.0 / theta, X, stats

    def _solve_slepc(self, K, M, initial):
        eps = self._eps
        eps.setOperators(K, M)
        eps.setDimensions(self.n)
        eps.setTolerances(self.tol, 1000)
        eps.setWhichEigenpairs(SLEPc.EPS.Which.TARGET_MAGNITUDE)
        eps.setTarget(self.shift)
        if initial:
            eps.setInitialSpace(list(initial))
        eps.setFromOptions()
        begin = time.perf_counter()
        try:
            eps.setUp()
            factor_seconds = time.perf_counter() - begin
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
            "factor_seconds": factor_seconds,
            "restarts": eps.getIterationNumber(),
            "basis": eps.getDimensions()[1],
        }
        return values[order], X, stats


def solve_pencil(
    K: PETSc.Mat,
    M: PETSc.Mat,
    n: int,
    *,
    shift: float = DEFAULT_SHIFT,
    petsc_options: Mapping[str, object] | None = None,
    initial: Sequence[PETSc.Vec] | None = None,
    **settings,
) -> EigenResult:
    """Solve one pencil: ``EigenSolver(n, ...).solve(K, M, initial)``; the arguments are its."""
    solver = EigenSolver(n, shift=shift, petsc_options=petsc_options, **settings)
    try:
        return solver.solve(K, M, initial)
    finally:
        solver.destroy()


def count_below(K: PETSc.Mat, M: PETSc.Mat, value: float) -> int:
    """Number of eigenvalues below a value, by Sylvester's law of inertia.

    An independent check that no mode was missed; it costs an indefinite factorisation, as much as
    a whole solve, and so is not part of one.

    Args:
        K: Stiffness.
        M: Mass.
        value: Bound, in the unit of the eigenvalues; not itself an eigenvalue.

    Raises:
        ConvergenceError: The factorisation failed.
    """
    A = K.duplicate(copy=True)
    A.axpy(-value, M, PETSc.Mat.Structure.UNKNOWN_NONZERO_PATTERN)
    A.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    pc = PETSc.PC().create(K.comm)
    pc.setOperators(A)
    pc.setType(PETSc.PC.Type.CHOLESKY)
    pc.setFactorSolverType("mumps")
    pc.setFactorSetUpSolverType()
    factor = pc.getFactorMatrix()
    factor.setMumpsIcntl(13, 1)  # the root front on one rank: MUMPS counts no pivots elsewhere
    pc.setUp()
    if factor.getMumpsInfog(1) < 0:
        raise ConvergenceError(
            f"MUMPS could not factorise K - {value} M", f"INFOG(1) = {factor.getMumpsInfog(1)}"
        )
    negative = factor.getMumpsInfog(12)
    pc.destroy()
    A.destroy()
    return negative


def _residuals(K, M, values, X, shift) -> np.ndarray:
    """Relative residuals as in EigenResult."""
    diagonal = K.getDiagonal()
    diagonal.axpy(-shift, M.getDiagonal())
    r = product(K, X) - product(M, X) * values
    squares = np.sum(np.abs(r) ** 2 / np.abs(diagonal.array_r)[:, None], axis=0)
    squares = K.comm.tompi4py().allreduce(squares, op=MPI.SUM)
    return np.sqrt(squares / np.maximum(values - shift, np.finfo(float).tiny))


def _round_off(K: PETSc.Mat, X: np.ndarray) -> np.ndarray:
    """See `EigenResult`."""
    squares = np.abs(K.getDiagonal().array_r) @ X**2
    return np.finfo(float).eps * K.comm.tompi4py().allreduce(squares, op=MPI.SUM)


def _set_up(ksp: PETSc.KSP) -> float:
    """Factorise; returns the seconds it took."""
    begin = time.perf_counter()
    advice = (
        "K - shift M could not be factorised: is K symmetric positive semi-definite, "
        "and the shift below zero for a free body?"
    )
    try:
        ksp.setUp()
        give_room(ksp)
    except PETSc.Error as error:
        raise ConvergenceError(advice, str(error)) from error
    if ksp.getPC().getFailedReason():
        raise ConvergenceError(advice, reason_of(ksp.getPC()))
    return time.perf_counter() - begin


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
