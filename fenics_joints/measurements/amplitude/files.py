"""Amplitude data from files, in whatever form a test lab has them.

Backbones, sweeps and histories are known by their columns; universal files hold histories of free
decays (datasets 58 of time responses), or with levels functions.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fenics_joints.errors import InputError, located
from fenics_joints.files import is_file, shown_path
from fenics_joints.measurements.amplitude.backbone import (
    NOISE,
    RESPONSES,
    MeasuredBackbone,
    concatenated,
    level_unit,
    motion_kind,
)
from fenics_joints.measurements.amplitude.ring_downs import from_ring_down
from fenics_joints.measurements.amplitude.sweeps import (
    SineSweep,
    from_constant_force,
    from_constant_response,
)
from fenics_joints.measurements.files import UFF_SUFFIXES, FileMetadata
from fenics_joints.measurements.readers import reader_of
from fenics_joints.measurements.tables import LISTED, DataTable, read_table
from fenics_joints.measurements.uff import axis_label, read_sets, units_of, word
from fenics_joints.response.units import frf_unit

#: Names of a column that says the level; and of one that says the response.
LEVELS = ("level", "amplitude", "acceleration", "velocity", "displacement", "force")
MOTIONS = ("amplitude", "response", "acceleration", "velocity", "displacement")


def only_unit(table: DataTable, name: str) -> tuple[str, float]:
    """`level_unit` of a column, with the file and the column in its message."""
    with located(f"{table.path}: column {name!r}"):
        unit = table.unit(name)
        if not unit:
            raise InputError(f"the unit is missing; expected a head such as '{name} [m/s2]'")
        return level_unit(unit)


def motion_column(table: DataTable, names: Iterable[str]) -> tuple[str, np.ndarray] | None:
    """(kind, values in SI units, above 0) of the first of these columns; None if none is there."""
    name = next((n for n in names if n in table.names), None)
    if name is None:
        return None
    kind, factor = only_unit(table, name)
    return kind, factor * table.numbers(name, above=0)


# -- tables ----------------------------------------------------------------------------------------


#: Columns that only sweeps have.
_OF_SWEEPS = ("phase", "re", "im", "abs")
#: Noise of a plain backbone that says none, relative, of its damping.
_DAMPING_NOISE = 0.1
#: How far a response may be from constant.
_HELD = 0.1


@dataclass(frozen=True, eq=False)
class Sweeps:
    """Sweeps of one file: what was held, ``force`` or a kind of response, and the response."""

    held: str
    response: str
    sweeps: tuple[SineSweep, ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class History:
    """A record over time: s, (n,), and responses in SI units by the sensors' names, (n,)."""

    times: np.ndarray
    response: str
    signals: dict[str, np.ndarray]
    where: str


def is_history(table: DataTable) -> bool:
    """Whether a table is of a response over time."""
    return "time" in table.names


def is_sweeps(table: DataTable) -> bool:
    """Whether a table is of sweeps: a level, and what was measured at it over frequency."""
    if "level" not in table.names or "frequency" not in table.names:
        return False
    return any(name in table.names for name in (*_OF_SWEEPS, *MOTIONS, "force"))


# -- plain backbones -------------------------------------------------------------------------------


def plain(
    table: DataTable, noise: float | None = None, damping_noise: float | None = None
) -> MeasuredBackbone:
    """A backbone as it stands: level, frequency, damping, perhaps with their deviations.

    Columns: one of `LEVELS`, or another with such a unit; ``frequency [Hz]``, or one other column
    in Hz; perhaps ``damping``, ``frequency sd`` and ``damping sd``.

    Raises:
        InputError: Names the file, the column and what was expected.
    """
    path, hz = table.path, _frequency(table)
    kind, amplitudes = _level(table, hz)
    f = table.numbers(hz, "Hz", above=0)
    ratios = _ratios(table, hz)
    notes = list(table.notes)
    f_sd = _stated(table, "frequency sd", "Hz")
    if f_sd is None:
        f_sd = (noise or NOISE) * f
        if noise is None:
            notes.append(f"{path}: frequencies are taken to be known to {100 * NOISE:g} %")
    sd = _stated(table, "damping sd", "")
    if sd is None:
        sd = (damping_noise or _DAMPING_NOISE) * np.abs(ratios)
        if damping_noise is None and np.isfinite(ratios).any():
            notes.append(f"{path}: damping is taken to be known to {100 * _DAMPING_NOISE:g} %")
    return MeasuredBackbone(kind, amplitudes, f, f_sd, ratios, sd, notes=tuple(notes))


