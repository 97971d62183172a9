"""Vectors from samples of a structure's parameters, made into a basis (proper orthogonal
decomposition in the energy of one sample)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Protocol

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from fenics_joints.errors import InputError
from fenics_joints.modal.modes import Modes
from fenics_joints.structure.sparse import vectors_like
from fenics_joints.structure.structure import Structure

#: Tolerance of modes that span a basis; their own error matters by its square.
SNAPSHOT = 1e-4
#: Share of the largest energy below which a direction among the rigid-body modes is none.
_RIGID = 1e-10
#: Share of the rows of a matrix that have entries, below which the others are left out.
_FEW_ROWS = 0.5


class _Pencil(Protocol):
    """K(p) and M(p) as arrays."""

    def stiffness(self, given: Mapping[str, float] | None = None) -> np.ndarray: ...

    def mass(self, given: Mapping[str, float] | None = None) -> np.ndarray: ...


class Snapshots:
    """Modes, and what else a basis shall hold, at samples of the parameters.

    Args:
        structure: The full model.
    """

    def __init__(self, structure: Structure):
        self.structure = structure
        self._rigid: list[PETSc.Vec] = []
        self._others: list[PETSc.Vec] = []
        self._first: Mapping[str, float] | None = None

    def add(
        self, modes: Modes, keep: Iterable[int] | None = None, more: np.ndarray | None = None
    ) -> None:
        """Take modes in.

        Args:
            modes: Modes of the structure.
            keep: Which of them, by index; all by default.
            more: This rank's rows of further vectors, (n_local, k).
        """
        self._first = modes.given if self._first is None else self._first
        for i in range(len(modes)) if keep is None else keep:
            (self._rigid if i < modes.n_rigid else self._others).append(modes.shapes[int(i)])
        if more is not None:
            self._others += vectors_like(modes.shapes[0], more.T)

    def basis(self, tolerance: float) -> list[PETSc.Vec]:
        """Orthonormal vectors that span all of them. Collective.

        Args:
            tolerance: Directions with less than this share of the largest energy are left out.

        Raises:
            InputError: Without any.
        """
        if not self._rigid and not self._others:
            raise InputError("samples: expected at least one set of parameter values.")
        full, given, whole = self.structure, self._first, []
        # Rigid bodies are kept whole, or they would no longer be rigid; they are the same in all
        # samples, but that soft springs may mix them.
        if self._rigid:
            whole = orthonormal(full, self._rigid, given, _RIGID, only_mass=True)
        if not self._others:
            return whole
        return orthonormal(full, [*whole, *self._others], given, tolerance, len(whole))


def orthonormal(
    structure: Structure,
    snapshots: list[PETSc.Vec],
    given: Mapping[str, float] | None,
    tolerance: float,
    whole: int = 0,
    only_mass: bool = False,
    known: _Pencil | None = None,
) -> list[PETSc.Vec]:
    """Snapshots made orthonormal in the energy of one sample, without the dependent ones.

    The first ``whole`` of them are kept, and what the others have of them is taken off. Collective.

    Args:
        structure: The structure.
        snapshots: The vectors.
        given: The sample.
        tolerance: Directions with less than this share of the largest energy are left out.
        whole: See above.
        only_mass: Whether the energy is that of the mass alone.
        known: The structure on the first ``whole``, which are then left as they are; None to make
            them orthonormal too.
    """
    # The energy of a support as good as rigid would hide how the snapshots differ elsewhere.
    soft = [k for s in structure.elastic_supports for k in (s.k_n, s.k_t) if isinstance(k, str)]
    given = {**(given or {}), **dict.fromkeys(soft, 0.0)}
    K, M = structure.stiffness(given), structure.mass(given)
    Z = dense_columns(snapshots)
    blocks = (None, None) if known is None else (known.stiffness(given), known.mass(given))
    stiff, heavy = project(K, Z, blocks[0]), project(M, Z, blocks[1])
    K.destroy(), M.destroy()
    scale = np.trace(stiff) / np.trace(heavy)
    # Rigid bodies have no energy but round-off, which may be below zero: there the mass decides.
    gram = heavy if only_mass else stiff + scale * heavy
    norms = np.sqrt(np.diag(gram))
    gram = gram / np.outer(norms, norms)
    first, rest = slice(0, whole), slice(whole, None)
    onto = np.linalg.solve(gram[first, first], gram[first, rest])
    values, vectors = np.linalg.eigh(gram[rest, rest] - gram[rest, first] @ onto)
    # A few that are new have little beyond the first: all together have as much as they are many.
    keep = values > tolerance * (values[-1] if known is None else len(gram))
    rest_vectors = vectors[:, keep] / np.sqrt(values[keep])
    combine = np.zeros((len(gram), whole + int(keep.sum())))
    combine[first, first] = np.linalg.inv(np.linalg.cholesky(gram[first, first])).T
    combine[first, rest], combine[rest, rest] = -onto @ rest_vectors, rest_vectors
    combine /= norms[:, None]
    left = 0 if known is None else whole
    made = vectors_like(snapshots[0], (Z.getDenseArray() @ combine[:, left:]).T)
    Z.destroy()
    return [*snapshots[:left], *made]


def dense_columns(vectors: list[PETSc.Vec]) -> PETSc.Mat:
    """Dense matrix with these columns."""
    Z = PETSc.Mat().createDense((vectors[0].getSizes(), (None, len(vectors))), comm=vectors[0].comm)
    Z.setUp()
    array = Z.getDenseArray()
    for column, vector in enumerate(vectors):
        array[:, column] = vector.array_r
    Z.assemble()
    return Z


def project(A: PETSc.Mat, Z: PETSc.Mat, known: np.ndarray | None = None) -> np.ndarray:
    """Z^T A Z, made symmetric, equal on all ranks. Collective.

    Args:
        A: A symmetric matrix.
        Z: Dense columns.
        known: What it is of the first columns, (k, k); None for none.
    """
    known = np.zeros((0, 0)) if known is None else known
    if not len(known):
        return bordered(known, cross(A, Z, Z))
    new = _columns_from(Z, len(known))
    found = bordered(known, cross(A, Z, new))
    new.destroy()
    return found


def cross(A: PETSc.Mat, Z: PETSc.Mat, X: PETSc.Mat) -> np.ndarray:
    """Z^T A X, equal on all ranks. Collective."""
    AX = A.matMult(X)
    left, right = Z.getDenseArray(), AX.getDenseArray()
    # The matrix of a part or joint is empty but for its own rows.
    rows = np.flatnonzero(right.any(axis=1))
    if len(rows) < _FEW_ROWS * len(right):
        left, right = left[rows], right[rows]
    local = np.ascontiguousarray(left.T @ right)
    A.comm.tompi4py().Allreduce(MPI.IN_PLACE, local)
    AX.destroy()
    return local


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


def _columns_from(Z: PETSc.Mat, first: int) -> PETSc.Mat:
    """A dense matrix of the columns of another from one on."""
    count = Z.getSize()[1] - first
    found = PETSc.Mat().createDense((Z.getSizes()[0], (None, count)), comm=Z.comm)
    found.setUp()
    found.getDenseArray()[:] = Z.getDenseArray()[:, first:]
    found.assemble()
    return found
