"""A measured static stiffness: it tells stiffness from mass where frequencies cannot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from fenics_joints.diagnosis.evidence.at_point import AtPoint, Energies
from fenics_joints.diagnosis.evidence.covariance import UNKNOWN
from fenics_joints.diagnosis.evidence.entries import STIFFNESS
from fenics_joints.diagnosis.evidence.scalars import Values
from fenics_joints.reduction.static import StaticModel


@dataclass(frozen=True, eq=False, kw_only=True)
class StaticStiffness(AtPoint):
    """Force over displacement, N/m.

    Attributes:
        model: Has the compliance of all that were measured.
    """

    model: StaticModel
    kind: ClassVar[int] = STIFFNESS
    unknown: ClassVar[float] = 2 * UNKNOWN  # as the square of a frequency

    def log_value(self, values: Mapping[str, float | np.ndarray]) -> float | np.ndarray:
        """ln of the model's, N/m, without its mesh's error; (b,) of values (b,)."""
        return -self.model.log_compliance(values)[..., self.index] - self.mesh

    def log_slopes(self, values: Values, low: Values, high: Values, width: float) -> np.ndarray:
        """See `scalars.Scalar`."""
        return -self.model.log_slopes(self.index, values, low, high, width)

    def by_logs(self, energies: Energies, values: Mapping[str, float]) -> np.ndarray:
        """With the response u to the force, u^T dK u over u^T K u; see `AtPoint`."""
        stiff, _ = energies(self.model.response(values, self.index), 0.0, values)
        return np.array([stiff / stiff.sum(), 0.0 * stiff])
