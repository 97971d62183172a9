"""A forward of one's own that knows one set of parameter values at a time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np


def model_of(names: Iterable[str]) -> SimpleNamespace:
    """A model of which nothing is known but its parameters.

    Args:
        names: Their names.
    """
    return SimpleNamespace(parameters=dict.fromkeys(names), n_dofs=1)


@dataclass(frozen=True, eq=False)
class PointwiseModes:
    """What stands for `fenics_joints.reduction.many.ManyModes`, without shapes.

    Attributes:
        values: Values of the model's parameters, each (b,).
        log_f: ln f, (b, m).
        by_values: Derivatives by these values, (b, m, n).
    """

    values: Mapping[str, np.ndarray]
    log_f: np.ndarray
    by_values: np.ndarray

    @property
    def index(self) -> np.ndarray:
        """Mode of each of the test's, (b, m): in order."""
        return np.zeros(self.log_f.shape, dtype=int)

    @property
    def x(self) -> np.ndarray:
        """Shapes, (b, 1, m); there are none."""
        b, m = self.log_f.shape
        return np.zeros((b, 1, m))

    def slopes(self, along: np.ndarray) -> np.ndarray:
        """Derivatives of `log_f`, (b, m, p), along directions of the values, (b, n, p)."""
        moves = np.any(along != 0, axis=(0, 2))  # others may have no derivative
        return np.einsum("bmn,bnp->bmp", self.by_values[:, :, moves], along[:, moves])

    def share(self, name: str) -> np.ndarray:
        """See `ManyModes.share`."""
        column = list(self.values).index(name)
        return np.maximum(2 * self.by_values[:, :, column] * self.values[name][:, None], 0.0)


class PointwiseForward:
    """A forward for `fit` whose subclass has ``model``, from `model_of`, and is called with values
    by name: it returns ln f, (m,), and its derivatives by the model's parameters, (m, n)."""

    batches, sensors, further = True, None, None

    def many(self, values: Mapping[str, np.ndarray], every=True, followed=None) -> PointwiseModes:
        """See `LeanForward.many`."""
        table = {name: np.asarray(value, dtype=float) for name, value in values.items()}
        each = [self(dict(zip(table, row, strict=True))) for row in np.stack([*table.values()], 1)]
        own = {name: table[name] for name in self.model.parameters}
        return PointwiseModes(own, *(np.array(part) for part in zip(*each, strict=True)))

    def change(self, low, high, width: float, count: int = 1) -> np.ndarray:
        """Derivatives of the values along directions, (b, n, count); a value that is nan, being
        that of nothing, does not change."""
        pairs = [(low[name], high[name]) for name in self.model.parameters]
        moved = [np.where(np.isnan(a) & np.isnan(b), 0.0, b - a) / width for a, b in pairs]
        return np.reshape(moved, (len(moved), count, -1)).transpose(2, 0, 1)
