"""Reduced models for frequency response functions, checked against the full one.

Modes alone are a poor basis for an FRF: a force at a point has a share of all modes, and what those
beyond the basis answer decides where the antiresonances are. So the basis also holds, at every
sample of the parameters, residual vectors for the forces, the sensors and the damped layers (see
`response.modal_basis`). `frf_error` says what is left, against the direct solution of the full
model, and `checked_frf_model` adds samples until it is small enough where it was asked to be.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.modal.modes import Modes, solve_modes
from fenics_joints.reduction.arrays import ArrayModel
from fenics_joints.reduction.reduced import ReducedStructure
from fenics_joints.reduction.snapshots import SNAPSHOT, Snapshots
from fenics_joints.response.frf import solve_frf
from fenics_joints.response.modal_basis import check_lines, modal_pencil
from fenics_joints.response.pencil import DampedPencil
from fenics_joints.structure import Damping, Sensors, Structure

Values = Mapping[str, float]


@dataclass(frozen=True)
class FRFError:
    """Error of a reduced model's FRFs against the full one's direct solution.

    Attributes:
        frequencies_hz: Lines at which it was found, Hz, (n_f,).
        relative: |H - H_full| / |H_full|, (n_points, n_f, n_sensors, n_excitations).
        log: ln(H / H_full), complex: the error of ln|H| and of the phase, rad; the same shape.
    """

    frequencies_hz: np.ndarray
    relative: np.ndarray
    log: np.ndarray

    @property
    def by_point(self) -> np.ndarray:
        """The largest relative error at each point, (n_points,)."""
        return self.relative.max(axis=(1, 2, 3))

    @property
    def worst(self) -> float:
        """The largest relative error of all."""
        return float(self.relative.max())

    def __repr__(self) -> str:
        points, lines = self.relative.shape[:2]
        return f"FRFError(at most {self.worst:.2g} at {points} points, {lines} lines)"


@dataclass(frozen=True)
class CheckedFRFModel:
    """A reduced model and what it was found to be worth.

    Attributes:
        reduced: The reduced model.
        arrays: The same as plain arrays, with displacements where forces and sensors are.
        error: Its error at `points`.
        points: Values at which it was checked.
        samples: Values at which its basis was made, those of the points that were added last.
        history: In each round: size of the basis, largest relative error over all points.
        fresh: Largest relative error at points of which the basis has no vectors: what to expect
            elsewhere among them. None if vectors of every point are in it.
    """

    reduced: ReducedStructure
    arrays: ArrayModel
    error: FRFError
    points: tuple[Values, ...]
    samples: tuple[Values, ...]
    history: tuple[tuple[int, float], ...]
    fresh: float | None

    def __repr__(self) -> str:
        return f"CheckedFRFModel({self.reduced.n_dofs} vectors, {self.error!r})"


class ResponseSampler:
    """Modes and residual vectors at one sample after the other, one factorisation each.

    Args:
        structure: The full model.
        n_modes: Modes at each sample.
        loads: Forces, and what is read, as columns, (n_local, k); None for none.
        lines: Lines of interest, Hz; None for the modes' own frequencies.
        damping: The damping.

    Attributes:
        snapshots: What was found.
    """

    def __init__(
        self, structure: Structure, n_modes: int, loads: np.ndarray | None, lines, damping: Damping
    ):
        self.structure, self.n_modes, self.damping = structure, n_modes, damping
        self.loads, self.lines = loads, lines
        self.snapshots, self.solver = Snapshots(structure), None

    def modes(self, given: Values) -> Modes:
        """Modes at a sample."""
        modes = solve_modes(
            self.structure, given, n_modes=self.n_modes, solver=self.solver, tolerance=SNAPSHOT
        )
        self.solver = modes.solver
        return modes

    def add(self, given: Values, modes: Modes, residual: bool = True) -> None:
        """Take the modes in, and residual vectors for the loads and the damped layers."""
        more = None
        if residual:
            lines = modes.frequencies_hz[modes.n_rigid :] if self.lines is None else self.lines
            pencil = DampedPencil(self.structure, given, self.damping)
            try:
                modal = modal_pencil(pencil, self.loads, lines, modes=modes)
            finally:
                pencil.destroy()
            more = modal.basis[:, len(modes) :]
        self.snapshots.add(modes, more=more)


def response_loads(structure: Structure, excitation: Sensors, sensors: Sensors) -> np.ndarray:
    """Loads of a unit at excitations and sensors, this rank's rows, (n_local, k)."""
    return np.hstack([structure.loads(excitation, "excitation"), structure.loads(sensors)])


