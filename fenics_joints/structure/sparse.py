"""Products of sparse matrices with blocks of columns, and K(p), M(p) as sums of kept matrices."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from petsc4py import PETSc

from fenics_joints.structure.components import number
from fenics_joints.structure.laws import Law

#: Parts in which the rows of a matrix are copied, one after the other: chosen, for memory.
_CHUNKS = 8
#: Share of rows with entries below which rows of zeros are left out of a product: chosen, for time.
_FEW_ROWS = 0.5


class MatrixForm:
    """A sparse matrix, to be destroyed with the form if it is ``owned``. Collective.

    Attributes:
        A: The matrix.
        rows: This rank's rows, of which alone the form consists; None for all.
    """

    def __init__(self, A: PETSc.Mat, owned: bool = False, rows: np.ndarray | None = None):
        self.A, self.owned, self.comm, self.rows = A, owned, A.comm.tompi4py(), rows

    def __matmul__(self, X: np.ndarray) -> np.ndarray:
        """This rank's rows of the product with X, of a block of its rows."""
        image = product(self.A, X)
        if self.rows is None:
            return image
        found = np.zeros_like(image)
        found[self.rows] = image[self.rows]
        return found

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


Matrix = PETSc.Mat | np.ndarray | MatrixForm | RowForm


def product(A: Matrix, X: np.ndarray) -> np.ndarray:
    """``A X`` for this rank's rows of a block of columns. Collective.

    Args:
        A: A matrix, which need not be square; an array, or one of the forms of this module.
        X: This rank's rows, (n_local, k).
    """
    if not isinstance(A, PETSc.Mat):
        return A @ X
    dense = dense_block(A, X.shape[1])
    dense.getDenseArray()[:] = X
    image = A.matMult(dense)
    out = image.getDenseArray().copy(order="F")
    image.destroy()
    dense.destroy()
    return out


def cross(A: Matrix, Z: np.ndarray, X: np.ndarray) -> np.ndarray:
    """``Z^T A X``, equal on all ranks. Collective.

    Args:
        A: See `product`.
        Z: This rank's rows, (n_local, m).
        X: Likewise, (n_local, k).
    """
    image = product(A, X)
    # The matrix of a part or joint is empty but for its own rows.
    rows = np.flatnonzero(image.any(axis=1))
    if len(rows) < _FEW_ROWS * len(image):
        Z, image = Z[rows], image[rows]
    found = Z.T @ image
    if isinstance(A, np.ndarray):
        return found
    comm = A.comm.tompi4py() if isinstance(A, PETSc.Mat) else A.comm
    return comm.allreduce(found)


def slope_products(
    slopes: Iterable[tuple[int, str, str | None, Matrix]], Z: np.ndarray, X: np.ndarray
) -> Iterator[tuple[int, str, str | None, np.ndarray]]:
    """``Z^T A X`` in the place of each form A of a model's ``slopes``, which are destroyed.
    Collective.

    Forms that are rows of one matrix multiply it once.

    Args:
        slopes: See `fenics_joints.structure.model.Damped.slopes`.
        Z: This rank's rows, (n_local, m).
        X: Likewise, (n_local, k).

    Yields:
        The same with (m, k), equal on all ranks.
    """
    A = image = None
    for parameter, kind, name, form in slopes:
        if getattr(form, "rows", None) is None:
            found = cross(form, Z, X)
        else:
            if form.A is not A:
                A, image = form.A, product(form.A, X)
            found = form.comm.allreduce(Z[form.rows].T @ image[form.rows])
        if not isinstance(form, np.ndarray):
            form.destroy()
        yield parameter, kind, name, found


def project(A: Matrix, X: np.ndarray, known: np.ndarray | None = None) -> np.ndarray:
    """``X^T A X``, made symmetric, equal on all ranks. Collective.

    Args:
        A: See `product`.
        X: This rank's rows of a basis, (n_local, n).
        known: The result of the first k vectors, (k, k); None if unknown.
    """
    known = np.zeros((0, 0)) if known is None else known
    return bordered(known, cross(A, X, X[:, len(known) :]))


