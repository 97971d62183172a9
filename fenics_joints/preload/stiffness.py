"""The stiffness in x, of which one copy serves products and preconditioners.

What contact and supports hold or give springs, C, is a small share of x. With N the rest,
K = K_NN + D, where D has all rows and columns of C. A preconditioner needs the matrix with some of
C held, A = K_NN + D', and a product takes K_NN from that: K x = A x_N in the rows of N, plus D x.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse
from petsc4py import PETSc

from fenics_joints.structure.sparse import filtered

_NONE = np.empty((0, 1), dtype=np.int64)
_SAME = PETSc.Mat.Structure.SAME_NONZERO_PATTERN


class Stiffness:
    """Context of PETSc's Python matrix: y = K x. Collective.

    Args:
        K: The stiffness, which becomes this one's.
        entries: Local numbers of the entries C.

    Attributes:
        A: The matrix, with what `hold` held last.
        near: D, the rows and columns of C.
        now: The same as A has it.
        diagonal: Diagonal of K.
        mean: Its mean, N/m.
    """

    def __init__(self, K: PETSc.Mat, entries: np.ndarray):
        self.A, self.entries, self.diagonal = K, entries, K.getDiagonal()
        self.mean = self.diagonal.sum() / self.diagonal.getSize()
        self._first = first = K.getOwnershipRange()[0]
        every = np.concatenate(K.comm.tompi4py().allgather(entries + first))
        marked = np.zeros(K.getSize()[0], dtype=bool)
        marked[every] = True

        def touched(low: int, rows: scipy.sparse.csr_matrix) -> np.ndarray:
            own = np.repeat(marked[low : low + rows.shape[0]], np.diff(rows.indptr))
            return own | marked[rows.indices]

        self.near = filtered(K, touched)
        self.now, self._work = self.near.copy(), K.createVecRight()

    def kept(self, held: np.ndarray) -> PETSc.Vec:
        """One where an entry is not held, else zero."""
        kept = self.diagonal.duplicate()
        kept.set(1.0)
        kept.array[held] = 0.0
        return kept

    def hold(self, held: np.ndarray, numbers=_NONE, springs=_NONE[..., None], A=None) -> None:
        """Put the present state into A: some entries held, and springs at others. Collective.

        Args:
            held: Local numbers of entries of C, whose rows and columns get the mean of the diagonal
                alone.
            numbers: Local numbers of entries of C, (n, k).
            springs: Blocks that are added there, (n, k, k).
            A: Another matrix, of A's pattern.
        """
        kept = self.kept(held)
        self.near.copy(self.now, structure=_SAME)
        self.now.diagonalScale(kept, kept)
        kept.destroy()
        diagonal = np.full((len(held), 1, 1), self.mean)
        for at, blocks in ((held[:, None], diagonal), (numbers, springs)):
            set_blocks(self.now, at + self._first, blocks, PETSc.InsertMode.ADD_VALUES)
        put_rows(self.now, self.A if A is None else A)

    def mult(self, mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """PETSc's product."""
        x.copy(self._work)
        self._work.array[self.entries] = 0.0
        self.A.mult(self._work, y)
        y.array[self.entries] = 0.0
        self.near.multAdd(x, y, y)

    def getDiagonal(self, mat: PETSc.Mat, diagonal: PETSc.Vec) -> None:
        """PETSc's diagonal."""
        self.diagonal.copy(diagonal)

    def destroy(self, mat: PETSc.Mat | None = None) -> None:
        """Free everything. Collective."""
        for owned in (self.A, self.near, self.now, self.diagonal, self._work):
            owned.destroy()


def put_rows(rows: PETSc.Mat, A: PETSc.Mat) -> None:
    """Put the entries that one matrix has into another, and assemble. Collective."""
    A.setValuesCSR(*rows.getValuesCSR())
    A.assemble()


def set_blocks(A: PETSc.Mat, rows: np.ndarray, blocks: np.ndarray, mode) -> None:
    """Put dense blocks, (n, k, k), at global rows and columns, (n, k), and assemble. Collective."""
    (n, k), rows = rows.shape, rows.astype(np.int32)
    starts = np.arange(0, n * k * k + 1, k, dtype=np.int32)
    columns = np.repeat(rows[:, None, :], k, axis=1).ravel()
    A.setValuesIJV(starts, columns, blocks.ravel(), addv=mode, rowmap=rows.ravel())
    A.assemble()
