"""The eigensolver against dense LAPACK and ARPACK on pencils with everything that goes wrong."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sp
import scipy.sparse.linalg
from mpi4py import MPI
from petsc4py import PETSc

from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.modal import EigenSolver
from fenics_joints.modal.eigensolver import refined

comm = MPI.COMM_WORLD


def to_petsc(A) -> PETSc.Mat:
    """The rows of a scipy matrix, known on every rank, spread over the ranks."""
    A = sp.csr_matrix(A)
    first, last = PETSc.Vec().createMPI(A.shape[0], comm=comm).getOwnershipRange()
    rows, size = A[first:last], (last - first, A.shape[0])
    csr = rows.indptr, rows.indices, rows.data
    mat = PETSc.Mat().createAIJ((size, size), csr=csr, comm=comm)
    mat.assemble()
    return mat


def springs(nodes: int, seed: int, massless: int = 0, held: int = 0):
    """A random free frame of springs in space, six rigid-body modes, as sparse K and diagonal M.

    The last ``massless`` nodes weigh nothing; the first ``held`` nodes are constrained the way
    DOLFINx does it: decoupled, with one on the diagonal of K and zero in M.
    """
    rng = np.random.default_rng(seed)
    x = rng.random((nodes, 3))
    K = np.zeros((3 * nodes, 3 * nodes))
    for i in range(nodes):
        for j in np.argsort(np.linalg.norm(x - x[i], axis=1))[1:8]:
            d = (x[j] - x[i]) / np.linalg.norm(x[j] - x[i])
            b = np.zeros(3 * nodes)
            b[3 * i : 3 * i + 3], b[3 * j : 3 * j + 3] = -d, d
            K += 1e6 * np.outer(b, b)
    mass = np.repeat(rng.uniform(0.5, 1.5, nodes), 3)
    if massless:
        mass[-3 * massless :] = 0.0
    K[: 3 * held], K[:, : 3 * held] = 0.0, 0.0
    K[range(3 * held), range(3 * held)] = 1.0
    mass[: 3 * held] = 0.0
    return sp.csr_matrix(K), sp.diags(mass).tocsr()


def solve_pencil(A, B, n, **settings):
    solver = EigenSolver(n, **settings)
    try:
        return solver.solve(A, B)
    finally:
        solver.destroy()


def condensed(K, M) -> np.ndarray:
    """All finite eigenvalues by LAPACK, after static condensation of the massless DOFs."""
    K, m = K.toarray(), M.diagonal()
    heavy, light = m > 0, m == 0
    k = K[np.ix_(heavy, heavy)]
    if light.any():
        k = k - K[np.ix_(heavy, light)] @ np.linalg.solve(
            K[np.ix_(light, light)], K[np.ix_(light, heavy)]
        )
    return scipy.linalg.eigh(k, np.diag(m[heavy]), eigvals_only=True)


@pytest.mark.parallel
@pytest.mark.parametrize("massless, held", [(0, 0), (15, 0), (10, 4)])
def test_values_and_shapes_match_lapack(massless, held):
    K, M = springs(60, seed=massless + held, massless=massless, held=held)
    exact = condensed(K, M)
    n = 15
    A, B = to_petsc(K), to_petsc(M)
    result = solve_pencil(A, B, n, shift=-100.0)
    assert np.allclose(result.values, exact[:n], rtol=1e-10, atol=1e-10 * exact[n])
    assert (abs(result.values) < 1e-6 * exact[6]).sum() == (0 if held else 6)
    gram = [[x.dot(B * y) for y in result.shapes] for x in result.shapes]
    assert np.allclose(gram, np.eye(n), atol=1e-10)
    for value, x in zip(result.values, result.shapes, strict=True):
        assert (A * x - float(value) * (B * x)).norm() < 1e-5 * (A.norm() * x.norm())
        # A massless node follows its neighbours statically; round-off must not live there.
        assert x.norm() < 1e3
    assert result.residuals.max() < 1e-5


@pytest.mark.parallel
def test_every_copy_of_a_multiple_eigenvalue_is_found():
    """A square membrane has exact pairs; three uncoupled ones have each value up to six times."""
    line = sp.diags([[-1.0] * 11, [2.0] * 12, [-1.0] * 11], [-1, 0, 1])
    membrane = sp.kron(line, sp.eye(12)) + sp.kron(sp.eye(12), line)
    K = sp.kron(sp.eye(3), membrane)
    one = 2.0 - 2.0 * np.cos(np.pi * np.arange(1, 13) / 13.0)
    exact = np.sort(np.tile((one[:, None] + one).ravel(), 3))
    result = solve_pencil(to_petsc(K), to_petsc(sp.eye(K.shape[0])), 24, shift=0.0)
    assert np.allclose(result.values, exact[:24], rtol=1e-10)


@pytest.mark.parallel
def test_another_slepc_solver_by_option_agrees_with_arpack():
    K, M = springs(60, seed=3, held=3)
    free = M.diagonal() > 0
    k, m = K[free][:, free].tocsc(), M[free][:, free].tocsc()
    arpack = scipy.sparse.linalg.eigsh(k, 8, m, sigma=-100.0, return_eigenvectors=False, tol=1e-12)
    superlu = {"st_pc_type": "lu", "st_pc_factor_mat_solver_type": "superlu_dist"}
    for options in ({}, {"eps_type": "krylovschur"}, superlu):
        # One prefix for all: the options of one solver must not reach the next.
        solver = EigenSolver(8, shift=-100.0, petsc_options=options)
        result = solver.solve(to_petsc(K), to_petsc(M))
        assert np.allclose(result.values, np.sort(arpack), rtol=1e-9)
        expected = options.get("eps_type", "block Lanczos")
        assert result.statistics["method"] == expected
        pc = solver.solver.getST().getKSP().getPC()
        assert pc.getFactorSolverType() == options.get("st_pc_factor_mat_solver_type", "mumps")


@pytest.mark.parallel
def test_repeated_solves_follow_the_matrix_and_warm_starts_save_solves():
    K, M = springs(60, seed=5)
    solver = EigenSolver(12, shift=-100.0)
    cold = solver.solve(to_petsc(K), to_petsc(M))
    stiffer = (1.01 * K).tocsr()
    again = solver.solve(to_petsc(stiffer), to_petsc(M), initial=cold.shapes)
    assert np.allclose(again.values[6:], 1.01 * condensed(K, M)[6:12], rtol=1e-10)
    assert again.statistics["solves"] < cold.statistics["solves"]


@pytest.mark.parallel
def test_a_small_basis_restarts_to_the_same_answer():
    K, M = springs(80, seed=6)
    exact = condensed(K, M)[:12]
    result = solve_pencil(to_petsc(K), to_petsc(M), 12, shift=-100.0, block=2, max_basis=18)
    assert result.statistics["basis"] <= 24
    assert np.allclose(result.values, exact, rtol=1e-9, atol=1e-9 * exact[-1])


def test_too_few_converged_is_an_error_that_counts_them():
    K, M = springs(60, seed=7)
    light, weightless, loose = M.copy(), M.copy(), K.tolil()
    light.data[30:], weightless.data[0] = 0.0, 0.0
    loose[0, :], loose[:, 0] = 0.0, 0.0
    few = {"block": 1, "max_basis": 31, "max_restarts": 0}
    for A, B, n, more, message in (
        (K, M, 30, few, "of 30 modes converged after 0 restarts"),
        (K, light, 40, {}, "M has rank 30 only"),
        (K, M, 10, {"shift": 0.0}, "shift"),
        (K, 0.0 * M, 5, {}, "0 of 5 modes exist: M is zero"),
        (loose, weightless, 5, {}, "could not be factorised"),
        (K * np.nan, M, 5, {}, ""),
    ):
        with pytest.raises(ConvergenceError, match=message):
            solve_pencil(to_petsc(A), to_petsc(B), n, **({"shift": -100.0} | more))


def test_one_solver_takes_pencils_of_another_size():
    solver = EigenSolver(10, shift=-100.0)
    for nodes in (40, 60):
        K, M = springs(nodes, seed=nodes)
        exact = condensed(K, M)[:10]
        values = solver.solve(to_petsc(K), to_petsc(M)).values
        assert np.allclose(values, exact, rtol=1e-10, atol=1e-10 * exact[-1])


def test_bad_input_is_named():
    K, M = map(to_petsc, springs(10, seed=8))
    with pytest.raises(InputError, match="30 rows only"):
        solve_pencil(K, M, 31)
    with pytest.raises(InputError, match="shift is 10.0: expected zero or less"):
        solve_pencil(K, M, 2, shift=10.0)
    with pytest.raises(InputError, match="expected square and alike"):
        solve_pencil(K, to_petsc(sp.eye(12)), 2)


def test_eigenvalues_without_divide_and_conquer(monkeypatch):
    """Where LAPACK's divide and conquer gives up another algorithm has the same modes."""
    K = np.diag(np.arange(1.0, 41.0)) + 0.1 * np.ones((40, 40))

    class Dense:
        def mass(self, X):
            return X.copy()

        def dot(self, X, Y):
            return X.T @ Y

        def solve(self, X):
            return np.linalg.solve(K, X)

    start = np.eye(40)[:, :4] + 0.01 * np.ones((40, 4))
    known = refined(Dense(), K @ start, start)[0]

    def gives_up(matrix):
        raise np.linalg.LinAlgError("Eigenvalues did not converge")

    monkeypatch.setattr(np.linalg, "eigh", gives_up)
    assert refined(Dense(), K @ start, start)[0] == pytest.approx(known, rel=1e-12)
