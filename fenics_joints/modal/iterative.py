"""The lowest modes of a structure without a factorisation: LOBPCG with multigrid.

``M x = theta A x`` with ``A = K - shift M``, ``theta = 1 / (lambda - shift)``, largest theta first:
A is positive definite, so M may be singular. Knyazev's locally optimal block method (SIAM J. Sci.
Comput. 23, 2001) in the inner product of A, with guard columns and soft locking: a mode that has
converged stays in the basis and costs nothing more. Rigid-body motions that K does not resist are
known beforehand; they are found exactly, and everything else is kept M-orthogonal to them, since
A's near-singularity would magnify round-off along them. SLEPc's own LOBPCG breaks down on these
pencils, as its Gram matrices become indefinite (benchmarks/README.md).

The preconditioner is multigrid for A: degree 2 to degree 1, then PETSc's GAMG.
On meshes with thin cells and soft layers smoothed aggregation straight on elements of degree 2
converges slowly. The elements of degree 1 on the same mesh span a subspace with a quarter of the
DOFs, and are assembled anew, so the large matrix only smooths: symmetric Gauss-Seidel needs no
more of it than one triangle. GAMG works on the small one, with the rigid-body motions as the near
null space (Vaněk, Mandel and Brezina, Computing 56, 1996).
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence

import numpy as np
from dolfinx.fem import petsc as fem_petsc
from mpi4py import MPI
from petsc4py import PETSc

from fenics_joints.errors import ConvergenceError, InputError, items, real, whole
from fenics_joints.meshes.tagged import limits
from fenics_joints.modal.eigensolver import EigenResult
from fenics_joints.modal.options import given_options, petsc_defaults
from fenics_joints.modal.rigid import rigid_motions
from fenics_joints.structure.points import node_positions
from fenics_joints.structure.sparse import product, vectors_like, without_zeros
from fenics_joints.structure.structure import Structure

#: A rigid motion's forces, relative to the diagonal of K: round-off is 1e-13, a spring of 1 N/m on
#: a steel part 1e-9.
_NO_FORCE = 1e-11
#: Eigenvalue of the scaled Gram matrix, relative to the largest, of a direction that is in the
#: basis twice.
_DEPENDENT = 1e-12
#: Columns beside the modes wanted: chosen; fewer take more iterations.
_GUARD = 4
_PREFIX = "fenics_joints_iterative_"

_GAMG = {
    # Aggregates must not reach across a soft layer, nor skip a distance.
    "pc_gamg_threshold": "0.02",
    "pc_gamg_aggressive_coarsening": "0",
}
#: Options of two levels of degree. Some steps of CG on the coarse level cost little: it has a
#: tenth of the entries.
_TWO_LEVELS = {
    "pc_type": "mg",
    "mg_levels_ksp_type": "chebyshev",
    "mg_levels_ksp_max_it": "2",
    "mg_levels_pc_type": "sor",
    "mg_coarse_ksp_type": "cg",
    "mg_coarse_ksp_max_it": "4",
    "mg_coarse_pc_type": "gamg",
    **{f"mg_coarse_{key}": value for key, value in _GAMG.items()},
}
_ONE_LEVEL = {"pc_type": "gamg", **_GAMG}


class IterativeEigenSolver:
    """LOBPCG for a structure's modes; keeps its multigrid hierarchy on the mesh.

    Args:
        n: Number of modes wanted, rigid-body modes included.
        shift: Shift in (rad/s)^2, below zero.
        tol: Relative error of the shapes in the norm of A, by ``r^T B r`` of the residual r and
            the preconditioner B; an eigenvalue's is of the order of its square.
        max_iterations: Iterations before ConvergenceError.
        petsc_options: Options of the preconditioner, see `Multigrid`.

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
        self._A: PETSc.Mat | None = None
        self._M: PETSc.Mat | None = None
        self._rigid: np.ndarray | None = None

    @property
    def solver(self) -> PETSc.KSP | None:
        """The preconditioner as a KSP (None before the first solve)."""
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
        op = _Operators(self._A, self._M, self.solver)
        Y = op.M_orthonormal(self._rigid)
        more = self.n - Y.shape[1]
        values, X = np.zeros(min(self.n, Y.shape[1])), Y[:, : self.n]
        steps = 0
        if more > 0:
            width = min(more + _GUARD, structure.n_dofs - Y.shape[1])
            start = _start(op, Y, width, list(initial)[-more:])
            theta, Z, steps = _lobpcg(op, Y, start, more, self.tol, self.max_iterations)
            values = np.concatenate([values, self.shift + 1.0 / theta])
            X = np.hstack([X, Z / np.sqrt(theta)])
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
        shapes = vectors_like(self._A.createVecRight(), X.T)
        return EigenResult(values, shapes, residuals, stats)

    def _set_up(self, structure, given) -> None:
        """Matrices as their triangles, one after the other, so that few whole ones exist at once"""
        if self._multigrid is None or self._multigrid.structure is not structure:
            self.destroy()
            self._multigrid = Multigrid(structure, self.petsc_options)
        self._free_matrices()
        M = structure.mass(given)
        self._M = without_zeros(M)
        M.destroy()
        self._A = structure.stiffness(given)
        self._rigid = _unresisted(self._A, structure_motions(structure))
        self._A.axpy(-self.shift, self._M, PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
        if structure.degree > 1:  # GAMG, on its own, takes no half matrix
            to_upper_half(self._M)
            to_upper_half(self._A)
        self._A.setOption(PETSc.Mat.Option.SPD, True)
        self._multigrid.set_up(self._A, given, self.shift)

    def inverse(self, block: np.ndarray) -> np.ndarray:
        """``(K - shift M)^-1 block`` by conjugate gradients to 1e-10. Collective.

        Args:
            block: This rank's rows of the right-hand sides, shape (n_local, n_columns).

        Raises:
            InputError: Before the first solution.
            ConvergenceError: The gradients did not converge.
        """
        if self._A is None:
            raise InputError("the solver has no preconditioner yet: expected a solution first")
        op = _Operators(self._A, self._M, self.solver)
        Y = op.M_orthonormal(self._rigid)
        MY = op.mass(Y)
        weights = op.dot(Y, block)
        ksp = PETSc.KSP().create(self._A.comm)
        ksp.setType(PETSc.KSP.Type.CG)
        ksp.setOperators(self._A)
        ksp.setPC(self.solver.getPC())
        ksp.setTolerances(rtol=1e-10, max_it=500)
        found = op.each(ksp.solve, block - MY @ weights)
        reason = ksp.getConvergedReason()
        ksp.destroy()
        if reason < 0:
            raise ConvergenceError("the linear solve with K - shift M failed", f"KSP: {reason}")
        return found - Y @ op.dot(MY, found) + Y @ weights / -self.shift

    def _residuals(self, op: _Operators, values, X) -> np.ndarray:
        """Relative residuals as in EigenResult."""
        diagonal = self._A.getDiagonal().array_r
        r = op.stiff(X) - op.mass(X) * (values - self.shift)
        squares = op.comm.allreduce(np.sum(r**2 / diagonal[:, None], axis=0), op=MPI.SUM)
        return np.sqrt(squares / (values - self.shift))

    def _free_matrices(self) -> None:
        for owned in (self._A, self._M):
            if owned is not None:
                owned.destroy()
        self._A = self._M = None

    def destroy(self) -> None:
        """Free everything. Collective; on several ranks Python's collector cannot do it."""
        if self._multigrid is not None:
            self._multigrid.destroy()
        self._multigrid = None
        self._free_matrices()


class _Operators:
    """A, M and the preconditioner on blocks of local columns, shape (n_local, columns)."""

    def __init__(self, A: PETSc.Mat, M: PETSc.Mat, preconditioner: PETSc.KSP):
        self._A, self._M, self._ksp = A, M, preconditioner
        self.comm = A.comm.tompi4py()
        self.applications = 0
        self._x, self._y = A.createVecs()

    def each(self, operation, X: np.ndarray) -> np.ndarray:
        out = np.empty_like(X, order="F")
        for j in range(X.shape[1]):
            self._x.array[:] = X[:, j]
            operation(self._x, self._y)
            out[:, j] = self._y.array_r
        return out

    def stiff(self, X):
        return self.each(self._A.mult, X)

    def mass(self, X):
        return self.each(self._M.mult, X)

    def precondition(self, X):
        self.applications += X.shape[1]
        return self.each(self._ksp.getPC().apply, X)

    def dot(self, left, right) -> np.ndarray:
        return self.comm.allreduce(left.T @ right, op=MPI.SUM)

    def M_orthonormal(self, Y: np.ndarray) -> np.ndarray:
        """M-orthonormal basis of the motions that have mass."""
        s, Q = np.linalg.eigh(self.dot(Y, self.mass(Y)))
        good = s > 1e-12 * s.max(initial=0.0)
        return Y @ (Q[:, good] / np.sqrt(s[good]))


def _unresisted(K: PETSc.Mat, R: np.ndarray) -> np.ndarray:
    """Combinations of the rigid motions R that K does not resist, as columns; none if held.

    By the singular values of the forces over the diagonal of K: a spring at one point shows,
    however stiff the body.
    """
    comm = K.comm.tompi4py()
    diagonal = np.maximum(np.abs(K.getDiagonal().array_r), np.finfo(float).tiny)
    forces = product(K, R) / diagonal[:, None]
    parts = comm.allgather(np.linalg.qr(forces, mode="r"))
    _, s, Vt = np.linalg.svd(np.vstack(parts))
    s = np.concatenate([s, np.zeros(R.shape[1] - len(s))])
    n = comm.allreduce(R.shape[0], op=MPI.SUM)
    free = s <= _NO_FORCE * max(1.0, np.sqrt(n / 1e5))
    return R @ Vt[free].T


def _lobpcg(op: _Operators, Y, X, n: int, tol: float, max_iterations: int):
    """Largest n theta of ``M x = theta A x`` beside Y; returns (theta, X, iterations).

    Args:
        op: The operators.
        Y: M-orthonormal motions to leave out.
        X: Starting block.
        n: Number of eigenpairs.
        tol: See `IterativeEigenSolver`.
        max_iterations: Limit.

    Raises:
        ConvergenceError: Fewer converged, or something was not finite.
    """
    MY = op.mass(Y)
    groups = [(X, op.stiff(X), op.mass(X))]
    for step in range(1, max_iterations + 1):
        theta, C = _ritz(op, groups, X.shape[1])
        if len(theta) < n:
            raise ConvergenceError(f"{len(theta)} of {n} elastic modes exist: M has no more rank")
        groups = _advance(groups, C)
        X, AX, MX = groups[0]
        R = MX - AX * theta
        R -= MY @ op.dot(Y, R)
        W = op.precondition(R)
        W -= Y @ op.dot(MY, W)
        errors = op.comm.allreduce(np.sum(R * W, axis=0), op=MPI.SUM)
        if not np.all(np.isfinite(errors)):
            raise ConvergenceError("the preconditioner's result was not finite")
        errors = np.sqrt(np.abs(errors)) / theta
        if np.all(errors[:n] <= tol):
            return theta[:n], X[:, :n], step
        active = errors > tol
        W = W[:, active]
        W -= X @ op.dot(AX, W)
        W /= np.sqrt(op.comm.allreduce(np.sum(W**2, axis=0), op=MPI.SUM))
        past = [tuple(block[:, active] for block in group) for group in groups[1:]]
        groups = [groups[0], *past, (W, op.stiff(W), op.mass(W))]
    done = int(np.sum(errors[:n] <= tol))
    raise ConvergenceError(
        f"{done} of {n} elastic modes converged in {max_iterations} iterations",
        f"largest error {errors[:n].max():.1e}, asked {tol:.1e}: allow more iterations, more guard "
        "columns, or take the direct method",
    )


def _ritz(op: _Operators, groups, width: int):
    """Rayleigh-Ritz in the span of all groups: (theta, coefficients of the groups' columns)."""
    local = [[left[0].T @ np.hstack(right[1:]) for right in groups] for left in groups]
    sizes = [group[0].shape[1] for group in groups]
    total = sum(sizes)
    G, H = np.empty((total, total)), np.empty((total, total))
    edges = np.concatenate([[0], np.cumsum(sizes)])
    for i, row in enumerate(local):
        for j, both in enumerate(row):
            at = slice(edges[i], edges[i + 1]), slice(edges[j], edges[j + 1])
            G[at], H[at] = both[:, : sizes[j]], both[:, sizes[j] :]
    G, H = op.comm.allreduce(np.array([G, H]), op=MPI.SUM)
    d = 1.0 / np.sqrt(np.maximum(np.diag(G), np.finfo(float).tiny))
    G, H = ((A + A.T) / 2 * np.outer(d, d) for A in (G, H))
    if not np.all(np.isfinite(G)) or not np.all(np.isfinite(H)):
        raise ConvergenceError("K or M times a vector was not finite: is a NaN in K or M?")
    s, Q = np.linalg.eigh(G)
    good = s > _DEPENDENT * s[-1]
    T = Q[:, good] / np.sqrt(s[good])
    theta, Z = np.linalg.eigh(T.T @ H @ T)
    theta, Z = theta[::-1][:width], Z[:, ::-1][:, :width]
    keep = theta > 1e-14 * theta[0]
    C = d[:, None] * (T @ Z[:, keep])
    return theta[keep], np.split(C, edges[1:-1])


def _advance(groups, C):
    """The Ritz vectors and their last change, each with its products by A and M."""
    X = [block @ C[0] for block in groups[0]]
    if len(groups) == 1:
        return [tuple(X)]
    change = []
    for k in range(3):
        step = groups[1][k] @ C[1]
        for group, coefficients in zip(groups[2:], C[2:], strict=True):
            step += group[k] @ coefficients
        X[k] += step
        change.append(step)
    return [tuple(X), tuple(change)]


def _start(op: _Operators, Y, width: int, given) -> np.ndarray:
    """Starting block: the given shapes and smoothed noise, M-orthogonal to Y."""
    rows = Y.shape[0]
    for vector in given:
        if vector.getLocalSize() != rows:
            raise InputError(f"an initial shape has {vector.getSize()} rows: expected this model's")
    given = given[:width]
    shapes = np.array([vector.array_r for vector in given]).reshape(len(given), rows).T
    rng = np.random.default_rng([op.comm.rank, 2001])
    noise = op.mass(rng.standard_normal((rows, width - len(given))))
    MY = op.mass(Y)
    X = np.hstack([shapes, op.precondition(noise - MY @ op.dot(Y, noise))])
    return X - Y @ op.dot(MY, X)


# -- the preconditioner ------------------------------------------------------------------------


class Multigrid:
    """The preconditioner, as a PETSc KSP that applies it once.

    Args:
        structure: The structure.
        petsc_options: PETSc options without prefix, such as ``mg_coarse_pc_type``; on the command
            line they have the prefix ``fenics_joints_iterative_``.

    Attributes:
        solver: The KSP; its operator is A.
    """

    def __init__(self, structure: Structure, petsc_options: Mapping[str, object] | None = None):
        self.structure = structure
        self.coarse = structure.coarser() if structure.degree > 1 else None
        ours = _ONE_LEVEL if self.coarse is None else _TWO_LEVELS
        self.options = {**ours, **given_options(petsc_options)}
        self.solver: PETSc.KSP | None = None
        self._prolongation = self._matrix = None

    def set_up(self, A: PETSc.Mat, given: Mapping[str, float] | None, shift: float) -> None:
        """Make the hierarchy for A, and for the parameters that it was assembled with.

        Raises:
            ConvergenceError: PETSc could not.
        """
        self._forget()
        self.solver = PETSc.KSP().create(A.comm)
        self.solver.setOptionsPrefix(_PREFIX)
        self.solver.setType(PETSc.KSP.Type.PREONLY)
        self.solver.setOperators(A)
        pc = self.solver.getPC()
        try:
            with petsc_defaults(_PREFIX, self.options):
                # The levels come before the other options, which are theirs.
                pc.setType(PETSc.Options(_PREFIX).getString("pc_type"))
                if self.coarse is None:
                    set_near_null_space(A, self.structure)
                elif pc.getType() == PETSc.PC.Type.MG:
                    self._two_levels(pc, A, given, shift)
                self.solver.setFromOptions()
                self.solver.setUp()
        except PETSc.Error as error:
            raise ConvergenceError("the multigrid of K - shift M failed", str(error)) from error

    def _two_levels(self, pc, A, given, shift) -> None:
        if self._prolongation is None:
            self._prolongation = prolongation(self.coarse, self.structure)
        self._matrix = self.coarse.stiffness(given)
        M = self.coarse.mass(given)
        self._matrix.axpy(-shift, M, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        self._matrix.setOption(PETSc.Mat.Option.SPD, True)
        M.destroy()
        set_near_null_space(self._matrix, self.coarse)
        pc.setMGLevels(2)
        pc.setMGInterpolation(1, self._prolongation)
        pc.getMGCoarseSolve().setOperators(self._matrix)
        pc.getMGSmoother(1).setOperators(A)

    def _forget(self) -> None:
        for owned in (self.solver, self._matrix):
            if owned is not None:
                owned.destroy()
        self.solver = self._matrix = None

    def destroy(self) -> None:
        """Free everything. Collective."""
        self._forget()
        if self._prolongation is not None:
            self._prolongation.destroy()
            self._prolongation = None


def structure_motions(structure: Structure) -> np.ndarray:
    """Rigid-body motions, zero at held DOFs, shape (n_local, 3 or 6).

    Translations of 1 m, and rotations about the mesh's centre with 1 m at half its size.
    """
    low, high = limits(structure.tagged)
    owned = structure.n_local // structure.gdim
    x = node_positions(structure.V)[:owned] - (low + high) / 2
    R = rigid_motions(x / (np.max(high - low) / 2)).reshape(-1, structure.n_local).T
    R[structure.held_dofs[: structure.n_local]] = 0.0
    return R


def to_upper_half(A: PETSc.Mat) -> None:
    """Keep the upper triangle of a symmetric matrix alone, in PETSc's SBAIJ format.

    In blocks of 3 x 3 it would be smaller, but PETSc has no Gauss-Seidel there.
    """
    A.setBlockSize(1)
    A.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    A.convert(PETSc.Mat.Type.SBAIJ)  # in place


def prolongation(coarse: Structure, fine: Structure) -> PETSc.Mat:
    """Interpolation from degree 1 to degree 2 of displacements, zero at held DOFs of both."""
    P = fem_petsc.interpolation_matrix(coarse.V, fine.V)
    P.assemble()
    if coarse.ties is not None:
        whole, P = P, P.matMult(coarse.ties.T)
        whole.destroy()
    left, right = P.createVecLeft(), P.createVecRight()
    left.array[:], right.array[:] = (
        ~structure.held_dofs[: structure.n_local] for structure in (fine, coarse)
    )
    P.diagonalScale(left, right)
    lean = without_zeros(P)
    P.destroy()
    return lean


def set_near_null_space(A: PETSc.Mat, structure: Structure) -> None:
    """Tell GAMG the rigid-body motions."""
    comm = structure.comm
    R = structure_motions(structure)
    squares = comm.allreduce(R.T @ R, op=MPI.SUM)
    s, Q = np.linalg.eigh(squares)
    if not len(s) or s[-1] <= 0.0:
        raise InputError("supports: expected ones that leave some DOF free.")
    good = s > 1e-12 * s[-1]
    R = R @ (Q[:, good] / np.sqrt(s[good]))
    vectors = vectors_like(A.createVecRight(), R.T)
    space = PETSc.NullSpace().create(vectors=vectors, comm=A.comm)
    A.setNearNullSpace(space)
    space.destroy()
    for vector in vectors:
        vector.destroy()
