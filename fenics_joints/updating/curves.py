"""Curves of identified parameters over the bolts' torque (Tian et al. 2021, section 2.3).

The paper prints no formula for its curves. Two are tried, with two numbers per parameter each, and
the one that fits the fitted torques better is kept: a power law, which eqs. 22 to 25 imply for a
pressure proportional to the torque, and one that saturates. Where a law bounds E by G, the curve of
E is that of the odds s = E / (3 G - E), so that it stays allowed at any torque.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fenics_joints.measurements.least_squares import LeastSquares
from fenics_joints.measurements.target import Target
from fenics_joints.updating.coordinates import LogScale
from fenics_joints.updating.prediction import Predictor
from fenics_joints.updating.result import Update
from fenics_joints.updating.target_fit import TargetFit


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
#: Standard deviation of the shape numbers about their usual value, so that one which the data leave
#: open does not run away; chosen.
_PULL = 1.0


@dataclass(frozen=True, eq=False, repr=False)
class Curves:
    """Curves of several parameters over a condition T.

    Attributes:
        names: Names of the parameters.
        form: Formula; in it ``a`` is in the parameter's unit, or a pure number for odds.
        reference: T0.
        a: Logarithms of a, shape (p,).
        b: Exponents, or logarithms of b in the saturating form, shape (p,).
        cost: Weighted sum of squares over the fitted data.
        scale: Coordinates that the curves are of.
    """

    names: tuple[str, ...]
    form: str
    reference: float
    a: np.ndarray
    b: np.ndarray
    cost: float
    scale: LogScale

    def __repr__(self) -> str:
        return f"Curves({', '.join(self.names)[:60]}: {self.form})"

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
    model,
    targets: Sequence[Target],
    conditions: Sequence[float],
    found: Sequence[Update],
    start: Mapping[str, float],
    *,
    regularisation: float = 2.3,
    n_modes: int | None = None,
) -> Curves:
    """Curves fitted to the data of all conditions at once: least squares in their coefficients.

    They start from the parameters identified condition by condition, weighted by what each of these
    identifications knew, so that combinations the data leave open do not steer the curve.

    Args:
        model: As for `update`.
        targets: The data at each condition.
        conditions: Fitted conditions, positive, as many.
        found: What was identified at each.
        start: Values of the model's parameters, about which ln a is held.
        regularisation: Standard deviation of that.
        n_modes: As for `update`.
    """
    names = found[0].names
    fixed = {name: value for name, value in start.items() if name not in names}
    predictors = [Predictor(model, target, names, fixed, n_modes=n_modes) for target in targets]
    fitted = []
    for form in _FORMS:
        coefficients = _Coefficients(form, names, start, conditions, model, regularisation)
        problem = TargetFit(predictors, coefficients, coefficients.pull)
        result = problem.solve(coefficients.guess(found), 60)
        a, b = np.split(result.x, 2)
        fitted.append(
            Curves(names, form, coefficients.reference, a, b, 2 * result.cost, coefficients.scale)
        )
    return min(fitted, key=lambda c: c.cost)


class _Coefficients:
    """Coordinates (ln a, b) of all parameters' curves."""

    def __init__(self, form, names, start, conditions, model, regularisation):
        self.names, self.scale = tuple(names), LogScale(names, model)
        self.curve, usual = _FORMS[form]
        self.reference = float(np.max(conditions))
        self.ratios = np.asarray(conditions) / self.reference
        centre = self.scale.inverse(np.log([start[n] for n in names]))
        # Odds have no usual trend.
        flat = np.isin(np.arange(len(names)), [E for E, _, _ in self.scale.pairs])
        self.usual = np.where(flat, 0.0 if form == _POWER else 3.0, usual)
        self.centre = np.concatenate([centre, self.usual])
        self.sd = np.repeat([regularisation, _PULL], len(names))

    def at(self, condition: int, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values of the parameters at a condition, and their derivative by (ln a, b)."""
        at, by_a, by_b = self.curve(*np.split(x, 2), self.ratios[condition])
        values = np.exp(self.scale.logs(at))
        by_at = values[:, None] * self.scale.slope(at)
        return values, np.concatenate([by_at * by_a, by_at * by_b], axis=1)

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """None: infinite."""
        return -np.inf * np.ones_like(self.centre), np.inf * np.ones_like(self.centre)

    def pull(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What holds what the data leave open: a to the start, b to its usual value."""
        return (x - self.centre) / self.sd, np.diag(1 / self.sd)

    def guess(self, found: Sequence[Update]) -> np.ndarray:
        """Generalised least squares of the curve through the identified parameters."""
        points = [self.scale.inverse(np.log(update.values)) for update in found]
        roots = []
        for x, update in zip(points, found, strict=True):
            by_log = np.linalg.inv(self.scale.slope(x))
            variances, directions = np.linalg.eigh(by_log @ update.log_covariance @ by_log.T)
            roots.append((directions / np.sqrt(variances)).T)

        def off(x):
            parts = [
                root @ (self.curve(*np.split(x, 2), ratio)[0] - point)
                for root, ratio, point in zip(roots, self.ratios, points, strict=True)
            ]
            return np.concatenate(parts)

        first = np.concatenate([points[int(np.argmax(self.ratios))], self.usual])
        return LeastSquares(off, prior=self.pull).solve(first).x
