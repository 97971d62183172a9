"""Products of sparse matrices with eight columns at once, and Gauss-Seidel on them.

A product with one vector waits for the matrix to come from memory; eight columns take it once, and
of a symmetric matrix the upper half. Compiled from ``blocks.c`` when first used. Blocks of columns
are arrays of this rank's rows, (n_local, 8), row by row.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc
from scipy import sparse

from fenics_joints.machine.c_code import compiled
from fenics_joints.structure.sparse import row_pieces

#: Columns of a block.
WIDTH = 8
#: Rows of nodes that are copied at once, to save memory: chosen.
_CHUNK = 4_000
#: Relative size of an entry of a mass, or an eigenvalue of a diagonal block, that is round-off.
_ROUND_OFF = 1e-12
_DECLARATIONS = """
int blocks_multiply(int size, int n, const long *at, const int *column, const double *a,
                    const double *x, double *y);
int blocks_smooth(int size, int n, const long *at, const int *column, const double *a,
                  const double *inverse, const double *extra, const double *b, double *z,
                  double *r);
"""


@cache
def _library():
    source = Path(__file__).with_name("blocks.c").read_text(encoding="utf-8")
    return compiled(source, _DECLARATIONS, "blocks")


@cache
def _unit(columns: int) -> MPI.Datatype:
    """A row of numbers."""
    return MPI.DOUBLE.Create_contiguous(columns).Commit()


class Ghosts:
    """Rows that other ranks own, fetched, or sent back and added. Collective.

    Args:
        comm: Communicator.
        ranges: First row of each rank, and the end, (n_ranks + 1,).
        rows: Global numbers of the rows wanted, ascending.
    """

    def __init__(self, comm: MPI.Comm, ranges: np.ndarray, rows: np.ndarray):
        self.n, self._sf = len(rows), None
        if comm.size > 1:
            owner = np.searchsorted(ranges, rows, side="right") - 1
            remote = np.stack([owner, rows - ranges[owner]], axis=1).astype(PETSc.IntType)
            self._sf = PETSc.SF().create(comm)
            self._sf.setGraph(int(ranges[comm.rank + 1] - ranges[comm.rank]), None, remote.ravel())

    def fetch(self, X: np.ndarray) -> np.ndarray:
        """The rows, (n, k), of X, (n_local, k)."""
        out = np.empty((self.n, X.shape[1]))
        if self._sf is not None:
            unit = _unit(X.shape[1])
            self._sf.bcastBegin(unit, X, out, MPI.REPLACE)
            self._sf.bcastEnd(unit, X, out, MPI.REPLACE)
        return out

    def give(self, ghosts: np.ndarray, X: np.ndarray) -> None:
        """Add rows, (n, k), to those of their owners in X, (n_local, k)."""
        if self._sf is not None:
            unit = _unit(X.shape[1])
            self._sf.reduceBegin(unit, ghosts, X, MPI.SUM)
            self._sf.reduceEnd(unit, ghosts, X, MPI.SUM)

    def destroy(self) -> None:
        """Free it. Collective."""
        if self._sf is not None:
            self._sf.destroy()


class Rows:
    """A sparse matrix by this rank's rows, and its transpose. Collective.

    Args:
        rows: This rank's rows with global columns.
        comm: Communicator.
        ranges: First column of each rank, and the end, (n_ranks + 1,).
    """

    def __init__(self, rows: sparse.csr_matrix, comm: MPI.Comm, ranges: np.ndarray):
        start, stop = ranges[comm.rank], ranges[comm.rank + 1]
        own = (rows.indices >= start) & (rows.indices < stop)
        ghosts = np.unique(rows.indices[~own])
        self.n = stop - start
        place = np.searchsorted(ghosts, rows.indices) + self.n
        place = np.where(own, rows.indices - start, place).astype(np.int32)
        shape = rows.shape[0], self.n + len(ghosts)
        self.local = sparse.csr_matrix((rows.data, place, rows.indptr), shape)
        self._ghosts = Ghosts(comm, ranges, ghosts)

    @classmethod
    def of(cls, P: PETSc.Mat) -> Rows:
        """Of a PETSc matrix, which is not kept."""
        rows = sparse.vstack([rows for _, rows in row_pieces(P, _CHUNK)], format="csr")
        return cls(rows, P.comm.tompi4py(), np.asarray(P.getOwnershipRangesColumn()))

    def __matmul__(self, X: np.ndarray) -> np.ndarray:
        """The product with X, (n_local_columns, k)."""
        ghosts = self._ghosts.fetch(X)
        return self.local @ (np.concatenate([X, ghosts]) if len(ghosts) else X)

    def transposed(self, R: np.ndarray) -> np.ndarray:
        """The transpose's product with R, (n_local, k)."""
        found = self.local.T @ R
        out = np.ascontiguousarray(found[: self.n])
        self._ghosts.give(np.ascontiguousarray(found[self.n :]), out)
        return out

    def destroy(self) -> None:
        """Free it."""
        self._ghosts.destroy()


