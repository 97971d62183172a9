"""A measured static stiffness: it tells stiffness from mass where frequencies cannot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from fenics_joints.diagnosis.evidence.entries import STIFFNESS
from fenics_joints.diagnosis.evidence.scalars import Values
from fenics_joints.diagnosis.evidence.signatures import Signatures
from fenics_joints.reduction.static import StaticModel

__all__ = ["StaticStiffness"]


@dataclass(frozen=True, eq=False)
class StaticStiffness:
    """Force over displacement at a point, along a direction: a `scalars.Scalar`.

    Attributes:
        name: The measurement's.
        measured: N/m.
        sd: Relative standard deviation: of the instrument, of any such model, and of what is left
            of the mesh's error.
        row: The test's row at which it was measured.
        model: Has the compliance of all that were measured.
        index: Which of them this is.
        mesh: ln of how much too stiff the mesh makes it.
        patches: Change of its logarithm by the stiffness and by the mass of each patch, (2, P);
            None where no unknown cause has a place.
    """

    name: str
    measured: float
    sd: float
    row: int
    model: StaticModel
    index: int
    mesh: float = 0.0
    patches: np.ndarray | None = None
    kind: ClassVar[int] = STIFFNESS
    unknown: ClassVar[float] = 0.2

    def log_value(self, values: Mapping[str, float | np.ndarray]) -> float | np.ndarray:
        """ln of the model's, N/m, without its mesh's error; (b,) of values (b,)."""
        return -self.model.log_compliance(values)[..., self.index] - self.mesh

    def log_slopes(self, values: Values, low: Values, high: Values, width: float) -> np.ndarray:
        """See `scalars.Scalar`."""
        return -self.model.log_slopes(self.index, values, low, high, width)

    def by_patch(self, patches: Signatures) -> tuple[np.ndarray, np.ndarray]:
        """See `scalars.Scalar`."""
        none = np.zeros(len(patches.names))
        return (none, none) if self.patches is None else (self.patches[0], self.patches[1])
