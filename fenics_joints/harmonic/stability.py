"""Stability of periodic responses: Floquet multipliers by Hill's method, and by the period's map.

The map takes small disturbances of displacement, velocity and the interfaces' states over one
period, by the trapezoidal rule along the solution, with the laws' own derivatives in every step
(Krack and Gross, Harmonic Balance for Nonlinear Vibration Problems, 2019, sec. 3.6, for systems
without memory). A slider that stands still all the time stays where it is put: that is no motion,
and left out. So are rigid motions that nothing resists.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.sparse.linalg

from fenics_joints.errors import whole
from fenics_joints.harmonic.balance import Balance
from fenics_joints.harmonic.fourier import basis
from fenics_joints.interfaces.model import InterfacePoints


def hill_multipliers(balance: Balance, X: np.ndarray, omega: float) -> np.ndarray:
    """Floquet multipliers by Hill's method with linearised sliders, complex, the largest first.

    A disturbance e^(lambda t) times a Fourier series obeys J + lambda (C + 2 omega M d/d(wt)) +
    lambda^2 M (Moore 2005). Of laws with memory the derivative of harmonic balance stands for that
    of their forces, which it is where a multiplier is 1: a disturbance that grows slowly moves
    sliders as a lasting one does. Of the exponents those count whose imaginary part is at most half
    the response's frequency.

    Args:
        balance: The equations; laws without the rate of strain.
        X: Coefficients of the solution, (n, K).
        omega: Its angular frequency, rad/s.
    """
    N = balance.size
    J, damping, mass = _disturbed(balance, X, omega)
    # By the inverses of the exponents: a basis may have directions without mass.
    companion = np.zeros((2 * N, 2 * N))
    companion[:N], companion[N:, :N] = -scipy.linalg.solve(J, np.hstack([damping, mass])), np.eye(N)
    inverses = scipy.linalg.eigvals(companion, overwrite_a=True)
    own = omega / balance.fourier.periods
    values = 1 / inverses[np.abs(inverses) > 1e-9 / own]
    values = values[np.argsort(np.abs(values.imag))]
    inside = int(np.sum(np.abs(values.imag) <= 0.5 * own * (1 + 1e-6)))
    values = values[: max(inside, 2)]
    found = np.exp(values * 2 * np.pi / own)
    return found[np.argsort(-np.abs(found))]


def _disturbed(balance: Balance, X: np.ndarray, omega: float) -> tuple[np.ndarray, ...]:
    """J, D, M of J + lambda D + lambda^2 M, which a disturbance e^(lambda t) obeys."""
    model, one, G = balance.model, np.eye(balance.fourier.size), balance.fourier.derivative
    damping = np.kron(model.C, one) + 2 * omega * np.kron(model.M, G)
    return balance.evaluate(X, omega)[1], damping, np.kron(model.M, one)


# -- map of a period -------------------------------------------------------------------------------


#: Steps of a period of laws with memory, and without, whose stiffness may jump within a step;
#: chosen for errors of multipliers of some 1e-3.
_STEPS, _MEMORYLESS = 512, 1024
#: Most disturbances whose map is formed, and the number of the largest multipliers that are found
#: of more; chosen for time.
LARGEST, _WANTED = 600, 8
#: Most disturbances for which the maps of single steps are multiplied, many at once, since stepping
#: is quicker for more; and most numbers of these maps at a time. Chosen for time and memory.
_FEW, _BLOCK = 40, 2_000_000


def floquet_multipliers(
    balance: Balance, X: np.ndarray, omega: float, *, steps: int | None = None
) -> np.ndarray:
    """Floquet multipliers of a periodic response, complex, the largest first.

    Args:
        balance: The equations.
        X: Coefficients of the response, (n, K).
        omega: Its angular frequency, rad/s.
        steps: Of the period; by default 512, or 1,024 where laws have no memory, and at least the
            balance's samples.

    Returns:
        All of them, or the eight largest of a model with many sliders that move.
    """
    kernels = [points.kernel for points in balance.model.interfaces]
    if steps is None:
        memory = any(kernel.m for kernel in kernels)
        steps = (_STEPS if memory else _MEMORYLESS) * balance.fourier.periods
        steps = max(steps, balance.fourier.samples)
    steps = 2 * (whole("steps", steps, 8) // 2)
    period = _Period(balance, X, omega, steps)
    if period.size <= _FEW:
        map_ = period.product()
        if not any(kernel.m or kernel.n_switches for kernel in kernels):
            # The rule's error falls with the square of the step.
            map_ = (4 * map_ - _Period(balance, X, omega, steps // 2).product()) / 3
        values = scipy.linalg.eigvals(map_)
    elif period.size <= LARGEST:
        values = scipy.linalg.eigvals(period.apply(np.eye(period.size)))
    else:
        shape = (period.size, period.size)
        map_ = scipy.sparse.linalg.LinearOperator(
            shape, matvec=lambda x: period.apply(x[:, None])[:, 0], dtype=float
        )
        start = np.ones(period.size)
        values = scipy.sparse.linalg.eigs(map_, _WANTED, v0=start, return_eigenvectors=False)
    return values[np.argsort(-np.abs(values))]


@dataclass(frozen=True)
class _Slopes:
    """Derivatives of one interface's steps over the period, of the sliders that move.

    Attributes:
        rows: Strain rows, (P, d, n).
        load: Weighted rows, (n, P d).
        kernel: The law.
        by_strain: (P, T, d, inputs).
        by_state: (P, T, E, d, m).
        state_by_strain: (P, T, E, m, inputs).
        state_by_state: (P, T, E, m, m).
        moves: Which of its states' numbers count, (P, E, m).
    """

    rows: np.ndarray
    load: np.ndarray
    kernel: object
    by_strain: np.ndarray
    by_state: np.ndarray
    state_by_strain: np.ndarray
    state_by_state: np.ndarray
    moves: np.ndarray

    def inputs(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Disturbed strain, and rate if the law asks for it, (P, inputs, columns)."""
        strain = np.einsum("pdn,nc->pdc", self.rows, u, optimize=True)
        if not self.kernel.rated:
            return strain
        return np.concatenate([strain, np.einsum("pdn,nc->pdc", self.rows, v)], axis=1)

    def memory(self, t: int, s: np.ndarray) -> np.ndarray:
        """Force of disturbed states, (n, columns), in step t."""
        stress = np.einsum("pedm,pemc->pdc", self.by_state[:, t], s, optimize=True)
        return self.load @ stress.reshape(-1, s.shape[-1])

    def stiffness(self, steps: slice, part: slice) -> np.ndarray:
        """Force by displacement, or by velocity, in some steps, (T, n, n)."""
        slopes = self.by_strain[:, steps, :, part]
        moved = np.einsum("ptij,pjn->tpin", slopes, self.rows, optimize=True)
        return self.load @ moved.reshape(len(moved), -1, self.rows.shape[2])

    def memories(self, steps: slice) -> np.ndarray:
        """Force by states that move, (T, n, count), in several steps."""
        P, d, n = self.rows.shape
        load = self.load.reshape(n, P, d)
        found = np.einsum("npd,ptedm->tnpem", load, self.by_state[:, steps], optimize=True)
        return found[:, :, self.moves]

    def states_by(self, steps: slice, part: slice) -> np.ndarray:
        """New states that move by displacement, or by velocity, (T, count, n)."""
        slopes = self.state_by_strain[:, steps, ..., part]
        found = np.einsum("ptemi,pin->tpemn", slopes, self.rows, optimize=True)
        return found[:, self.moves]

    def states_by_states(self, steps: slice) -> np.ndarray:
        """New states that move by the old ones, (T, count, count)."""
        place = np.full(self.moves.shape, -1)
        place[self.moves] = np.arange(self.moves.sum())
        slopes = self.state_by_state[:, steps]
        found = np.zeros((slopes.shape[1], self.moves.sum(), self.moves.sum()))
        for i, j in np.ndindex(slopes.shape[3:]):
            both = self.moves[..., i] & self.moves[..., j]
            found[:, place[..., i][both], place[..., j][both]] = slopes[..., i, j].transpose(
                1, 0, 2
            )[:, both]
        return found

    def after(self, t: int, e: np.ndarray, s: np.ndarray) -> np.ndarray:
        """Disturbed states after step t."""
        new = np.einsum("pemi,pic->pemc", self.state_by_strain[:, t], e, optimize=True)
        new += np.einsum("pemk,pekc->pemc", self.state_by_state[:, t], s, optimize=True)
        return new


