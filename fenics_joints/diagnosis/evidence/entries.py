"""What each entry of a test's data is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

#: Kinds of entries.
FREQUENCY, DAMPING, SHAPE, MASS, STIFFNESS, ANTIRESONANCE, FUNCTION = range(7)
#: Their names.
KINDS = (
    "frequencies",
    "damping",
    "shapes",
    "masses",
    "static stiffness",
    "antiresonances",
    "functions",
)


@dataclass(frozen=True)
class Entries:
    """What each entry of the data is; arrays of shape (N,).

    Attributes:
        kind: `FREQUENCY`, `DAMPING`, `SHAPE`, or one of a single number.
        row: Its condition; 0 for what depends on none, as masses.
        mode: Its mode; 0 for single numbers.
        sensor: Its sensor; -1 but for shapes.
    """

    kind: np.ndarray
    row: np.ndarray
    mode: np.ndarray
    sensor: np.ndarray

    @property
    def of_scalars(self) -> np.ndarray:
        """Which are of no mode and no condition: single numbers of their own."""
        return self.kind >= MASS

    def filled(self, log_f: np.ndarray, shapes: np.ndarray | None) -> np.ndarray:
        """Changes of every entry, (N, k), the same at all rows; nought of other kinds, and of modes
        beyond those that are known.

        Args:
            log_f: Of ln f, (m, k).
            shapes: Of the shapes at the sensors, (n_s, m, k); None for none.
        """
        found = np.zeros((len(self.kind), log_f.shape[1]))
        own = (self.kind == FREQUENCY) & (self.mode < len(log_f))
        found[own] = log_f[self.mode[own]]
        if shapes is not None:
            own = (self.kind == SHAPE) & (self.mode < shapes.shape[1])
            found[own] = shapes[self.sensor[own], self.mode[own]]
        return found
