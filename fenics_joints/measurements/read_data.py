"""Reads a test from its tables: frequencies, damping ratios and conditions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from fenics_joints.errors import InputError, Problems
from fenics_joints.formatting import first_of
from fenics_joints.measurements.data import TestData, same_conditions
from fenics_joints.measurements.tables import LISTED, DataTable, read_table

#: More columns of frequencies and conditions than any test has: such a table is of something else.
_MODES, _CONDITIONS = 1000, 10_000
#: Wrong cells that a message names.
_CELLS = 10


def read_test_data(
    frequencies: str | Path,
    *,
    condition: str | None = None,
    modes: Sequence[str] | None = None,
    damping: str | Path | None = None,
    noise: Sequence[float] | float = 0.0,
) -> TestData:
    """Read a test from its tables; rows are put in the order of the condition.

    Args:
        frequencies: Table with a column for each mode, and one for the condition; beside it may
            stand columns of damping ratios, ``MODE damping``, or ``damping`` of a single mode, so
            that a backbone (level, frequency, damping) is one table.
        condition: Name of the condition's column; None if there is none, then rows are numbered.
        modes: Names of the modes' columns, in the order of the model's modes; all by default.
        damping: Table of damping ratios with the same columns; rows and cells may be missing.
        noise: Relative standard deviation of the frequencies, for all or each mode.

    Raises:
        InputError: For what is wrong in the files; names file, row and column.
    """
    table = read_table(frequencies)
    conditions, unit = _conditions(table, condition)
    beside = _beside(table, condition)
    measured = [name for name in table.names if name not in (condition, *beside)]
    modes = list(measured if modes is None else modes)
    _check_size(table, modes, condition)
    problems, files = Problems(table.path), Problems()
    columns = [
        problems.tried(lambda name=name: _frequencies(table, name, condition)) for name in modes
    ]
    left = [name for name in measured if name not in set(modes)]
    if left:
        problems.add(
            f"{table.path}: has columns {', '.join(map(repr, left[:LISTED]))}, which are no "
            f"modes; expected {len(modes)} columns of frequencies: {', '.join(modes[:LISTED])}"
        )
    if not problems:
        f = np.column_stack(columns)
        problems.tried(lambda: _check_values(table, modes, f > 0, "a frequency above 0 Hz"))
        problems.tried(lambda: _check_measured(table, condition, conditions, modes, np.isfinite(f)))
    ratios = None
    if beside:
        ratios = problems.tried(lambda: _damping_beside(table, beside, modes, damping))
    files.tried(problems.check)
    if damping is not None and not beside:
        ratios = files.tried(lambda: _damping(damping, condition, unit, conditions, modes))
    files.check()
    order = np.argsort(conditions)
    return TestData(
        conditions[order],
        f[order],
        tuple(modes),
        condition or "row",
        unit,
        None if ratios is None else ratios[order],
        noise=noise,
        notes=tuple(table.notes),
    )


def _beside(table: DataTable, condition: str | None) -> list[str]:
    """Columns of damping ratios beside those of frequencies."""
    names = [name for name in table.names if name != condition]
    return [
        name
        for name in names
        if name.lower().endswith("damping")
        and table.unit(name) in ("", "%")
        and (name.lower() == "damping" or name[: -len("damping")].strip() in names)
    ]


def _damping_beside(table: DataTable, columns: Sequence[str], modes, damping) -> np.ndarray:
    """Damping ratios that stand in the table of frequencies, (n, m)."""
    if damping is not None:
        raise InputError(
            f"{table.path}: has damping in column {columns[0]!r}, expected it there or in "
            f"{damping}, not in both"
        )
    places = {}
    for name in columns:
        mode = name[: -len("damping")].strip()
        if not mode and len(modes) > 1:
            raise InputError(
                f"{table.path}: column {name!r} is of one mode, expected 'MODE damping' for each "
                f"of: {', '.join(modes[:LISTED])}"
            )
        places[name] = modes.index(mode) if mode in modes else None if mode else 0
    n = len(table.values)
    return _ratios(table, places, range(n), (n, len(modes)))


def _ratios(table: DataTable, places: Mapping[str, int | None], rows, shape) -> np.ndarray:
    """Damping ratios of a table by the index of their modes, None for one that is not wanted."""
    read = np.column_stack([table.column(name, "") for name in places])
    good = (read >= 0) & (read < 1)
    expected = "a damping ratio from 0 to below 1 (or a unit [%] in its head)"
    _check_values(table, list(places), good, expected)
    ratios = np.full(shape, np.nan)
    for column, place in zip(read.T, places.values(), strict=True):
        if place is not None:
            ratios[rows, place] = column
    return ratios


def _check_size(table: DataTable, modes: Sequence[str], condition: str | None) -> None:
    if not modes:
        raise InputError(
            f"{table.path}: has no column but that of the condition, {condition!r}; expected one "
            "of frequencies for each mode, such as 'mode 1 [Hz]'"
        )
    for n, most, what in (
        (len(modes), _MODES, "columns of frequencies"),
        (len(table.values), _CONDITIONS, "rows"),
    ):
        if n > most:
            raise InputError(f"{table.path}: has {n} {what}, expected at most {most} of a test")


def _frequencies(table: DataTable, name: str, condition: str | None) -> np.ndarray:
    try:
        return table.column(name, "Hz")
    except InputError as error:
        if condition is not None or name not in table.names or not table.unit(name):
            raise
        shown, unit = name[:40], table.unit(name)[:40]
        raise InputError(
            f"{table.path}: column {shown!r} is in {unit!r}, which is no frequency; expected "
            f"condition = {shown!r} in [test] if it is what the test was repeated at, else columns "
            "of frequencies alone"
        ) from error


def _conditions(table: DataTable, name: str | None) -> tuple[np.ndarray, str]:
    if name is None:
        return np.arange(1.0, len(table.values) + 1), ""
    conditions = table.column(name)
    unit = table.unit(name)
    if "torque" in name.lower() and unit not in ("", "%"):
        table.column(name, "N*m")  # for other conditions any name may be a unit
    if np.isnan(conditions).any():
        row = int(np.argmax(np.isnan(conditions))) + 1
        raise InputError(f"{table.path}: {name} of data row {row} is empty, expected a number")
    if len(values := np.unique(conditions)) < len(conditions):
        twice = ", ".join(f"{v:g}" for v in values if np.sum(conditions == v) > 1)
        raise InputError(f"{table.path}: {name} = {twice} is repeated, expected each value once")
    if (same := same_conditions(conditions)) is not None:
        raise InputError(f"{table.path}: {name}: {same}")
    return conditions, unit


def _check_measured(table: DataTable, condition, conditions, modes, there: np.ndarray) -> None:
    """A row or a column without any frequency says nothing, and is likely to be a slip."""
    names = [f" ({condition} = {c:g})" if condition is not None else "" for c in conditions]
    rows = [f"data row {i}{name}" for i, name in enumerate(names, start=1)]
    problems = Problems(table.path)
    for axis, what, places in ((1, "row", rows), (0, "column", [f"column {m!r}" for m in modes])):
        for i in np.flatnonzero(~there.any(axis=axis)):
            problems.add(
                f"{table.path}: {places[i]} has no frequency, expected one or more, or no "
                f"such {what}"
            )
    problems.check()


def _check_values(table: DataTable, modes, good: np.ndarray, expected: str) -> None:
    columns = np.column_stack([table.column(name) for name in modes])
    bad = np.argwhere(~good & ~np.isnan(columns))
    if len(bad):
        cells = [f"data row {i + 1}, column {modes[j]!r} = {columns[i, j]:g}" for i, j in bad]
        raise InputError(f"{table.path}: {first_of(cells, _CELLS, '; ')}, expected {expected}")


def _damping(path, condition, unit, conditions, modes) -> np.ndarray:
    table = read_table(path)
    own, own_unit = _conditions(table, condition)
    if own_unit != unit:
        raise InputError(
            f"{table.path}: {condition} is in {own_unit!r}, expected {unit!r} as in the frequencies"
        )
    present = [name for name in table.names if name != condition]
    _check_size(table, present, condition)
    for name in present:
        if name not in modes:
            raise InputError(
                f"{table.path}: column {name!r} is no mode, expected {', '.join(modes)}"
            )
    rows = [int(np.argmin(np.abs(conditions - c))) for c in own]
    for c, row in zip(own, rows, strict=True):
        if not np.isclose(c, conditions[row], rtol=1e-9, atol=0):
            raise InputError(
                f"{table.path}: {condition} = {c:g} has damping but no frequencies, expected one "
                f"of {', '.join(f'{v:g}' for v in conditions)}"
            )
    places = {name: modes.index(name) for name in present}
    return _ratios(table, places, rows, (len(conditions), len(modes)))
