"""What single numbers have in common that were measured at a point of the structure."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, field

import numpy as np

from fenics_joints.diagnosis.evidence.signatures import Signatures

#: Of a motion, at a circular frequency, with parameter values: x^T K x and omega^2 x^T M x of each
#: patch, (2, P).
Energies = Callable[[object, float, Mapping[str, float]], np.ndarray]


@dataclass(frozen=True, eq=False, kw_only=True)
class AtPoint(ABC):
    """A number measured at a point along a direction: a `scalars.Scalar`.

    Attributes:
        name: The measurement's.
        measured: The number, in its SI unit.
        sd: Relative standard deviation: of the instrument, of any such model, and of what is left
            of the mesh's error.
        row: The test's row at which it was measured.
        index: Which of its model's this is.
        mesh: How much too high, in ln of it, the mesh makes it.
        common: See `scalars.Scalar`.
        patches: Change of its logarithm by the stiffness and by the mass of each patch, (2, P);
            None where no unknown cause has a place.
    """

    name: str
    measured: float
    sd: float
    row: int
    index: int
    mesh: float = 0.0
    common: Mapping[Hashable, float] = field(default_factory=dict)
    patches: np.ndarray | None = None

    @abstractmethod
    def by_logs(self, energies: Energies, values: Mapping[str, float]) -> np.ndarray:
        """Derivatives by ln of the stiffness and of the mass of each patch, (2, P). Collective."""

    def by_patch(self, patches: Signatures) -> tuple[np.ndarray, np.ndarray]:
        """See `scalars.Scalar`."""
        none = np.zeros((2, len(patches.names)))
        stiff, mass = none if self.patches is None else self.patches
        return stiff, mass