def _sampler(structure, n_modes, lines, excitation, sensors, damping) -> ResponseSampler:
    damping = damping or Damping()
    damping.check(structure.parameters, structure.layers)
    loads = response_loads(structure, excitation, sensors)
    return ResponseSampler(structure, n_modes, loads, check_lines(lines), damping)


def frf_basis(
    structure: Structure,
    samples: Iterable[Values],
    *,
    n_modes: int,
    frequencies_hz,
    excitation: Sensors,
    sensors: Sensors,
    damping: Damping | None = None,
    tolerance: float = 1e-8,
    travel: Mapping[str, tuple[float, float]] | None = None,
    progress: Callable[[], None] | None = None,
) -> ReducedStructure:
    """Reduced model on modes and residual vectors at samples of the parameters. Collective.

    Args:
        structure: The full model.
        samples: Values at which they are computed.
        n_modes: Modes at each sample, rigid-body ones included.
        frequencies_hz: Lines of interest, Hz; their median weighs the layers' damping.
        excitation: Points and directions of the forces.
        sensors: Points and directions of the responses.
        damping: The damping, whose damped layers get residual vectors of their own.
        tolerance: Directions with less than this share of the largest energy are left out.
        travel: Ranges of moving masses, see `ReducedStructure`.
        progress: Called after each sample.

    Raises:
        InputError: Without samples, or if a value is out of range or a point outside the mesh.
        ConvergenceError: If modes were not found.
    """
    sampler = _sampler(structure, n_modes, frequencies_hz, excitation, sensors, damping)
    for given in samples:
        sampler.add(given, sampler.modes(given))
        if progress:
            progress()
    return ReducedStructure(structure, sampler.snapshots.basis(tolerance), travel)


def frf_error(
    reduced,
    structure: Structure,
    at: Sequence[Values],
    *,
    frequencies_hz,
    excitation: Sensors,
    sensors: Sensors,
    damping: Damping | None = None,
    lines: int | None = 5,
) -> FRFError:
    """Error of FRFs of a reduced model at parameter values. Collective.

    Receptance, mobility and accelerance have the same relative error.

    Args:
        reduced: A `ReducedStructure` or `ArrayModel`.
        structure: The full model, which is solved directly; by modes where it has modal ratios.
        at: Values of the parameters, n_points sets of them.
        frequencies_hz: Lines of interest, Hz.
        excitation: Points and directions of the forces.
        sensors: Points and directions of the responses.
        damping: The damping.
        lines: At how many lines, evenly from the first to the last; None for all.

    Raises:
        InputError: As `solve_frf`; without values.
        ConvergenceError: If a line is at a resonance without damping.
    """
    if not len(at):
        raise InputError("at: expected at least one set of parameter values.")
    asked = {
        "frequencies_hz": _some(check_lines(frequencies_hz), lines),
        "excitation": excitation,
        "sensors": sensors,
        "damping": damping,
    }
    return _error(reduced, at, [_exact(structure, given, asked) for given in at], asked)


