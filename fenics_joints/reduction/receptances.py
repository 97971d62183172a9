"""Responses to forces at points: antiresonances, receptances and static stiffness."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy.linalg
from petsc4py import PETSc

from fenics_joints.errors import InputError
from fenics_joints.modal.eigensolver import EigenSolver
from fenics_joints.modal.modes import Modes, solve_modes
from fenics_joints.reduction.arrays import ArrayModel
from fenics_joints.reduction.basis import Points, orthonormal
from fenics_joints.reduction.batch_modes import (
    BatchModes,
    BatchValues,
    Change,
    change,
    own_arrays,
    own_values,
)
from fenics_joints.reduction.prediction import ModalPrediction, batched
from fenics_joints.reduction.reduced import ReducedStructure, reduce
from fenics_joints.structure import Sensors, Structure
from fenics_joints.structure.sparse import as_columns, combination, vectors_like

#: Default ``tolerance`` of `PointBasis`; chosen: at an antiresonance large terms cancel.
_BASIS = 1e-10
#: Least distance, in ln f, of an antiresonance from a resonance: chosen; closer ones cancel each
#: other and cannot be seen at the point.
_APART = 2e-3


class PointBasis:
    """A model on its modes and on responses to forces at points, at samples. Collective.

    Args:
        full: The full model.
        at: Points and directions of the forces.
        everywhere: Places all over the structure at which modes are compared.
        samples: Parameter values, the nominal ones first; not used for beams.
        n_modes: Modes at each sample.
        travel: See `reduce`.
        tolerance: Share of the largest energy below which a direction is left out of the basis.

    Attributes:
        model: The model, whose ``sensor_rows`` are those of ``everywhere``.
        rows: Displacements of its basis at the points, (n, n_dofs).
        everywhere: See above.
    """

    def __init__(
        self,
        full,
        at: Sensors,
        everywhere: Sensors,
        samples: Points,
        n_modes: int,
        travel: Mapping | None = None,
        tolerance: float = _BASIS,
    ):
        self.everywhere = everywhere
        self._basis: list[PETSc.Vec] | None = None
        if full.is_dense:
            self.model, self.rows = full.arrays(everywhere), full.loads(at).T
            return
        loads = full.loads(at)
        reduced = reduce(
            full,
            samples,
            n_modes,
            travel=travel,
            tolerance=tolerance,
            more=lambda modes: _beyond(modes, loads, at),
        )
        self._basis = reduced.basis
        self.model = reduced.arrays(sensors=everywhere)
        self.rows = full.observe(self._basis, at)

    def in_full(self, y: np.ndarray):
        """A vector of the basis in the full model's unknowns: an array or a PETSc vector."""
        return y if self._basis is None else combination(self._basis, y)


def _beyond(modes: Modes, loads: np.ndarray, at: Sensors) -> np.ndarray:
    """This rank's rows of the responses to forces without the share of the modes, (n_local,
    n_sensors); of a free body its rigid modes would dominate them."""
    share = modes.at(at).T / (modes.eigenvalues - modes.solver.shift)[:, None]
    return modes.solver.inverse(loads) - as_columns(modes.shapes) @ share