def _frequency(table: DataTable) -> str:
    if "frequency" in table.names:
        return "frequency"
    found = [n for n in table.names if table.unit(n).lower() in ("hz", "khz") and "sd" not in n]
    if len(found) == 1:
        return found[0]
    raise InputError(
        f"{table.path}: has the columns {', '.join(table.names[:LISTED])}; expected amplitude data "
        "of one mode: a level and 'frequency [Hz]', perhaps 'damping [%]'; or sweeps ('level', "
        "'frequency' and 'force' or 'amplitude', perhaps 'phase'); or 'time' and responses"
    )


def _level(table: DataTable, hz: str) -> tuple[str, np.ndarray]:
    """Kind and values of the level's column."""
    for name in LEVELS:
        if name in table.names:
            return motion_column(table, [name])
    for name in table.names:
        if name != hz and table.unit(name):
            try:
                level_unit(table.unit(name))
            except InputError:
                continue
            return motion_column(table, [name])
    raise InputError(
        f"{table.path}: has no column of the level; expected one such as 'level [m/s2]', with its "
        f"unit, one of {', '.join(RESPONSES.values())} or g"
    )


def _ratios(table: DataTable, hz: str) -> np.ndarray:
    name = next((n for n in ("damping", f"{hz} damping") if n in table.names), None)
    if name is None:
        return np.full(len(table.values), np.nan)
    ratios = table.column(name, "")
    bad = ~np.isnan(ratios) & ~((ratios > 0) & (ratios < 1))
    if bad.any():
        row = int(np.argmax(bad))
        raise InputError(
            f"{table.path}: column {name!r}, data row {row + 1} = {ratios[row]:g}; expected a "
            "damping ratio between 0 and 1, or a unit [%] in its head"
        )
    return ratios


def _stated(table: DataTable, name: str, unit: str) -> np.ndarray | None:
    return table.numbers(name, unit, above=0) if name in table.names else None


# -- sweeps ----------------------------------------------------------------------------------------


def sweeps_of(table: DataTable) -> Sweeps:
    """Sweeps, a level each: of the response (then with the force) or of the force.

    Columns: ``level``, ``frequency``, and ``re`` and ``im``, or ``abs``, of the response over the
    force; or ``force`` and a response (`MOTIONS`), of which that may be missing which was held.
    ``phase`` is that of the response to the force.

    Raises:
        InputError: Names the file, the column and what was expected.
    """
    held, factor = only_unit(table, "level")
    levels = factor * table.numbers("level", above=0)
    f = table.numbers("frequency", "Hz", above=0)
    kind, functions, forces, motion = _functions(table, held, levels)
    sweeps, notes = [], list(table.notes)
    for level in np.unique(levels):
        rows, of = np.flatnonzero(levels == level), f"level {level:g} {RESPONSES[held]}"
        was = float(level)
        if held != "force" and motion is not None:
            was = float(np.median(motion[rows]))
            if np.ptp(motion[rows]) > 2 * _HELD * was:
                notes.append(f"{table.path}: {of}: the response is not held constant")
        with located(f"{table.path}: {of}"):
            sweeps.append(SineSweep(was, f[rows], functions[rows], forces[rows]))
    return Sweeps(held, kind, tuple(sweeps), tuple(notes))


