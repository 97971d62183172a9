"""Lines of a test's frequency response functions that a diagnosis takes, and what a model errs."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.ndimage import median_filter

from fenics_joints.case.test import FRFSection
from fenics_joints.diagnosis.evidence.function_line import FunctionLine
from fenics_joints.diagnosis.model.function_errors import Errors
from fenics_joints.diagnosis.model.static import row_of
from fenics_joints.errors import InputError
from fenics_joints.measurements.frfs import MeasuredFRFs
from fenics_joints.measurements.lines import choose_lines
from fenics_joints.reduction.forward import Forward
from fenics_joints.reduction.grounded import PointBasis
from fenics_joints.reduction.receptances import Lines, Poles, Receptances
from fenics_joints.structure import Sensors

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
#: Lines over which what a function is off is taken in the median: single ones may be hum.
#: [numerical: chosen]
_BESIDE = 5
#: How far a function may be off before it is another's: a unit, a scale or a sign is wrong.
#: [decision: chosen]
_OFF = 3.0
#: Damping ratio of a mode of which it was not measured, which it is within a factor of e.
#: [decision: chosen]
_DAMPING, _UNSURE = 0.01, 1.0


@dataclass(frozen=True, eq=False)
class _Taken:
    """Functions that are looked at, as receptances.

    Attributes:
        frfs: All that were measured.
        pairs: Response and reference of each, (n, 2).
        at: Points in which forces and responses are.
        points: Which of these is its response's and its reference's, (n, 2).
        values: m/N, (n_lines, n), signs as of these points.
        sd: Relative standard deviation, (n_lines, n).
    """

    frfs: MeasuredFRFs
    pairs: np.ndarray
    at: Sensors
    points: np.ndarray
    values: np.ndarray
    sd: np.ndarray

    def named(self, k: int) -> str:
        """Name of a function."""
        i, j = self.pairs[k]
        return f"{self.frfs.response_names[i]} by a force at {self.frfs.reference_names[j]}"


def measured_functions(
    model: Prepared, frfs: MeasuredFRFs, everywhere: Sensors
) -> tuple[tuple[FunctionLine, ...], list[str]]:
    """Lines of ``[test.frfs]`` as data, and what is to be said of them. Collective.

    Args:
        model: The case, with its reduced model.
        frfs: The functions.
        everywhere: Places by whose motion modes are told.

    Raises:
        InputError: If a point is beside the structure, or the condition none of the test's.
    """
    case, full, section = model.case, model.full, model.case.test.frfs
    row = row_of(case, "test.frfs", section.at, model.data)
    taken = _taken(frfs.converted("receptance"), section)
    if full.is_meshed:
        full.rows(taken.at.points, "frf", taken.at.names)  # whether they are on the mesh
    return _data(_Found(taken, section, _errors(model, taken.at, everywhere, row)), row)


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
    section = FRFSection.model_construct()
    return _data(_Found(_taken(frfs, section), section, errors), row)[0]


def _errors(model: Prepared, at: Sensors, everywhere: Sensors, row: int) -> Errors:
    """A model with these points, and what it errs there."""
    samples, travel = model.to_span()
    basis = PointBasis(
        model.full, at, everywhere, samples, model.case.diagnose.n_modes, travel, tolerance=_BASIS
    )
    return Errors(model, basis, _forward(model, basis, everywhere), row, *_poles(model, row))


def _data(found: _Found, row: int) -> tuple[tuple[FunctionLine, ...], list[str]]:
    """The lines as data, two entries each, and what is to be said of them."""
    taken, errors = found.taken, found.errors
    lines, numbers = found.lines()
    functions = Receptances(errors.basis, lines, errors.poles, errors.forward)
    entries = []
    for n, (k, at) in enumerate(numbers):
        value = found.values[at, k]
        of_model = errors.common(lines, n, value) | found.calibration(k)
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
                    common=_part(of_model, phase),
                    unknown=errors.unknown(of_model),
                )
            )
    return tuple(entries), found.notes


def _part(common: Mapping[Hashable, complex], phase: bool) -> dict[Hashable, float]:
    """What errors, each with a part in phase and one out of it, do to magnitude or phase."""
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


def _forward(model: Prepared, basis: PointBasis, everywhere: Sensors) -> Forward:
    seen = model.surrogate
    shapes = seen.nominal.at(everywhere)[:, seen.pairing.index]
    count = min(model.case.diagnose.n_modes, basis.model.n_dofs)
    return Forward(basis.model, everywhere, shapes.shape[1], count, reference=shapes)


def _taken(frfs: MeasuredFRFs, section: FRFSection) -> _Taken:
    """The driving points, and those whose responses are the farthest from others."""
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
        (
            getattr(frfs, f"{side}_points")[k],
            getattr(frfs, f"{side}_directions")[k],
            getattr(frfs, f"{side}_names")[k],
        )
        for side, k in where
    ]
    place, way, names = zip(*sides, strict=True)
    sensors = Sensors(np.array(place), np.array(way), tuple(f"test.frfs {name}" for name in names))
    i, j = np.array(pairs).T
    signs = np.array([driving.get(pair, 1) for pair in pairs])
    sd = frfs.stated_sd(section.noise, section.averages)
    return _Taken(
        frfs, np.array(pairs), sensors, np.array(points), signs * frfs.values[:, i, j], sd[:, i, j]
    )


class _Found:
    """Which lines of which functions are data, and what is to be said of that.

    Attributes:
        values: The functions, m/N, (n_lines, n), less what single lines alone have, as hum.
        notes: What is to be said.
    """

    def __init__(self, taken: _Taken, section: FRFSection, errors: Errors):
        self.taken, self.errors, self.notes = taken, errors, []
        self._given = complex(section.calibration)
        self._hz, self.values = taken.frfs.frequencies_hz, taken.values.copy()

    def lines(self) -> tuple[Lines, list[tuple[int, int]]]:
        """The lines, and the function and the measured line of each."""
        taken, chosen = self.taken, []
        count = max(_LINES // len(taken.pairs), _FEW)
        for k in range(len(taken.pairs)):
            own = self._of(k, count)
            chosen += [(k, at) for at in own]
        used = len({k for k, _ in chosen})
        if chosen:
            self.notes.insert(
                0,
                f"Measured functions: {len(chosen)} lines of {used} of "
                f"{int(taken.frfs.measured.sum())} are data, magnitude and phase, away from "
                "resonances and valleys, with the test's resonances in the place of the model's.",
            )
        return self._at(chosen), chosen

    def _at(self, chosen: list[tuple[int, int]]) -> Lines:
        k, at = np.array(chosen, dtype=int).reshape(-1, 2).T
        points = self.taken.points[k]
        return Lines(self._hz[at], points[:, 0], points[:, 1])

    def _of(self, k: int, count: int) -> list[int]:
        """Lines of a function, as many or fewer; none if it seems to be another's."""
        taken, f, sd = self.taken, self._hz, self.taken.sd[:, k]
        there = np.flatnonzero((f > 0) & (taken.values[:, k] != 0))
        lines = self._at([(k, at) for at in there])
        nominal = self.errors.receptances(lines)
        ratio = taken.values[there, k] / nominal
        ratio = median_filter(ratio.real, _BESIDE) + 1j * median_filter(ratio.imag, _BESIDE)
        self.values[there, k] = ratio * nominal
        allowed = np.zeros(len(f), dtype=bool)
        allowed[there] = self.errors.small(lines, np.minimum(1, np.abs(ratio)) * nominal, sd[there])
        if not allowed.any():
            self.notes.append(
                f"test.frfs: of {taken.named(k)} no line is data: expected some between "
                "resonances, where a model with the test's resonances says what to expect."
            )
            return []
        values = self.values[:, k]
        own = choose_lines(
            f, values[:, None, None], count, relative_sd=sd[:, None, None], allowed=allowed
        )
        ratio = ratio[np.searchsorted(there, own)]
        times, sign = np.median(np.abs(ratio)), np.median(np.cos(np.angle(ratio)))
        if not 1 / _OFF < times < _OFF or sign < 0:
            self.notes.append(
                f"test.frfs: {taken.named(k)} is left out: it is {'-' if sign < 0 else ''}"
                f"{times:.3g} times the model's, in the median; expected about 1: look at its "
                "unit, its scale and its directions."
            )
            return []
        return own.tolist()

    def calibration(self, k: int) -> dict[Hashable, complex]:
        """What the scales of a function's sensor and of its force are off."""
        i, j = map(int, self.taken.pairs[k])
        return {("sensor", i): self._given, ("force", j): self._given} if self._given else {}
