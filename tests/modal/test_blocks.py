"""Products and Gauss-Seidel on eight columns against dense algebra, on any number of ranks."""

import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc
from scipy import sparse

from fenics_joints.modal.blocks import WIDTH, Mass, SymmetricBlocks

COMM = MPI.COMM_WORLD


def distributed(A: np.ndarray, size: int, everywhere: bool = True) -> PETSc.Mat:
    """A dense matrix's entries as PETSc's, with rows on all ranks or on the first alone."""
    own = None if everywhere else len(A) * (COMM.rank == 0)
    made = PETSc.Mat().createAIJ(((own, len(A)), (own, len(A))), comm=COMM, bsize=size)
    made.setUp()
    first, last = made.getOwnershipRange()
    own = sparse.csr_matrix(A[first:last])
    made.setPreallocationCSR((own.indptr, own.indices, own.data))
    made.assemble()
    return made


def spd(size: int, nodes: int = 10) -> np.ndarray:
    """A sparse positive definite matrix with dense blocks, the same on all ranks."""
    rng = np.random.default_rng(7)
    L = np.kron(rng.random((nodes, nodes)) < 0.25, np.ones((size, size)))
    L *= rng.standard_normal(L.shape)
    return L @ L.T + np.eye(len(L))


@pytest.mark.parallel
@pytest.mark.parametrize("everywhere", [True, False])
@pytest.mark.parametrize("size", [1, 2, 3, 4, 5, 6])
def test_products_and_residuals_of_gauss_seidel(size, everywhere):
    A = spd(size)
    whole = distributed(A, size, everywhere)
    blocks = SymmetricBlocks(whole, size)
    X = np.random.default_rng(1).standard_normal((len(A), WIDTH))
    own = slice(*whole.getOwnershipRange())
    assert blocks @ X[own] == pytest.approx((A @ X)[own], abs=1e-10)
    Z, R = blocks.gauss_seidel(X[own])
    Z = np.concatenate(COMM.allgather(Z))
    assert pytest.approx((X - A @ Z)[own], abs=1e-10) == R
    if COMM.size == 1:  # two triangular solves with the blocks' own lower and upper halves
        lower = np.kron(np.tril(np.ones((10, 10))), np.ones((size, size))) * A
        D = np.kron(np.eye(10), np.ones((size, size))) * A
        expected = np.linalg.solve(lower.T, D @ np.linalg.solve(lower, X))
        assert pytest.approx(expected, abs=1e-9) == Z
    # No eigenvalue of its product with A is above 1, on however many ranks.
    V = X
    for _ in range(100):
        V = V / np.sqrt(np.sum(V * (A @ V), axis=0))
        V = np.concatenate(COMM.allgather(blocks.gauss_seidel((A @ V)[own])[0]))
    assert np.all(np.sum(V * (A @ V), axis=0) <= 1.0 + 1e-10)


@pytest.mark.parallel
@pytest.mark.parametrize("alike", [True, False])
def test_a_mass_is_one_number_a_pair_of_nodes_unless_it_is_not(alike):
    m, held = spd(1), np.zeros(30, dtype=bool)
    held[[3, 10, 11]] = True
    M = np.kron(m, np.eye(3) if alike else np.diag([1.0, 2.0, 3.0])) * np.outer(~held, ~held)
    whole = distributed(M, 3)
    own = slice(*whole.getOwnershipRange())
    found = Mass(whole, held[own], 3)
    assert found.size == (3 if alike else 1)
    X = np.random.default_rng(1).standard_normal((30, WIDTH))
    assert found @ X[own] == pytest.approx((M @ X)[own], abs=1e-12)
    assert found.diagonal == pytest.approx(np.diag(M)[own])
