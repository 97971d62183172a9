"""A line of a measured frequency response function: masses and stiffnesses in their units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from fenics_joints.diagnosis.evidence.at_point import AtPoint, Energies
from fenics_joints.diagnosis.evidence.entries import FUNCTION
from fenics_joints.diagnosis.evidence.scalars import Values
from fenics_joints.reduction.receptances import About, Receptances


@dataclass(frozen=True, eq=False, kw_only=True)
class FunctionLine(AtPoint):
    """The model's receptance over the measured one: its logarithm to first order about one.

    That is what the magnitude is off, and of the other part what the phase is, rad; unlike a
    logarithm it knows signs, and does not go to infinity where the model has an antiresonance.
    ``measured`` is one, and ``sd`` that of the function relative to it.

    Attributes:
        functions: Has all lines.
        over: The measured receptance, m/N.
        phase: Whether this is the phase's.
        unknown: What an unknown cause may do to it, one standard deviation.
    """

    functions: Receptances
    over: complex
    phase: bool
    unknown: float
    kind: ClassVar[int] = FUNCTION

    def log_value(self, values: Mapping[str, float | np.ndarray]) -> np.ndarray:
        """What the model is off, (b,) of values (b,); nan where it lacks a mode of the test."""
        return self._part(self.functions.at(values)[:, self.index] / self.over - 1.0)

    def log_slopes(self, values: Values, low: Values, high: Values, width: float) -> np.ndarray:
        """See `scalars.Scalar`."""
        return self._part(
            self.functions.slopes(values, low, high, width)[:, self.index] / self.over
        )

    def _part(self, off: np.ndarray) -> np.ndarray:
        return off.imag if self.phase else off.real

    def by_logs(self, energies: Energies, values: Mapping[str, float]) -> np.ndarray:
        """-x^T dZ y over the function, with the resonances put back; see `AtPoint`. A patch has no
        phase."""
        about = self.functions.about(values)
        pulls = about.pulls(energies, values)
        if self.phase:
            return 0.0 * pulls[0]
        found = np.einsum("k,kwp->wp", about.by_pole[self.index], pulls)
        return (found + self._of_motions(about, energies, values)) / about.value[self.index]

    def _of_motions(self, about: About, energies: Energies, values) -> np.ndarray:
        """-x^T dZ y of the two motions, which are one at a driving point."""
        i, omega = self.index, float(about.omega[self.index])
        x, y = (motion[:, i] for motion in about.motions)
        in_full = self.functions.basis.in_full
        both = energies(in_full(0.5 * (x + y)), omega, values)
        if np.any(x != y):
            both = both - energies(in_full(0.5 * (x - y)), omega, values)
        stiff, mass = both
        return np.array([-stiff, mass])
