"""Lowest modes of a sparse pencil, and solutions with one matrix (SLEPc, PETSc, MUMPS)."""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc
from scipy import sparse
from slepc4py import SLEPc


def _matrix(a: sparse.csr_matrix) -> PETSc.Mat:
    a = sparse.csr_matrix(a)
    a.sort_indices()
    csr = (a.indptr.astype(PETSc.IntType), a.indices.astype(PETSc.IntType), a.data)
    made = PETSc.Mat().createAIJ(a.shape, csr=csr, comm=PETSc.COMM_SELF)
    made.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    return made


def lowest_modes(stiffness, mass, n: int, shift_hz: float) -> tuple[np.ndarray, np.ndarray]:
    """The n lowest frequencies, Hz (0 for rigid motions), and mass-normalised shapes (n_dofs, n).

    Args:
        stiffness: Symmetric.
        mass: Symmetric, positive definite.
        n: Number of modes.
        shift_hz: The shift is minus the square of this, as an angular frequency.
    """
    k, m = _matrix(stiffness), _matrix(mass)
    eps = SLEPc.EPS().create(PETSc.COMM_SELF)
    eps.setOperators(k, m)
    eps.setProblemType(SLEPc.EPS.ProblemType.GHEP)
    eps.setType(SLEPc.EPS.Type.KRYLOVSCHUR)
    eps.setWhichEigenpairs(SLEPc.EPS.Which.TARGET_MAGNITUDE)
    eps.setTarget(-((2 * np.pi * shift_hz) ** 2))
    eps.setDimensions(n, n + 16)
    eps.setTolerances(1e-9, 100)
    eps.setPurify(False)  # the mass matrix is regular
    st = eps.getST()
    st.setType(SLEPc.ST.Type.SINVERT)
    ksp = st.getKSP()
    ksp.setType(PETSc.KSP.Type.PREONLY)
    pc = ksp.getPC()
    pc.setType(PETSc.PC.Type.CHOLESKY)
    pc.setFactorSolverType("mumps")
    eps.solve()
    if eps.getConverged() < n:
        raise RuntimeError(f"{eps.getConverged()} of {n} modes converged")
    vector = k.createVecLeft()
    values, shapes = [], []
    for i in range(n):
        values.append(eps.getEigenpair(i, vector).real)
        shape = vector.array.copy()
        shapes.append(shape / np.sqrt(shape @ (mass @ shape)))
    order = np.argsort(values)
    hz = np.sqrt(np.clip(np.array(values)[order], 0, None)) / (2 * np.pi)
    for thing in (eps, k, m, vector):
        thing.destroy()
    return hz, np.array(shapes).T[:, order]


def solver(matrix):
    """A function that solves with a symmetric matrix, factored once."""
    a = _matrix(matrix)
    ksp = PETSc.KSP().create(PETSc.COMM_SELF)
    ksp.setOperators(a)
    ksp.setType(PETSc.KSP.Type.PREONLY)
    pc = ksp.getPC()
    pc.setType(PETSc.PC.Type.CHOLESKY)
    pc.setFactorSolverType("mumps")
    x, b = a.createVecs()

    def solve(rhs: np.ndarray) -> np.ndarray:
        b.array[:] = rhs
        ksp.solve(b, x)
        return x.array.copy()

    return solve
