"""Predictions in closed form."""

from __future__ import annotations

from fenics_joints.diagnosis.evidence.predictions import PointwiseForward, model_of


class Function(PointwiseForward):
    """Predicts by a function from named values to ln f, (m,), and its derivatives, (m, n)."""

    def __init__(self, function, names):
        self._function, self.model = function, model_of(names)

    def __call__(self, values):
        return self._function(values)
