"""Lines of measured frequency response functions as data, and a model's errors in them."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.ndimage import median_filter

from fenics_joints.case import Case
from fenics_joints.case.test import FRFSection
from fenics_joints.diagnosis.evidence.observations import FunctionLine
from fenics_joints.errors import InputError
from fenics_joints.measurements.data import TestData
from fenics_joints.measurements.frfs import MeasuredFRFs, choose_lines
from fenics_joints.reduction.batch_modes import BatchModes
from fenics_joints.reduction.prediction import ModalPrediction
from fenics_joints.reduction.receptances import Lines, PointBasis, Poles, Receptances
from fenics_joints.structure import Sensors

#: Most that a line may be off, relative to its value, by all errors of the model, and by errors of
#: resonances and damping alone: beyond, it is not linear in these errors. [decision: chosen]
_MOST_OFF, _NEAR_POLES = 0.3, 0.1
#: Relative error of the residual of higher modes, mostly local bending at the point. [decision:
#: chosen]
_BEYOND = 0.2
#: Eigenvalue, over that of the lowest mode of the test, below which a mode is a rigid motion.
#: [numerical: chosen]
_RIGID = 1e-4
#: Change of a shape by an unknown cause, over the error of any model's shape. [decision: as of
#: shapes: 0.2 over the usual 0.05]
_UNKNOWN = 4.0


class Errors:
    """Errors of lines, by their cause, relative to the measured function.

    A function's residues are products of shapes, which any model has wrong by
    ``shape_discrepancy``, in phase and out of it; where the test has no resonance the model's is
    wrong as its others are.

    Args:
        model: The case.
        basis: A model with the functions' points.
        forward: Tells the test's modes of it.
        row: The test's row.
        poles: Its resonances.
        damping_sd: Standard deviation of ln of their damping, (m,).
    """

    def __init__(
        self,
        model: Prepared,
        basis: PointBasis,
        forward: ModalPrediction,
        row: int,
        poles: Poles,
        damping_sd: np.ndarray,
    ):
        self.basis, self.forward, self.poles = basis, forward, poles
        self._evidence, self._baseline = model.evidence, model.baseline
        self._log_sd, self._damping_sd = model.data.log_sd()[row], damping_sd
        self._n_modes = min(model.case.diagnose.n_modes, basis.model.n_dofs)
        self.modes: BatchModes = self._receptances(Lines(*np.zeros((3, 0)))).modes(self._baseline)
        self._lam, self._index = self.modes.eigenvalues[0], self.modes.index[0]
        self._n_rigid = int(np.sum(self._lam < _RIGID * self._lam[self._index].min()))
        self._moves = basis.rows @ self.modes.vectors[0]
        everywhere = basis.model.sensor_rows @ self.modes.vectors[0]
        # Of a motion's length, three directions to each place.
        self._size = np.sqrt(basis.everywhere.points.shape[1] * np.mean(everywhere**2, axis=0))
        own = np.isfinite(poles.frequencies_hz)
        away = self.modes.log_f[0][own] - np.log(poles.frequencies_hz[own])
        self._off = float(np.hypot(self._evidence.discrepancy, np.sqrt(np.mean(away**2))))
        self._last = self._highest(away, own)

    def receptances(self, lines: Lines) -> np.ndarray:
        """The nominal model's, m/N, (n,)."""
        return self._receptances(lines).at(self._baseline)[0]

    def _receptances(self, lines: Lines) -> Receptances:
        return Receptances(self.basis, lines, self.poles, self.forward)

    def _highest(self, away: np.ndarray, own: np.ndarray) -> float:
        """Up to where resonances are known, Hz: half way from the test's last one to the next."""
        hz = self.poles.frequencies_hz[own]
        last, shift = hz.max(), away[np.argmax(hz)]
        model = np.sqrt(np.maximum(self._lam[: self._n_modes], 0.0)) / (2 * np.pi)
        above = model[model > last * np.exp(shift) * (1 + 1e-6)] * np.exp(-shift)
        return float(np.sqrt(last * above.min())) if len(above) else float(last)

    def small(self, lines: Lines, values: np.ndarray, sd: np.ndarray) -> np.ndarray:
        """Which lines say something, (n,), of values (n,) with their noise: the lesser of what was
        measured and of what the model has, which errors shall be little of either."""
        of_shapes, of_poles = self._columns(lines)
        near, all_ = (
            np.sqrt(sum(np.abs(c) ** 2 for c in parts.values())) / np.abs(values)
            for parts in (of_poles, of_shapes | of_poles)
        )
        known = lines.frequencies_hz <= self._last
        return known & (near < _NEAR_POLES) & (np.hypot(all_, sd) < _MOST_OFF)

    def common(self, lines: Lines, values: np.ndarray) -> list[dict[Hashable, complex]]:
        """Errors of each line that others have too, by their cause, relative to values (n,)."""
        of_shapes, of_poles = self._columns(lines)
        return [
            {name: complex(c[n] / v) for name, c in (of_shapes | of_poles).items() if c[n]}
            for n, v in enumerate(values)
        ]

    def unknown(self, common: Mapping[Hashable, complex]) -> float:
        """What an unknown cause may do to a line with such errors, one standard deviation."""
        shapes = [abs(c) for name, c in common.items() if name[0] == "shape"]
        return float(_UNKNOWN * np.sqrt(np.sum(np.square(shapes))))

    def _columns(self, lines: Lines) -> tuple[dict, dict]:
        """Errors of the functions, m/N, each (n,): by shapes and higher modes; by resonances."""
        square, shapes, poles = lines.omega**2, {}, {}
        one, other = self._moves[lines.response], self._moves[lines.reference]
        given, mode_of = self.poles.dynamic_stiffness(lines.omega), {}
        for i, k in enumerate(self._index):
            if np.isfinite(self.poles.frequencies_hz[i]):
                mode_of[int(k)] = i
        for k in range(self._n_rigid, self._n_modes):
            i = mode_of.get(k)
            stiffness = self._lam[k] - square + 0j if i is None else given[i]
            residue = one[:, k] * other[:, k]
            self._add_shape(shapes, lines, k, i, stiffness)
            if i is None:
                poles["resonance", k] = residue * 2 * self._off * self._lam[k] / stiffness**2
                continue
            own = 2 * np.pi * self.poles.frequencies_hz[i]
            lost = 2j * self.poles.damping[i] * own * lines.omega
            sd = np.nan_to_num(self._log_sd[i])
            poles["resonance", k] = residue * 2 * sd * own**2 / stiffness**2
            poles["damping", k] = residue * self._damping_sd[i] * lost / stiffness**2
        rest = one[:, self._n_modes :] * other[:, self._n_modes :]
        rest = (rest / (self._lam[self._n_modes :] - square[:, None])).sum(axis=1)
        for i, j in set(zip(lines.response.tolist(), lines.reference.tolist(), strict=True)):
            own = (lines.response == i) & (lines.reference == j)
            shapes["beyond", i, j] = np.where(own, _BEYOND * rest, 0.0)
        return shapes, poles

    def _add_shape(self, shapes: dict, lines: Lines, k: int, i: int | None, stiffness) -> None:
        """Add the errors of a mode's shape at either point."""
        error = self._evidence.shape_error
        if i is not None and self._evidence.mesh_shape is not None:
            error = max(error, float(self._evidence.mesh_shape[i]))
        size = error * self._size[k]
        for at, others in ((lines.response, lines.reference), (lines.reference, lines.response)):
            for point in np.unique(at):
                change = np.where(at == point, size * self._moves[others, k], 0.0) / stiffness
                name = "shape", k, int(point)
                shapes[name] = shapes.get(name, 0.0) + change


