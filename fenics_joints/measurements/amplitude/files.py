"""Amplitude data from files, in whatever form a test lab has them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from fenics_joints.errors import InputError, located
from fenics_joints.files import is_file, shown_path
from fenics_joints.measurements.amplitude.backbone import RESPONSES, MeasuredBackbone, joined
from fenics_joints.measurements.amplitude.columns import level_unit, motion_kind
from fenics_joints.measurements.amplitude.curves import (
    Sweep,
    from_constant_force,
    from_constant_response,
)
from fenics_joints.measurements.amplitude.ring_downs import from_ring_down
from fenics_joints.measurements.amplitude.tables import (
    History,
    Sweeps,
    history_of,
    is_history,
    is_sweeps,
    plain,
    sweeps_of,
)
from fenics_joints.measurements.files import UFF_SUFFIXES, reader_of
from fenics_joints.measurements.records import Said
from fenics_joints.measurements.tables import read_table


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
        found = _reduced([_functions(paths, levels, units)], band)
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
            histories += _universal(path, units)
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
        return joined([_decay(history, band, sensor) for history in histories])
    return _reduced(sweeps, band) if sweeps else joined(backbones)


def _universal(path: Path, units: str | None) -> list[History]:
    # The library that it needs is an option.
    from fenics_joints.measurements.amplitude.universal import histories_of

    return histories_of(path, units)


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


def _functions(paths: Sequence[Path], levels: Sequence[str], units: str | None) -> Sweeps:
    """Functions of files that do not say their levels."""
    said, records = Said(units=units), []
    for path in paths:
        records += reader_of(path)(path, said).functions
    if len(records) != len(levels):
        raise InputError(
            f"levels: {len(levels)} of them for {len(records)} functions in "
            f"{', '.join(str(p) for p in paths)}; expected one for each function, in their order"
        )
    held, sizes = _levels(levels)
    kinds = {motion_kind(record.kind) for record in records}
    if len(kinds) > 1 or held not in ("force", *kinds):
        raise InputError(
            f"levels are of {held}, the functions of {', '.join(sorted(kinds))}; expected levels "
            "of the response of the functions, or of the force"
        )
    sweeps = []
    for record, level in zip(records, sizes, strict=True):
        there = (record.frequencies_hz > 0) & (np.abs(record.values) > 0)
        values = record.values[there]
        forces = level if held == "force" else level / np.abs(values)
        with located(record.where):
            sweeps.append(Sweep(level, record.frequencies_hz[there], values, forces))
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
