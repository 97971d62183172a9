"""Amplitude data from tables: backbones, sweeps, histories, known by their columns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fenics_joints.errors import InputError, located
from fenics_joints.measurements.amplitude.backbone import RESPONSES, MeasuredBackbone
from fenics_joints.measurements.amplitude.columns import (
    LEVELS,
    MOTIONS,
    checked_column,
    level_unit,
    motion_column,
    motion_kind,
    only_unit,
    phase_column,
)
from fenics_joints.measurements.amplitude.curves import Sweep
from fenics_joints.measurements.amplitude.levels import NOISE
from fenics_joints.measurements.tables import LISTED, Table
from fenics_joints.response.units import frf_unit

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
    sweeps: tuple[Sweep, ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class History:
    """A record over time: s, (n,), and responses in SI units by the sensors' names, (n,)."""

    times: np.ndarray
    response: str
    signals: dict[str, np.ndarray]
    where: str


def is_history(table: Table) -> bool:
    """Whether a table is of a response over time."""
    return "time" in table.names


def is_sweeps(table: Table) -> bool:
    """Whether a table is of sweeps: a level, and what was measured at it over frequency."""
    if "level" not in table.names or "frequency" not in table.names:
        return False
    return any(name in table.names for name in (*_OF_SWEEPS, *MOTIONS, "force"))


# -- plain backbones -------------------------------------------------------------------------------


def plain(
    table: Table, noise: float | None = None, damping_noise: float | None = None
) -> MeasuredBackbone:
    """A backbone as it stands: level, frequency, damping, perhaps with their deviations.

    Columns: one of `LEVELS`, or another with such a unit; ``frequency [Hz]``, or one other column
    in Hz; perhaps ``damping``, ``frequency sd`` and ``damping sd``.

    Raises:
        InputError: Names the file, the column and what was expected.
    """
    path, hz = table.path, _frequency(table)
    kind, amplitudes = _level(table, hz)
    f = checked_column(table, hz, "Hz", above=0)
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


def _frequency(table: Table) -> str:
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


def _level(table: Table, hz: str) -> tuple[str, np.ndarray]:
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


def _ratios(table: Table, hz: str) -> np.ndarray:
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


def _stated(table: Table, name: str, unit: str) -> np.ndarray | None:
    return checked_column(table, name, unit, above=0) if name in table.names else None


# -- sweeps ----------------------------------------------------------------------------------------


def sweeps_of(table: Table) -> Sweeps:
    """Sweeps, a level each: of the response (then with the force) or of the force.

    Columns: ``level``, ``frequency``, and ``re`` and ``im``, or ``abs``, of the response over the
    force; or ``force`` and a response (`MOTIONS`), of which that may be missing which was held.
    ``phase`` is that of the response to the force.

    Raises:
        InputError: Names the file, the column and what was expected.
    """
    held, factor = only_unit(table, "level")
    levels = factor * checked_column(table, "level", above=0)
    f = checked_column(table, "frequency", "Hz", above=0)
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
            sweeps.append(Sweep(was, f[rows], functions[rows], forces[rows]))
    return Sweeps(held, kind, tuple(sweeps), tuple(notes))


def _functions(table: Table, held: str, levels: np.ndarray):
    """(kind of response, functions, forces, responses or None) of each row."""
    turn = phase_column(table)
    spin = 1.0 if turn is None else np.exp(1j * turn)
    given = [name for name in ("re", "im", "abs") if name in table.names]
    motion = motion_column(table, MOTIONS)
    if given:
        kind, functions = _written(table, given, spin)
        if held not in ("force", kind):
            raise InputError(f"{table.path}: level is of {held}, the functions are of {kind}")
        forces = levels if held == "force" else levels / np.abs(functions)
        return kind, functions, forces, None
    force = None
    if "force" in table.names:
        force = checked_column(table, "force", "N", above=0)
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


def _written(table: Table, given: list[str], spin) -> tuple[str, np.ndarray]:
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
        return motion_kind(kind), factor * checked_column(table, "abs", above=0) * spin
    parts = [factor * checked_column(table, name) for name in given]
    return motion_kind(kind), parts[0] + 1j * parts[1]


# -- histories -------------------------------------------------------------------------------------


def history_of(table: Table) -> History:
    """A record over time: ``time`` and a column for each sensor; one in newtons is left out.

    Raises:
        InputError: Names the file, the column and what was expected.
    """
    t, signals, kinds = checked_column(table, "time", "s"), {}, {}
    for name in table.names:
        if name == "time":
            continue
        kind, factor = only_unit(table, name)
        if kind != "force":
            signals[name], kinds[name] = factor * checked_column(table, name), kind
    if len(set(kinds.values())) != 1:
        shown = ", ".join(f"{name} of {kind}" for name, kind in kinds.items())
        raise InputError(
            f"{table.path}: has {shown or 'no response'} beside the time; expected responses of "
            "one kind, such as 'a1 [m/s2]'"
        )
    return History(t, next(iter(kinds.values())), signals, str(table.path))