class Antiresonances:
    """Antiresonances of the receptance at a point, some of which a test saw.

    An attached oscillator (`fenics_joints.structure.changes`) is not in this model: it leaves
    antiresonances as they are.

    Args:
        basis: The model.
        index: Index of the point among the model's.
        baseline: Parameter values of the nominal model.
        n_modes: Number of modes among which they are sought.
    """

    def __init__(self, basis: PointBasis, index: int, baseline: Mapping[str, float], n_modes: int):
        self.basis = basis
        # Vectors that do not move the point.
        self._held = scipy.linalg.null_space(basis.rows[index][None])
        self._model: ArrayModel = basis.model.on(self._held)
        self._n_modes = min(n_modes, self._model.n_dofs)
        free = solve_modes(basis.model, baseline, n_modes=self._n_modes)
        self.nominal: Modes = solve_modes(self._model, baseline, n_modes=self._n_modes)
        own = np.arange(self.nominal.n_rigid, self._n_modes)
        poles = np.log(free.frequencies_hz[free.n_rigid :])
        zeros = np.log(self.nominal.frequencies_hz[own])
        apart = np.min(np.abs(zeros[:, None] - poles), axis=1)
        seen = (apart > _APART) & (zeros < poles[-1])
        self._own, self.log_f = own[seen], zeros[seen]
        self.forward: ModalPrediction | None = None
        self._last: tuple | None = None

    def follow(self, which: np.ndarray) -> None:
        """Select antiresonances by their index in ``log_f``; the other methods are of these."""
        index = self._own[which]
        shapes = self.nominal.at(self.basis.everywhere)[:, index]
        self.forward = ModalPrediction(
            self._model, self.basis.everywhere, len(index), self._n_modes, reference=shapes
        )

    def at(self, values: Mapping[str, float | np.ndarray]) -> BatchModes:
        """The selected antiresonances at values (b,), as modes with the point held."""
        own = own_arrays(self._model, values)
        key = tuple(each.tobytes() for each in own.values())
        if self._last is None or self._last[0] != key:
            self._last = key, batched(self.forward).batch(own, every=False)
        return self._last[1]

    def slopes(
        self, values: BatchValues, low: BatchValues, high: BatchValues, width: float
    ) -> np.ndarray:
        """Derivatives of ln f along directions in the parameters, (b, m, p).

        Args:
            values: Parameter values, each (b,).
            low: See `fenics_joints.reduction.batch_modes.change`.
            high: Likewise.
            width: Likewise.
        """
        modes = self.at(values)
        count = len(next(iter(low.values()))) // len(modes.index)
        return modes.slopes(change(modes.model, low, high, width, count))

    def shape(self, i: int, values: Mapping[str, float]):
        """The full model's motion in a selected one, of unit modal mass, and its omega^2.

        Raises:
            InputError: If the model does not have it at these values.
        """
        modes, pairing = self.forward.solve({name: values[name] for name in self._model.parameters})
        k = int(pairing.index[i])
        moved = self.basis.in_full(self._held @ modes.shapes[:, k])
        return moved, float(modes.eigenvalues[k])


#: Relative distance of a line from a resonance, in the square of the frequency, within which the
#: effect of a patch is bounded: chosen.
_CLOSE = 0.03
#: Least magnitude by which changes of a function are divided, over the sum of the magnitudes of all
#: modes: chosen; near an antiresonance the function itself vanishes.
_VALLEY = 0.1
#: Entries of eigenvectors that are held at a time: chosen, for memory.
_ROOM = 2**24


@dataclass(frozen=True, eq=False)
class Poles:
    """Measured resonances of a test's modes.

    Attributes:
        frequencies_hz: Hz, (m,); nan where the model's own is used.
        damping: Damping ratios, (m,).
    """

    frequencies_hz: np.ndarray
    damping: np.ndarray

    def dynamic_stiffness(self, omega: np.ndarray) -> np.ndarray:
        """That of each mode of unit mass, 1/s2, (m, n), at circular frequencies (n,), rad/s."""
        own = 2 * np.pi * self.frequencies_hz[:, None]
        return own**2 - omega**2 + 2j * self.damping[:, None] * own * omega


