"""Curves of identified parameters over the bolts' torque (seed 001, section 2.3 and Fig. 15).

The paper prints no formula for its curves. Two are tried, with two numbers per parameter each, and
the one that fits the fitted torques better is kept: a power law, which eqs. 22 to 25 imply for a
pressure proportional to the torque, and one that saturates. Where a law bounds E by G, the curve of
E is that of the odds s = E / (3 G - E), so that it stays allowed at any torque.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from fenics_joints.reduction.forward import Forward
from fenics_joints.updating.coordinates import LogScale

__all__ = ["CurveFit", "fit_curves"]


def _power(a, b, ratio):
    """ln of p = e^a ratio^b, and its derivatives by a and b."""
    log = np.log(ratio)
    return a + b * log, np.ones_like(a), np.full_like(b, log)


def _saturating(a, b, ratio):
    """ln of p = e^a (1 - exp(-ratio e^b)), and its derivatives by a and b."""
    y = np.minimum(ratio * np.exp(b), 500.0)
    return a + np.log(-np.expm1(-y)), np.ones_like(a), y / np.expm1(y)


_POWER, _SATURATING = "a (T/T0)^b", "a (1 - exp(-b T/T0))"
_FORMS = {_POWER: (_power, 0.5), _SATURATING: (_saturating, 0.5)}


@dataclass(frozen=True, eq=False)
class CurveFit:
    """Curves of several parameters over a condition T.

    Attributes:
        names: Names of the parameters.
        form: Formula; in it ``a`` is in the parameter's unit, or a pure number for odds.
        reference: T0.
        a: Logarithms of a, shape (p,).
        b: Exponents, or logarithms of b in the saturating form, shape (p,).
        cost: Weighted sum of squares over the fitted frequencies.
        scale: Coordinates that the curves are of.
    """

    names: tuple[str, ...]
    form: str
    reference: float
    a: np.ndarray
    b: np.ndarray
    cost: float
    scale: LogScale

    def values(self, condition: float) -> dict[str, float]:
        """Parameter values at a condition."""
        x, _, _ = _FORMS[self.form][0](self.a, self.b, condition / self.reference)
        return dict(zip(self.names, np.exp(self.scale.logs(x)).tolist(), strict=True))

    def table(self, conditions: np.ndarray | None = None) -> list[dict]:
        """Name, form, T0, a and b of each parameter, and ``samples`` (T, value) to draw it by."""
        drawn = [] if conditions is None else conditions
        at = [(float(c), self.values(float(c))) for c in drawn]
        rows = [
            {
                "name": name,
                "form": self.form,
                "T0": self.reference,
                "a": float(np.exp(a)),
                "b": float(b if self.form == _POWER else np.exp(b)),
                "samples": [(c, values[name]) for c, values in at],
            }
            for name, a, b in zip(self.names, self.a, self.b, strict=True)
        ]
        for E, G, limit in self.scale.pairs:
            rows[E]["form"] = f"{limit:g} {self.names[G]} s/(1 + s), s = {self.form}"
        return rows


def fit_curves(
    forward: Forward,
    names: Sequence[str],
    start: Mapping[str, float],
    conditions: np.ndarray,
    measured_hz: np.ndarray,
    log_sd: np.ndarray,
    log_values: np.ndarray,
    information: Sequence[np.ndarray],
    regularisation: float = 2.3,
) -> CurveFit:
    """Curves fitted to the measured frequencies of all conditions at once.

    They start from the parameters identified condition by condition, weighted by what each of these
    identifications knew, so that combinations the data leave open do not steer the curve.

    Args:
        forward: Frequencies and sensitivities.
        names: The p parameters.
        start: Values of all the model's parameters.
        conditions: Fitted conditions, shape (n,), positive.
        measured_hz: Measured frequencies, Hz, shape (n, m); nan where missing.
        log_sd: Standard deviations of their logarithms, shape (n, m).
        log_values: Logarithms of the identified parameters, shape (n, p).
        information: Inverse covariances of these, n of shape (p, p).
        regularisation: Standard deviation of ln a about the starting value, as in `update`.
    """
    problem = _Problem(
        forward, tuple(names), start, conditions, measured_hz, log_sd, regularisation
    )
    found = []
    for form in _FORMS:
        guess = problem.guess(form, log_values, information)
        result = least_squares(
            problem.residual, guess, problem.slope, args=(form,), max_nfev=60,
            ftol=1e-8, xtol=1e-7, gtol=1e-8,
        )  # fmt: skip
        a, b = np.split(result.x, 2)
        found.append(
            CurveFit(problem.names, form, problem.reference, a, b, 2 * result.cost, problem.scale)
        )
    return min(found, key=lambda c: c.cost)


class _Problem:
    #: Weak pull of the shape numbers to their usual value: an open one must not run away.
    _PULL = 1.0

    def __init__(self, forward, names, start, conditions, measured_hz, log_sd, regularisation):
        self.forward, self.names, self.start = forward, names, dict(start)
        self.conditions, self.reference = conditions, float(np.max(conditions))
        self.log_f, self.log_sd = np.log(measured_hz), log_sd
        self.scale, self.regularisation = LogScale(names, forward.model), regularisation
        self.centre = self.scale.inverse(np.log([start[n] for n in names]))
        position = list(forward.model.parameters)
        self.columns = [position.index(n) for n in names]
        # Odds have no usual trend.
        self.flat = np.isin(np.arange(len(names)), [E for E, _, _ in self.scale.pairs])

    def _usual(self, form) -> np.ndarray:
        trend = 0.0 if form == _POWER else 3.0
        return np.where(self.flat, trend, _FORMS[form][1])

    def guess(self, form, log_values, information) -> np.ndarray:
        """Generalised least squares of the curve through the identified parameters."""
        curve, _ = _FORMS[form]
        points = [self.scale.inverse(log) for log in log_values]
        turned = [self.scale.slope(x) for x in points]
        roots = [
            np.linalg.cholesky(T.T @ H @ T + 1e-9 * np.eye(len(T))).T
            for T, H in zip(turned, information, strict=True)
        ]

        def residual(theta):
            a, b = np.split(theta, 2)
            parts = [
                root @ (curve(a, b, c / self.reference)[0] - x)
                for root, c, x in zip(roots, self.conditions, points, strict=True)
            ]
            return np.concatenate([*parts, self._pull(theta, form)])

        first = np.concatenate([points[int(np.argmax(self.conditions))], self._usual(form)])
        return least_squares(residual, first).x

    def _curve(self, theta, form, condition):
        """Model values, logarithms' slope by the coordinates, and the curve's slopes."""
        a, b = np.split(theta, 2)
        x, by_a, by_b = _FORMS[form][0](a, b, condition / self.reference)
        at = np.exp(self.scale.logs(x))
        values = {**self.start, **dict(zip(self.names, at.tolist(), strict=True))}
        return values, at[:, None] * self.scale.slope(x), by_a, by_b

    def _pull(self, theta, form):
        """What holds what the data leave open: a to the start, b to its usual value."""
        a, b = np.split(theta, 2)
        pull_a = (a - self.centre) / self.regularisation
        return np.concatenate([pull_a, (b - self._usual(form)) / self._PULL])

    def residual(self, theta, form):
        parts = []
        for condition, log_f, sd in zip(self.conditions, self.log_f, self.log_sd, strict=True):
            used = np.isfinite(log_f)
            values, *_ = self._curve(theta, form, condition)
            model, _ = self.forward(values)
            parts.append(((model - log_f) / sd)[used])
        return np.concatenate([*parts, self._pull(theta, form)])

    def slope(self, theta, form):
        p = len(self.names)
        parts = []
        for condition, log_f, sd in zip(self.conditions, self.log_f, self.log_sd, strict=True):
            used = np.isfinite(log_f)
            values, at, by_a, by_b = self._curve(theta, form, condition)
            _, by_values = self.forward(values)
            by_log = by_values[:, self.columns] @ at / sd[:, None]
            parts.append(np.concatenate([by_log * by_a, by_log * by_b], axis=1)[used])
        pull = np.diag([1 / self.regularisation] * p + [1 / self._PULL] * p)
        return np.concatenate([*parts, pull])
