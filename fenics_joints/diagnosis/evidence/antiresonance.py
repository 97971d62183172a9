"""A measured antiresonance: it tells where a change is, which resonances may not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from fenics_joints.diagnosis.evidence.at_point import AtPoint, Energies
from fenics_joints.diagnosis.evidence.covariance import UNKNOWN
from fenics_joints.diagnosis.evidence.entries import ANTIRESONANCE
from fenics_joints.diagnosis.evidence.scalars import Values
from fenics_joints.reduction.grounded import Antiresonances


@dataclass(frozen=True, eq=False, kw_only=True)
class Antiresonance(AtPoint):
    """A frequency, Hz, at which a point stands still under a force there.

    Attributes:
        zeros: Has all antiresonances of the point.
    """

    zeros: Antiresonances
    kind: ClassVar[int] = ANTIRESONANCE
    unknown: ClassVar[float] = UNKNOWN

    def log_value(self, values: Mapping[str, float | np.ndarray]) -> np.ndarray:
        """ln of the model's, Hz, without its mesh's error, (b,) of values (b,); nan where the model
        has it no more."""
        return self.zeros.at(values).log_f[:, self.index] - self.mesh

    def log_slopes(self, values: Values, low: Values, high: Values, width: float) -> np.ndarray:
        """See `scalars.Scalar`."""
        return self.zeros.slopes(values, low, high, width)[:, self.index]

    def by_logs(self, energies: Energies, values: Mapping[str, float]) -> np.ndarray:
        """As of any frequency; see `AtPoint`."""
        x, square = self.zeros.shape(self.index, values)
        return np.array([[0.5], [-0.5]]) * energies(x, np.sqrt(square), values) / square
