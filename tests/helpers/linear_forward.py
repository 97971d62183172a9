"""A forward model that several tests share: linear, so that all answers have closed forms."""

from __future__ import annotations

import numpy as np
from scipy.stats import multivariate_normal

from fenics_joints.diagnosis import Effect, Prior
from fenics_joints.diagnosis.evidence.fitted import Fit
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.diagnosis.evidence.predictions import PointwiseForward, model_of


class Linear(PointwiseForward):
    """ln f = 5 + A p + b p0^2 for parameters p0, p1, ...: without b every answer has a closed
    form."""

    def __init__(self, matrix, bend=None):
        self.matrix = np.asarray(matrix, dtype=float)
        self.bend = np.zeros(len(self.matrix)) if bend is None else np.asarray(bend)
        names = [f"p{i}" for i in range(self.matrix.shape[1])]
        self.model = model_of(names)
        self.baseline = dict.fromkeys(names, 0.0)

    def __call__(self, values):
        p = np.array([values[name] for name in self.model.parameters])
        slope = self.matrix.copy()
        slope[:, 0] += 2 * self.bend * p[0]
        return 5.0 + self.matrix @ p + self.bend * p[0] ** 2, slope


def shift(index, spread=1.0, median=0.0, span=(-np.inf, np.inf)):
    """An effect that adds a normal amount to parameter ``index``."""

    def apply(values, theta, condition):
        values[f"p{index}"] += theta["d"]

    prior = Prior("d", median, spread, log=False, span=span)
    return Effect(f"effect {index}", "", (prior,), apply)


def linear_fit(causes: tuple[int, ...], slope: np.ndarray, log_f: np.ndarray, sd: float) -> Fit:
    """The fit of causes that move ln f, (m,), by ``slope`` at one standard deviation of each's
    size; ``sd`` is that of the data."""
    precision = slope.T @ slope / sd**2 + np.eye(len(causes))
    z = np.linalg.solve(precision, slope.T @ log_f / sd**2)
    left, m = (log_f - slope @ z) / sd, len(log_f)
    density = multivariate_normal(cov=sd**2 * np.eye(m) + slope @ slope.T).logpdf(log_f)
    return Fit(
        Hypothesis(tuple(shift(i) for i in causes)),
        z,
        np.linalg.inv(precision),
        slope @ z,
        (1, m),
        slope,
        float(density),
        float(left @ left),
        m,
    )
