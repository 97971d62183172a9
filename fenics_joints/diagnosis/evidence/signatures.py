"""Changes of a test by changes of stiffness and mass in each patch of a structure, to first
order."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

#: Correlation lengths of the changes of patches over the structure's size, equally probable.
#: [decision: chosen]
LENGTHS = (0.05, 0.2, 1.0)

#: Variance that keeps a correlation definite. [numerical: chosen]
_JITTER = 1e-6


@dataclass(frozen=True, repr=False)
class Signatures:
    """Changes of a test by changes of the expected size in each patch of a structure.

    Attributes:
        names: Name of each patch, (P,).
        region: Region of each, (P,).
        middle: Centre of each, m, (P, 3).
        volume: m3, (P,).
        of_joint: Which are of joints, whose stiffness falls and whose mass stays, (P,).
        log_f: Change of ln f by the stiffness and by the mass of each, (m, P, 2).
        shapes: Change of shapes at the sensors, which the test has scaled, (n_s, m, P, 2); None
            without shapes.
        expected: Expected changes of ln E and ln rho, which these are of.
    """

    names: tuple[str, ...]
    region: tuple[str, ...]
    middle: np.ndarray
    volume: np.ndarray
    of_joint: np.ndarray
    log_f: np.ndarray
    shapes: np.ndarray | None
    expected: tuple[float, float]

    def __repr__(self) -> str:
        return f"Signatures({len(self.names)} patches, {len(self.log_f)} modes)"

    @cached_property
    def _apart(self) -> np.ndarray:
        """Distances over the structure's size, (P, P); infinite between regions."""
        away = np.linalg.norm(self.middle[:, None] - self.middle[None, :], axis=2)
        away = away / max(float(away.max(initial=0.0)), 1e-300)
        region = np.array(self.region)
        return np.where(region[:, None] == region[None, :], away, np.inf)

    def alike(self, length: float) -> np.ndarray:
        """Correlation of the patches' changes, (P, P).

        Args:
            length: Correlation length over the structure's size.
        """
        return np.exp(-0.5 * (self._apart / length) ** 2)

    def root(self, length: float) -> np.ndarray:
        """Factor of the correlation, (P, P); see `alike`."""
        alike = self.alike(length)
        return np.linalg.cholesky(alike + _JITTER * np.eye(len(alike)))