#: `fenics_joints.diagnosis.model.prepared.Prepared`, whose test these are of.
Prepared = Any
#: Functions and lines that are taken, at most; the fewest of a function. [numerical: chosen for
#: time]
_FUNCTIONS, _LINES, _FEW = 6, 48, 4
#: Lines of a planned function, and where they begin, in lowest resonances. [numerical: chosen]
_GRID, _LOWEST = 800, 0.3
#: See `PointBasis`: lines are off by 0.2 % in the median, 1 % near valleys (test plates).
#: [numerical: measured on the test plates]
_BASIS = 1e-4
#: Lines over which the ratio to the model is a running median: single ones may be hum. [numerical:
#: chosen]
_BESIDE = 5
#: How far a function may be off before it is another's: a unit, a scale or a sign is wrong.
#: [decision: chosen]
_OFF = 3.0
#: Damping ratio of a mode for which none was measured, and its standard deviation of ln. [decision:
#: chosen]
_DAMPING, _UNSURE = 0.01, 1.0


@dataclass(frozen=True, eq=False)
class _Functions:
    """Functions that are looked at, as receptances.

    Attributes:
        frfs: All that were measured.
        calibration: Standard deviation of the scale of a sensor, or of a force.
        pairs: Response and reference of each, (n, 2).
        at: Points in which forces and responses are.
        points: Numbers of the points of its response and of its reference, (n, 2).
        values: m/N, (n_lines, n), with the signs of these points.
        sd: Relative standard deviation, (n_lines, n).
    """

    frfs: MeasuredFRFs
    calibration: complex
    pairs: np.ndarray
    at: Sensors
    points: np.ndarray
    values: np.ndarray
    sd: np.ndarray

    def named(self, k: int) -> str:
        """Name of a function."""
        i, j = self.pairs[k]
        return f"{self.frfs.response_names[i]} by a force at {self.frfs.reference_names[j]}"

    def lines(self, chosen: Sequence[tuple[int, int]]) -> Lines:
        """Lines by the function and the measured line of each."""
        k, at = np.array(chosen, dtype=int).reshape(-1, 2).T
        points = self.points[k]
        return Lines(self.frfs.frequencies_hz[at], points[:, 0], points[:, 1])

    def off(self, k: int) -> dict[Hashable, complex]:
        """Errors of the scales of a function's sensor and of its force."""
        i, j = map(int, self.pairs[k])
        names = (("sensor", i), ("force", j)) if self.calibration else ()
        return dict.fromkeys(names, self.calibration)


