"""Measured responses near a resonance, at several levels of a sinusoidal force."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fenics_joints.errors import InputError, member, reals, wanted
from fenics_joints.measurements.tables import read_table

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

    def __post_init__(self):
        member("response", self.response, UNITS)
        levels = reals("levels", self.levels, (None,), "N", above=0.0)
        if not len(levels) or np.any(np.diff(levels) <= 0):
            raise wanted("levels", self.levels, "levels of the force, ascending")
        for key in ("frequencies_hz", "amplitudes"):
            rows = getattr(self, key)
            if not isinstance(rows, list | tuple) or len(rows) != len(levels):
                raise wanted(key, rows, f"{len(levels)} lists of numbers, one for each level")
            for i, row in enumerate(rows):
                reals(f"{key}[{i}]", row, np.shape(self.frequencies_hz[i]), above=0.0)
        for i, row in enumerate(self.frequencies_hz):
            if np.ndim(row) != 1 or np.any(np.diff(row) <= 0):
                raise wanted(f"frequencies_hz[{i}]", row, "frequencies, ascending")

    def __repr__(self) -> str:
        levels = ", ".join(f"{level:g}" for level in self.levels[:6])
        more = ", ..." if len(self.levels) > 6 else ""
        return f"MeasuredCurves({self.response} at {levels}{more} N)"

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

    Units stand in the columns' heads, such as ``level [N]``.

    Args:
        path: CSV or TOML, as `read_table` reads them.
        response: ``displacement``, ``velocity`` or ``acceleration``.

    Raises:
        InputError: Names the file, the column, and what was expected.
    """
    member("response", response, UNITS)
    table = read_table(path)
    level, hz, size = (
        table.numbers(name, unit, above=0.0)
        for name, unit in (("level", "N"), ("frequency", "Hz"), ("amplitude", UNITS[response]))
    )
    levels, frequencies, amplitudes = tuple(np.unique(level).tolist()), [], []
    for one in levels:
        rows = np.flatnonzero(level == one)
        rows = rows[np.argsort(hz[rows], kind="stable")]
        if len(np.unique(hz[rows])) < len(rows) or len(rows) < 3:
            raise InputError(
                f"{path}: level {one:g} N: expected three or more different frequencies"
            )
        frequencies.append(hz[rows])
        amplitudes.append(size[rows])
    return MeasuredCurves(levels, tuple(frequencies), tuple(amplitudes), response)
