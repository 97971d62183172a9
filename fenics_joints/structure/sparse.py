"""Products of sparse matrices with blocks of columns, and K(p), M(p) as sums of kept matrices."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse
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
    # The matrix of a part or joint is empty but for its own rows.
    few = None
    if isinstance(A, PETSc.Mat) and A.comm.size == 1 and A.getInfo()["nz_used"] < X.size:
        few = _without_empty(A)  # copies A's entries, fewer than those of X that PETSc would copy
    if few is None:
        image, own = product(A, X), np.arange(len(Z))
    else:
        part, own, columns = few
        image = part @ X[columns]
    rows = np.flatnonzero(image.any(axis=1))
    if len(rows) < _FEW_ROWS * len(Z):
        Z, image = Z[own[rows]], image[rows]
    found = Z.T @ image
    if isinstance(A, np.ndarray):
        return found
    comm = A.comm.tompi4py() if isinstance(A, PETSc.Mat) else A.comm
    return comm.allreduce(found)


def _without_empty(A: PETSc.Mat) -> tuple[scipy.sparse.csr_array, np.ndarray, np.ndarray] | None:
    """A's rows and columns that have entries, and which they are; None if they are too many."""
    starts, columns, values = A.getValuesCSR()
    rows = np.flatnonzero(np.diff(starts))
    if len(rows) >= 0.5 * _FEW_ROWS * (len(starts) - 1):  # PETSc's product takes as long
        return None
    there = np.zeros(A.getSize()[1], dtype=bool)
    there[columns] = True
    csr = values, (np.cumsum(there) - 1)[columns], np.append(starts[rows], starts[-1])
    there = np.flatnonzero(there)
    return scipy.sparse.csr_array(csr, (len(rows), len(there))), rows, there


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


