"""Forwards of closed forms: what they say at one set of values, asked for many in turn."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np


def model_of(names) -> SimpleNamespace:
    """A model of which nothing is known but its parameters."""
    return SimpleNamespace(parameters=dict.fromkeys(names), n_dofs=1)


@dataclass(frozen=True, eq=False)
class Answers:
    """As `fenics_joints.reduction.many.ManyModes`: ln f, (b, m), and derivatives, (b, m, n)."""

    values: dict[str, np.ndarray]
    log_f: np.ndarray
    by_values: np.ndarray

    @property
    def index(self) -> np.ndarray:
        return np.zeros(self.log_f.shape, dtype=int)

    @property
    def x(self) -> np.ndarray:
        b, m = self.log_f.shape
        return np.zeros((b, 1, m))

    def slopes(self, along: np.ndarray) -> np.ndarray:
        return np.einsum("bmn,bnp->bmp", self.by_values, along)

    def share(self, name: str) -> np.ndarray:
        column = list(self.values).index(name)
        return np.maximum(2 * self.by_values[:, :, column] * self.values[name][:, None], 0.0)


class ByHand:
    """A forward whose call has ln f, (m,), and its derivatives by the values, (m, n)."""

    batches, sensors, further = True, None, None

    def many(self, values, every=True, followed=None) -> Answers:
        own = {name: np.asarray(values[name], dtype=float) for name in self.model.parameters}
        each = [self(dict(zip(own, row, strict=True))) for row in np.stack(list(own.values()), 1)]
        return Answers(own, *(np.array(part) for part in zip(*each, strict=True)))

    def change(self, low, high, width: float, count: int = 1) -> np.ndarray:
        """Derivatives of the values along directions, (b, n, count)."""
        moved = [(high[name] - low[name]) / width for name in self.model.parameters]
        return np.reshape(moved, (len(moved), count, -1)).transpose(2, 0, 1)


class Function(ByHand):
    """The same of a function."""

    def __init__(self, function, names):
        self._function, self.model = function, model_of(names)

    def __call__(self, values):
        return self._function(values)
