"""Modes of a small model at many parameter values together, and how they change with these.

K and M are sums of fixed matrices times scalars (`fenics_joints.reduction.affine`). The derivative
of an eigenvalue or shape along any direction follows from the modes' products with these matrices,
which are formed once, and from the derivatives of the scalars.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fenics_joints.reduction.arrays import ArrayModel

#: Step of a central difference by the logarithm of a stiffness: its truncation error is 1e-12.
_STEP = 1e-6

#: Values of all parameters, each (b,).
BatchValues = Mapping[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class Change:
    """Derivatives of the terms of K and M along p directions.

    Attributes:
        theta: Of the scalars of K, (b, n_terms, p).
        rho: Likewise of M.
        moved: By direction, for masses that move: terms w u^T u of dM, each a number w, (b,), and
            the displacement u of the basis at the mass, (b, gdim, n).
    """

    theta: np.ndarray
    rho: np.ndarray
    moved: Mapping[int, Sequence[tuple[np.ndarray, np.ndarray]]]

    @property
    def n(self) -> int:
        """Number of directions, p."""
        return self.theta.shape[2]


def own_values(model: ArrayModel, values: Mapping[str, float | np.ndarray]) -> dict:
    """A model's own parameters among values, all of one shape: numbers, or (b,) each."""
    names = list(model.parameters)
    own = [values[name] for name in names]
    if len({np.shape(value) for value in own}) > 1:
        own = np.broadcast_arrays(*own)
    return dict(zip(names, own, strict=True))


def own_arrays(model: ArrayModel, values: Mapping[str, float | np.ndarray]) -> dict:
    """The same, each (b,), of numbers (1,)."""
    return {name: np.atleast_1d(value) for name, value in own_values(model, values).items()}


def change(
    model: ArrayModel, low: BatchValues, high: BatchValues, width: float, count: int = 1
) -> Change:
    """The central differences between two sets of values, one for each direction.

    Args:
        model: The model.
        low: Values of the model's parameters and maybe others, each (count * b,): all of one
            direction, then the next.
        high: Likewise.
        width: How far they are apart along the direction.
        count: Number of directions, p.
    """
    pencil, (low, high) = model.pencil, (own_arrays(model, values) for values in (low, high))
    theta, rho = (
        np.moveaxis(part.reshape(len(part), count, part.shape[1] // count) / width, 2, 0)
        for part in pencil.change(low, high)
    )
    moved = {}
    for k in range(count if pencil.travellers else 0):
        below, above = (
            {name: np.reshape(values[name], (count, -1))[k] for name in pencil.travellers}
            for values in (low, high)
        )
        if any(np.any(below[name] != above[name]) for name in below):
            moved[k] = [
                (sign * weight / width, at)
                for sign, values in ((1.0, above), (-1.0, below))
                for weight, at in pencil.travelling(values)
            ]
    return Change(theta, rho, moved)


@dataclass(frozen=True, eq=False)
class BatchModes:
    """The lowest k modes of a model at b sets of values, and which of them a test saw.

    Attributes:
        model: The model.
        values: Values of its parameters, each (b,).
        eigenvalues: Ascending, (b, k).
        vectors: Of unit modal mass, as columns, (b, n, k).
        index: Mode of each of the test's, (b, m).
        good: Whether the test's modes are all there, (b,); results of other points are nan.
    """

    model: ArrayModel
    values: BatchValues
    eigenvalues: np.ndarray
    vectors: np.ndarray
    index: np.ndarray
    good: np.ndarray

    @cached_property
    def lam(self) -> np.ndarray:
        """Eigenvalues of the test's modes, (b, m)."""
        found = np.take_along_axis(self.eigenvalues, self.index, axis=1)
        return np.where(self.good[:, None], found, np.nan)

    @cached_property
    def x(self) -> np.ndarray:
        """Their shapes, (b, n, m)."""
        return np.take_along_axis(self.vectors, self.index[:, None, :], axis=2)

    @cached_property
    def log_f(self) -> np.ndarray:
        """ln of their frequencies, (b, m)."""
        with np.errstate(invalid="ignore"):
            return 0.5 * np.log(self.lam) - np.log(2 * np.pi)

    def slopes(self, along: Change) -> np.ndarray:
        """Derivatives of `log_f` along directions, (b, m, p)."""
        b, n, m = self.x.shape
        columns = np.moveaxis(self.x, 1, 0).reshape(n, b * m)
        wanted = (np.any(change != 0, axis=(0, 2)) for change in (along.theta, along.rho))
        squares = self.model.pencil.squares(columns, *wanted)
        stiff, heavy = (found.reshape(b, m, -1) for found in squares)
        by_M, lam = heavy @ along.rho, self.lam[:, :, None]
        for k, parts in along.moved.items():
            for w, at in parts:
                by_M[:, :, k] += w[:, None] * np.sum((at @ self.x) ** 2, axis=1)
        return (stiff @ along.theta - lam * by_M) / (2 * lam)

    @cached_property
    def _shares(self) -> dict[str, np.ndarray]:
        return {}

    def share(self, name: str) -> np.ndarray:
        """Share of the modes' strain energy in stiffness proportional to a parameter, (b, m):
        d ln lambda by d ln of that parameter, at least 0."""
        if name not in self._shares:
            low, high = (
                {**self.values, name: self.values[name] * (1 + s * _STEP)} for s in (-1.0, 1.0)
            )
            slopes = self.slopes(change(self.model, low, high, 2 * _STEP))
            self._shares[name] = np.maximum(2 * slopes[:, :, 0], 0.0)
        return self._shares[name]

    def _forced(self, along: Change) -> tuple[np.ndarray, np.ndarray]:
        """y^T dK x and y^T dM x of every mode y and test mode x, each (b, p, n, m), remembered."""
        if along not in self._known:
            turned = np.swapaxes(self.vectors, 1, 2)[:, None]
            self._known[along] = tuple(
                turned @ self._changed(whole, change)
                for whole, change in zip(
                    self.model.pencil.terms, (along.theta, along.rho), strict=True
                )
            )
        return self._known[along]

    def _changed(self, whole: np.ndarray, change: np.ndarray) -> np.ndarray:
        """The sum of matrices times their scalars' derivatives, times x, (b, p, n, m)."""
        b, n, m = self.x.shape
        found = np.zeros((b, change.shape[2], n, m))
        there = np.any(change != 0, axis=0)
        for term in np.flatnonzero(there.any(axis=1)):
            own = there[term]
            found[:, own] += change[:, term, own, None, None] * (whole[term] @ self.x)[:, None]
        return found

    @cached_property
    def _known(self) -> dict[Change, tuple[np.ndarray, np.ndarray]]:
        return {}

    def shape_slope(self, along: Change, k: int) -> np.ndarray:
        """Derivative of `x` along direction k, (b, n, m), by expansion in all modes, all of which
        must be among `vectors` (Fox and Kapoor, AIAA J. 6, 1968)."""
        by_K, by_M = (part[:, k] for part in self._forced(along))
        for w, at in along.moved.get(k, ()):
            by_M = by_M + w[:, None, None] * (np.swapaxes(at @ self.vectors, 1, 2) @ (at @ self.x))
        gap = self.lam[:, None, :] - self.eigenvalues[:, :, None]
        own = self.index[:, None, :]
        with np.errstate(divide="ignore", invalid="ignore"):
            weight = (by_K - self.lam[:, None, :] * by_M) / gap
        np.put_along_axis(weight, own, -0.5 * np.take_along_axis(by_M, own, axis=1), axis=1)
        return self.vectors @ weight