def checked_frf_model(
    structure: Structure,
    samples: Sequence[Values],
    points: Sequence[Values],
    *,
    n_modes: int,
    frequencies_hz,
    excitation: Sensors,
    sensors: Sensors,
    damping: Damping | None = None,
    error: float = 1e-3,
    lines: int | None = 5,
    rounds: int = 8,
    strict: bool = True,
    tolerance: float = 1e-8,
    travel: Mapping[str, tuple[float, float]] | None = None,
    progress: Callable[[], None] | None = None,
) -> CheckedFRFModel:
    """Reduced model whose FRFs have no larger error than asked at points. Collective.

    The point with the largest error becomes a sample, and all are looked at again.

    Args:
        structure: The full model.
        samples: Values at which the basis is made to begin with.
        points: Values at which the error shall be small.
        n_modes: As in `frf_basis`.
        frequencies_hz: Lines of interest, Hz.
        excitation: Points and directions of the forces.
        sensors: Points and directions of the responses.
        damping: The damping.
        error: Largest relative error of any FRF at any of the points and lines.
        lines: At how many lines each point is checked, see `frf_error`.
        rounds: How many points may be added.
        strict: Whether a larger error is an exception; otherwise it is there to be read.
        tolerance: As in `frf_basis`.
        travel: Ranges of moving masses.
        progress: Called after each sample and each point.

    Raises:
        InputError: As `frf_basis`.
        ConvergenceError: If the error is still larger after all rounds, and ``strict``.
    """
    if not len(samples) or not len(points):
        raise InputError("samples and points: expected at least one set of values in each.")
    done = progress or (lambda: None)
    sampler = _sampler(structure, n_modes, frequencies_hz, excitation, sensors, damping)
    used, exact = list(samples), []
    asked = {
        "frequencies_hz": _some(sampler.lines, lines),
        "excitation": excitation,
        "sensors": sensors,
        "damping": damping,
    }
    for given in used:
        sampler.add(given, sampler.modes(given))
        done()
    for given in points:
        exact.append(_exact(structure, given, asked))
        done()
    history, own = [], np.zeros(len(points), dtype=bool)
    while True:
        reduced = ReducedStructure(structure, sampler.snapshots.basis(tolerance), travel)
        found = _error(reduced, points, exact, asked)
        history.append((reduced.n_dofs, found.worst))
        worst = int(np.argmax(np.where(own, 0.0, found.by_point)))
        late = found.worst > error
        if not late or len(history) > rounds or own.all() or found.by_point[worst] <= error:
            break
        own[worst] = True
        used.append(points[worst])
        sampler.add(points[worst], sampler.modes(points[worst]))
        done()
    if late and strict:
        raise ConvergenceError(
            f"the FRFs of the reduced model of {reduced.n_dofs} vectors have an error of "
            f"{found.worst:.1e} at the worst of {len(points)} points, more than the {error:.1e} "
            "asked for: allow more rounds, more modes or a smaller tolerance."
        )
    fresh = None if own.all() else float(found.by_point[~own].max())
    return CheckedFRFModel(
        reduced,
        reduced.arrays(excitation, sensors),
        found,
        tuple(points),
        tuple(used),
        tuple(history),
        fresh,
    )


def _some(lines: np.ndarray, count: int | None) -> np.ndarray:
    """Some of the lines, evenly from the first to the last."""
    if count is None or count >= len(lines):
        return lines
    if count < 1:
        raise InputError(f"lines = {count}: expected at least 1, or None for all.")
    return lines[np.unique(np.linspace(0, len(lines) - 1, count).round().astype(int))]


def _exact(structure, given: Values, asked) -> np.ndarray:
    """Receptances of the full model, (n_f, n_sensors, n_excitations)."""
    modal = asked["damping"] and asked["damping"].is_modal
    settings = {"method": "modal", "check": 0} if modal else {}
    return solve_frf(structure, given, **asked, **settings).values


def _error(reduced, at: Sequence[Values], exact, asked) -> FRFError:
    found = np.array([solve_frf(reduced, given, **asked).values for given in at])
    ratio = found / np.array(exact)
    return FRFError(asked["frequencies_hz"], np.abs(ratio - 1), np.log(ratio))