def _functions(table: DataTable, held: str, levels: np.ndarray):
    """(kind of response, functions, forces, responses or None) of each row."""
    spin = np.exp(1j * table.phase()) if "phase" in table.names else 1.0
    given = [name for name in ("re", "im", "abs") if name in table.names]
    motion = motion_column(table, MOTIONS)
    if given:
        kind, functions = _written(table, given, spin)
        if held not in ("force", kind):
            raise InputError(f"{table.path}: level is of {held}, the FRFs are of {kind}")
        forces = levels if held == "force" else levels / np.abs(functions)
        return kind, functions, forces, None
    force = None
    if "force" in table.names:
        force = table.numbers("force", "N", above=0)
    if held == "force" and motion is None:
        raise InputError(
            f"{table.path}: levels are of force; expected the response too, such as "
            "'amplitude [m/s2]'"
        )
    if held != "force" and force is None:
        raise InputError(
            f"{table.path}: levels are of {held}; expected the force that held it too, 'force [N]'"
        )
    kind, values = (held, levels) if motion is None else motion
    if kind == "force" or held not in ("force", kind):
        raise InputError(f"{table.path}: level is of {held}, the response of {kind}")
    forces = levels if force is None else force
    return kind, values / forces * spin, forces, None if motion is None else values


def _written(table: DataTable, given: list[str], spin) -> tuple[str, np.ndarray]:
    """Functions that stand in the table: real and imaginary part, or size and phase."""
    if given not in (["re", "im"], ["abs"]):
        raise InputError(
            f"{table.path}: has the columns {', '.join(given)}; expected re and im, or abs and "
            "perhaps phase"
        )
    units = set()
    for name in given:
        with located(f"{table.path}: column {name!r}"):
            units.add(frf_unit(table.unit(name)))
    if len(units) > 1:
        raise InputError(f"{table.path}: re and im have different units; expected one for both")
    ((kind, factor),) = units
    if given == ["abs"]:
        return motion_kind(kind), factor * table.numbers("abs", above=0) * spin
    parts = [factor * table.numbers(name) for name in given]
    return motion_kind(kind), parts[0] + 1j * parts[1]


# -- histories -------------------------------------------------------------------------------------


def history_of(table: DataTable) -> History:
    """A record over time: ``time`` and a column for each sensor; one in newtons is left out.

    Raises:
        InputError: Names the file, the column and what was expected.
    """
    t, signals, kinds = table.numbers("time", "s"), {}, {}
    for name in table.names:
        if name == "time":
            continue
        kind, factor = only_unit(table, name)
        if kind != "force":
            signals[name], kinds[name] = factor * table.numbers(name), kind
    if len(set(kinds.values())) != 1:
        shown = ", ".join(f"{name} of {kind}" for name, kind in kinds.items())
        raise InputError(
            f"{table.path}: has {shown or 'no response'} beside the time; expected responses of "
            "one kind, such as 'a1 [m/s2]'"
        )
    return History(t, next(iter(kinds.values())), signals, str(table.path))


# -- histories from universal files ----------------------------------------------------------------


#: Function type of a response over time, and kinds of response by the ordinate's data type.
_TIME = 1
_RESPONSES = {8: "displacement", 11: "velocity", 12: "acceleration"}
_AXES = {1: "+x", -1: "-x", 2: "+y", -2: "-y", 3: "+z", -3: "-z"}


