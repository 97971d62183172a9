"""Updating by one number: the pressure below which a bolted contact is lost (Fronk et al. 2019).

The preload gives every facet of a contact its pressure. A cut-off pressure makes those above it
stuck and leaves the others sliding or open; the frequencies fall in steps as it passes one facet
after another. `CutoffSweep` finds them at every step: the full model is solved at a few cut-offs
(anchors), and between two anchors a reduced model is exact in the jumps that differ, so that only
the high modes are cut (component modes with attachment modes, Rubin, AIAA J. 13, 1975). Its error
is measured where it is largest, at the far anchor. `fenics_joints.updating.cutoff` needs a
few full solutions only.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy.linalg
from mpi4py import MPI
from petsc4py import PETSc
from scipy.interpolate import PchipInterpolator
from scipy.optimize import linear_sum_assignment

from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.modal import EigenSolver, Modes, solve_modes
from fenics_joints.preload import LinearJoint, PreloadResult, cutoff_conditions, pair_conditions
from fenics_joints.structure.sparse import as_columns, product, without_zeros

#: Pressures nearer than this, relative to the largest, are one step: round-off of symmetric facets.
_SAME = 1e-6
#: Jump entries that may differ between two anchors; chosen for time.
_INTERVAL = 500
#: Largest relative error of the frequencies at the far end of an interval.
_ERROR = 1e-4
#: Modes beyond the wanted ones that enter a reduced model, and right-hand sides that are solved for
#: at a time; chosen.
SPARE, _BLOCK = 8, 64


class CutoffModel:
    """A preloaded structure at any cut-off pressure.

    Args:
        result: The preload state.
        scheme: ``"two"`` conditions (stuck, open) or ``"three"`` (stuck, sliding, open).
        n_elastic: Number of elastic modes wanted.
        given: Values of the structure's parameters that differ from their nominal value.
        contacts: Names of the contacts with this cut-off; all of them by default.

    Attributes:
        cutoffs: Every distinct facet pressure, ascending, Pa: step k has the cut-off
            ``cutoffs[k]``, and the facets with that pressure are the next to be lost.
        solver: That of the last full solution.
        solves: Number of full solutions so far.
    """

    def __init__(
        self,
        result: PreloadResult,
        *,
        scheme: str = "two",
        n_elastic: int = 6,
        given: Mapping[str, float] | None = None,
        contacts: Sequence[str] | None = None,
    ):
        self.result, self.scheme, self.n_elastic = result, scheme, n_elastic
        self.given = dict(given or {})
        self.states = [result[name] for name in contacts or result.contacts]
        result.solver.forget()  # room for the factorisations of modes
        self.joint = LinearJoint(result.model)
        self.cutoffs = _levels([s.facet_pressure for s in self.states])
        self.solves = 0
        self.order: dict[int, np.ndarray] = {}
        self.solver: EigenSolver | None = None
        self._known: dict[int, Modes] = {}

    def __len__(self) -> int:
        return len(self.cutoffs)

    def conditions(self, step: int) -> dict[str, np.ndarray]:
        """Condition of every pair at a step, by contact."""
        facets = self.facets(step)
        return {s.name: pair_conditions(s.interface, facets[s.name]) for s in self.states}

    def facets(self, step: int) -> dict[str, np.ndarray]:
        """Condition of every facet at a step, by contact."""
        # Just below the pressure, as symmetric facets differ by round-off.
        cutoff = self.cutoffs[step] * (1 - 0.5 * _SAME)
        return {s.name: cutoff_conditions(s, cutoff, self.scheme) for s in self.states}

    def step_at(self, cutoff: float) -> int:
        """The step that a cut-off pressure, Pa, leads to."""
        found = int(np.searchsorted(self.cutoffs, cutoff * (1 - 0.5 * _SAME)))
        return min(found, len(self) - 1)

    def held(self, step: int) -> np.ndarray:
        """Entries of x held at zero at a step, ascending."""
        return np.sort(self.joint.held({**self.joint.conditions, **self.conditions(step)}))

    def solve(self, step: int, *, keep: bool = True) -> Modes:
        """Modes of the full model at a step. Collective."""
        if step in self._known:
            return self._known[step]
        joint = self.joint.change(self.conditions(step))
        n_modes = 6 + self.n_elastic + SPARE
        modes = solve_modes(joint, self.given, n_modes=n_modes, solver=self.solver)
        self.solver, self.solves = modes.solver, self.solves + 1
        if keep:
            self._known[step] = modes
        return modes

    @cached_property
    def mass(self) -> PETSc.Mat:
        """Mass in x with every jump free, without stored zeros."""
        return without_zeros(self.joint.free_matrices(self.given)[1])


@dataclass(frozen=True, eq=False, repr=False)
class Anchor:
    """A full solution in a sweep, beside what the reduced model below it said.

    Attributes:
        step: Its step.
        frequencies_hz: Elastic frequencies of the full model, in the sweep's order, (n,).
        error: Largest relative difference of the reduced model of the interval above it; NaN for
            the last.
    """

    step: int
    frequencies_hz: np.ndarray
    error: float


@dataclass(eq=False, repr=False)
class CutoffSweep:
    """Frequencies at every cut-off pressure.

    Attributes:
        cutoffs: Cut-off pressures, Pa, (n_steps,).
        frequencies_hz: Elastic modes, followed by their shapes, (n_steps, n_elastic).
        anchors: The full solutions.
        scheme: The scheme.
    """

    cutoffs: np.ndarray
    frequencies_hz: np.ndarray
    scheme: str
    anchors: list[Anchor] = field(default_factory=list)

    def __repr__(self) -> str:
        solved = f"{len(self.cutoffs)} cut-offs, {len(self.anchors)} solved"
        return f"CutoffSweep({self.scheme}, {solved})"

    @property
    def error(self) -> float:
        """Largest relative error of the reduced models at the anchors, where it is largest."""
        return float(np.nanmax([a.error for a in self.anchors]))

    def objective(self, measured_hz) -> np.ndarray:
        """Sum of the relative frequency errors, Fronk et al. 2019, eq. 7, of every step."""
        return misfit(self.frequencies_hz, np.asarray(measured_hz, dtype=float))

    def best(self, measured_hz) -> int:
        """Step of the least objective."""
        return int(np.argmin(self.objective(measured_hz)))


def sweep(
    model: CutoffModel,
    *,
    interval: int = _INTERVAL,
    tolerance: float = _ERROR,
    progress: Callable[[int, int, float], None] | None = None,
) -> CutoffSweep:
    """Frequencies at every step. Collective.

    Args:
        model: The model.
        interval: Jump entries that may differ between two anchors: more of them make fewer full
            solutions and larger reduced models.
        tolerance: Largest relative error of a reduced model at its far anchor; a longer interval
            is cut in two.
        progress: Told (steps done, all steps, largest error so far) after each interval.
    """
    n, n_kept = len(model), model.n_elastic + SPARE // 2
    found = np.full((n, n_kept), np.nan)
    # Down from the softest state, as a reduced model needs the factorisation of its softer end.
    high, modes = n - 1, model.solve(n - 1, keep=False)
    order = np.arange(n_kept)
    found[high] = elastic(modes, n_kept)
    anchors = [Anchor(high, found[high].copy(), np.nan)]
    sizes = np.array([len(model.held(step)) for step in range(n)])
    while high > 0:
        low = _next_anchor(sizes, high, interval)
        while True:
            part = _Part(model, modes, low, high, n_kept)
            if part.error <= tolerance or high - low < 2:
                break
            # Too far: take the nearer half of what was released.
            low = _next_anchor(sizes, high, (sizes[low] - sizes[high]) / 2)
            modes = model.solve(high, keep=False)
        for step in range(high - 1, low - 1, -1):
            order = part.links[step][order]
            found[step] = part.frequencies[step][order]
        high, modes = low, part.modes
        order = part.last[order]
        found[high] = elastic(modes, n_kept)[order]
        anchors.append(Anchor(high, elastic(modes, n_kept), part.error))
        if progress is not None:
            progress(n - high, n, max(a.error for a in anchors[1:]))
    # Modes are numbered as they stand in the stiffest state.
    first = np.argsort(order)[: model.n_elastic]
    return CutoffSweep(model.cutoffs, found[:, first], model.scheme, anchors[::-1])


class _Part:
    """Frequencies between two anchors by a reduced model, followed by shape, and its error.

    Attributes:
        frequencies: At every step from ``low`` to ``high - 1``, ascending, Hz.
        links: Which of a step's modes continues each of the step above.
        last: Which of the full modes at ``low`` continues each of the reduced ones there.
        modes: Modes of the full model at ``low``.
        error: Largest relative difference of the wanted frequencies there.
    """

    def __init__(self, model: CutoffModel, modes: Modes, low: int, high: int, n: int):
        reduced = _Interval(model, modes, low, high)
        before, self.frequencies, self.links = reduced.of_modes(n), {}, {}
        for step in range(high - 1, low - 1, -1):
            self.frequencies[step], vectors = reduced.solve(step, n)
            self.links[step] = assign(before.T @ reduced.mass @ vectors)
            before = vectors
        self.modes = model.solve(low, keep=False)
        exact = elastic(self.modes, n)
        self.error = float(np.abs(self.frequencies[low] / exact - 1)[: model.n_elastic].max())
        self.last = assign(before.T @ reduced.onto(self.modes, n))


class _Interval:
    """Reduced model of all steps between two anchors, exact in the jumps that differ.

    With A = K - shift M of the softer anchor, its modes Phi, and attachment modes Psi = A^-1 E for
    unit forces at those jumps, coordinates are the jumps w themselves and the modes' share q that
    leaves them at zero; a step holds some of w at zero.

    Args:
        model: The model; its last full solution is ``modes``.
        modes: Modes at step ``high``.
        low: The stiffer end.
        high: The softer end.
    """

    def __init__(self, model: CutoffModel, modes: Modes, low: int, high: int):
        self.model, self.n_rigid, self.shift = model, modes.n_rigid, model.solver.shift
        self.released = np.setdiff1d(model.held(low), model.held(high), assume_unique=True)
        jumps, comm = model.joint.jumps, model.joint.model.comm
        self._comm, self._M = comm, model.mass
        self.Phi = as_columns(modes.shapes)
        mine = jumps.owned(self.released)
        at = jumps.local(self.released[mine])
        self.Psi = _attachments(model, at, np.flatnonzero(mine), len(self.released))
        rows = np.zeros((len(self.released), self.Phi.shape[1] + self.Psi.shape[1]))
        rows[mine] = np.column_stack([self.Phi[at], self.Psi[at]])
        comm.Allreduce(MPI.IN_PLACE, rows)
        self._assemble(modes.eigenvalues - self.shift, rows)

    def _assemble(self, theta: np.ndarray, rows: np.ndarray) -> None:
        """A and M in the coordinates (q, w)."""
        m = len(theta)
        self.at_modes, flexibility = rows[:, :m], 0.5 * (rows[:, m:] + rows[:, m:].T)
        heavy = product(self._M, self.Psi)
        mass = np.eye(m + rows.shape[0])
        mass[m:, m:] = self._comm.allreduce(self.Psi.T @ heavy)
        # A Psi = E and A Phi = M Phi diag(theta) give the mixed block without a product.
        mass[m:, :m] = self.at_modes / theta
        mass[:m, m:] = mass[m:, :m].T
        stiff = np.linalg.inv(flexibility)
        self.turn = np.eye(m + rows.shape[0])
        self.turn[m:, :m], self.turn[m:, m:] = -stiff @ self.at_modes, stiff
        self.stiffness = scipy.linalg.block_diag(
            np.diag(theta) - self.at_modes.T @ stiff @ self.at_modes, stiff
        )
        self.mass = self.turn.T @ mass @ self.turn
        self.n_modes = m

    def solve(self, step: int, n: int) -> tuple[np.ndarray, np.ndarray]:
        """Elastic frequencies, Hz, (n,), and mass-normalised vectors, (size, n), at a step."""
        free = ~np.isin(self.released, self.model.held(step), assume_unique=True)
        index = np.concatenate([np.arange(self.n_modes), self.n_modes + np.flatnonzero(free)])
        pick = np.ix_(index, index)
        size, wanted = len(index), self.n_rigid + n
        try:
            theta, y = scipy.linalg.eigh(
                self.mass[pick], self.stiffness[pick], subset_by_index=[size - wanted, size - 1]
            )
        except scipy.linalg.LinAlgError as error:
            raise ConvergenceError(
                f"the reduced model at the cut-off {self.model.cutoffs[step]:.4g} Pa was not "
                "solved; try a smaller interval",
                str(error),
            ) from error
        values = 1 / theta[::-1] + self.shift
        vectors = np.zeros((len(self.mass), n))
        vectors[index] = (y / np.sqrt(theta))[:, ::-1][:, self.n_rigid :]
        return np.sqrt(np.maximum(values[self.n_rigid :], 0)) / (2 * np.pi), vectors

    def of_modes(self, n: int) -> np.ndarray:
        """The softer anchor's elastic modes in the coordinates, (size, n)."""
        keep = slice(self.n_rigid, self.n_rigid + n)
        return np.vstack([np.eye(self.n_modes)[:, keep], self.at_modes[:, keep]])

    def onto(self, modes: Modes, n: int) -> np.ndarray:
        """Products M-wise of the coordinates' vectors with other elastic modes, (size, n)."""
        heavy = product(self._M, elastic_shapes(modes, n))
        local = np.vstack([self.Phi.T @ heavy, self.Psi.T @ heavy])
        return self.turn.T @ self._comm.allreduce(local)