def measured_functions(
    model: Prepared, frfs: MeasuredFRFs, everywhere: Sensors
) -> tuple[tuple[FunctionLine, ...], list[str]]:
    """Lines of ``[test.frfs]`` as data, and notes on them. Collective.

    Args:
        model: The case, with its reduced model.
        frfs: The functions.
        everywhere: Places at which modes are compared.

    Raises:
        InputError: If a point is beside the structure, or the condition none of the test's.
    """
    case, full, section = model.case, model.full, model.case.test.frfs
    row = row_of(case, "test.frfs", section.at, model.data)
    taken = _taken(frfs.converted("receptance"), section)
    if full.is_meshed:
        full.rows(taken.at.points, "frf", taken.at.names)  # whether they are on the mesh
    return _data(taken, _errors(model, taken.at, everywhere, row), row)


def planned_function(model: Prepared, at: Sensors, everywhere: Sensors) -> tuple[FunctionLine, ...]:
    """Lines of a function that would be measured, of force and motion at one place, as the nominal
    model has it. Collective.

    Args:
        model: The case, with its reduced model.
        at: The place.
        everywhere: See `measured_functions`.
    """
    row = row_of(model.case, "test.planned", None, model.data)
    errors = _errors(model, at, everywhere, row)
    poles = errors.poles.frequencies_hz[np.isfinite(errors.poles.frequencies_hz)]
    hz = np.geomspace(_LOWEST * poles.min(), poles.max(), _GRID)
    same = np.zeros(_GRID, dtype=int)
    values = errors.receptances(Lines(hz, same, same))
    three = [np.pad(each, [(0, 0), (0, 3 - each.shape[1])]) for each in (at.points, at.directions)]
    frfs = MeasuredFRFs(hz, values[:, None, None], "receptance", *three, *three)
    return _data(_taken(frfs, FRFSection.model_construct()), errors, row)[0]


