"""Receptances at a few lines, with the resonances of a test where the test has them.

A function near and between resonances is made of where these are, and of what each mode moves the
two points. Where they are a test's frequencies say, and a model whose resonances are a few per cent
off has functions that are off by factors: what is left of a comparison of these is the wrong
resonances, again and again. So each mode of the model that the test has is given the test's
frequency and damping ratio, and what the function says besides is compared (Ewins, Modal Testing,
2nd ed., 2000, sections 3.4 and 5.2): masses and stiffnesses in kilograms and newtons per metre,
which no frequency has, and shapes with their sign.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from fenics_joints.errors import InputError
from fenics_joints.reduction.forward import Forward
from fenics_joints.reduction.grounded import PointBasis
from fenics_joints.reduction.lean import batched
from fenics_joints.reduction.many import Change, ManyModes, ManyValues, change, own_arrays

#: How near a line may be to a resonance, in the square of the frequency and relative to that,
#: before what a patch does there is bounded.
_CLOSE = 0.03
#: Share of what modes add up to without their signs that is the least a function is compared with.
_VALLEY = 0.1
#: Entries of eigenvectors that are held at a time.
_ROOM = 2**24


@dataclass(frozen=True, eq=False)
class Poles:
    """Where a test has the resonances of its modes.

    Attributes:
        frequencies_hz: Hz, (m,); nan where the model's own stays.
        damping: Damping ratios, (m,).
    """

    frequencies_hz: np.ndarray
    damping: np.ndarray

    def dynamic_stiffness(self, omega: np.ndarray) -> np.ndarray:
        """That of each mode of unit mass, 1/s2, (m, n), at circular frequencies (n,)."""
        own = 2 * np.pi * self.frequencies_hz[:, None]
        return own**2 - omega**2 + 2j * self.damping[:, None] * own * omega


@dataclass(frozen=True, eq=False)
class Lines:
    """Lines of functions.

    Attributes:
        frequencies_hz: Hz, (n,).
        response: Which point of the basis moves, (n,).
        reference: Where the force acts, (n,).
    """

    frequencies_hz: np.ndarray
    response: np.ndarray
    reference: np.ndarray

    def __len__(self) -> int:
        return len(self.frequencies_hz)

    @cached_property
    def omega(self) -> np.ndarray:
        """Circular frequencies, rad/s, (n,)."""
        return 2 * np.pi * self.frequencies_hz


@dataclass(frozen=True, eq=False)
class About:
    """What patches of the full model do to functions about some parameter values.

    Attributes:
        omega: The lines, moved as the model's resonances are from the test's, rad/s, (n,).
        value: The functions there, m/N, (n,), never nought.
        by_pole: What a change of a resonance's eigenvalue does to them, which the test's
            resonances take back, (n, k).
        modes: Those of the test: motion of the full model and circular frequency, k of them.
        motions: Of every line, the motions by unit forces at both points in the basis, (n_dofs, n).
    """

    omega: np.ndarray
    value: np.ndarray
    by_pole: np.ndarray
    modes: list[tuple[object, float]]
    motions: tuple[np.ndarray, np.ndarray]
    _pulls: list[np.ndarray] = field(default_factory=list)

    def pulls(self, energies: Callable, values: Mapping[str, float]) -> np.ndarray:
        """Change of the eigenvalue of each of the modes by ln of the stiffness and of the mass of
        each patch, (k, 2, P); the same each time. Collective.

        Args:
            energies: Of a motion, at a circular frequency, with parameter values: x^T K x and
                omega^2 x^T M x of each patch, (2, P).
            values: The parameter values.
        """
        if not self._pulls:
            found = (energies(x, omega, values) for x, omega in self.modes)
            self._pulls.extend(np.array([[1.0], [-1.0]]) * each for each in found)
        return np.array(self._pulls)


class Receptances:
    """Functions of motion by force as functions of a model's parameters.

    All modes of the basis take part, those of the test with its resonances. The others are
    undamped. What hangs on the structure and moves by itself is not in this model, as in
    `fenics_joints.reduction.grounded.Antiresonances`.

    Args:
        basis: The model.
        lines: Where they are asked for.
        poles: The test's resonances.
        forward: Tells the test's modes among those of ``basis.model``.
    """

    def __init__(self, basis: PointBasis, lines: Lines, poles: Poles, forward: Forward):
        self.basis, self.lines, self.poles, self.forward = basis, lines, poles, forward
        self._own = np.isfinite(poles.frequencies_hz)
        self._given = poles.dynamic_stiffness(lines.omega)[self._own]
        self._kept: dict[str, tuple] = {}

    def modes(self, values: Mapping[str, float | np.ndarray]) -> ManyModes:
        """All modes of the basis, at values (b,)."""
        return self._once("modes", (values,), batched(self.forward).many)

    def at(self, values: Mapping[str, float | np.ndarray]) -> np.ndarray:
        """Receptances at the lines, m/N, complex, (b, n), of values (b,); nan where the model lacks
        a mode of the test."""

        def found(own: dict[str, np.ndarray]) -> np.ndarray:
            count = len(next(iter(own.values())))
            parts = -(-count * self.basis.model.n_dofs**2 // _ROOM)
            split = [np.array_split(each, parts) for each in own.values()]
            each = (dict(zip(own, part, strict=True)) for part in zip(*split, strict=True))
            return np.concatenate([self._at(self.modes(part)) for part in each])

        return self._once("at", (values,), found)

    def about(self, values: Mapping[str, float]) -> About:
        """For what patches do to them. Collective.

        Args:
            values: Parameter values.

        Raises:
            InputError: If the model lacks a mode of the test there.
        """
        return self._once("about", (values,), lambda own: self._about(self.modes(own)))

    def _about(self, modes: ManyModes) -> About:
        if not modes.good[0]:
            raise InputError("functions: the model lacks a mode of the test at these values.")
        own = self._own
        lam, index = modes.eigenvalues[0], modes.index[0][own]
        tested, model = np.log(self.poles.frequencies_hz[own]), modes.log_f[0][own]
        order, away = np.argsort(tested), np.log(self.lines.frequencies_hz)
        omega = self.lines.omega * np.exp(np.interp(away, tested[order], (model - tested)[order]))
        gap = lam - (omega**2)[:, None]
        inverse = gap / (gap**2 + (_CLOSE * omega[:, None] ** 2) ** 2)
        moves = self.basis.rows @ modes.vectors
        one, other = moves[0, self.lines.response], moves[0, self.lines.reference]
        parts = one * other * inverse
        value, least = parts.sum(axis=1), _VALLEY * np.abs(parts).sum(axis=1)
        value = np.where(value < 0, -1.0, 1.0) * np.maximum(np.abs(value), least)
        shapes = [
            (self.basis.in_full(modes.vectors[0][:, k]), float(np.sqrt(lam[k]))) for k in index
        ]
        return About(
            omega,
            value,
            (parts * inverse)[:, index],
            shapes,
            (modes.vectors[0] @ (one * inverse).T, modes.vectors[0] @ (other * inverse).T),
        )

    def _at(self, modes: ManyModes) -> np.ndarray:
        moves = self.basis.rows @ modes.vectors
        found = np.sum(self._residues(moves) * self._compliance(modes), axis=2)
        return np.where(modes.good[:, None], found, np.nan)

    def slopes(
        self, values: ManyValues, low: ManyValues, high: ManyValues, width: float
    ) -> np.ndarray:
        """Derivatives of them along directions in the parameters, (b, n, p).

        Args:
            values: Parameter values, each (b,).
            low: See `fenics_joints.reduction.many.change`.
            high: Likewise.
            width: Likewise.
        """
        return self._once(
            "slopes",
            (values, low, high),
            lambda own, below, above: self._slopes(self.modes(own), below, above, width),
        )

    def _slopes(self, modes: ManyModes, low, high, width: float) -> np.ndarray:
        count = len(next(iter(low.values()))) // len(modes.index)
        along = change(modes.model, low, high, width, count)
        return np.stack([self._slopes_at(modes, along, b) for b in range(len(modes.index))])

    def _slopes_at(self, modes: ManyModes, along: Change, b: int) -> np.ndarray:
        """At one of the points, (n, p): -x^T dZ y of the motions x and y by forces at both points,
        and what is to be added since the test's resonances stay where they are."""
        lam, vectors = modes.eigenvalues[b], modes.vectors[b]
        moves, square, n = self.basis.rows @ vectors, self.lines.omega**2, len(self.lines)
        inverse = 1 / (lam - square[:, None])
        x = vectors @ (moves[self.lines.response] * inverse).T
        y = vectors @ (moves[self.lines.reference] * inverse).T
        index = modes.index[b][self._own]
        own = vectors[:, index]
        by_K, by_M = _products(modes.model, along, b, np.hstack([y, own]))
        found = -np.einsum("nl,pnl->lp", x, by_K[..., :n] - square * by_M[..., :n]) + 0j
        pull, heavy = by_K[..., n:] - lam[index] * by_M[..., n:], by_M[..., n:]
        # Of what a mode moves the points, by expansion in all (Fox and Kapoor, AIAA J. 6, 1968).
        gap = lam[index] - lam[:, None]
        gap[index, np.arange(len(index))] = np.inf
        mixed = np.einsum("ns,pnm->psm", vectors, pull) / gap
        turned = np.einsum("is,psm->pim", moves, mixed)
        at = moves[:, index]
        turned -= 0.5 * at * np.einsum("nm,pnm->pm", own, heavy)[:, None]
        one, other = self.lines.response, self.lines.reference
        changed = turned[:, one] * at[other] + at[one] * turned[:, other]
        free, by_lam = inverse[:, index], np.einsum("nm,pnm->pm", own, pull)
        found += np.einsum("plm,lm->lp", changed, 1 / self._given.T - free)
        found += np.einsum("lm,pm->lp", at[one] * at[other] * free**2, by_lam)
        return found

    def _residues(self, moves: np.ndarray) -> np.ndarray:
        """Products of what modes move the two points, (b, n, k), from those of all points."""
        return moves[:, self.lines.response] * moves[:, self.lines.reference]

    def _compliance(self, modes: ManyModes) -> np.ndarray:
        """1 / dynamic stiffness of every mode of unit mass, (b, n, k)."""
        found = 1 / (modes.eigenvalues[:, None, :] - (self.lines.omega**2)[:, None] + 0j)
        for b, index in enumerate(modes.index):
            found[b][:, index[self._own]] = 1 / self._given.T
        return found

    def _once(self, what: str, given: tuple, made: Callable):
        """What was made last, if it was of these values: all lines ask for the same."""
        kept = self._kept.get(what)
        if kept is not None and all(a is b for a, b in zip(kept[0], given, strict=True)):
            return kept[2]
        own = [own_arrays(self.basis.model, values) for values in given]
        key = [value.tobytes() for values in own for value in values.values()]
        found = kept[2] if kept is not None and kept[1] == key else made(*own)
        self._kept[what] = given, key, found
        return found


def _products(model, along: Change, b: int, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of K x and of M x along all directions at one of b points, each (p, n, k)."""
    found = []
    for terms, by in zip(model.pencil.terms, (along.theta[b], along.rho[b]), strict=True):
        moving = np.flatnonzero(by.any(axis=1))
        found.append(np.tensordot(by[moving], terms[moving], axes=(0, 0)) @ x)
    for k, parts in along.moved.items():
        for w, at in parts:
            found[1][k] += w[b] * np.einsum("di,dk->ik", at[b], at[b] @ x)
    return found[0], found[1]
