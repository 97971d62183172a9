"""Frequency and damping of one mode over its amplitude, and tests by level made of such modes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fenics_joints.errors import InputError, member, reals
from fenics_joints.measurements.data import TestData
from fenics_joints.response.units import KINDS as TIMES
from fenics_joints.response.units import frf_unit
from fenics_joints.units import factor_to_si

#: Quantities that an amplitude may have, with their SI units.
RESPONSES = {"displacement": "m", "velocity": "m/s", "acceleration": "m/s2", "force": "N"}
#: What a backbone may come from.
KINDS = ("backbone", "constant response", "constant force", "ring-down")
#: Most levels of a test that is made of it: a diagnosis computes each.
_LEVELS = 8
#: Points whose deviation is larger than the median's by this factor make no level.
_POOR = 10.0


#: Relative deviation of a frequency where none is given: assumed.
NOISE = 1e-3
_BY_FUNCTION = dict(zip(TIMES, ("displacement", "velocity", "acceleration"), strict=True))


def motion_kind(function: str) -> str:
    """Kind of response of a kind of function, such as ``acceleration`` of an ``accelerance``."""
    return _BY_FUNCTION[function]


def level_unit(text: str) -> tuple[str, float]:
    """What a unit measures, one of `RESPONSES`, and its factor to SI; g is that of acceleration.

    Raises:
        InputError: If it measures something else.
    """
    try:
        return "force", factor_to_si(text, "N")
    except InputError:
        pass
    try:
        kind, factor = frf_unit(f"({text})/N")
    except InputError as error:
        known = ", ".join(f"[{unit}]" for unit in RESPONSES.values())
        raise InputError(
            f"the unit {text!r} is none of a level; expected one of displacement, velocity, "
            f"acceleration or force, such as {known} or [g]"
        ) from error
    return motion_kind(kind), factor


@dataclass(frozen=True, eq=False)
class MeasuredBackbone:
    """A mode over its amplitude at one sensor, points in ascending order of the amplitude.

    Attributes:
        response: ``displacement``, ``velocity``, ``acceleration`` of the sensor; or ``force``, that
            at resonance.
        amplitudes: Peak values (not rms), in SI units, (n,).
        frequencies_hz: Natural frequencies, Hz, (n,).
        frequencies_sd: Their standard deviations, Hz, (n,).
        damping: Damping ratios, (n,); nan where not measured.
        damping_sd: Their standard deviations, (n,); nan likewise.
        kind: One of `KINDS`: what was measured.
        notes: What is doubtful or was left out, in sentences.
    """

    response: str
    amplitudes: np.ndarray
    frequencies_hz: np.ndarray
    frequencies_sd: np.ndarray
    damping: np.ndarray
    damping_sd: np.ndarray
    kind: str = "backbone"
    notes: tuple[str, ...] = ()

    def __post_init__(self):
        member("response", self.response, RESPONSES)
        member("kind", self.kind, KINDS)
        a = reals("amplitudes", self.amplitudes, (None,), above=0)
        f = reals("frequencies_hz", self.frequencies_hz, a.shape, "Hz", above=0)
        if not len(a):
            raise InputError("amplitudes: expected one point or more.")
        arrays = {"amplitudes": a, "frequencies_hz": f}
        arrays["frequencies_sd"] = reals(
            "frequencies_sd", self.frequencies_sd, a.shape, "Hz", above=0
        )
        zeta, sd = (np.array(v, dtype=float) for v in (self.damping, self.damping_sd))
        there = np.isfinite(zeta)
        if zeta.shape != a.shape or sd.shape != a.shape or not np.all(sd[there] > 0):
            raise InputError(
                "damping, damping_sd: expected a ratio and its deviation above 0 for each "
                "amplitude, nan where damping was not measured."
            )
        arrays |= {"damping": zeta, "damping_sd": np.where(there, sd, np.nan)}
        order = np.argsort(a, kind="stable")
        for key, value in arrays.items():
            object.__setattr__(self, key, value[order])

    def __len__(self) -> int:
        return len(self.amplitudes)

    def __repr__(self) -> str:
        a = self.amplitudes
        reach = f"{a[0]:.3g} to {a[-1]:.3g} {RESPONSES[self.response]}"
        return f"MeasuredBackbone({len(self)} points, {reach}, {self.kind})"

    @property
    def displacements(self) -> np.ndarray:
        """Amplitudes as displacements, m, (n,), unless they are of force."""
        times = tuple(RESPONSES).index(self.response)
        return self.amplitudes / (2 * np.pi * self.frequencies_hz) ** times

    @property
    def has_damping(self) -> bool:
        """Whether damping was measured at some amplitude."""
        return bool(np.isfinite(self.damping).any())

    def with_noise(
        self, frequency: float | np.ndarray = 0.0, damping: float = 0.0
    ) -> MeasuredBackbone:
        """With further relative deviations that the files do not show: drift, reassembly."""
        return replace(
            self,
            frequencies_sd=np.hypot(self.frequencies_sd, frequency * self.frequencies_hz),
            damping_sd=np.hypot(self.damping_sd, damping * np.abs(self.damping)),
        )

    def averaged(self, most: int = _LEVELS) -> MeasuredBackbone:
        """At most so many points: means, by their precision, over even steps of ln amplitude."""
        good = self.frequencies_sd <= _POOR * np.median(self.frequencies_sd)
        x = np.log(self.amplitudes)
        if good.sum() <= most:
            step = np.where(good, np.cumsum(good), -1)
        else:
            edges = np.linspace(x[good][0], x[good][-1] + 1e-9, most + 1)
            step = np.where(good, np.digitize(x, edges), -1)
        rows = [np.flatnonzero(step == i) for i in np.unique(step[good])]
        f = [_mean(self.frequencies_hz[r], self.frequencies_sd[r]) for r in rows]
        zeta = [_mean(self.damping[r], self.damping_sd[r]) for r in rows]
        amplitudes = [np.exp(_mean(x[r], self.frequencies_sd[r])[0]) for r in rows]
        return replace(
            self,
            amplitudes=amplitudes,
            frequencies_hz=[m for m, _ in f],
            frequencies_sd=[s for _, s in f],
            damping=[m for m, _ in zeta],
            damping_sd=[s for _, s in zeta],
        )


def concatenated(parts: Sequence[MeasuredBackbone]) -> MeasuredBackbone:
    """Points of several records of one mode together.

    Raises:
        InputError: If they are of different responses.
    """
    first = parts[0]
    if len(parts) == 1:
        return first
    for part in parts:
        if part.response != first.response:
            raise InputError(
                f"one record is of {first.response}, another of {part.response}; expected one "
                "kind of response"
            )
    arrays = {
        key: np.concatenate([getattr(part, key) for part in parts])
        for key in ("amplitudes", "frequencies_hz", "frequencies_sd", "damping", "damping_sd")
    }
    notes = tuple(dict.fromkeys(note for part in parts for note in part.notes))
    return MeasuredBackbone(first.response, **arrays, kind=first.kind, notes=notes)


def _mean(values: np.ndarray, sd: np.ndarray) -> tuple[float, float]:
    """Mean by precision and its deviation, widened where the values scatter by more."""
    there = np.isfinite(values)
    if not there.any():
        return np.nan, np.nan
    values, weights = values[there], 1 / sd[there] ** 2
    mean = float(np.sum(weights * values) / np.sum(weights))
    spread = np.sum(weights * (values - mean) ** 2) / max(len(values) - 1, 1)
    return mean, float(np.sqrt(max(spread, 1.0) / np.sum(weights)))


#: Relative distance below which two levels are the same.
_SAME = 1e-5
#: Level of modes measured near rest, as a share of the lowest level: assumed.
_REST = 0.1
#: Frequencies of two modes nearer than this, relative, are of one mode by two names, as a rule.
_ONE_MODE = 0.02


def test_by_level(backbones: Mapping[str, MeasuredBackbone]) -> TestData:
    """A test of one or more modes by level, as a diagnosis takes it.

    Args:
        backbones: By the modes' names; of each some levels are taken, see
            `MeasuredBackbone.averaged`.

    Raises:
        InputError: If their amplitudes are of different responses.
    """
    few = {name: backbone.averaged() for name, backbone in backbones.items()}
    kinds = {one.response for one in few.values()}
    if len(kinds) != 1:
        raise InputError(
            f"the modes' amplitudes are of {' and '.join(sorted(kinds))}; expected one kind"
        )
    each = {name: _distinct(one.amplitudes) for name, one in few.items()}
    levels = np.unique(np.concatenate(list(each.values())))
    levels = levels[np.append(True, np.diff(levels) > _SAME * levels[1:])]
    f, zeta = (np.full((len(levels), len(few)), np.nan) for _ in range(2))
    noise, ratios = [], []
    for column, (name, one) in enumerate(few.items()):
        rows = [int(np.argmin(np.abs(levels - a))) for a in each[name]]
        f[rows, column], zeta[rows, column] = one.frequencies_hz, one.damping
        noise.append(np.sqrt(np.mean((one.frequencies_sd / one.frequencies_hz) ** 2)))
        there = one.damping > 0
        ratios += ((one.damping_sd[there] / one.damping[there]) ** 2).tolist()
    notes = tuple(dict.fromkeys(note for one in few.values() for note in one.notes))
    return TestData(
        levels,
        f,
        tuple(few),
        "level",
        RESPONSES[kinds.pop()],
        zeta if ratios else None,
        noise=np.array(noise),
        damping_noise=float(np.sqrt(np.mean(ratios))) if ratios else None,
        notes=notes,
    )


#: Not a test, whatever pytest thinks of the name.
test_by_level.__test__ = False


def with_modes_at_rest(driven: TestData, rest: TestData) -> TestData:
    """One test of driven modes at their levels and of other modes that were measured near rest.

    The others stand at a tenth of the lowest level, where what depends on the level hardly shows.
    Of a mode in both tests only the levels count: as a rule they were measured in another set-up,
    with a shaker. Frequencies keep the noise of their own test.

    Args:
        driven: From `test_by_level`.
        rest: One row of the modes, such as a hammer test's; perhaps with damping and shapes.

    Raises:
        InputError: If a driven mode is not in the other test but has the frequency of one that is.
    """
    f = np.nanmean(driven.frequencies_hz, axis=0)
    missing = [j for j, name in enumerate(driven.mode_names) if name not in rest.mode_names]
    for j in missing:
        away = np.abs(rest.frequencies_hz[0] / f[j] - 1)
        if np.nanmin(away) < _ONE_MODE:
            same = rest.mode_names[int(np.nanargmin(away))]
            raise InputError(
                f"the mode {driven.mode_names[j]!r} by amplitude, {f[j]:.4g} Hz, is within "
                f"{100 * _ONE_MODE:g} % of {same!r} of the frequencies; expected that name if it "
                "is that mode"
            )
    hz = dict(zip(rest.mode_names, rest.frequencies_hz[0], strict=True))
    hz |= {driven.mode_names[j]: f[j] for j in missing}
    names = sorted(hz, key=lambda name: hz[name]) if missing else list(rest.mode_names)
    rows = _rows_at_rest(driven, rest, names)
    shapes = None
    if rest.shapes is not None:
        shapes = np.full((len(rest.shapes), len(names)), np.nan)
        shapes[:, [names.index(name) for name in rest.mode_names]] = rest.shapes
    return replace(
        driven,
        **rows,
        mode_names=tuple(names),
        sensors=rest.sensors,
        shapes=shapes,
        shapes_at=None if shapes is None else float(rows["conditions"][0]),
        shape_noise=rest.shape_noise,
        notes=(*rest.notes, *driven.notes, _said(driven, rest)),
    )


def _rows_at_rest(driven: TestData, rest: TestData, names: list[str]) -> dict[str, np.ndarray]:
    """Conditions, frequencies, damping and their noise, with the row at rest before the others."""
    n, both = len(driven) + 1, (driven, rest)
    found = {key: np.full((n, len(names)), np.nan) for key in ("frequencies_hz", "damping")}
    each = {key: np.zeros(len(names)) for key in ("noise", "resolution_hz")}
    for test in reversed(both):  # what was driven comes last, and stands
        at = slice(1, n) if test is driven else slice(0, 1)
        for j, name in enumerate(test.mode_names):
            column = names.index(name)
            for key, values in found.items():
                values[:, column] = np.nan
                if getattr(test, key) is not None:
                    values[at, column] = getattr(test, key)[:, j]
            for key, values in each.items():
                values[column] = getattr(test, key)[j]
    known = [test for test in both if test.damping is not None]
    counts = [np.isfinite(test.damping).sum() for test in known]
    squares = np.dot(counts, [test.damping_sd**2 for test in known])
    found |= {"damping_noise": float(np.sqrt(squares / max(sum(counts), 1)))} if known else {}
    return {
        **found,
        **each,
        "damping": found["damping"] if known else None,
        "conditions": np.append(_REST * driven.conditions[0], driven.conditions),
    }


def _said(driven: TestData, rest: TestData) -> str:
    """A note on the level assumed for modes near rest."""
    level = f"{_REST * driven.conditions[0]:g} {driven.condition_unit}"
    words = f"modes measured without a level are placed at {level}, a tenth of the lowest level"
    both = [name for name in driven.mode_names if name in rest.mode_names]
    items = []
    for name in both:
        column = driven.frequencies_hz[:, driven.mode_names.index(name)]
        lowest = column[np.isfinite(column)][0]
        alone = rest.frequencies_hz[0, rest.mode_names.index(name)]
        items.append(f"{name} ({alone:.5g} Hz without a level, {lowest:.5g} Hz at its lowest)")
    return f"{words}; of {', '.join(items)} only the levels are used" if items else words


def _distinct(levels: np.ndarray) -> np.ndarray:
    """Ascending levels, moved apart where two are equal, as of two ring-downs."""
    found = levels.copy()
    for i in range(1, len(found)):
        found[i] = max(found[i], found[i - 1] * (1 + 2 * _SAME))
    return found


def by_mode(data: TestData) -> dict[str, MeasuredBackbone]:
    """Backbones of the modes of a test by level, by their names."""
    kind, factor = level_unit(data.condition_unit)
    log_sd, found = data.log_sd(), {}
    for j, name in enumerate(data.mode_names):
        rows = np.flatnonzero(np.isfinite(data.frequencies_hz[:, j]) & (data.conditions > 0))
        if not len(rows):
            continue
        f, sd = data.frequencies_hz[rows, j], log_sd[rows, j]
        zeta = np.full(len(rows), np.nan) if data.damping is None else data.damping[rows, j]
        zeta = np.where(zeta > 0, zeta, np.nan)
        found[name] = MeasuredBackbone(
            kind,
            factor * data.conditions[rows],
            f,
            np.where(sd > 0, sd, NOISE) * f,
            zeta,
            data.damping_sd * zeta,
        )
    return found