def histories_of(path: Path, units: str | None = None) -> list[History]:
    """Records over time, each with all sensors: a sensor's second dataset is the second record.

    Args:
        path: The file.
        units: Unit of the responses; it goes before what the file says.

    Raises:
        InputError: Names the file, the dataset and what was expected.
    """
    sets = read_sets(path, (58, 164))
    length, _ = units_of(sets, FileMetadata())
    records: list[History] = []
    for where, data in sets:
        if data["type"] != 58 or data["func_type"] != _TIME:
            continue
        code = data["ordinate_spec_data_type"]
        if code not in _RESPONSES:
            continue
        name = f"{int(data['rsp_node'])}:{_AXES.get(int(data['rsp_dir']), '')}".rstrip(":")
        values = np.asarray(data["data"], dtype=float)
        signal = values * _factor(where, data, _RESPONSES[code], length, units)
        record = next((r for r in records if name not in r.signals), None)
        if record is None:
            record = History(np.asarray(data["x"]), _RESPONSES[code], {}, where)
            records.append(record)
        if len(record.times) != len(values) or record.response != _RESPONSES[code]:
            raise InputError(
                f"{where}: {len(values)} samples of {_RESPONSES[code]}; expected "
                f"{len(record.times)} of {record.response} as in {record.where}"
            )
        record.signals[name] = signal
    if not records:
        kinds = sorted({word({}, d["func_type"]) for _, d in sets if d["type"] == 58})
        raise InputError(
            f"{path}: holds no response over time (its datasets 58 are of type "
            f"{', '.join(kinds) or 'none'}); expected type 1 with displacement, velocity or "
            "acceleration; or, for FRFs (type 4), the level of each in levels"
        )
    return records


def _factor(where: str, data, kind: str, length: float | None, units: str | None) -> float:
    text = units or axis_label(data, "ordinate")
    if text:
        with located(f"{where}: unit of the response"):
            found, factor = level_unit(text)
            if found != kind:
                raise InputError(f"{text!r} is one of {found}, expected one of {kind}")
        return factor
    if length is None:
        raise InputError(
            f"{where}: the unit of the response is not known; expected a dataset 164, a label of "
            "the axis, or units"
        )
    return length


# -- files of any form -----------------------------------------------------------------------------


def read_amplitude(
    paths: str | Path | Sequence[str | Path],
    *,
    levels: Sequence[str] | None = None,
    band: tuple[float, float] | None = None,
    sensor: str | None = None,
    units: str | None = None,
    noise: float | None = None,
    damping_noise: float | None = None,
) -> MeasuredBackbone:
    """Frequency and damping of one mode over its amplitude, from files of one kind.

    The kind is known by what the files hold: see `docs/amplitude.md`.

    Args:
        paths: Tables (CSV or TOML), or with ``levels``, or for ring-downs, universal files.
        levels: Level of each function in the files, in their order, such as ``"5 m/s2"``; for
            functions (UFF 58, MATLAB, CSV) alone.
        band: Frequencies to take, Hz, that hold this mode and no other.
        sensor: The sensor that the amplitude is of, where a ring-down has several.
        units: Unit of functions or ring-downs, where a universal file does not say it.
        noise: Relative standard deviation of frequencies; of plain backbones instead of 0.1 %,
            of all others beside what their own scatter says.
        damping_noise: Likewise of damping ratios; 10 % of plain backbones by default.

    Raises:
        InputError: For what is wrong in the files; names the file, the place and what was expected.
    """
    paths = [Path(p) for p in ([paths] if isinstance(paths, str | Path) else paths)]
    for path in paths:
        if not is_file(path):
            raise InputError(f"{shown_path(path)}: no such file, expected amplitude data")
    if levels is not None:
        found = _reduced([_functions_at_levels(paths, levels, units)], band)
    else:
        found = _by_content(paths, band, sensor, units, noise, damping_noise)
    if found.kind != "backbone":
        found = found.with_noise(noise or 0.0, damping_noise or 0.0)
    return found