def _attachments(model: CutoffModel, at, columns, n: int) -> np.ndarray:
    """Responses to unit forces at entries of x: local rows ``at`` get the ``columns``."""
    n_local = model.joint.jumps.n_local
    found = np.empty((n_local, n), order="F")
    for start in range(0, n, _BLOCK):
        block = np.zeros((n_local, min(_BLOCK, n - start)), order="F")
        inside = (columns >= start) & (columns < start + _BLOCK)
        block[at[inside], columns[inside] - start] = 1.0
        found[:, start : start + _BLOCK] = model.solver.inverse(block)
    return found


def elastic(modes: Modes, n: int) -> np.ndarray:
    """The first n elastic frequencies, Hz."""
    return modes.frequencies_hz[modes.n_rigid : modes.n_rigid + n]


def elastic_shapes(modes: Modes, n: int) -> np.ndarray:
    """This rank's rows of the shapes of the first n elastic modes, (n_local, n)."""
    return as_columns(modes.shapes[modes.n_rigid : modes.n_rigid + n])


def misfit(frequencies_hz: np.ndarray, measured_hz: np.ndarray) -> np.ndarray:
    """Sum of the relative frequency errors (Fronk et al. 2019, eq. 7), of frequencies (..., n)."""
    return np.sum(np.abs(frequencies_hz / measured_hz - 1), axis=-1)


