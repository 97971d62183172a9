"""Measured responses near a resonance, at several levels of a sinusoidal force."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fenics_joints.errors import InputError
from fenics_joints.measurements import read_table
from fenics_joints.units import to_si

__all__ = ["MeasuredCurves", "read_curves"]

#: SI unit of each kind of response.
UNITS = {"displacement": "m", "velocity": "m/s", "acceleration": "m/s2"}


@dataclass(frozen=True)
class MeasuredCurves:
    """Amplitudes at one sensor, by level of the force.

    Attributes:
        levels: Amplitudes of the force, N, ascending.
        frequencies_hz: For each level, Hz, ascending, (n,).
        amplitudes: For each level, of the first harmonic, in SI units, (n,).
        response: ``displacement``, ``velocity`` or ``acceleration``.
    """

    levels: tuple[float, ...]
    frequencies_hz: tuple[np.ndarray, ...]
    amplitudes: tuple[np.ndarray, ...]
    response: str

    def at(self, level: float) -> tuple[np.ndarray, np.ndarray]:
        """(frequencies, amplitudes) of one level.

        Raises:
            InputError: If there is none of that level.
        """
        if level not in self.levels:
            there = ", ".join(f"{known:g} N" for known in self.levels)
            raise InputError(f"no curve was measured at {level:g} N; expected one of: {there}.")
        i = self.levels.index(level)
        return self.frequencies_hz[i], self.amplitudes[i]


def read_curves(path: str | Path, response: str) -> MeasuredCurves:
    """Read curves from a table with the columns ``level``, ``frequency`` and ``amplitude``.

    Units stand in the columns' heads; without, they are N, Hz and SI's for the response.

    Args:
        path: CSV or TOML, as `read_table` reads them.
        response: ``displacement``, ``velocity`` or ``acceleration``.

    Raises:
        InputError: Names the file, the column, and what was expected.
    """
    table = read_table(path)
    units = {"level": "N", "frequency": "Hz", "amplitude": UNITS[response]}
    columns = {}
    for name, unit in units.items():
        if name not in table.names:
            raise InputError(
                f"{path}: no column {name!r}; expected the columns {', '.join(units)}, got "
                f"{', '.join(table.names)}"
            )
        i = table.names.index(name)
        values, given = table.values[:, i], table.units[i] or unit
        if not np.all(values > 0):
            raise InputError(f"{path}: column {name!r}: expected numbers above zero in every row")
        columns[name] = values * _factor(path, name, given, unit)
    levels = tuple(float(level) for level in np.unique(columns["level"]))
    frequencies, amplitudes = [], []
    for level in levels:
        rows = np.flatnonzero(columns["level"] == level)
        rows = rows[np.argsort(columns["frequency"][rows], kind="stable")]
        if len(np.unique(columns["frequency"][rows])) < len(rows) or len(rows) < 3:
            raise InputError(
                f"{path}: level {level:g} N: expected three or more different frequencies"
            )
        frequencies.append(columns["frequency"][rows])
        amplitudes.append(columns["amplitude"][rows])
    return MeasuredCurves(levels, tuple(frequencies), tuple(amplitudes), response)


def _factor(path, name: str, given: str, unit: str) -> float:
    try:
        return to_si(f"1 {given}", unit)
    except ValueError as error:
        raise InputError(f"{path}: column {name!r}: {error}") from error