def _by_content(paths, band, sensor, units, noise, damping_noise) -> MeasuredBackbone:
    """What the files say themselves; all must be of one kind."""
    histories, sweeps, backbones = [], [], []
    for path in paths:
        if path.suffix.lower() in UFF_SUFFIXES:
            histories += histories_of(path, units)
            continue
        if path.suffix.lower() not in (".csv", ".toml", ".txt"):
            ends = ", ".join((".csv", ".toml", *UFF_SUFFIXES))
            raise InputError(f"{path}: the ending is not known; expected one of {ends}")
        table = read_table(path)
        if is_history(table):
            histories.append(history_of(table))
        elif is_sweeps(table):
            sweeps.append(sweeps_of(table))
        else:
            backbones.append(plain(table, noise, damping_noise))
    if sum(map(bool, (histories, sweeps, backbones))) > 1:
        raise InputError(
            f"{', '.join(p.name for p in paths)}: are of different kinds; expected ring-downs, "
            "sweeps or backbones"
        )
    if histories:
        return concatenated([_decay(history, band, sensor) for history in histories])
    return _reduced(sweeps, band) if sweeps else concatenated(backbones)


def _decay(history: History, band, sensor: str | None) -> MeasuredBackbone:
    names = list(history.signals)
    if sensor is None and len(names) > 1:
        raise InputError(
            f"{history.where}: has the sensors {', '.join(names)}; expected sensor, the one that "
            "the amplitude is of"
        )
    if sensor is not None and sensor not in names:
        raise InputError(
            f"{history.where}: has no sensor {sensor!r}; expected one of {', '.join(names)}"
        )
    column = names.index(sensor) if sensor is not None else 0
    with located(history.where):
        return from_ring_down(
            history.times,
            np.column_stack(list(history.signals.values())),
            history.response,
            band=band,
            sensor=column,
        )


def _reduced(parts: Sequence[Sweeps], band) -> MeasuredBackbone:
    """The backbone of sweeps of one or more files."""
    first = parts[0]
    if any((p.held, p.response) != (first.held, first.response) for p in parts):
        raise InputError("the files hold different things constant; expected one kind of sweeps")
    sweeps = [sweep for part in parts for sweep in part.sweeps]
    reduce = from_constant_force if first.held == "force" else from_constant_response
    found = reduce(sweeps, first.response, band)
    notes = [note for part in parts for note in part.notes]
    return replace(found, notes=(*notes, *found.notes))


def _functions_at_levels(paths: Sequence[Path], levels: Sequence[str], units: str | None) -> Sweeps:
    """Functions of files that do not say their levels."""
    metadata, records = FileMetadata(units=units), []
    for path in paths:
        records += reader_of(path)(path, metadata).functions
    if len(records) != len(levels):
        raise InputError(
            f"levels: {len(levels)} of them for {len(records)} FRFs in "
            f"{', '.join(str(p) for p in paths)}; expected one for each function, in their order"
        )
    held, sizes = _levels(levels)
    kinds = {motion_kind(record.kind) for record in records}
    if len(kinds) > 1 or held not in ("force", *kinds):
        raise InputError(
            f"levels are of {held}, the FRFs of {', '.join(sorted(kinds))}; expected levels "
            "of the response of the FRFs, or of the force"
        )
    sweeps = []
    for record, level in zip(records, sizes, strict=True):
        there = (record.frequencies_hz > 0) & (np.abs(record.values) > 0)
        values = record.values[there]
        forces = level if held == "force" else level / np.abs(values)
        with located(record.where):
            sweeps.append(SineSweep(level, record.frequencies_hz[there], values, forces))
    return Sweeps(held, kinds.pop(), tuple(sweeps))


def _levels(levels: Sequence[str]) -> tuple[str, list[float]]:
    """What levels such as ``"5 m/s2"`` are of, and their values in SI units."""
    found = []
    for text in levels:
        value, _, unit = str(text).strip().partition(" ")
        try:
            kind, factor = level_unit(unit.strip())
            found.append((kind, float(value) * factor))
        except (ValueError, InputError):
            known = ", ".join(f"'5 {unit}'" for unit in RESPONSES.values())
            raise InputError(f"levels: {text!r}: expected one such as {known}") from None
    kinds = {kind for kind, _ in found}
    if len(kinds) != 1 or not all(value > 0 for _, value in found):
        raise InputError(f"levels = {list(levels)}: expected levels above 0 in one kind of unit")
    return kinds.pop(), [value for _, value in found]