def assign(overlap: np.ndarray) -> np.ndarray:
    """Column that continues each row, by the largest sum of squared overlaps."""
    return linear_sum_assignment(-(overlap**2))[1]


def _next_anchor(sizes: np.ndarray, high: int, interval: float) -> int:
    """The lowest step from which at most ``interval`` entries are released on the way to ``high``.

    Args:
        sizes: Number of held entries at every step.
        high: A step above 0.
        interval: Entries.
    """
    near = np.flatnonzero(sizes[:high] - sizes[high] <= interval)
    return int(near[0]) if len(near) else high - 1


def _levels(pressures: list[np.ndarray]) -> np.ndarray:
    """Distinct positive pressures, ascending."""
    p = np.sort(np.concatenate(pressures))
    if not len(p) or p[-1] <= 0:
        raise InputError("the contact has no pressure; expected a preload that presses it.")
    p = p[p > 1e-9 * p[-1]]
    return p[np.concatenate([[True], np.diff(p) > _SAME * p[-1]])]


# -- the least objective by few full solutions -----------------------------------------------------


@dataclass(eq=False, repr=False)
class CutoffMinimum:
    """The least objective, found by full solutions alone.

    Attributes:
        step: Its step.
        cutoff: Its cut-off pressure, Pa.
        objective: Sum of relative frequency errors there.
        frequencies_hz: Elastic frequencies there, (n_elastic,).
        visited: Steps that were solved, in order.
        bound: No step has an objective below this; equal to ``objective`` when that is proved to
            be the least.
    """

    step: int
    cutoff: float
    objective: float
    frequencies_hz: np.ndarray
    visited: list[int]
    bound: float

    def __repr__(self) -> str:
        found = f"{self.cutoff:.4g} Pa, objective {self.objective:.4g}"
        return f"CutoffMinimum({found}, {len(self.visited)} solutions)"


