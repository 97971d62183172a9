"""Evidence of a hypothesis by nested sampling: no Gaussian posterior is taken for granted.

Sampled are the parameters z_e of the effects. The others, z_n (nuisances, tightenings, amplitudes,
dampings at rest), are integrated out in closed form: about their most probable values z_n* the
prediction is linear in them,

    r(z_e, z_n) = r(z_e, z_n*) + J_n (z_n - z_n*),    z_n ~ N(0, I),

so that the residual at z_e is Gaussian with mean r(z_e, z_n*) - J_n z_n* and covariance
Sigma + J_n J_n^T. The sampler is nautilus (Lange, MNRAS 525, 2023): importance nested sampling
from regions that neural networks bound. Over a single parameter the sum is taken on a line.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from nautilus import Sampler
from scipy.interpolate import RBFInterpolator
from scipy.special import logsumexp
from scipy.stats import norm, qmc

from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.inference import Fit
from fenics_joints.diagnosis.evidence.linear import whiten
from fenics_joints.diagnosis.evidence.prediction import RowPrediction, joined, predict
from fenics_joints.diagnosis.evidence.weighed import weights
from fenics_joints.errors import ConvergenceError
from fenics_joints.reduction import Forward, LeanForward
from fenics_joints.reduction.lean import arrays_of, frequency_error, lean_forward, modes_at

__all__ = ["Nested", "nested_evidence"]

#: Posterior standard deviations, and prior ones, to which the lean model's samples reach.
_REACH, _PRIOR_REACH = 3.5, 3.0
#: Samples of the posterior's region and of the prior; rows of the test at each; points that check.
_NEAR, _WIDE, _ROWS, _CHECKS = 32, 16, 2, 8
#: Weight of a sample of the prior in the lean model's basis.
_WIDE_WEIGHT = 0.05
#: Error of the lean model relative to the measurement's noise above which it gets more samples.
_LIMIT = 0.1
#: Points of the posterior at which the interpolated derivatives are made good.
_CORRECTED = 24
#: For points at which the model lacks a mode that the test saw.
_IMPOSSIBLE = -1e30
_BATCH = 100
#: Steps over a single parameter's prior, and over so many standard deviations of its posterior.
_STEPS, _NEAR_SD = 201, 8.0
#: Few points and smooth posteriors: a small network bounds them as well and is taught faster.
_NETWORK = {"hidden_layer_sizes": (32, 16)}


@dataclass(frozen=True, repr=False)
class Nested:
    """The evidence of a hypothesis by nested sampling.

    Attributes:
        log_evidence: ln of the marginal likelihood of the fitted entries, the priors of the
            effects' parameters renormalised on their limits (which the Laplace evidence does not).
        error: Its standard deviation from sampling, and from the correction by exact derivatives.
        calls: Number of points at which the likelihood was asked for.
        mean: Posterior mean of the effects' parameters, z, shape (d_e,).
        sd: Their posterior standard deviation, shape (d_e,).
        model_error: Largest error of ln f of the lean model against the reduced one at points of
            the posterior; 0 where no lean model was needed.
    """

    log_evidence: float
    error: float
    calls: int
    mean: np.ndarray
    sd: np.ndarray
    model_error: float

    def __repr__(self) -> str:
        return f"Nested(ln Z {self.log_evidence:.2f} +- {self.error:.2f}, {self.calls} calls)"


def nested_evidence(
    fit: Fit,
    forward: Forward,
    evidence: Evidence,
    baseline: dict[str, float],
    *,
    n_live: int = 150,
    n_effective: int = 500,
    slopes: str = "interpolated",
    seed: int = 1,
) -> Nested:
    """Evidence of a fitted hypothesis by nested sampling over its effects' parameters.

    Deterministic with the seed, and without communication, so that ranks may share out hypotheses.

    Args:
        fit: The hypothesis at its most probable parameters.
        forward: Predicts frequencies.
        evidence: The test.
        baseline: Parameter values of the nominal model.
        n_live: Live points.
        n_effective: Effective sample size to end at; the error of ln Z is about its root's inverse.
        slopes: Derivatives by what is integrated out: ``"interpolated"`` between samples of the
            effects' parameters, or ``"fixed"`` at the most probable ones, or ``"exact"``. After the
            first two the evidence is corrected by the mean ratio of the exact likelihood to the
            one sampled, over points of the posterior.
        seed: Of the random numbers.

    Raises:
        ConvergenceError: If the sampler does not end.
    """
    problem = Marginal(fit, evidence, baseline)
    if problem.n_effects == 0:
        return Nested(fit.log_evidence, 0.0, 0, np.zeros(0), np.zeros(0), 0.0)
    # Sample; if the lean model is not good enough where the posterior is, improve it and again.
    model, limit = arrays_of(forward), problem.error_limit
    design = problem.design(seed)
    lean = forward if model is None else problem.lean(forward, model, *design, limit)
    calls = 0
    for last in (False, True):
        problem.use(lean, slopes, design[0])
        points, weights, log_z, n_eff = problem.sample(n_live, n_effective, seed)
        calls += problem.calls
        drawn = _resample(points, weights, _CHECKS, seed)
        error = 0.0
        if model is not None:
            checks = problem.spread(drawn)
            exact = np.array([problem.watched(forward)(values)[0] for values in checks])
            error = frequency_error(problem.watched(lean), checks, exact)
        if error <= limit or last:
            break
        wider = np.concatenate([design[0], drawn]), np.append(design[1], np.ones(len(drawn)))
        lean = problem.lean(forward, model, *wider, limit)
    gain, spread = problem.correction(_resample(points, weights, _CORRECTED, seed + 1))
    mean = weights @ points
    return Nested(
        float(log_z + gain + fit.widening),
        float(np.hypot(1 / np.sqrt(n_eff), spread)),
        calls,
        mean,
        np.sqrt(weights @ (points - mean) ** 2),
        error,
    )


def _resample(points, weights, count, seed) -> np.ndarray:
    """Points drawn by their weights."""
    return points[np.random.default_rng(seed).choice(len(points), size=count, p=weights)]


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
        covariance = evidence.at(fit.between).covariance(self.hypothesis.unknown)
        self.lower = np.linalg.cholesky(covariance)
        noise = evidence.log_sd[evidence.used]
        self.error_limit = _LIMIT * float(np.median(noise))
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

    def design(self, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """Samples, (n, d_e), of the posterior as Laplace sees it and of the prior; weights, (n,).

        Those of the posterior fill a box along its principal axes, cut off at the limits.
        """
        d = self.n_effects
        sizes, axes = np.linalg.eigh(self.fit.covariance[self.own, self.own])
        near = qmc.Sobol(d, seed=seed).random(_NEAR)
        steps = _REACH * (2 * near - 1) * np.sqrt(np.maximum(sizes, 0.0))
        near = np.vstack([np.zeros(d), steps @ axes.T]) + self.fit.z[self.own]
        wide = _PRIOR_REACH * (2 * qmc.Sobol(d, seed=seed + 1).random(_WIDE) - 1)
        points = np.clip(np.vstack([near, wide]), *self.limits.T)
        weights = np.append(np.ones(len(near)), np.full(len(wide), _WIDE_WEIGHT))
        return points, weights

    def spread(self, points: np.ndarray, rows: int = _ROWS) -> list[dict[str, float]]:
        """Parameter values at the points, each at a few of the test's rows, all in turn."""
        n = len(self.evidence.conditions)
        found = []
        for i, point in enumerate(points):
            for k in range(min(rows, n)):
                row = (i + k * n // rows) % n
                mode = i % len(self.hypothesis.modes) if self.hypothesis.amplitudes else None
                found.append(self._values(self.full(point), row, mode))
        return found

    def _values(self, z, row, mode) -> dict[str, float]:
        condition = self.evidence.conditions[row]
        return self.hypothesis.values(z, condition, self.baseline, row, mode or None)

    def lean(self, forward, model, points, weights, limit) -> LeanForward:
        """The lean model of the samples, as large as some of the posterior's ask for."""
        values = self.spread(points)
        each = len(values) // len(points)
        found = [modes_at(forward, v) for v in values]
        sizes = [
            np.full(shapes.shape[1], weights[i // each]) for i, shapes in enumerate(found)
        ]
        # Half-way to the most probable point, where no sample is.
        centre = self.fit.z[self.own]
        checks = self.spread(centre + 0.5 * (points[weights == 1.0][1 : _CHECKS + 1] - centre))
        lean, _ = lean_forward(
            forward, model, self._values(self.fit.z, 0, None), np.hstack(found),
            np.concatenate(sizes), checks, limit, beyond=self.watched(forward) is not forward,
        )  # fmt: skip
        return lean

    def watched(self, forward: Forward) -> Forward:
        """The one that has all modes that count: if the test missed one, the next one too."""
        h, n_test = self.hypothesis, forward.n_test
        if not h.senses:
            return forward
        order = h.sensing(self.fit.z, n_test, len(forward.sensors or ())).order
        return forward if np.max(order) < n_test else forward.further

    # -- the likelihood ------------------------------------------------------------------------

    def use(self, forward: Forward, slopes: str, samples: np.ndarray) -> None:
        """Take this model from now on, and this way to the derivatives."""
        self.forward, self.slopes, self.calls = forward, slopes, 0
        if slopes == "fixed":
            self.fixed = self._slopes_at(self.fit.z[self.own])
        elif slopes == "interpolated":
            at = np.unique(samples, axis=0)
            values = np.array([self._slopes_at(point).ravel() for point in at])
            self.box = at.min(axis=0), at.max(axis=0)
            self.surface = RBFInterpolator(at, values, kernel="cubic", degree=1)

    def _slopes_at(self, point: np.ndarray) -> np.ndarray:
        """Whitened derivatives by what is integrated out, (k, p)."""
        arguments = self.hypothesis, self.forward, self.evidence, self.full(point), self.baseline
        _, jacobian = predict(*arguments)
        return whiten(self.lower, jacobian[np.ix_(self.used, self.rest)])

    def _all_slopes(self, points: np.ndarray) -> np.ndarray:
        """`_slopes_at` of many points, (b, k, p)."""
        shape = len(points), len(self.lower), len(self.rest)
        if self.slopes == "fixed":
            return np.broadcast_to(self.fixed, shape)
        if self.slopes == "exact":
            return np.array([self._slopes_at(point) for point in points])
        # Beyond the samples there is nothing to go by but the nearest of their box.
        return self.surface(np.clip(points, *self.box)).reshape(shape)

    def _residuals(self, points: np.ndarray) -> np.ndarray:
        """Whitened residuals with the rest at its most probable values, (b, k)."""
        z = [self.full(point) for point in points]
        predicted = self.predictions(z)[:, self.used]
        return whiten(self.lower, (predicted - self.evidence.data[self.used]).T).T

    def predictions(self, z: list[np.ndarray]) -> np.ndarray:
        """Predictions at several z, (len(z), N); a lean model solves for all of them at once."""
        h, evidence = self.hypothesis, self.evidence
        modes = range(len(h.modes) if h.amplitudes else 1)
        rows = range(len(evidence.conditions))
        wanted = [self._values(each, row, i) for each in z for row in rows for i in modes]
        asked = dict.fromkeys((self.forward, self.watched(self.forward)))
        for forward in asked:
            found = forward.prepare(wanted, slopes=h.damped)
        more = evidence.shapes is not None or evidence.weighed
        if h.amplitudes or h.senses or h.damped or more:
            found = np.array([self._predicted(each) for each in z])
        for forward in asked:
            forward.release()
        return found.reshape(len(z), -1)

    def _predicted(self, z: np.ndarray) -> np.ndarray:
        """As `predict`, without derivatives; nan where the model lacks a mode."""
        rows, shapes, evidence = [], [], self.evidence
        for row, condition in enumerate(evidence.conditions):
            arguments = self.hypothesis, self.forward, z, condition, self.baseline, row
            prediction = RowPrediction(*arguments)
            if not np.all(np.isfinite(prediction.log_f)):
                return np.full(len(evidence.data), np.nan)
            rows.append(prediction.data)
            if evidence.shapes is not None and row == evidence.shape_row:
                shapes = [prediction.read_shapes(evidence.shapes).ravel()]
        first = evidence.conditions[0]
        masses, _ = weights(
            evidence.weighed, self.hypothesis, z, first, self.baseline, slopes=False
        )
        return joined(rows, [*shapes, masses], evidence.shape[1])

    def log_likelihood(self, points: np.ndarray) -> np.ndarray:
        """ln N(r - J_n z_n*; 0, Sigma + J_n J_n^T) at points, (b, d_e) -> (b,)."""
        self.calls += len(points)
        slope = self._all_slopes(points)
        residual = self._residuals(points) - slope @ self.fit.z[self.rest]
        good = np.all(np.isfinite(residual), axis=1)
        residual = np.where(good[:, None], residual, 0.0)
        # Woodbury: whitened, the covariance is I + W W^T.
        small = np.swapaxes(slope, 1, 2) @ slope + np.eye(len(self.rest))
        root = np.linalg.cholesky(small)
        along = np.linalg.solve(root, np.einsum("bkp,bk->bp", slope, residual)[:, :, None])
        square = np.sum(residual**2, axis=1) - np.sum(along[:, :, 0] ** 2, axis=1)
        log_det = np.sum(np.log(np.diagonal(root, axis1=1, axis2=2)), axis=1)
        log_det = log_det + np.sum(np.log(np.diag(self.lower)))
        constant = 0.5 * len(self.lower) * np.log(2 * np.pi)
        return np.where(good, -0.5 * square - log_det - constant, _IMPOSSIBLE)

    def correction(self, points: np.ndarray) -> tuple[float, float]:
        """What exact derivatives add to ln Z, from points of the posterior; standard deviation.

        Z_exact / Z = E[L_exact / L] under the posterior that was sampled.
        """
        if self.slopes == "exact" or len(self.rest) == 0:
            return 0.0, 0.0
        sampled, calls, kind = self.log_likelihood(points), self.calls, self.slopes
        self.slopes = "exact"
        ratio = np.exp(self.log_likelihood(points) - sampled)
        self.slopes, self.calls = kind, calls
        return float(np.log(np.mean(ratio))), float(
            np.std(ratio) / np.mean(ratio) / np.sqrt(len(points))
        )

    # -- sampling ------------------------------------------------------------------------------

    def sample(self, n_live: int, n_effective: int, seed: int):
        """Points, (n, d_e), their weights, (n,), ln Z and the effective sample size."""
        if self.n_effects == 1:
            return self._on_a_line()
        sampler = Sampler(
            self.from_unit, self.log_likelihood, n_dim=self.n_effects, n_live=n_live,
            n_batch=_BATCH, n_networks=1, neural_network_kwargs=_NETWORK, vectorized=True,
            pass_dict=False, seed=seed,
        )  # fmt: skip
        if not sampler.run(n_eff=n_effective, n_like_max=200 * n_live * (1 + self.n_effects)):
            label = self.hypothesis.label
            raise ConvergenceError(
                f"{label}: nested sampling did not end", f"{self.calls} likelihoods"
            )
        points, log_weights, _ = sampler.posterior()
        weights = np.exp(log_weights - log_weights.max())
        return points, weights / weights.sum(), sampler.log_z, sampler.n_eff

    def _on_a_line(self):
        """The same over one parameter, for which the sampler is not made: by the trapezoidal rule,
        on steps over the whole prior and finer ones where Laplace sees the posterior."""
        (low, high), own = self.limits[0], self.own.start
        sd = np.sqrt(self.fit.covariance[own, own])
        near = np.clip(self.fit.z[own] + sd * np.linspace(-_NEAR_SD, _NEAR_SD, _STEPS), low, high)
        z = np.unique(np.concatenate([np.linspace(low, high, _STEPS), near]))
        width = np.convolve(np.diff(z), [0.5, 0.5])
        batches = np.array_split(z[:, None], len(z) // _BATCH + 1)
        log_l = np.concatenate([self.log_likelihood(batch) for batch in batches])
        cut = np.log(norm.cdf(high) - norm.cdf(low))
        log_w = log_l + norm.logpdf(z) + np.log(width) - cut
        log_z = float(logsumexp(log_w))
        return z[:, None], np.exp(log_w - log_z), log_z, np.inf
