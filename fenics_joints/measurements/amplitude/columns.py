"""Columns of amplitude data: what they measure, by their names and units."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from fenics_joints.errors import InputError, located
from fenics_joints.measurements.amplitude.backbone import RESPONSES
from fenics_joints.measurements.tables import Table
from fenics_joints.response.units import KINDS as TIMES
from fenics_joints.response.units import frf_unit
from fenics_joints.units import factor_to_si

#: Names of a column that says the level; and of one that says the response.
LEVELS = ("level", "amplitude", "acceleration", "velocity", "displacement", "force")
MOTIONS = ("amplitude", "response", "acceleration", "velocity", "displacement")
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


def only_unit(table: Table, name: str) -> tuple[str, float]:
    """`level_unit` of a column, with the file and the column in its message."""
    with located(f"{table.path}: column {name!r}"):
        unit = table.unit(name)
        if not unit:
            raise InputError(f"the unit is missing; expected a head such as '{name} [m/s2]'")
        return level_unit(unit)


def checked_column(table: Table, name: str, unit: str | None = None, *, above=None) -> np.ndarray:
    """A column with a number in every row, in an SI unit, or as written; above a bound."""
    values = table.column(name, unit)
    if not np.isfinite(values).all():
        row = int(np.argmax(~np.isfinite(values))) + 1
        raise InputError(
            f"{table.path}: column {name!r}, data row {row} is empty; expected a number"
        )
    if above is not None and not np.all(values > above):
        row = int(np.argmax(~(values > above))) + 1
        raise InputError(
            f"{table.path}: column {name!r}, data row {row} = {values[row - 1]:g}; expected a "
            f"number above {above:g}"
        )
    return values


def motion_column(table: Table, names: Iterable[str]) -> tuple[str, np.ndarray] | None:
    """(kind, values in SI units, above 0) of the first of these columns; None if none is there."""
    name = next((n for n in names if n in table.names), None)
    if name is None:
        return None
    kind, factor = only_unit(table, name)
    return kind, factor * checked_column(table, name, above=0)


def phase_column(table: Table) -> np.ndarray | None:
    """Phase of the response to the force, rad; None if there is none."""
    if "phase" not in table.names:
        return None
    unit = table.unit("phase")
    if unit not in ("deg", "°", "rad"):
        raise InputError(f"{table.path}: column 'phase': unit {unit!r}, expected [deg] or [rad]")
    values = checked_column(table, "phase")
    return values if unit == "rad" else np.deg2rad(values)