class Mass:
    """A mass matrix, which is a number for each pair of nodes where no DOF is held.

    Args:
        M: The matrix, with the pattern of all pairs of DOFs; not kept.
        held: Which of this rank's DOFs have no mass as they are held, (n_local,).
        size: DOFs of a node.
    """

    def __init__(self, M: PETSc.Mat, held: np.ndarray, size: int):
        comm = M.comm.tompi4py()
        ranges = np.asarray(M.getOwnershipRanges())
        everywhere = np.concatenate(comm.allgather(~held)).reshape(-1, size)
        kept, scalar = [], True
        for low, rows in row_pieces(M, _CHUNK * size):
            blocks = rows.tobsr((size, size))
            row = np.repeat(np.arange(len(blocks.indptr) - 1), np.diff(blocks.indptr)) + low // size
            both = everywhere[row] & everywhere[blocks.indices]
            diagonal = np.diagonal(blocks.data, axis1=1, axis2=2)
            number = np.take_along_axis(diagonal, abs(diagonal).argmax(1)[:, None], 1)
            rest = blocks.data.copy()
            rest[:, range(size), range(size)] -= np.where(both, number, 0.0)
            scalar &= np.abs(rest).max(initial=0.0) <= _ROUND_OFF * np.abs(number).max(initial=0.0)
            shape = len(blocks.indptr) - 1, M.getSize()[1] // size
            kept.append(sparse.csr_matrix((number.ravel(), blocks.indices, blocks.indptr), shape))
            kept[-1].eliminate_zeros()
        self._free = (~held).astype(float)[:, None]
        if comm.allreduce(scalar, op=MPI.LAND):
            self.size = size
        else:
            self.size, kept = 1, []
            for _, rows in row_pieces(M, _CHUNK * size):
                rows.eliminate_zeros()
                kept.append(rows)
        self.rows = Rows(sparse.vstack(kept, format="csr"), comm, ranges // self.size)

    @property
    def diagonal(self) -> np.ndarray:
        """This rank's diagonal, (n_local,)."""
        return np.repeat(self.rows.local.diagonal(), self.size) * self._free[:, 0]

    def __matmul__(self, X: np.ndarray) -> np.ndarray:
        """M X. Collective."""
        if self.size == 1:
            return self.rows @ X
        shape = len(X) // self.size, self.size * X.shape[1]
        out = (self.rows @ (X * self._free).reshape(shape)).reshape(X.shape)
        out *= self._free
        return out

    def destroy(self) -> None:
        """Free it. Collective."""
        self.rows.destroy()


class SymmetricBlocks:
    """A symmetric matrix: the upper half of this rank's square, and its ghosts' columns.

    Args:
        A: The matrix, with all its entries; not kept.
        size: DOFs of a node, six at most.
    """

    def __init__(self, A: PETSc.Mat, size: int):
        self.comm, self.size = A.comm.tompi4py(), size
        first, last = (k // size for k in A.getOwnershipRange())
        self.n = n = last - first
        counts = np.zeros(n, dtype=np.int64)
        self._columns, self._values = np.empty(0, dtype=np.int32), np.empty((0, size, size))
        outer = []
        for low, rows in row_pieces(A, _CHUNK * size):
            blocks = rows.tobsr((size, size))
            blocks.sort_indices()
            row = np.repeat(np.arange(len(blocks.indptr) - 1), np.diff(blocks.indptr)) + low // size
            own = (blocks.indices >= first) & (blocks.indices < last)
            upper = own & (blocks.indices >= row)
            used = len(self._columns)
            more = used + np.count_nonzero(upper)
            # In place: a list of pieces and what is made of it would be there at once.
            self._columns.resize(more, refcheck=False)
            self._values.resize((more, size, size), refcheck=False)
            self._columns[used:] = blocks.indices[upper] - first
            self._values[used:] = blocks.data[upper]
            counts += np.bincount(row[upper] - first, minlength=n)
            outer.append((row[~own] - first, blocks.indices[~own], blocks.data[~own]))
        self._at = np.concatenate([[0], np.cumsum(counts)])
        self._between(*(np.concatenate(part) for part in zip(*outer, strict=True)), A)
        self._invert()

    def _between(self, row, column, entries, A) -> None:
        """The columns of other ranks, of which the rows come in blocks."""
        size = self.size
        ghosts, column = np.unique(column, return_inverse=True)
        starts = np.concatenate([[0], np.cumsum(np.bincount(row, minlength=self.n))])
        shape = self.n * size, len(ghosts) * size
        self._outer = sparse.bsr_matrix(
            (entries, column, starts), shape, blocksize=(size, size)
        ).tocsr()
        self._ghosts = Ghosts(self.comm, np.asarray(A.getOwnershipRanges()) // size, ghosts)

    def _invert(self) -> None:
        """Inverses of the diagonal blocks; of an aggregate of one node, which has no turns, theirs.

        Couplings to other ranks, which Gauss-Seidel leaves out, count on the diagonal: its product
        with A then has no eigenvalue above 1 (Baker, Falgout, Kolev and Yang, SIAM J. Sci. Comput.
        33, 2011).
        """
        size = self.size
        self._extra = np.asarray(abs(self._outer).sum(axis=1)).reshape(self.n, size)
        blocks = self._values[self._at[:-1]]
        blocks[:, range(size), range(size)] += self._extra
        s, Q = np.linalg.eigh(blocks)
        good = s > _ROUND_OFF * s[:, -1:]
        s = np.where(good, 1.0 / np.where(good, s, 1.0), 0.0)
        self._inverse = np.ascontiguousarray((Q * s[:, None, :]) @ Q.transpose(0, 2, 1))

    @property
    def diagonal(self) -> np.ndarray:
        """This rank's diagonal, (n_local,)."""
        return np.diagonal(self._values[self._at[:-1]], axis1=1, axis2=2).ravel()

    def _remote(self, X: np.ndarray) -> np.ndarray:
        ghosts = self._ghosts.fetch(X.reshape(self.n, self.size * X.shape[1]))
        return self._outer @ ghosts.reshape(-1, X.shape[1])

    def __matmul__(self, X: np.ndarray) -> np.ndarray:
        """A X. Collective."""
        X = np.ascontiguousarray(X)
        Y = np.zeros_like(X)
        self._run("blocks_multiply", X, Y)
        if self.comm.size > 1:
            Y += self._remote(X)
        return Y

    def gauss_seidel(self, B: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A step of symmetric Gauss-Seidel from zero, of each rank by itself. Collective.

        Returns:
            The solutions Z for B, and the residuals B - A Z, which come at no further cost.
        """
        B = np.ascontiguousarray(B)
        Z, R = np.empty_like(B), np.zeros_like(B)
        self._run("blocks_smooth", self._inverse, self._extra, B, Z, R)
        if self.comm.size > 1:
            R -= self._remote(Z)
        return Z, R

    def _run(self, name: str, *arrays: np.ndarray) -> None:
        library = _library()
        kinds = {"d": "double *", "l": "long *", "i": "int *"}
        pointers = [
            library.ffi.cast(kinds[a.dtype.char], a.ctypes.data)
            for a in (self._at, self._columns, self._values, *arrays)
        ]
        getattr(library.lib, name)(self.size, self.n, *pointers)

    def destroy(self) -> None:
        """Free it. Collective."""
        self._ghosts.destroy()
