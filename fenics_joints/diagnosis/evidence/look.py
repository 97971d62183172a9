"""A model at many values of a hypothesis' parameters, as one of the test's modes sees it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fenics_joints.reduction.many import Change, ManyModes


@dataclass(frozen=True, eq=False)
class Look:
    """The model as one mode sees it, at many points.

    Attributes:
        mode: That mode, or None.
        modes: The model's modes.
        values: The model's parameter values, each (b,).
        along: Changes of the model by what acts; None where nothing does.
        columns: Which of their directions is that of each parameter that acts.
        felt: Which points feel one of these, (b, 1), where not all do.
    """

    mode: int | None
    modes: ManyModes
    values: dict[str, np.ndarray]
    along: Change | None
    columns: dict[int, int]
    felt: dict[int, np.ndarray]

    def slopes(self, by: Sequence[int]) -> np.ndarray:
        """Derivatives of ln f by some parameters, (b, m, p)."""
        b, m = self.modes.index.shape
        found = np.zeros((b, m, len(by)))
        there = [k for k, j in enumerate(by) if j in self.columns]
        if there:
            columns = [self.columns[by[k]] for k in there]
            found[:, :, there] = self._all_slopes[:, :, columns]
        for k, j in enumerate(by):
            if j in self.felt:
                found[:, :, k] = np.where(self.felt[j], found[:, :, k], 0.0)
        return found

    @cached_property
    def _all_slopes(self) -> np.ndarray:
        """Along every direction, (b, m, n)."""
        return self.modes.slopes(self.along)
