"""The least-squares problem of one fit: residuals, slopes, looks at what acts in steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.integrate import trapezoid

from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.fitted import Fit
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.diagnosis.evidence.least import least_apart, residuals_at, squares
from fenics_joints.diagnosis.evidence.linear import least_square, log_evidence, whiten
from fenics_joints.diagnosis.evidence.prediction import (
    frequencies_and_damping,
    predict,
    predicted,
    predicted_alone,
)
from fenics_joints.errors import InputError
from fenics_joints.reduction.forward import Forward

__all__ = ["Problem", "Scan", "Scanned"]

#: Standard deviations of the prior beyond which a scanned parameter is not looked for.
_FARTHEST = 4.0
#: Of the places that are looked at so many are started from: in a linear model about each, and by
#: the model itself.
_STARTS, _STARTS_ALL = 3, 5
#: Sizes of an effect, in standard deviations, at which its places are looked at, and how far apart
#: those are that a fit starts from.
_SIZES, _AWAY = (-0.6, 0.6), 0.15
#: Points of a scan about the end of a fit that is surer than two of its steps, and how far they
#: reach, in standard deviations.
_NEAR, _NEAR_SD = 13, 6.0
#: Distance of starts from limits.
_INSIDE = np.array([[1e-6], [-1e-6]])
#: Step of differences, in standard deviations of the prior.
_STEP = 1e-4
#: Nats by which a guide may differ from the model where a fit ended, or where it was integrated.
_SAME = 0.02


class Scanned:
    """Predictions at points of grids over parameters that act in steps, where all others are at
    their medians: no data move them, so that what is fitted to parts of a test asks for them again.

    Args:
        evidence: The whole test.
        baseline: Parameter values of the nominal model.
    """

    def __init__(self, evidence: Evidence, baseline: dict[str, float]):
        self._evidence, self._baseline = evidence, baseline
        self._known: dict[tuple, tuple[np.ndarray, np.ndarray]] = {}

    def __call__(
        self, hypothesis: Hypothesis, forward: Forward, z: np.ndarray, role: str
    ) -> tuple[np.ndarray, np.ndarray]:
        """See `predict`.

        Args:
            hypothesis: The hypothesis.
            forward: Predicts.
            z: The point.
            role: Which of the hypothesis' models this forward is of.
        """
        key = hypothesis.label_of_keys, role, z.tobytes()
        if key not in self._known:
            self._known[key] = predict(hypothesis, forward, self._evidence, z, self._baseline)
        return self._known[key]


@dataclass(frozen=True)
class Scan:
    """The posterior over one parameter, on a grid.

    Attributes:
        index: Which parameter.
        grid: Its values, ascending, (n,).
        log_density: ln of the evidence at each, the others integrated out, (n,).
        points: The most probable point at each, (n, d).
    """

    index: int
    grid: np.ndarray
    log_density: np.ndarray
    points: np.ndarray

    @property
    def start(self) -> np.ndarray:
        """The most probable point met, (d,)."""
        return self.points[int(np.argmax(self.log_density))]

    def with_points(self, grid: np.ndarray, log_density: np.ndarray, points: np.ndarray) -> Scan:
        """The same with more points."""
        grid = np.concatenate([self.grid, grid])
        order = np.argsort(grid, kind="stable")
        return Scan(
            self.index, grid[order], np.concatenate([self.log_density, log_density])[order],
            np.concatenate([self.points, points])[order],
        )  # fmt: skip

    def improved(self, found: Fit) -> Fit:
        """A fit with the evidence and the variance from the grid."""
        top = self.log_density.max()
        weight = np.exp(self.log_density - top)
        total = trapezoid(weight, self.grid)
        mean = trapezoid(weight * self.grid, self.grid) / total
        variance = trapezoid(weight * (self.grid - mean) ** 2, self.grid) / total
        scale = np.ones(len(found.z))
        scale[self.index] = np.sqrt(variance / found.covariance[self.index, self.index])
        return replace(
            found,
            log_evidence=float(top + np.log(total) - 0.5 * np.log(2 * np.pi)),
            covariance=found.covariance * np.outer(scale, scale),
        )


class Problem:
    """Residuals and slopes of one fit; remembers the last point, since both are asked for."""

    def __init__(self, hypothesis, forward, evidence, baseline, lower, known: Fit | None = None,
                 scanned: Scanned | None = None, role: str = "whole"):  # fmt: skip
        self._scanned, self._role = scanned, role
        self.hypothesis, self.forward, self.evidence = hypothesis, forward, evidence
        self.baseline, self.lower = baseline, lower
        self.knows = known is not None
        self._last = None if known is None else (known.z, known.predicted, known.jacobian)
        self._alone: tuple[np.ndarray, np.ndarray] | None = None
        self._slips = hypothesis.damped and any(e.by_level and e.loss for e in hypothesis.effects)

    def predict(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if self._last is None or not np.array_equal(self._last[0], z):
            found = predict(self.hypothesis, self.forward, self.evidence, z, self.baseline)
            if self._slips:
                found = found[0], self._with_differences(z, *found)
            self._last = (z.copy(), *found)
        return self._last[1:]

    def _with_differences(self, z, predicted, jacobian) -> np.ndarray:
        """Slopes in which those of damping by the effects' own parameters are differences.

        `RowPrediction` takes a joint's share of the energy for that of one spring in series: with
        compliances across and along, what slips may have the other sign.
        """
        n = self.evidence.log_f.size
        jacobian = jacobian.copy()
        for j in range(*self.hypothesis.own.indices(len(z))):
            step = np.where(np.arange(len(z)) == j, _STEP if z[j] < 0 else -_STEP, 0.0)
            moved = frequencies_and_damping(
                self.hypothesis, self.forward, self.evidence, z + step, self.baseline
            )
            jacobian[n : 2 * n, j] = (moved[n:] - predicted[n : 2 * n]) / step[j]
        return jacobian

    def _predicted(self, z, ends: bool = False) -> np.ndarray:
        """The prediction alone: a search asks for slopes only where it goes on from, and if it
        ``ends`` there nobody does."""
        for last in (self._last, self._alone):
            if last is not None and np.array_equal(last[0], z):
                return last[1]
        alone = predicted if ends else predicted_alone
        found = alone(self.hypothesis, self.forward, self.evidence, z, self.baseline)
        if found is None:
            return self.predict(z)[0]
        self._alone = z.copy(), found
        return found

    def residual(self, z, ends: bool = False):
        predicted = self._predicted(z, ends)
        used = self.evidence.fitted
        return np.concatenate([whiten(self.lower, (predicted - self.evidence.data)[used]), z])

    def inside(self, z) -> np.ndarray:
        """The point within the limits that is nearest."""
        return np.clip(z, *(self.hypothesis.limits.T + _INSIDE))

    def cost(self, z) -> float:
        """Half the sum of squares that a search makes small, inside the limits, of a point that
        none goes on from at once."""
        return 0.5 * float(np.sum(self.residual(self.inside(z), ends=True) ** 2))

    def slope(self, z):
        _, jacobian = self.predict(z)
        return np.concatenate(
            [whiten(self.lower, jacobian[self.evidence.fitted]), np.eye(len(z))]
        )

    def ends_with(self, other: Problem, z: np.ndarray, tolerance: float) -> bool:
        """Whether a search that another model ends at a point would end there, but for a small part
        of a nat, or of what the search itself leaves: its value there is one's own in any case."""
        own, slope = self.residual(z), self.slope(z)
        turn = slope.T @ own - other.slope(z).T @ other.residual(z)
        gain = turn @ np.linalg.solve(slope.T @ slope, turn)
        return bool(gain <= max(2 * _SAME, tolerance * (own @ own)))

    def agrees(self, other: Problem, z: np.ndarray) -> bool:
        """Whether another model has the same evidence at a point, but for a small part of a nat."""
        own, residual = self.residual(z), other.residual(z)
        return bool(abs(own @ own - residual @ residual) <= 2 * _SAME)

    def scan(self, index: int, limits) -> Scan:
        """The evidence's integrand over one parameter, the others optimal in a linear model."""
        count = self.hypothesis.priors[index][1].scan
        grid = np.linspace(max(limits[0], -_FARTHEST), min(limits[1], _FARTHEST), count)
        return Scan(index, grid, *self._along(index, grid))

    def scan_near(self, scan: Scan, found: Fit) -> Scan:
        """A scan with points about the end of a fit, where the others are linear about that: a peak
        that is narrower than a step of the grid would be passed by.

        Args:
            scan: The scan.
            found: The fit.
        """
        j, sd = scan.index, np.sqrt(found.covariance[scan.index, scan.index])
        if sd > 2 * (scan.grid[1] - scan.grid[0]):
            return scan
        steps = sd * np.linspace(-_NEAR_SD, _NEAR_SD, _NEAR)
        near = np.unique(np.clip(found.z[j] + steps, scan.grid[0], scan.grid[-1]))
        return scan.with_points(near, *self._along(j, near, found.z))

    def _along(self, index: int, grid, about=None) -> tuple[np.ndarray, np.ndarray]:
        """`_at` at values of one parameter, (n,) and (n, d)."""
        looks = [self._at({index: value}, about) for value in grid]
        return np.array([look[0] for look in looks]), np.array([z for _, z in looks])

    def places(self, indices: Sequence[int]) -> list[np.ndarray]:
        """The most probable points over parameters that say where, and others that act in steps, at
        the values of each that their priors say; the others optimal in a linear model."""
        points, value, exact = self._looks(indices)
        if exact:
            return least_apart(points, -value, list(indices), _AWAY, _STARTS_ALL)
        return [points[i] for i in np.argsort(-value, kind="stable")[:_STARTS]]

    def at_each(self, indices: Sequence[int], index: int) -> list[np.ndarray]:
        """The most probable point of `places` at each value of one of the parameters, the best
        first.

        Args:
            indices: See `places`.
            index: Which of these.
        """
        points, value, _ = self._looks(indices)
        values = np.unique(points[:, index])
        own = (np.flatnonzero(points[:, index] == at) for at in values)
        best = np.array([i[np.argmax(value[i])] for i in own])
        return [points[i] for i in best[np.argsort(-value[best], kind="stable")]]

    def _looks(self, indices) -> tuple[np.ndarray, np.ndarray, bool]:
        """Points at all values of some parameters, (n, d), how probable they are, in ln, (n,), and
        whether all were solved for; else the others are optimal in a linear model."""
        axes = [self.hypothesis.priors[j][1].tried() for j in indices]
        if any(self.hypothesis.priors[j][1].also for j in indices):
            # What resonates makes new modes, of which no slope tells.
            points = self._all_over(indices, axes)
            residual = residuals_at(
                self.hypothesis, self.forward, self.evidence, self.baseline, points
            )
            if residual is not None:
                return points, -0.5 * squares(points, residual, self.lower), True
        looks = [self._at(dict(zip(indices, point, strict=True))) for point in product(*axes)]
        return np.array([z for _, z in looks]), np.array([value for value, _ in looks]), False

    def _all_over(self, indices: Sequence[int], axes) -> np.ndarray:
        """Points at all values of some parameters, at two sizes of the effects' others, (n, d)."""
        own = self.hypothesis.own
        sizes = [j for j in range(own.start, own.stop) if j not in indices]
        grid = np.array(list(product(*axes, *([_SIZES] * len(sizes)))))
        points = np.zeros((len(grid), len(self.hypothesis.priors)))
        points[:, [*indices, *sizes]] = grid
        return points

    def _at(self, fixed: dict[int, float], about=None) -> tuple[float, np.ndarray]:
        """ln of the evidence at values of some parameters, the others linear about a point, by
        default their medians; and the most probable z there."""
        z = np.zeros(len(self.hypothesis.priors)) if about is None else about.copy()
        z[list(fixed)] = list(fixed.values())
        if about is None and self._scanned is not None and not self._slips:
            self._last = z.copy(), *self._scanned(self.hypothesis, self.forward, z, self._role)
        others = np.delete(np.arange(len(z)), list(fixed))
        residual, slope = self.residual(z)[: -len(z)], self.slope(z)[: -len(z), others]
        square, hessian = least_square(residual, slope, z[others])
        given = np.array(list(fixed.values()))
        z[others] -= np.linalg.solve(hessian, slope.T @ residual + z[others])
        return log_evidence(square + given @ given, hessian, self.lower), z

    def finish(self, z) -> Fit:
        predicted, jacobian = self.predict(z)
        residual, slope = self.residual(z), self.slope(z)
        n = len(self.lower)
        hessian = slope.T @ slope
        found = log_evidence(residual @ residual, hessian, self.lower)
        at_bound = tuple(
            f"{effect.name}: {prior.name}"
            for (effect, prior), near in zip(
                self.hypothesis.priors, self.hypothesis.at_limit(z), strict=True
            )
            if near
        )
        if not np.isfinite(found):
            label = self.hypothesis.label
            raise InputError(f"{label}: the evidence is not finite; check the data.")
        return Fit(
            self.hypothesis, z, np.linalg.inv(hessian), predicted, self.evidence.shape, jacobian,
            found, float(residual[:n] @ residual[:n]), n, at_bound, self.evidence.scales,
        )  # fmt: skip
