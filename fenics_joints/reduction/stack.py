"""Sums of many symmetric matrices, which to read is the work."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property

import numpy as np
from scipy.linalg.blas import daxpy

#: Matrices whose products with vectors are held at a time.
_READ = 32
#: Sums that are formed one after the other from a near one; how many times larger a factor may have
#: been there; and rows between two that are wanted which are read along with them.
_FEW, _MAGNITUDES, _GAP = 12, 1e6, 4


class Stack:
    """Matrices of which a sum is made.

    Attributes:
        whole: The matrices, (n_terms, n, n).
    """

    def __init__(self, matrices: Sequence[np.ndarray], n: int):
        self.n, self.whole = n, np.array(matrices, dtype=float).reshape(len(matrices), n, n)
        self.about: tuple[np.ndarray, np.ndarray] | None = None

    @cached_property
    def _indices(self) -> tuple[np.ndarray, np.ndarray]:
        return np.triu_indices(self.n)

    @cached_property
    def _upper(self) -> np.ndarray:
        """The upper triangles as rows, (n_terms, n (n + 1) / 2): half the work for one sum."""
        i, j = self._indices
        return np.ascontiguousarray(self.whole[:, i, j])

    @cached_property
    def _twice(self) -> np.ndarray:
        """How often each entry of an upper triangle is in the matrix."""
        i, j = self._indices
        return np.where(i == j, 1.0, 2.0)

    def sum(self, factors: np.ndarray, rows=slice(None)) -> np.ndarray:
        """The sum of factors times matrices, (n, n); of factors (n_terms, b) all b, (b, n, n).

        Args:
            factors: Of each matrix.
            rows: Which of the matrices.
        """
        if factors.ndim == 1:
            whole = len(factors) == len(self.whole)
            return self._unpacked(self._near(factors) if whole else factors @ self._upper[rows])
        if self.about and len(factors) == len(self.whole) and factors.shape[1] <= _FEW:
            return np.array([self._unpacked(self._near(column)) for column in factors.T])
        flat = self.whole[rows].reshape(len(factors), self.n**2)
        return (factors.T @ flat).reshape(-1, self.n, self.n)

    def _near(self, factors: np.ndarray) -> np.ndarray:
        """The upper triangle of the sum of all, from the one that is known, if any: mostly few
        factors differ, and to read the matrices is the work."""
        if self.about is None:
            return factors @ self._upper
        first, total = self.about
        change = factors - first
        moved = np.flatnonzero(change)
        # Round-off of what is known must not show in what is left of it.
        lost = np.abs(first[moved]) > _MAGNITUDES * np.abs(factors[moved])
        if len(moved) > len(factors) // 2 or np.any(lost & (factors[moved] != 0.0)):
            return factors @ self._upper
        total = total.copy()
        for i in moved:
            daxpy(self._upper[i], total, a=change[i])
        return total

    def settle(self, factors: np.ndarray) -> None:
        """Know a sum, from which others are formed: it must not be what happened to be asked for
        first, or round-off would hang on that."""
        self.about = factors.copy(), factors @ self._upper

    def sums(self, factors: np.ndarray, rows) -> Iterator[np.ndarray]:
        """`sum` of every column of the factors, one after the other."""
        yield from map(self._unpacked, factors.T @ self._upper[rows])

    def _unpacked(self, row: np.ndarray) -> np.ndarray:
        full = np.empty((self.n, self.n))
        full[self._indices] = row
        full.T[self._indices] = row
        return full

    def pack(self, shapes: np.ndarray) -> np.ndarray:
        """x x^T of every column of the shapes, for `squares` of this stack or one of its size."""
        i, j = self._indices
        packed = shapes[i] * shapes[j]
        packed *= self._twice[:, None]
        return packed.T

    def squares(self, packed: np.ndarray, wanted: np.ndarray | None = None) -> np.ndarray:
        """x^T A x of every packed vector and every matrix, (k, n_terms).

        Args:
            packed: From `pack`.
            wanted: Which matrices, (n_terms,), bool; of others it is 0, or not. None for all.
        """
        if wanted is None:
            return packed @ self._upper.T
        found, used = np.zeros((len(packed), len(self.whole))), np.flatnonzero(wanted)
        for run in np.split(used, np.flatnonzero(np.diff(used) > _GAP) + 1) if len(used) else ():
            rows = slice(run[0], run[-1] + 1)  # a view: rows that are picked would be copied
            found[:, rows] = packed @ self._upper[rows].T
        return found

    def times(self, shapes: np.ndarray, factors: np.ndarray) -> np.ndarray:
        """A x of every column, A being each of some sums of factors times matrices, (n, k, p).

        Args:
            shapes: The columns, (n, k).
            factors: Of each matrix in each sum, (n_terms, p).
        """
        found = np.zeros((*shapes.shape, factors.shape[1]))
        # To read the matrices is most of the work: those in none of the sums are let be.
        used = np.flatnonzero(factors.any(axis=1))
        for first in range(0, len(used), _READ):
            rows = used[first : first + _READ]
            columns = np.array([self.whole[i] @ shapes for i in rows]).reshape(len(rows), -1)
            found += (columns.T @ factors[rows]).reshape(found.shape)
        return found