def minimise(
    model: CutoffModel,
    measured_hz,
    *,
    max_solves: int = 15,
    progress: Callable[[int, float, float], None] | None = None,
) -> CutoffMinimum:
    """Find the cut-off of least objective with few full solutions. Collective.

    The frequencies fall monotonically with the cut-off. So between two solved steps each lies
    between its values there, which bounds the objective from below, and each is interpolated
    monotonically; the next step solved is the one of least interpolated objective among those that
    the bounds leave, until none is left or ``max_solves`` are done.

    Args:
        model: The model.
        measured_hz: Measured elastic frequencies, Hz, (n_elastic,), in the model's order in its
            stiffest state.
        max_solves: Most full solutions.
        progress: Told (solutions, cut-off, objective) after each.
    """
    measured = np.asarray(measured_hz, dtype=float)
    if measured.shape != (model.n_elastic,):
        raise InputError(f"measured_hz has shape {measured.shape}: expected ({model.n_elastic},).")
    n = len(model)
    solved: dict[int, np.ndarray] = {}
    visited: list[int] = []

    def error(step: int) -> float:
        return float(misfit(solved[step], measured))

    def solve(step: int) -> None:
        solved[step] = _followed(model, step, solved)
        visited.append(step)
        if progress is not None:
            progress(len(visited), model.cutoffs[step], error(step))

    if n < 2:
        raise InputError(f"the contact has {n} distinct pressure; expected at least 2.")
    for step in dict.fromkeys([0, (n - 1) // 3, 2 * (n - 1) // 3, n - 1]):
        solve(step)
    bound = -np.inf
    while True:
        least = min(map(error, solved))
        predicted, below = _predict(model.cutoffs, solved, measured)
        predicted[[*solved, *np.flatnonzero(below >= least)]] = np.inf
        step = int(np.argmin(predicted))
        bound = least if np.isinf(predicted[step]) else min(least, below.min())
        if np.isinf(predicted[step]) or len(visited) >= max_solves:
            break
        solve(step)
    best = min(solved, key=error)
    return CutoffMinimum(
        best, float(model.cutoffs[best]), error(best), solved[best], visited, float(bound)
    )


def _predict(cutoffs, solved, measured) -> tuple[np.ndarray, np.ndarray]:
    """Interpolated objective at every step, and a bound from below by monotonicity."""
    steps = sorted(solved)
    known = np.array([solved[k] for k in steps])
    curves = PchipInterpolator(cutoffs[steps], known)
    left = np.clip(np.searchsorted(steps, np.arange(len(cutoffs)), "right") - 1, 0, len(steps) - 2)
    high = np.maximum(known[left], known[left + 1]) / measured - 1
    low = np.minimum(known[left], known[left + 1]) / measured - 1
    off = np.maximum(0.0, np.maximum(low, -high))
    return misfit(curves(cutoffs), measured), off.sum(axis=1)


def _followed(model: CutoffModel, step: int, solved: Mapping[int, np.ndarray]) -> np.ndarray:
    """Elastic frequencies at a step, in the order of the stiffest state."""
    modes = model.solve(step)
    n = model.n_elastic + SPARE // 2
    frequencies = elastic(modes, n)
    if not solved:
        model.order = {step: np.arange(n)}
        return frequencies[: model.n_elastic]
    near = min(solved, key=lambda k: abs(k - step))
    A, B = (elastic_shapes(m, n) for m in (model.solve(near), modes))
    link = assign(model.joint.model.comm.allreduce(A.T @ product(model.mass, B)))
    model.order[step] = link[model.order[near]]
    return frequencies[model.order[step]][: model.n_elastic]