def _errors(model: Prepared, at: Sensors, everywhere: Sensors, row: int) -> Errors:
    """A model with these points, and its errors there."""
    samples, travel = model.to_span()
    basis = PointBasis(
        model.full, at, everywhere, samples, model.case.diagnose.n_modes, travel, tolerance=_BASIS
    )
    return Errors(model, basis, _forward(model, basis, everywhere), row, *_poles(model, row))


def _data(
    taken: _Functions, errors: Errors, row: int
) -> tuple[tuple[FunctionLine, ...], list[str]]:
    """The lines as data, two entries each, and notes on them."""
    count, notes = max(_LINES // len(taken.pairs), _FEW), []
    values, chosen = taken.values.copy(), []
    for k in range(len(taken.pairs)):
        chosen += [(k, at) for at in _lines_of(taken, k, count, errors, values[:, k], notes)]
    if chosen:
        used, there = len({k for k, _ in chosen}), int(taken.frfs.measured.sum())
        notes.insert(
            0,
            f"Measured FRFs: {len(chosen)} lines of {used} of {there} FRFs are used, magnitude and "
            "phase, away from resonances and valleys, with the resonances of the test instead of "
            "the model's. In the blind check FRFs made answers worse: compare with frfs = false in "
            "[diagnose].",
        )
    lines = taken.lines(chosen)
    functions = Receptances(errors.basis, lines, errors.poles, errors.forward)
    entries = []
    at_lines = [values[at, k] for k, at in chosen]
    found = zip(chosen, at_lines, errors.common(lines, at_lines), strict=True)
    for n, ((k, at), value, of_model) in enumerate(found):
        common = of_model | taken.off(k)
        for phase in (False, True):
            entries.append(
                FunctionLine(
                    name=f"test.frfs: {taken.named(k)} at {lines.frequencies_hz[n]:.4g} Hz",
                    measured=1.0,
                    sd=float(taken.sd[at, k]),
                    row=row,
                    index=n,
                    phase=phase,
                    functions=functions,
                    over=complex(value),
                    common=_part(common, phase),
                    unknown=errors.unknown(of_model),
                )
            )
    return tuple(entries), notes


def _lines_of(
    taken: _Functions, k: int, count: int, errors: Errors, values: np.ndarray, notes: list[str]
) -> list[int]:
    """Lines of a function, as many or fewer; none if it seems to be another's.

    Args:
        taken: The functions.
        k: Which of them.
        count: How many lines.
        errors: The model's errors.
        values: Its values, (n_lines,), from which peaks of single lines, such as hum, are removed.
        notes: Notes for the reader, which grow.
    """
    f, sd = taken.frfs.frequencies_hz, taken.sd[:, k]
    there = np.flatnonzero((f > 0) & (values != 0))
    lines = taken.lines([(k, at) for at in there])
    nominal = errors.receptances(lines)
    ratio = values[there] / nominal
    ratio = median_filter(ratio.real, _BESIDE) + 1j * median_filter(ratio.imag, _BESIDE)
    values[there] = ratio * nominal
    allowed = np.zeros(len(f), dtype=bool)
    allowed[there] = errors.small(lines, np.minimum(1, np.abs(ratio)) * nominal, sd[there])
    if not allowed.any():
        notes.append(
            f"test.frfs: no line of {taken.named(k)} is used: expected some between resonances, "
            "where a model with the resonances of the test predicts the FRF."
        )
        return []
    own = choose_lines(
        f, values[:, None, None], count, relative_sd=sd[:, None, None], allowed=allowed
    )
    ratio = ratio[np.searchsorted(there, own)]
    times, sign = np.median(np.abs(ratio)), np.median(np.cos(np.angle(ratio)))
    if not 1 / _OFF < times < _OFF or sign < 0:
        notes.append(
            f"test.frfs: {taken.named(k)} is left out: it is {'-' if sign < 0 else ''}{times:.3g} "
            "times the model's, in the median; expected about 1: look at its unit, its scale and "
            "its direction."
        )
        return []
    return own.tolist()


def _part(common: Mapping[Hashable, complex], phase: bool) -> dict[Hashable, float]:
    """Changes of magnitude or phase by errors, each with a part in phase and one out of it."""
    found = {}
    for name, c in common.items():
        found[name, "in phase"] = c.imag if phase else c.real
        found[name, "out of phase"] = c.real if phase else -c.imag
    return found


def _poles(model: Prepared, row: int) -> tuple[Poles, np.ndarray]:
    """The test's resonances, and the standard deviation of ln of their damping."""
    data = model.data
    hz = data.frequencies_hz[row]
    if not np.isfinite(hz).any():
        raise InputError(
            f"{model.case.path}: test.frfs.at: expected a condition at which the test has "
            "frequencies, or diagnose.frfs = false"
        )
    damping = np.full(len(hz), np.nan) if data.damping is None else data.damping[row]
    sd = np.where(np.isfinite(damping), data.damping_sd, _UNSURE)
    return Poles(hz, np.where(np.isfinite(damping), damping, _DAMPING)), sd


def _forward(model: Prepared, basis: PointBasis, everywhere: Sensors) -> ModalPrediction:
    seen = model.surrogate
    shapes = seen.nominal.at(everywhere)[:, seen.pairing.index]
    count = min(model.case.diagnose.n_modes, basis.model.n_dofs)
    return ModalPrediction(basis.model, everywhere, shapes.shape[1], count, reference=shapes)


def _taken(frfs: MeasuredFRFs, section: FRFSection) -> _Functions:
    """Functions at driving points, then those with the responses farthest from the others."""
    driving = {(i, j): sign for i, j, sign in frfs.driving_points()}
    pairs, rest = (
        list(driving)[:_FUNCTIONS],
        [pair for pair in map(tuple, np.argwhere(frfs.measured).tolist()) if pair not in driving],
    )
    at = frfs.response_points
    while rest and len(pairs) < _FUNCTIONS:
        away = [
            min((np.linalg.norm(at[i] - at[k]) for k, _ in pairs), default=0.0) for i, _ in rest
        ]
        pairs.append(rest.pop(int(np.argmax(np.round(away, 9)))))
    where: dict[tuple[str, int], int] = {}
    points = []
    for i, j in pairs:
        reference = where.setdefault(("reference", j), len(where))
        own = reference if (i, j) in driving else where.setdefault(("response", i), len(where))
        points.append((own, reference))
    sides = [
        [getattr(frfs, f"{side}_{what}")[k] for what in ("points", "directions", "names")]
        for side, k in where
    ]
    place, way, names = zip(*sides, strict=True)
    sensors = Sensors(np.array(place), np.array(way), tuple(f"test.frfs {name}" for name in names))
    i, j = np.array(pairs).T
    signs = np.array([driving.get(pair, 1) for pair in pairs])
    sd = frfs.stated_sd(section.noise, section.averages)
    return _Functions(
        frfs,
        complex(section.calibration),
        np.array(pairs),
        sensors,
        np.array(points),
        signs * frfs.values[:, i, j],
        sd[:, i, j],
    )


def row_of(case: Case, name: str, at: float | None, data: TestData) -> int:
    """The test's row of a condition, those after a known change left out.

    Args:
        case: The case.
        name: Of the section that says it.
        at: The condition; None for the last one.
        data: The test.

    Raises:
        InputError: If it is none of the test's.
    """
    own = np.flatnonzero([not known for known in data.known] or np.ones(len(data), dtype=bool))
    if at is None:
        return int(own[-1])
    near = own[np.isclose(data.conditions[own], at)]
    if not len(near):
        there = ", ".join(f"{c:g}" for c in data.conditions[own])
        raise InputError(
            f"{case.path}: {name}.at = {at:g}: expected a condition of the test: {there}"
        )
    return int(near[0])
