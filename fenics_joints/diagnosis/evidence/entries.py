"""What each entry of a test's data is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["DAMPING", "FREQUENCY", "MASS", "SHAPE", "Entries"]

#: Kinds of entries.
FREQUENCY, DAMPING, SHAPE, MASS = 0, 1, 2, 3


@dataclass(frozen=True)
class Entries:
    """What each entry of the data is; arrays of shape (N,).

    Attributes:
        kind: `FREQUENCY`, `DAMPING`, `SHAPE` or `MASS`.
        row: Its condition; 0 for masses.
        mode: Its mode; likewise.
        sensor: Its sensor; -1 but for shapes.
    """

    kind: np.ndarray
    row: np.ndarray
    mode: np.ndarray
    sensor: np.ndarray
