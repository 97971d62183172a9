"""Measured loops of force against response over a cycle of a sinusoidal force."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fenics_joints.errors import InputError, member
from fenics_joints.harmonic.fourier import basis
from fenics_joints.measurements.curves import UNITS, si_columns

#: Largest distance of the force's samples from a sine, relative to its amplitude.
_NO_SINE = 0.1


@dataclass(frozen=True, repr=False)
class MeasuredLoop:
    """Force and response over one cycle or more.

    Attributes:
        frequency_hz: Frequency of the force, Hz.
        times: s, (n,).
        forces: Force, N, (n,).
        responses: Response at one sensor, in SI units, (n,).
        response: ``displacement``, ``velocity`` or ``acceleration``.

    Raises:
        InputError: If there are too few samples, or the force is no sine of that frequency.
    """

    frequency_hz: float
    times: np.ndarray
    forces: np.ndarray
    responses: np.ndarray
    response: str

    def __post_init__(self):
        if self.response not in UNITS:
            raise InputError(f"response = {self.response!r}: expected one of: {', '.join(UNITS)}.")
        sizes = {len(self.times), len(self.forces), len(self.responses)}
        if len(sizes) > 1 or sizes.pop() < 8:
            raise InputError("a loop: expected eight samples or more, as many of each kind.")
        c = self._force()
        apart = self.forces - basis(2 * np.pi * self.frequency_hz * self.times, 3) @ c
        if not self.level > 0 or np.abs(apart).max() > _NO_SINE * self.level:
            raise InputError(
                f"a loop at {self.frequency_hz:g} Hz: its force is no sine of that frequency; "
                "expected one."
            )

    def __repr__(self) -> str:
        return f"MeasuredLoop({len(self.times)} samples at {self.frequency_hz:g} Hz)"

    def _force(self) -> np.ndarray:
        """Mean, cosine and sine of the force, N, (3,)."""
        angles = 2 * np.pi * self.frequency_hz * self.times
        return np.linalg.lstsq(basis(angles, 3), self.forces, rcond=None)[0]

    @property
    def level(self) -> float:
        """Amplitude of the force, N."""
        return float(np.hypot(*self._force()[1:]))

    def angles(self) -> np.ndarray:
        """Angles at which the force is level * cos(angle), (n,)."""
        _, cosine, sine = self._force()
        return 2 * np.pi * self.frequency_hz * self.times - np.arctan2(sine, cosine)


def read_loops(path: str | Path, response: str) -> tuple[MeasuredLoop, ...]:
    """Read loops from a table: ``frequency``, ``time``, ``force`` and ``response``.

    Units stand in the columns' heads, such as ``time [s]``. Rows of the same frequency are one
    loop.

    Args:
        path: CSV or TOML, as `read_table` reads them.
        response: ``displacement``, ``velocity`` or ``acceleration``.

    Raises:
        InputError: Names the file, the column, and what was expected.
    """
    member("response", response, UNITS)
    units = {"frequency": "Hz", "time": "s", "force": "N", "response": UNITS[response]}
    columns = si_columns(path, units)
    found = []
    for frequency in np.unique(columns["frequency"]):
        rows = columns["frequency"] == frequency
        times, forces, responses = (columns[key][rows] for key in ("time", "force", "response"))
        try:
            loop = MeasuredLoop(float(frequency), times, forces, responses, response)
        except InputError as error:
            raise InputError(f"{path}: {error}") from error
        found.append(loop)
    return tuple(found)
