"""Forwards of closed forms."""

from __future__ import annotations

from fenics_joints.diagnosis.evidence.predictions import PointwiseForward, model_of


class Function(PointwiseForward):
    """Of a function of values by name: ln f, (m,), and its derivatives by them, (m, n)."""

    def __init__(self, function, names):
        self._function, self.model = function, model_of(names)

    def __call__(self, values):
        return self._function(values)