def row_pieces(A: PETSc.Mat, step: int) -> Iterator[tuple[int, scipy.sparse.csr_matrix]]:
    """This rank's rows some at a time, as (first row, rows with global columns). Collective.

    A's entries are not copied whole.

    Args:
        A: The matrix.
        step: Rows of a piece, the same on all ranks; the last ones have fewer or none.
    """
    first, last = A.getOwnershipRange()
    start, stop = A.getOwnershipRangeColumn()
    everything = PETSc.IS().createStride(stop - start, start, 1, comm=A.comm)
    for k in range(max(-(-int(np.diff(A.getOwnershipRanges()).max()) // step), 1)):
        low, high = (min(first + j * step, last) for j in (k, k + 1))
        some = PETSc.IS().createStride(high - low, low, 1, comm=A.comm)
        part = A.createSubMatrix(some, everything)
        at, columns, values = part.getValuesCSR()
        part.destroy(), some.destroy()
        yield low, scipy.sparse.csr_matrix((values, columns, at), (high - low, A.getSize()[1]))
    everything.destroy()


def filtered(A: PETSc.Mat, chosen: Callable) -> PETSc.Mat:
    """Copy of some entries of A. Collective.

    Args:
        A: The matrix.
        chosen: Of the first row of some rows, and those rows: which of their entries, as a mask.
    """
    most, kept = int(np.diff(A.getOwnershipRanges()).max()), []
    for low, rows in row_pieces(A, max(-(-most // _CHUNKS), 1)):
        mask = chosen(low, rows)
        at = np.concatenate([[0], np.cumsum(mask)])[rows.indptr]
        kept.append(scipy.sparse.csr_matrix((rows.data[mask], rows.indices[mask], at), rows.shape))
    whole = scipy.sparse.vstack(kept, format="csr")
    pattern = (part.astype(PETSc.IntType) for part in (whole.indptr, whole.indices))
    lean = PETSc.Mat().createAIJ(A.getSizes(), csr=(*pattern, whole.data), comm=A.comm)
    lean.assemble()
    return lean


def without_zeros(A: PETSc.Mat) -> PETSc.Mat:
    """Copy of A without its stored zeros. Collective.

    A consistent mass in DOLFINx's blocked pattern is two-thirds zeros.
    """
    library = ctypes.CDLL(PETSc.__file__)  # petsc4py has no call for it, PETSc since 3.20
    if not hasattr(library, "MatEliminateZeros"):
        return filtered(A, lambda _, rows: rows.data != 0.0)
    whole = A.duplicate(copy=True)
    error = library.MatEliminateZeros(ctypes.c_void_p(whole.handle), ctypes.c_int(False))
    if error:
        raise PETSc.Error(error)
    lean = whole.duplicate(copy=True)  # in memory of its own size
    whole.destroy()
    return lean


#: Share of a sample in a sum, relative to the largest, and of an entry in the sum of the magnitudes
#: that it is made of, that is round-off.
_ROUND_OFF = 1e-13
#: Degrees of freedom above which nothing is kept, to save memory: chosen; a solution takes long
#: then in any case.
MOST = 300_000

#: `fenics_joints.structure.assembly.Assembly`, which holds these.
Assembly = Any


class LawMatrices:
    """A region's stiffness and mass at its law's samples, assembled when first asked for.

    Once the stiffness at all samples is there, the matrices before the law's scalars are kept
    instead: each has entries between a few of the displacement's directions only.

    Args:
        assembly: The structure.
        index: Index of the region in its ``regions``.
    """

    def __init__(self, assembly: Assembly, index: int):
        self.assembly, self.index = assembly, index
        self.law: Law = assembly.regions[index].law
        self.pattern: tuple[np.ndarray, np.ndarray] | None = None
        self._entries: tuple[dict[int, np.ndarray], ...] = ({}, {})
        self._of_terms: scipy.sparse.csr_array | None = None

    def entries(self, which: int, sample: int) -> np.ndarray:
        """Entries of this rank's rows of the stiffness (0) or mass (1) at a sample, (n_entries,).
        Collective."""
        if not which and self._of_terms is not None:
            return self._of_terms @ self._terms[sample]
        kept = self._entries[which]
        if sample not in kept:
            kept[sample] = self._assembled(which, sample)
        return kept[sample]

    def _assembled(self, which: int, sample: int) -> np.ndarray:
        self.assembly.field.fill(self.index, self.law.samples[sample])
        A = self.assembly.assembled(self.assembly.compiled_region(self.index, which))
        *self.pattern, entries = A.getValuesCSR()
        A.destroy()
        return entries

    def matrix(self, which: int, sample: int) -> PETSc.Mat:
        """One of them as a matrix, the caller's to destroy. Collective."""
        entries = self.entries(which, sample)
        return self._as_matrix(*self.pattern, entries)

    def terms(self) -> Iterator[PETSc.Mat] | None:
        """The stiffness before each of the law's scalars, the caller's to destroy; None until these
        are kept. Collective."""
        if self._of_terms is None:
            return None
        (starts, columns), by_term = self.pattern, self._of_terms.tocsc()
        parts = (by_term[:, [i]] for i in range(by_term.shape[1]))
        return (
            self._as_matrix(
                np.searchsorted(part.indices, starts).astype(starts.dtype),
                columns[part.indices],
                part.data,
            )
            for part in parts
        )

    def _as_matrix(self, *csr: np.ndarray) -> PETSc.Mat:
        own, bs = self.assembly.V.dofmap.index_map, self.assembly.V.dofmap.index_map_bs
        sizes = own.size_local * bs, own.size_global * bs
        return PETSc.Mat().createAIJ((sizes, sizes), csr=csr, comm=self.assembly.comm)

    def kept(self, which: int) -> tuple[int, ...]:
        """Samples that are there, or -1 for all the matrices before the scalars."""
        every = not which and self._of_terms is not None
        return (-1,) if every else tuple(sorted(self._entries[which]))

    def columns(self, which: int) -> scipy.sparse.csr_array:
        """Entries of what is `kept`, (n_entries, n)."""
        if which or self._of_terms is None:
            kept = self._entries[which]
            entries = [kept[sample] for sample in sorted(kept)]
            if which or len(kept) < len(self.law.samples):
                return scipy.sparse.csr_array(np.column_stack(entries))
            self._of_terms = self._split(entries)
            kept.clear()
        return self._of_terms

    def _split(self, entries: list[np.ndarray]) -> scipy.sparse.csr_array:
        """Entries before the law's scalars, (n_entries, n), of those at all samples.

        An entry has a few of the scalars alone. All samples give them by least squares, so that
        round-off is not more than in a sum of samples. Some entries at a time, as together they are
        many times as large.
        """
        inverse, parts = np.linalg.inv(self._terms), []
        bits = 1 << np.arange(len(inverse))
        bounds = np.linspace(0, len(entries[0]), _CHUNKS + 1).astype(int)
        for low, high in zip(bounds[:-1], bounds[1:], strict=True):
            some = np.stack([own[low:high] for own in entries])
            there = np.abs(inverse @ some) > _ROUND_OFF * (np.abs(inverse) @ np.abs(some))
            codes, terms = bits @ there, np.zeros_like(some)
            for code in np.unique(codes):
                at, has = np.flatnonzero(codes == code), np.flatnonzero(bits & code)
                terms[np.ix_(has, at)] = np.linalg.pinv(self._terms[:, has]) @ some[:, at]
            parts.append(scipy.sparse.csr_array(terms.T))
        return scipy.sparse.vstack(parts, format="csr")

    def weights(self, which: int, q: Mapping[str, float]) -> np.ndarray:
        """Factors of `columns` in the matrix at given properties, (n,)."""
        if not which and self._of_terms is not None:
            return np.asarray(self.law.stiffness_terms(q), dtype=float)
        return self.shares(which, q)[list(self.kept(which))]

    def missing(self, which: int, q: Mapping[str, float]) -> list[int]:
        """Samples of which the matrix at given properties has a share, and that are not there."""
        if not which and self._of_terms is not None:
            return []
        used = np.flatnonzero(self.shares(which, q)).tolist()
        return [sample for sample in used if sample not in self._entries[which]]

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
    """Stiffness and mass of all regions as sums of kept matrices, by one product of a sparse matrix
    with the vector of their factors.

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
        self._columns: list[tuple | None] = [None, None]

    def matrix(self, which: int, values: Mapping[str, float]) -> PETSc.Mat | None:
        """Stiffness (0), with the identity in rows of held DOFs, or mass (1). Collective.

        Args:
            which: 0 or 1.
            values: Of all parameters, which the property field holds too.

        Returns:
            A new matrix; None as long as assembling the samples would take longer than it saves.
        """
        if self.assembly.n_dofs > MOST or not self._uniform:
            return None
        self._asked[which] += 1
        if self._like is None or self._many:
            return None
        own = [self._properties(laws, values) for laws in self._uniform]
        missing = [laws.missing(which, q) for laws, q in zip(self._uniform, own, strict=True)]
        if max(map(len, missing)) >= self._asked[which]:
            return None
        for laws, samples in zip(self._uniform, missing, strict=True):
            for sample in samples:
                laws.entries(which, sample)
        if any(missing) or self._graded:
            self.assembly.field.update(values)  # samples were put into it
        columns = self._all_columns(which)
        weights = [laws.weights(which, q) for laws, q in zip(self._uniform, own, strict=True)]
        found = columns @ np.concatenate(weights)
        for laws in self._graded:
            *pattern, entries = self.assembly.region_matrix(laws.index, which, None).getValuesCSR()
            found[np.searchsorted(self._keys, _keys(*pattern, self.assembly.n_dofs))] += entries
        return self._as_matrix(found, which)

    def assemble_samples(self) -> None:
        """Assemble all samples, so that no later matrix depends on what was asked for before it, to
        the last bit. Collective."""
        if self.assembly.n_dofs > MOST:
            return
        for laws in self._uniform:
            laws.entries(1, 0)
            for sample in () if laws.kept(0) == (-1,) else range(len(laws.law.samples)):
                laws.entries(0, sample)
            laws.columns(0)
        self._asked = [np.inf, np.inf]

    def learn(self, A: PETSc.Mat) -> None:
        """Keep the pattern of a matrix of all regions. Collective."""
        if self._like is None and self.assembly.n_dofs <= MOST:
            self._like = A.duplicate(copy=False)

    @cached_property
    def _pattern(self) -> tuple[np.ndarray, np.ndarray]:
        """Starts of rows and columns."""
        return self._like.getValuesCSR()[:2]

    @cached_property
    def _many(self) -> bool:
        """Whether the regions' matrices have more starts of rows than all of them have entries."""
        starts = len(self._uniform) * self.assembly.n_local
        return bool(self.assembly.comm.allreduce(starts - len(self._pattern[1])) > 0)

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

    def _all_columns(self, which: int) -> scipy.sparse.csr_array:
        """Entries of all that is kept, side by side, at the entries of the pattern."""
        before = self._columns[which]
        if before is None or before[0] != [laws.kept(which) for laws in self._uniform]:
            self._columns[which] = before = None
            none = scipy.sparse.coo_array((len(self._pattern[1]), 0))
            placed = [self._placed(laws, which) for laws in self._uniform if laws.kept(which)]
            columns = scipy.sparse.hstack([none, *placed], format="csr")
            before = [laws.kept(which) for laws in self._uniform], columns
            self._columns[which] = before
        return before[1]

    def _placed(self, laws: LawMatrices, which: int) -> scipy.sparse.coo_array:
        found = laws.columns(which).tocoo()
        places = np.searchsorted(self._keys, _keys(*laws.pattern, self.assembly.n_dofs))
        at = places[found.coords[0]].astype(np.int32), found.coords[1]
        return scipy.sparse.coo_array((found.data, at), (len(self._keys), found.shape[1]))

    def _as_matrix(self, entries: np.ndarray, which: int) -> PETSc.Mat:
        if not which:
            entries[self._held] = 1.0
        if self.assembly.comm.size == 1:  # the entries themselves are the matrix's
            A = PETSc.Mat().createAIJWithArrays(
                self._like.getSizes(),
                (*self._pattern, entries),
                bsize=self._like.getBlockSizes(),
                comm=self._like.comm,
            )
            A.setLGMap(*self._like.getLGMap())
        else:
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