class _Period:
    """The map of disturbances over a period.

    Attributes:
        size: Number of disturbances: displacements, velocities, states that move.
    """

    def __init__(self, balance: Balance, X: np.ndarray, omega: float, steps: int):
        model, free = balance.model, balance.model.free_motions()
        Q = scipy.linalg.null_space(free.inertia.T) if len(free) else np.eye(model.n_dofs)
        self.M, self.C, self.K = (Q.T @ A @ Q for A in (model.M, model.C, model.K))
        period = 2 * np.pi * balance.fourier.periods / omega
        self.steps, self.h, self.n = steps, period / steps, Q.shape[1]
        stresses = balance.stresses(X, omega)
        self.parts = [
            _slopes(p, Q, X, omega, balance.fourier.derivative, steps, stresses[p.name].state)
            for p in model.interfaces
        ]
        self.counts = [int(part.moves.sum()) for part in self.parts]
        self.size = 2 * self.n + sum(self.counts)

    def apply(self, columns: np.ndarray) -> np.ndarray:
        """Disturbances (size, columns) a period later."""
        n, h, M, C, K = self.n, self.h, self.M, self.C, self.K
        u, v, *states = np.split(columns, np.cumsum([n, n, *self.counts])[:-1])
        states = [_spread(part.moves, s) for part, s in zip(self.parts, states, strict=True)]
        force = self._force(-1, u, v, states)
        base = 4 / h**2 * M + 2 / h * C
        for t in range(self.steps):
            A, memory = base + K, np.zeros_like(u)
            for part, s in zip(self.parts, states, strict=True):
                d = part.kernel.d
                A = A + part.stiffness(slice(t, t + 1), slice(0, d))[0]
                memory += part.memory(t, s)
                if part.kernel.rated:
                    R = part.stiffness(slice(t, t + 1), slice(d, None))[0]
                    A = A + 2 / h * R
                    memory -= R @ (2 / h * u + v)
            right = (base - K) @ u + 4 / h * (M @ v) - force - memory
            new = np.linalg.solve(A, right)
            # C enters at both ends: what the present velocity has of it cancels.
            v = 2 / h * (new - u) - v
            u = new
            force = self._force(t, u, v, states)
            states = [
                part.after(t, part.inputs(u, v), s)
                for part, s in zip(self.parts, states, strict=True)
            ]
        picked = [s[part.moves] for part, s in zip(self.parts, states, strict=True)]
        return np.concatenate([u, v, *picked])

    def product(self) -> np.ndarray:
        """`apply` of all unit disturbances, (size, size), as the product of the steps' maps.

        They act on displacements, velocities, the interfaces' force and the states.
        """
        n, whole = self.n, self.size + self.n
        kept = [i for i in range(whole) if not 2 * n <= i < 3 * n]
        found = np.eye(whole)[:, kept]
        states = np.split(found[3 * n :], np.cumsum(self.counts)[:-1])
        first = [_spread(part.moves, s) for part, s in zip(self.parts, states, strict=True)]
        found[2 * n : 3 * n] = self._force(-1, found[:n], found[n : 2 * n], first)
        block = max(1, _BLOCK // whole**2)
        for start in range(0, self.steps, block):
            maps = self._maps(slice(start, min(start + block, self.steps)))
            while len(maps) > 1:
                odd = maps[len(maps) - len(maps) % 2 :]
                maps = np.concatenate([maps[1::2] @ maps[: len(maps) - len(odd) : 2], odd])
            found = maps[0] @ found
        return found[kept]

    def _maps(self, steps: slice) -> np.ndarray:
        """Maps of steps, see `product`, (T, size + n, size + n)."""
        n, h, T = self.n, self.h, steps.stop - steps.start
        one, base = np.eye(n), 4 / h**2 * self.M + 2 / h * self.C
        stiff, rated = np.zeros((2, T, n, n))
        memory = []
        for part in self.parts:
            d = part.kernel.d
            stiff += part.stiffness(steps, slice(0, d))
            if part.kernel.rated:
                rated += part.stiffness(steps, slice(d, None))
            memory.append(part.memories(steps))
        memory = np.concatenate([np.zeros((T, n, 0)), *memory], axis=2)
        none = np.zeros((T, n, n))
        right = np.concatenate(
            [base - self.K + 2 / h * rated, none + 4 / h * self.M + rated, none - one, -memory],
            axis=2,
        )
        u = np.linalg.solve(base + self.K + stiff + 2 / h * rated, right)
        v = 2 / h * u
        v[..., :n] -= 2 / h * one
        v[..., n : 2 * n] -= one
        force = stiff @ u + rated @ v
        force[..., 3 * n :] += memory
        return np.concatenate([u, v, force, *self._new_states(steps, u, v)], axis=1)

    def _new_states(self, steps: slice, u: np.ndarray, v: np.ndarray) -> list[np.ndarray]:
        """States after each step, (T, count, size + n), with its displacement and velocity."""
        found, first = [], 3 * self.n
        for part, count in zip(self.parts, self.counts, strict=True):
            d = part.kernel.d
            new = part.states_by(steps, slice(0, d)) @ u
            if part.kernel.rated:
                new += part.states_by(steps, slice(d, None)) @ v
            new[..., first : first + count] += part.states_by_states(steps)
            found.append(new)
            first += count
        return found

    def _force(self, t: int, u, v, states) -> np.ndarray:
        """Force of the interfaces, (n, columns), with the derivatives of step t."""
        found = np.zeros_like(u)
        for part, s in zip(self.parts, states, strict=True):
            e = part.inputs(u, v)
            stress = np.einsum("pij,pjc->pic", part.by_strain[:, t], e, optimize=True)
            found += part.load @ stress.reshape(-1, u.shape[1]) + part.memory(t, s)
        return found


def _spread(moves: np.ndarray, picked: np.ndarray) -> np.ndarray:
    """States that move, (count, columns), among all, (P, E, m, columns)."""
    found = np.zeros((*moves.shape, picked.shape[1]))
    found[moves] = picked
    return found


def _slopes(
    points: InterfacePoints,
    Q,
    X: np.ndarray,
    omega: float,
    G: np.ndarray,
    steps: int,
    state: np.ndarray,
) -> _Slopes:
    """The derivatives of an interface's steps along a response, its loops closed."""
    kernel, values = points.kernel, points.law.values(len(points))
    Z = points.rows @ X
    if kernel.rated:
        Z = np.concatenate([Z, omega * (Z @ G.T)], axis=1)
    phases = 2 * np.pi * np.arange(1, steps + 1) / steps
    strain = np.ascontiguousarray((Z @ basis(phases, Z.shape[2]).T).transpose(0, 2, 1))
    closed = kernel.history(strain, state, values)[1]
    by_strain, by_state, new_by_strain, new_by_state = kernel.slopes(strain, closed, values)
    still = np.abs(new_by_strain).max(axis=(1, 4), initial=0.0) == 0
    moves = ~still if kernel.m else np.zeros((*values.shape[:2], 0), dtype=bool)
    rows = np.einsum("pdn,nk->pdk", points.rows, Q)
    load = (rows * points.weights[:, None, None]).reshape(-1, Q.shape[1]).T.copy()
    return _Slopes(rows, load, kernel, by_strain, by_state, new_by_strain, new_by_state, moves)