def bordered(first: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Symmetric matrices from a first block and the columns beside and below it.

    Args:
        first: (..., n, n).
        new: (..., n + k, k).

    Returns:
        (..., n + k, n + k).
    """
    n, size = first.shape[-1], new.shape[-2]
    whole = np.empty((*new.shape[:-2], size, size))
    whole[..., :n, :n] = first
    whole[..., n:] = new
    whole[..., n:, :n] = np.swapaxes(new[..., :n, :], -1, -2)
    return 0.5 * (whole + np.swapaxes(whole, -1, -2))


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


def as_columns(vectors: Sequence[PETSc.Vec]) -> np.ndarray:
    """This rank's rows of vectors, (n_local, k), each column in one piece as PETSc has it."""
    return np.array([vector.array_r for vector in vectors]).T


def vectors_like(one: PETSc.Vec, rows: Iterable[np.ndarray]) -> list[PETSc.Vec]:
    """Vectors laid out like one, each with this rank's values of a row."""
    found = []
    for row in rows:
        found.append(one.duplicate())
        found[-1].array[:] = row
    return found


def combination(vectors: Sequence[PETSc.Vec], factors: np.ndarray) -> PETSc.Vec:
    """The sum of vectors times factors, (n,)."""
    return vectors_like(vectors[0], [as_columns(vectors) @ factors])[0]


def without_zeros(A: PETSc.Mat) -> PETSc.Mat:
    """Copy of A without its stored zeros, some rows at a time: A's entries are not copied whole.

    A consistent mass in DOLFINx's blocked pattern is two-thirds zeros.
    """
    first, last = A.getOwnershipRange()
    start, stop = A.getOwnershipRangeColumn()
    everything = PETSc.IS().createStride(stop - start, start, 1, comm=A.comm)
    bounds = np.linspace(first, last, _CHUNKS + 1).astype(PETSc.IntType)
    counts, numbers, values = [], [], []
    for low, high in zip(bounds[:-1], bounds[1:], strict=True):
        some = PETSc.IS().createStride(high - low, low, 1, comm=A.comm)
        part = A.createSubMatrix(some, everything)
        at, column, value = part.getValuesCSR()
        part.destroy(), some.destroy()
        keep = value != 0.0
        counts.append(np.diff(np.concatenate([[0], np.cumsum(keep)])[at]))
        numbers.append(column[keep])
        values.append(value[keep])
    everything.destroy()
    at = np.concatenate([[0], np.cumsum(np.concatenate(counts))]).astype(PETSc.IntType)
    csr = at, np.concatenate(numbers), np.concatenate(values)
    lean = PETSc.Mat().createAIJ(A.getSizes(), csr=csr, comm=A.comm)
    lean.assemble()
    return lean


#: Share of a sample in a sum, relative to the largest, that is round-off.
_ROUND_OFF = 1e-13
#: Degrees of freedom above which nothing is kept, to save memory: chosen; a solution takes long
#: then in any case.
_MOST = 300_000

#: `fenics_joints.structure.assembly.Assembly`, which holds these.
Assembly = Any


class LawMatrices:
    """A region's stiffness and mass at its law's samples, assembled when first asked for.

    They share a pattern: it takes 8 bytes for each entry and sample, and 8 for the pattern.

    Args:
        assembly: The structure.
        index: Index of the region in its ``regions``.
    """

    def __init__(self, assembly: Assembly, index: int):
        self.assembly, self.index = assembly, index
        self.law: Law = assembly.regions[index].law
        self._entries: dict[tuple[int, int], np.ndarray] = {}
        self._pattern: tuple[np.ndarray, np.ndarray] | None = None
        self._places: np.ndarray | None = None

    def entries(self, which: int, sample: int) -> np.ndarray:
        """Entries of this rank's rows of the stiffness (0) or mass (1) at a sample, (n_entries,).
        Collective."""
        if (which, sample) not in self._entries:
            self._entries[which, sample] = self._assembled(which, sample)
        return self._entries[which, sample]

    def _assembled(self, which: int, sample: int) -> np.ndarray:
        self.assembly.field.fill(self.index, self.law.samples[sample])
        A = self.assembly.assembled(self.assembly.compiled_region(self.index, which))
        *self._pattern, entries = A.getValuesCSR()
        A.destroy()
        return entries

    def matrix(self, which: int, sample: int) -> PETSc.Mat:
        """One of them as a matrix, the caller's to destroy. Collective."""
        entries = self.entries(which, sample)
        own, bs = self.assembly.V.dofmap.index_map, self.assembly.V.dofmap.index_map_bs
        sizes = own.size_local * bs, own.size_global * bs
        return PETSc.Mat().createAIJ(
            (sizes, sizes), csr=(*self._pattern, entries), comm=self.assembly.comm
        )

    def sum(self, which: int, shares: np.ndarray) -> np.ndarray:
        """Entries of the sum of the samples by their shares, (n_entries,). Collective."""
        return sum(shares[i] * self.entries(which, int(i)) for i in np.flatnonzero(shares))

    def places(self, keys: np.ndarray) -> np.ndarray:
        """Positions of the entries among those of a larger pattern, given by its `_keys`."""
        if self._places is None:
            found = np.searchsorted(keys, _keys(*self._pattern, self.assembly.n_dofs))
            self._places = found.astype(PETSc.IntType)
        return self._places

    def missing(self, which: int, shares: np.ndarray) -> int:
        """Number of samples in a sum with these shares that have not been assembled."""
        return sum((which, int(i)) not in self._entries for i in np.flatnonzero(shares))

    def shares(self, which: int, q: Mapping[str, float]) -> np.ndarray:
        """Shares of the samples in the matrix at given properties."""
        law = self.law
        if which:
            return np.array([law.inertia_term(q) / law.inertia_term(law.samples[0])], dtype=float)
        found = np.linalg.solve(self._terms.T, np.asarray(law.stiffness_terms(q), dtype=float))
        return np.where(np.abs(found) > _ROUND_OFF * np.max(np.abs(found)), found, 0.0)

    @cached_property
    def _terms(self) -> np.ndarray:
        return np.array([self.law.stiffness_terms(q) for q in self.law.samples], dtype=float)


class SummedMatrices:
    """Stiffness and mass of all regions as sums of those at their laws' samples.

    Args:
        assembly: The structure. Regions graded in space are assembled each time.
    """

    def __init__(self, assembly: Assembly):
        self.assembly = assembly
        self.laws = [LawMatrices(assembly, i) for i in range(len(assembly.regions))]
        graded = [any(map(callable, r.properties.values())) for r in assembly.regions]
        self._uniform = [laws for laws, g in zip(self.laws, graded, strict=True) if not g]
        self._graded = [laws for laws, g in zip(self.laws, graded, strict=True) if g]
        self._asked = [0, 0]
        self._like: PETSc.Mat | None = None

    def matrix(self, which: int, values: Mapping[str, float]) -> PETSc.Mat | None:
        """Stiffness (0), with the identity in rows of held DOFs, or mass (1). Collective.

        Args:
            which: 0 or 1.
            values: Of all parameters, which the property field holds too.

        Returns:
            A new matrix; None as long as assembling the samples would take longer than it saves.
        """
        if self.assembly.n_dofs > _MOST or not self._uniform or self._like is None:
            return None
        if len(self._uniform) * self.assembly.n_local > len(self._pattern[1]):
            return None
        own = [(laws, laws.shares(which, self._properties(laws, values))) for laws in self._uniform]
        missing = max(laws.missing(which, s) for laws, s in own)
        self._asked[which] += 1
        if missing >= self._asked[which] or self._like is None:
            return None
        found = self._sum(which, own)
        if missing or self._graded:
            self.assembly.field.update(values)  # samples were put into it
        for laws in self._graded:
            *pattern, entries = self.assembly.region_matrix(laws.index, which, None).getValuesCSR()
            found[np.searchsorted(self._keys, _keys(*pattern, self.assembly.n_dofs))] += entries
        return self._as_matrix(found, which)

    def learn(self, A: PETSc.Mat) -> None:
        """Keep the pattern of a matrix of all regions. Collective."""
        if self._like is None and self.assembly.n_dofs <= _MOST:
            self._like = A.duplicate(copy=False)
            *self._pattern, _ = A.getValuesCSR()

    @cached_property
    def _keys(self) -> np.ndarray:
        return _keys(*self._pattern, self.assembly.n_dofs)

    @cached_property
    def _held(self) -> np.ndarray:
        """Positions of the diagonal entries of held DOFs."""
        own = np.flatnonzero(self.assembly.held_dofs[: self.assembly.n_local])
        first = self._like.getOwnershipRange()[0]
        return np.searchsorted(self._keys, own * self.assembly.n_dofs + first + own)

    def _properties(self, laws: LawMatrices, values) -> dict[str, float]:
        properties = self.assembly.regions[laws.index].properties
        return {key: number(properties[key], values) for key in laws.law.properties}

    def _sum(self, which: int, own) -> np.ndarray:
        total = np.zeros(len(self._pattern[1]))
        for laws, shares in own:
            if np.any(shares):
                entries = laws.sum(which, shares)
                total[laws.places(self._keys)] += entries
        return total

    def _as_matrix(self, entries: np.ndarray, which: int) -> PETSc.Mat:
        if not which:
            entries[self._held] = 1.0
        A = self._like.duplicate(copy=False)
        A.setValuesCSR(*self._pattern, entries)
        A.assemble()
        for option in ("SYMMETRIC", "SYMMETRY_ETERNAL", "NEW_NONZERO_ALLOCATION_ERR"):
            A.setOption(getattr(PETSc.Mat.Option, option), True)
        return A


def _keys(starts: np.ndarray, columns: np.ndarray, n: int) -> np.ndarray:
    """A number for each entry of this rank's rows, ascending."""
    rows = np.repeat(np.arange(len(starts) - 1, dtype=np.int64), np.diff(starts))
    return rows * n + columns
