"""The likelihood of the effects' parameters alone, all others integrated out.

Sampled are the parameters z_e of the effects. The others, z_n (nuisances, tightenings, amplitudes,
dampings at rest), are integrated out in closed form: about their most probable values z_n* the
prediction is linear in them,

    r(z_e, z_n) = r(z_e, z_n*) + J_n (z_n - z_n*),    z_n ~ N(0, I),

so that the residual at z_e is Gaussian with mean r(z_e, z_n*) - J_n z_n* and covariance
Sigma + J_n J_n^T.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import RBFInterpolator
from scipy.stats import norm, qmc

from fenics_joints.diagnosis.evidence.entries import FREQUENCY
from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.fitted import Fit
from fenics_joints.diagnosis.evidence.leans import of_few_terms
from fenics_joints.diagnosis.evidence.linear import whiten
from fenics_joints.diagnosis.evidence.many import ManyPredictions
from fenics_joints.diagnosis.evidence.prediction import in_turn, joined, predict
from fenics_joints.diagnosis.evidence.scalars import scalars
from fenics_joints.reduction import Forward, LeanForward
from fenics_joints.reduction.forward import SPARE
from fenics_joints.reduction.leanest import lean_forward
from fenics_joints.reduction.seen_at import seen_modes_at

__all__ = ["CHECKS", "Marginal"]

#: Posterior standard deviations, and prior ones, to which the lean model's samples reach.
_REACH, _PRIOR_REACH = 3.5, 3.0
#: Rows of the test at each sample; points that check, and by which the evidence is corrected at a
#: time.
_ROWS, CHECKS = 2, 8
#: Weight of a sample of the prior in the lean model's basis, and of modes that are not the test's.
_WIDE_WEIGHT, _OTHERS = 0.05, 0.1
#: Error of the lean model's ln f, relative to its standard deviation, that is small enough: the
#: whole model has the last word.
_LIMIT = 0.1
#: Standard deviation of the correction of ln Z at which no further point is looked at.
_SURE = 0.02
#: Points looked at together.
_TOGETHER = 128
#: For points at which the model lacks a mode that the test saw.
_IMPOSSIBLE = -1e30


class Marginal:
    """The likelihood of the effects' parameters, all others integrated out.

    Args:
        fit: The hypothesis at its most probable parameters.
        evidence: The test.
        baseline: Parameter values of the nominal model.
    """

    def __init__(self, fit: Fit, evidence: Evidence, baseline):
        self.fit, self.evidence, self.baseline = fit, evidence, baseline
        self.hypothesis = fit.hypothesis
        self.own = self.hypothesis.own
        self.rest = np.delete(np.arange(len(fit.z)), self.own)
        self.limits = self.hypothesis.limits[self.own]
        self.n_effects = len(self.limits)
        self.used = evidence.fitted
        self.lower = evidence.at(fit.scales).lower(self.hypothesis.unknown)
        is_f = evidence.entries.kind[self.used] == FREQUENCY
        self.error_limit = _LIMIT * float(np.median(np.linalg.norm(self.lower[is_f], axis=1)))
        self.calls = 0

    # -- the prior -----------------------------------------------------------------------------

    def from_unit(self, unit: np.ndarray) -> np.ndarray:
        """Points of the prior, normal and cut off at its limits, from the unit cube."""
        low, high = norm.cdf(self.limits.T)
        z = norm.ppf(low + unit * (high - low))
        return np.clip(z, *self.limits.T)

    def full(self, point: np.ndarray) -> np.ndarray:
        """All of z, the others at their most probable values."""
        z = self.fit.z.copy()
        z[self.own] = point
        return z

    # -- the lean model ------------------------------------------------------------------------

    def design(self, seed: int, near: int, wide: int) -> tuple[np.ndarray, np.ndarray]:
        """Samples, (n, d_e), of the posterior as Laplace sees it and of the prior; weights, (n,).

        Those of the posterior fill a box along its principal axes, cut off at the limits.

        Args:
            seed: Of the random numbers.
            near: Samples of the posterior's region.
            wide: Of the prior.
        """
        d = self.n_effects
        sizes, axes = np.linalg.eigh(self.fit.covariance[self.own, self.own])
        unit = qmc.Sobol(d, seed=seed).random(near)
        steps = _REACH * (2 * unit - 1) * np.sqrt(np.maximum(sizes, 0.0))
        inner = np.vstack([np.zeros(d), steps @ axes.T]) + self.fit.z[self.own]
        outer = _PRIOR_REACH * (2 * qmc.Sobol(d, seed=seed + 1).random(wide) - 1)
        points = np.clip(np.vstack([inner, outer]), *self.limits.T)
        return points, np.append(np.ones(len(inner)), np.full(len(outer), _WIDE_WEIGHT))

    def spread(self, points: np.ndarray, rows: int = _ROWS) -> list[dict[str, float]]:
        """Parameter values at the points, each at a few of the test's rows, all in turn."""
        n = len(self.evidence.conditions)
        found = []
        for i, point in enumerate(points):
            for k in range(min(rows, n)):
                row = (i + k * n // rows) % n
                looks = self.hypothesis.looks
                found.append(self._values(self.full(point), row, looks[i % len(looks)]))
        return found

    def _values(self, z, row, mode) -> dict[str, float]:
        condition = self.evidence.conditions[row]
        return self.hypothesis.values(z, condition, self.baseline, row, mode)

    def lean(self, forward, points, weights) -> LeanForward:
        """The lean model of the samples, as large as some of the posterior's ask for."""
        values = self.spread(points)
        each = len(values) // len(points)
        watched = self.watched(forward)
        found = seen_modes_at(watched, values)
        # As many modes as hold the test's anywhere, and some more; but less of those.
        near = [at.index for i, at in enumerate(found) if weights[i // each] == 1.0]
        count = max(int(index.max(initial=-1)) for index in near) + 1 + SPARE
        if watched is forward and count > SPARE:
            forward = self._by_own_shapes(forward, min(count, forward.n_modes))
        sizes = []
        for i, at in enumerate(found):
            weight = np.where(np.isin(np.arange(at.shapes.shape[1]), at.index), 1.0, _OTHERS)
            sizes.append(weights[i // each] * weight[:count])
        found = [at.shapes[:, :count] for at in found]
        # Half-way to the most probable point, where no sample is.
        centre = self.fit.z[self.own]
        checks = self.spread(centre + 0.5 * (points[weights == 1.0][1 : CHECKS + 1] - centre))
        model = of_few_terms(self.hypothesis, forward.model, self.evidence, self.baseline)
        most_probable = self._values(self.fit.z, 0, None)
        lean, _ = lean_forward(
            forward, model, {name: most_probable[name] for name in model.parameters},
            np.hstack(found), np.concatenate(sizes), checks, self.error_limit,
            beyond=self.watched(forward) is not forward,
        )  # fmt: skip
        return lean

    def _by_own_shapes(self, forward: Forward, count: int) -> Forward:
        """The forward among so many modes, matched to its own shapes at the most probable values:
        a test's mode that no mode of the model is like goes to any, and that hangs on all others
        up to the highest; near the most probable values it is the same one."""
        found = forward.of(forward.model, count)
        if forward.sensors is None or forward.reference is None:
            return found
        modes, pairing = forward.solve(self._values(self.fit.z, self.evidence.shape_row, None))
        found.reference = modes.at(forward.sensors)[:, pairing.index]
        return found

    def watched(self, forward: Forward) -> Forward:
        """The one that has all modes that count: if the test missed one, the next one too."""
        h, n_test = self.hypothesis, forward.n_test
        if not h.senses:
            return forward
        order = h.sensing(self.fit.z, n_test, len(forward.sensors or ())).order
        return forward if np.max(order) < n_test else forward.further

    # -- the likelihood ------------------------------------------------------------------------

    def use(self, forward: Forward, slopes: str, samples: np.ndarray) -> None:
        """Take this model from now on, and this way to the derivatives: see `sampled.py`."""
        self.forward, self.slopes, self.calls = forward, slopes, 0
        self.many = None
        if forward.batches:
            self.many = ManyPredictions(self.hypothesis, forward, self.evidence, self.baseline)
        if slopes == "fixed":
            self.fixed = self._exact_slopes(self.fit.z[None, self.own])[0]
        elif slopes == "interpolated":
            at = np.unique(samples, axis=0)
            values = self._exact_slopes(at).reshape(len(at), -1)
            self.box = at.min(axis=0), at.max(axis=0)
            self.surface = RBFInterpolator(at, values, kernel="cubic", degree=1)

    def _exact_slopes(self, points: np.ndarray) -> np.ndarray:
        """Whitened derivatives by what is integrated out, (b, k, p)."""
        if self.many is not None:
            return self._looked(points)[1]
        return np.array([self._slopes_at(point) for point in points])

    def _slopes_at(self, point: np.ndarray) -> np.ndarray:
        arguments = self.hypothesis, self.forward, self.evidence, self.full(point), self.baseline
        _, jacobian = predict(*arguments)
        return whiten(self.lower, jacobian[np.ix_(self.used, self.rest)])

    def _looked(self, points: np.ndarray, slopes: bool = True) -> tuple[np.ndarray, np.ndarray]:
        """Whitened residuals, (b, k), and derivatives by what is integrated out, (b, k, p)."""
        z = np.array([self.full(point) for point in points])
        predicted, by_rest = self.many(z, self.rest if slopes else ())
        residual = whiten(self.lower, (predicted[:, self.used] - self.evidence.data[self.used]).T)
        b, _, p = by_rest.shape
        columns = by_rest[:, self.used].transpose(1, 0, 2).reshape(len(self.lower), b * p)
        white = whiten(self.lower, columns).reshape(len(self.lower), b, p)
        return residual.T, white.transpose(1, 0, 2)

    def _all_slopes(self, points: np.ndarray) -> np.ndarray:
        """`_exact_slopes` of many points, (b, k, p)."""
        shape = len(points), len(self.lower), len(self.rest)
        if self.slopes == "fixed":
            return np.broadcast_to(self.fixed, shape)
        if self.slopes == "exact":
            return self._exact_slopes(points)
        # Beyond the samples there is nothing to go by but the nearest of their box.
        return self.surface(np.clip(points, *self.box)).reshape(shape)

    def _residuals_and_slopes(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """At the rest's most probable values, (b, k) and (b, k, p)."""
        if self.many is None:
            z = [self.full(point) for point in points]
            predicted = self.predictions(z)[:, self.used]
            residual = whiten(self.lower, (predicted - self.evidence.data[self.used]).T).T
            return residual, self._all_slopes(points)
        if self.slopes == "exact":
            return self._looked(points)
        return self._looked(points, slopes=False)[0], self._all_slopes(points)

    def predictions(self, z: list[np.ndarray]) -> np.ndarray:
        """Predictions at several z, (len(z), N); a lean model solves for all of them at once."""
        h, evidence = self.hypothesis, self.evidence
        rows = range(len(evidence.conditions))
        wanted = [self._values(each, row, i) for each in z for row in rows for i in h.looks]
        asked = dict.fromkeys((self.forward, self.watched(self.forward)))
        for forward in asked:
            found = forward.prepare(wanted, slopes=h.damped)
        more = evidence.shapes is not None or evidence.scalars
        if h.amplitudes or h.senses or h.damped or more:
            found = np.array([self._predicted(each) for each in z])
        for forward in asked:
            forward.release()
        return found.reshape(len(z), -1)

    def _predicted(self, z: np.ndarray) -> np.ndarray:
        """As `predict`, without derivatives; nan where the model lacks a mode."""
        rows, shapes, evidence = {}, [], self.evidence
        for row, prediction in in_turn(
            self.hypothesis, self.forward, evidence, z, self.baseline
        ):
            if not np.all(np.isfinite(prediction.log_f)):
                return np.full(len(evidence.data), np.nan)
            rows[row] = prediction.data
            if evidence.shapes is not None and row == evidence.shape_row:
                shapes = [prediction.read_shapes(evidence.shapes).ravel()]
        single, _ = scalars(
            evidence.scalars, self.hypothesis, z, evidence.conditions, self.baseline, slopes=False
        )
        return joined(rows, [*shapes, single], evidence.shape[1])

    def log_likelihood(self, points: np.ndarray) -> np.ndarray:
        """ln N(r - J_n z_n*; 0, Sigma + J_n J_n^T) at points, (b, d_e) -> (b,)."""
        self.calls += len(points)
        batches = np.array_split(points, -(-len(points) // _TOGETHER))
        return np.concatenate([self._looked_at(batch)[0] for batch in batches])

    def _looked_at(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """ln of the likelihood, (b,), and the whitened residuals that it is of, (b, k)."""
        found, slope = self._residuals_and_slopes(points)
        residual = found - slope @ self.fit.z[self.rest]
        good = np.all(np.isfinite(residual), axis=1)
        residual = np.where(good[:, None], residual, 0.0)
        slope = np.where(good[:, None, None], slope, 0.0)
        # Woodbury: whitened, the covariance is I + W W^T.
        small = np.swapaxes(slope, 1, 2) @ slope + np.eye(len(self.rest))
        root = np.linalg.cholesky(small)
        along = np.linalg.solve(root, np.einsum("bkp,bk->bp", slope, residual)[:, :, None])
        square = np.sum(residual**2, axis=1) - np.sum(along[:, :, 0] ** 2, axis=1)
        log_det = np.sum(np.log(np.diagonal(root, axis1=1, axis2=2)), axis=1)
        log_det = log_det + np.sum(np.log(np.diag(self.lower)))
        constant = 0.5 * len(self.lower) * np.log(2 * np.pi)
        return np.where(good, -0.5 * square - log_det - constant, _IMPOSSIBLE), found

    def correction(self, points: np.ndarray, whole: Forward) -> tuple[float, float, float]:
        """What the whole model and exact derivatives add to ln Z, its standard deviation, and the
        largest error of ln f; from points of the posterior, no more than it takes to be sure.

        Z_exact / Z = E[L_exact / L] under the posterior that was sampled.

        Args:
            points: The points, (b, d_e), in no order.
            whole: The forward that the one in use stands for.
        """
        if whole is self.forward and (self.slopes == "exact" or len(self.rest) == 0):
            return 0.0, 0.0, 0.0
        used = self.forward, self.slopes, self.many, self.calls
        sampled, residuals = self._looked_at(points)
        if whole is not self.forward:
            self.use(whole, "exact", points)
        self.slopes, ratio, error = "exact", np.zeros(0), 0.0
        is_f = self.evidence.entries.kind[self.used] == FREQUENCY
        while len(ratio) < len(points):
            some = slice(len(ratio), len(ratio) + CHECKS)
            exact, found = self._looked_at(points[some])
            ratio = np.append(ratio, np.exp(exact - sampled[some]))
            off = np.abs((self.lower @ (found - residuals[some]).T)[is_f])
            error = max(error, float(np.max(off, initial=0.0)))
            spread = np.std(ratio) / np.mean(ratio) / np.sqrt(len(ratio))
            if spread < _SURE:
                break
        self.forward, self.slopes, self.many, self.calls = used
        return float(np.log(np.mean(ratio))), float(spread), error
