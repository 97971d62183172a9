"""A measured antiresonance: it tells where a change is, which resonances may not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from fenics_joints.diagnosis.evidence.entries import ANTIRESONANCE
from fenics_joints.diagnosis.evidence.scalars import Values
from fenics_joints.diagnosis.evidence.signatures import Signatures
from fenics_joints.reduction.grounded import Antiresonances

__all__ = ["Antiresonance"]


@dataclass(frozen=True, eq=False)
class Antiresonance:
    """A frequency at which a point stands still under a force there: a `scalars.Scalar`.

    Attributes:
        name: The point's.
        measured: Hz.
        sd: Relative standard deviation: of the instrument, of any such model, and of what is left
            of the mesh's error.
        row: The test's row at which it was measured.
        zeros: Has all antiresonances of the point.
        index: Which of them this is.
        mesh: How much too high, in ln f, the mesh makes it.
        patches: Change of its logarithm by the stiffness and by the mass of each patch, (2, P);
            None where no unknown cause has a place.
    """

    name: str
    measured: float
    sd: float
    row: int
    zeros: Antiresonances
    index: int
    mesh: float = 0.0
    patches: np.ndarray | None = None
    kind: ClassVar[int] = ANTIRESONANCE
    unknown: ClassVar[float] = 0.1

    def log_value(self, values: Mapping[str, float | np.ndarray]) -> np.ndarray:
        """ln of the model's, Hz, without its mesh's error, (b,) of values (b,); nan where the model
        has it no more."""
        return self.zeros.at(values).log_f[:, self.index] - self.mesh

    def log_slopes(self, values: Values, low: Values, high: Values, width: float) -> np.ndarray:
        """See `scalars.Scalar`."""
        return self.zeros.slopes(values, low, high, width)[:, self.index]

    def by_patch(self, patches: Signatures) -> tuple[np.ndarray, np.ndarray]:
        """See `scalars.Scalar`."""
        none = np.zeros(len(patches.names))
        return (none, none) if self.patches is None else (self.patches[0], self.patches[1])