@dataclass(frozen=True, eq=False)
class Lines:
    """Lines of functions.

    Attributes:
        frequencies_hz: Hz, (n,).
        response: Index of the point whose motion is meant, (n,).
        reference: Index of the point where the force acts, (n,).
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
    """Quantities from which derivatives of functions by patches of the full model are formed.

    Attributes:
        omega: The lines, shifted as the model's resonances are from the test's, rad/s, (n,).
        value: The functions there, m/N, (n,), never zero.
        by_pole: Derivatives of the functions by the eigenvalues of the test's modes, (n, k), which
            must be taken off, since measured resonances do not move.
        modes: Motion of the full model and circular frequency of each of these k modes.
        motions: Motions by unit forces at both points of every line, on the basis, (n_dofs, n).
    """

    omega: np.ndarray
    value: np.ndarray
    by_pole: np.ndarray
    modes: list[tuple[object, float]]
    motions: tuple[np.ndarray, np.ndarray]
    _pulls: list[np.ndarray] = field(default_factory=list)

    def pulls(self, energies: Callable, values: Mapping[str, float]) -> np.ndarray:
        """Derivatives of each mode's eigenvalue by ln of the stiffness and of the mass of each
        patch, (k, 2, P); computed once. Collective.

        Args:
            energies: ``(motion, circular frequency, values)`` to x^T K x and omega^2 x^T M x of
                each patch, (2, P).
            values: The parameter values.
        """
        if not self._pulls:
            found = (energies(x, omega, values) for x, omega in self.modes)
            self._pulls.extend(np.array([[1.0], [-1.0]]) * each for each in found)
        return np.array(self._pulls)


class Receptances:
    """Receptances at lines as functions of a model's parameters.

    They are sums over all modes of the basis. The test's modes have the measured resonances and
    damping, the others are undamped. An attached oscillator is left out, as in `Antiresonances`.

    Args:
        basis: The model.
        lines: The lines.
        poles: The test's resonances.
        forward: Matches modes of ``basis.model`` to the test's.
    """

    def __init__(self, basis: PointBasis, lines: Lines, poles: Poles, forward: ModalPrediction):
        self.basis, self.lines, self.poles, self.forward = basis, lines, poles, forward
        self._own = np.isfinite(poles.frequencies_hz)
        self._given = poles.dynamic_stiffness(lines.omega)[self._own]
        self._kept: dict[str, tuple] = {}

    def modes(self, values: Mapping[str, float | np.ndarray]) -> BatchModes:
        """All modes of the basis, at values (b,)."""
        return self._once("modes", (values,), batched(self.forward).batch)

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
        """See `About`. Collective.

        Args:
            values: Parameter values.

        Raises:
            InputError: If the model lacks a mode of the test there.
        """
        return self._once("about", (values,), lambda own: self._about(self.modes(own)))

    def _about(self, modes: BatchModes) -> About:
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

    def _at(self, modes: BatchModes) -> np.ndarray:
        moves = self.basis.rows @ modes.vectors
        found = np.sum(self._residues(moves) * self._compliance(modes), axis=2)
        return np.where(modes.good[:, None], found, np.nan)

    def slopes(
        self, values: BatchValues, low: BatchValues, high: BatchValues, width: float
    ) -> np.ndarray:
        """Derivatives of them along directions in the parameters, (b, n, p).

        Args:
            values: Parameter values, each (b,).
            low: See `fenics_joints.reduction.batch_modes.change`.
            high: Likewise.
            width: Likewise.
        """
        return self._once(
            "slopes",
            (values, low, high),
            lambda own, below, above: self._slopes(self.modes(own), below, above, width),
        )

    def _slopes(self, modes: BatchModes, low, high, width: float) -> np.ndarray:
        count = len(next(iter(low.values()))) // len(modes.index)
        along = change(modes.model, low, high, width, count)
        return np.stack([self._slopes_at(modes, along, b) for b in range(len(modes.index))])

    def _slopes_at(self, modes: BatchModes, along: Change, b: int) -> np.ndarray:
        """At one set of values, (n, p): -x^T dZ y of the motions x and y by forces at both points,
        corrected since the measured resonances do not move."""
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
        # Derivatives of shapes at the points by expansion in all modes (Fox and Kapoor, AIAA J. 6,
        # 1968).
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
        """Products of the modes' displacements at both points, (b, n, k), from those at all."""
        return moves[:, self.lines.response] * moves[:, self.lines.reference]

    def _compliance(self, modes: BatchModes) -> np.ndarray:
        """1 / dynamic stiffness of every mode of unit mass, (b, n, k)."""
        found = 1 / (modes.eigenvalues[:, None, :] - (self.lines.omega**2)[:, None] + 0j)
        for b, index in enumerate(modes.index):
            found[b][:, index[self._own]] = 1 / self._given.T
        return found

    def _once(self, what: str, given: tuple, made: Callable):
        """The last result if it was for these values: all lines share it."""
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


#: Share of the largest energy below which a combination of responses is round-off.
_DEPENDENT = 1e-12


