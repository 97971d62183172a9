"""A forward model that several tests share: linear, so that all answers have closed forms."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from fenics_joints.diagnosis import Effect, Prior


class Linear:
    """ln f = f0 + A p for parameters p0, p1, ...: every answer has a closed form."""

    def __init__(self, matrix):
        self.matrix = np.asarray(matrix, dtype=float)
        names = [f"p{i}" for i in range(self.matrix.shape[1])]
        self.model = SimpleNamespace(parameters=dict.fromkeys(names))
        self.baseline = dict.fromkeys(names, 0.0)

    def __call__(self, values):
        p = np.array([values[name] for name in self.model.parameters])
        return 5.0 + self.matrix @ p, self.matrix


def shift(index, spread=1.0, median=0.0):
    """An effect that adds a normal amount to parameter ``index``."""

    def apply(values, theta, condition):
        values[f"p{index}"] += theta["d"]

    return Effect(f"effect {index}", "", (Prior("d", median, spread, log=False),), apply)
