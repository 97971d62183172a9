"""Products of sparse matrices with blocks of columns, of which each rank has its rows."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from petsc4py import PETSc

#: Parts of a matrix whose rows are copied one after the other.
_CHUNKS = 8


class MatrixForm:
    """A sparse matrix; ``owned`` if nobody else keeps it. Collective."""

    def __init__(self, A: PETSc.Mat, owned: bool = False):
        self.A, self.owned = A, owned

    def __matmul__(self, X: np.ndarray) -> np.ndarray:
        """This rank's rows of A X, of a block of its rows."""
        return product(self.A, X)

    def destroy(self) -> None:
        """Free A, if it is owned. Collective."""
        if self.owned:
            self.A.destroy()


class RowForm:
    """factor * sum_k left_k right_k^T, with this rank's rows of both. Collective."""

    def __init__(self, left: np.ndarray, right: np.ndarray, factor: float, comm):
        self.left, self.right, self.factor, self.comm = left, right, factor, comm

    def __matmul__(self, X: np.ndarray) -> np.ndarray:
        """This rank's rows of the product with X, of a block of its rows."""
        return self.factor * self.left @ self.comm.allreduce(self.right.T @ X)

    def destroy(self) -> None:
        """Nothing to free."""


def product(A: PETSc.Mat, X: np.ndarray) -> np.ndarray:
    """``A X`` for this rank's rows of a block of columns; A need not be square. Collective."""
    dense = dense_block(A, X.shape[1])
    dense.getDenseArray()[:] = X
    image = A.matMult(dense)
    out = image.getDenseArray().copy(order="F")
    image.destroy()
    dense.destroy()
    return out


def absolute(A: PETSc.Mat) -> PETSc.Mat:
    """A new matrix of the magnitudes of A's entries. Collective."""
    rows, columns, values = A.getValuesCSR()
    return PETSc.Mat().createAIJ(A.getSizes(), csr=(rows, columns, np.abs(values)), comm=A.comm)


def dense_block(A: PETSc.Mat, columns: int) -> PETSc.Mat:
    """Dense matrix that A can multiply."""
    dense = PETSc.Mat().createDense([A.getSizes()[1], (None, columns)], comm=A.comm)
    dense.setUp()
    dense.assemble()
    return dense


def vectors_like(one: PETSc.Vec, rows: Iterable[np.ndarray]) -> list[PETSc.Vec]:
    """Vectors laid out like one, each with this rank's values of a row."""
    found = []
    for row in rows:
        found.append(one.duplicate())
        found[-1].array[:] = row
    return found


def combination(vectors: Sequence[PETSc.Vec], factors: np.ndarray) -> PETSc.Vec:
    """The sum of vectors times factors, (n,)."""
    rows = np.column_stack([vector.array_r for vector in vectors])
    return vectors_like(vectors[0], [rows @ factors])[0]


def without_zeros(A: PETSc.Mat) -> PETSc.Mat:
    """Copy of A without its stored zeros, some rows at a time: A's entries are not copied whole.

    A consistent mass in DOLFINx's blocked pattern is two-thirds zeros.
    """
    first, last = A.getOwnershipRange()
    start, stop = A.getOwnershipRangeColumn()
    everything = PETSc.IS().createStride(stop - start, start, 1, comm=A.comm)
    bounds = np.linspace(first, last, _CHUNKS + 1).astype(PETSc.IntType)
    counts, columns, values = [], [], []
    for low, high in zip(bounds[:-1], bounds[1:], strict=True):
        some = PETSc.IS().createStride(high - low, low, 1, comm=A.comm)
        part = A.createSubMatrix(some, everything)
        at, column, value = part.getValuesCSR()
        part.destroy(), some.destroy()
        keep = value != 0.0
        counts.append(np.diff(np.concatenate([[0], np.cumsum(keep)])[at]))
        columns.append(column[keep])
        values.append(value[keep])
    everything.destroy()
    at = np.concatenate([[0], np.cumsum(np.concatenate(counts))]).astype(PETSc.IntType)
    csr = at, np.concatenate(columns), np.concatenate(values)
    lean = PETSc.Mat().createAIJ(A.getSizes(), csr=csr, comm=A.comm)
    lean.assemble()
    return lean