class StaticSolver:
    """Static responses of the full model to a unit force at each sensor. Collective.

    Args:
        full: A structure that is held.
        sensors: Points and directions of the forces.
    """

    def __init__(self, full: Structure, sensors: Sensors):
        self.full, self.sensors, self.loads = full, sensors, full.loads(sensors)
        self._solver = EigenSolver(1, shift=0.0)

    def __call__(self, values: Mapping[str, float]) -> tuple[np.ndarray, list[PETSc.Vec]]:
        """ln of the displacement at each force along it, m/N, (n,), and the responses.

        Args:
            values: Parameter values.

        Raises:
            ConvergenceError: If the structure is not held.
        """
        K, M = self.full.stiffness(values), self.full.mass(values)
        self._solver.factorise(K, M)
        moved = self._solver.inverse(self.loads)
        responses = vectors_like(K.createVecRight(), moved.T)
        K.destroy(), M.destroy()
        given_way = self.full.comm.allreduce(np.sum(self.loads * moved, axis=0))
        return np.log(given_way), responses

    def destroy(self) -> None:
        """Free the factorisation. Collective."""
        self._solver.destroy()


class StaticModel:
    """Static responses by a reduced model, at any parameter values, on each rank by itself.

    Args:
        model: A model whose ``sensor_rows`` are the displacements at the forces.
        basis: The full model's vectors of its basis; None if it is not reduced.
    """

    def __init__(self, model: ArrayModel, basis: list[PETSc.Vec] | None = None):
        self.model, self.basis = model, basis

    @classmethod
    def made(
        cls,
        solver: StaticSolver,
        samples: Points,
        travel: Mapping | None = None,
        tolerance: float = 1e-3,
        fresh: Callable[[int], Points] | None = None,
        rounds: int = 4,
    ) -> StaticModel:
        """A model on responses at samples, and at further points if those do not do. Collective.

        Args:
            solver: Of the full model.
            samples: Parameter values of the responses.
            travel: See `ReducedStructure`.
            tolerance: Error of ln of a compliance that is good enough.
            fresh: ``round -> points`` at which the error is found; None for no check.
            rounds: How often responses at such points may be added.
        """
        responses = [vector for values in samples for vector in solver(values)[1]]
        for turn in range(rounds):
            basis = orthonormal(solver.full, responses, samples[0], _DEPENDENT)
            reduced = ReducedStructure(solver.full, basis, travel)
            found = cls(reduced.arrays(), basis)
            found.model.sensor_rows = solver.full.observe(basis, solver.sensors)
            points = [] if fresh is None or turn == rounds - 1 else fresh(turn)
            if not points:
                break
            exact, more = zip(*(solver(values) for values in points), strict=True)
            off = np.array([found.log_compliance(values) for values in points]) - exact
            if np.max(np.abs(off)) <= tolerance:
                break
            responses += [vector for vectors in more for vector in vectors]
        return found

    def log_compliance(self, values: Mapping[str, float | np.ndarray]) -> np.ndarray:
        """ln of the displacement at each force along it, m/N, (n,); (b, n) of values (b,)."""
        at = self.model.sensor_rows
        return np.log(np.einsum("sn,...ns->...s", at, self._moved(values, at)))

    def log_slopes(
        self, index: int, values: BatchValues, low: BatchValues, high: BatchValues, width: float
    ) -> np.ndarray:
        """Derivatives of one of them along directions, (b, p): with K u = r and the compliance
        r^T u, these are -u^T dK u / r^T u.

        Args:
            index: Index of the force.
            values: Parameter values, each (b,).
            low: See `fenics_joints.reduction.batch_modes.change`.
            high: Likewise.
            width: Likewise.
        """
        row, n = self.model.sensor_rows[index], len(next(iter(values.values())))
        moved = self._moved(values, row[None])[..., 0]
        along = change(self.model, low, high, width, len(next(iter(low.values()))) // n)
        stiff, _ = self.model.pencil.squares(moved.T)
        return -np.einsum("bt,btp->bp", stiff, along.theta) / (moved @ row)[:, None]

    def _moved(self, values, rows: np.ndarray) -> np.ndarray:
        """Responses to forces of these rows, (k, n): (n, k), or (b, n, k)."""
        K, _ = self.model.pencil.assemble(own_values(self.model, values))
        return np.linalg.solve(K, np.broadcast_to(rows.T, (*K.shape[:-2], *rows.T.shape)))

    def response(self, values: Mapping[str, float], index: int):
        """The response to a force in the full model's unknowns, as a vector of its kind."""
        y = np.linalg.solve(self.model.stiffness(values), self.model.sensor_rows[index])
        return y if self.basis is None else combination(self.basis, y)
