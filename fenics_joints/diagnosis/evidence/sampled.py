"""Evidence of a hypothesis from draws: no Gaussian posterior is taken for granted.

Drawn are the parameters of the effects (`fenics_joints.diagnosis.evidence.marginal`), by importance
sampling (`importance`), or by nested sampling (`nested`), which needs ten times as many likelihoods
and finds its way where importance sampling cannot. Over a single parameter the sum is taken on a
line.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp
from scipy.stats import norm

from fenics_joints.diagnosis.evidence import importance, nested
from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.fitted import Fit
from fenics_joints.diagnosis.evidence.importance import Draws
from fenics_joints.diagnosis.evidence.marginal import Marginal
from fenics_joints.reduction import Forward
from fenics_joints.reduction.lean import batched

__all__ = ["Sampled", "importance_evidence", "nested_evidence"]

#: Samples for the lean model, of the posterior's region and of the prior: for a few hundred
#: points, and for the ten thousands of nested sampling.
_FEW, _MANY = (16, 8), (32, 16)
#: Points of the posterior at which the lean model and interpolated derivatives are made good.
_CORRECTED = 24
#: Standard deviation of that correction, of ln Z, above which it is no small one.
_FAR = 0.2
#: Steps over a single parameter's prior, and over so many standard deviations of its posterior.
_STEPS, _NEAR, _NEAR_SD = 101, 61, 8.0


@dataclass(frozen=True, repr=False)
class Sampled:
    """The evidence of a hypothesis from draws.

    Attributes:
        log_evidence: ln of the marginal likelihood of the fitted entries, the priors of the
            effects' parameters renormalised on their limits (which the Laplace evidence does not).
        error: Its standard deviation from sampling, and from the correction by exact derivatives.
        calls: Number of points at which the likelihood was asked for.
        mean: Posterior mean of the effects' parameters, z, shape (d_e,).
        sd: Their posterior standard deviation, shape (d_e,).
        model_error: Largest error of ln f of the lean model against the reduced one at points of
            the posterior; 0 where no lean model was needed.
        way: ``importance`` or ``nested`` sampling, or on a ``line``.
        n_eff: Effective sample size; infinite on a line.
    """

    log_evidence: float
    error: float
    calls: int
    mean: np.ndarray
    sd: np.ndarray
    model_error: float
    way: str = "nested"
    n_eff: float = np.inf

    def __repr__(self) -> str:
        return (
            f"Sampled({self.way}: ln Z {self.log_evidence:.2f} +- {self.error:.2f}, "
            f"{self.calls} calls)"
        )


def importance_evidence(
    fit: Fit,
    forward: Forward,
    evidence: Evidence,
    baseline: dict[str, float],
    *,
    seed: int = 1,
) -> Sampled:
    """Evidence of a fitted hypothesis by importance sampling over its effects' parameters.

    Deterministic with the seed, and without communication, so that ranks may share out hypotheses.
    Where `Sampled.n_eff` is a few dozens only it has not found its way.

    Args:
        fit: The hypothesis at its most probable parameters.
        forward: Predicts frequencies.
        evidence: The test.
        baseline: Parameter values of the nominal model.
        seed: Of the random numbers.
    """

    def sample(problem: Marginal) -> Draws:
        ends = [z[problem.own] for z in (fit.z, *fit.ends)]
        return importance.draw(problem, ends, seed)

    return _sampled(fit, forward, evidence, baseline, sample, "importance", None, _FEW, seed)


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
) -> Sampled:
    """The same by nested sampling.

    Args:
        fit: The hypothesis at its most probable parameters.
        forward: Predicts frequencies.
        evidence: The test.
        baseline: Parameter values of the nominal model.
        n_live: Live points.
        n_effective: Effective sample size to end at; the error of ln Z is about its root's inverse.
        slopes: Derivatives by what is integrated out: ``"interpolated"`` between samples of the
            effects' parameters, or ``"fixed"`` at the most probable ones, or ``"exact"``. The
            evidence is corrected by the mean ratio of the exact likelihood to the one sampled, over
            points of the posterior.
        seed: Of the random numbers.

    Raises:
        ConvergenceError: If the sampler does not end.
    """

    def sample(problem: Marginal) -> Draws:
        return nested.draw(problem, n_live, n_effective, seed)

    return _sampled(fit, forward, evidence, baseline, sample, "nested", slopes, _MANY, seed)


def _sampled(
    fit, forward, evidence, baseline, sample: Callable[[Marginal], Draws], way: str,
    slopes: str | None, size: Sequence[int], seed: int,
) -> Sampled:  # fmt: skip
    """Sample with a lean model, which the whole one corrects; with that one if it has to much."""
    problem = Marginal(fit, evidence, baseline)
    if problem.n_effects == 0:
        return Sampled(fit.log_evidence, 0.0, 0, np.zeros(0), np.zeros(0), 0.0, way)
    if problem.n_effects == 1:
        sample, way = _on_a_line, "line"
    whole, design = batched(forward), problem.design(seed, *size)
    slopes = slopes or ("exact" if whole.batches else "interpolated")
    lean = problem.lean(forward, *design) if whole.batches else whole
    calls = 0
    for used, kind in ((lean, slopes), (whole, "exact")):
        problem.use(used, kind, design[0])
        draws = sample(problem)
        calls += problem.calls
        gain, spread, error = problem.correction(_resample(draws, _CORRECTED, seed), whole)
        if spread <= _FAR or not whole.batches:
            break
    mean = draws.weights @ draws.points
    sd = np.sqrt(draws.weights @ (draws.points - mean) ** 2)
    log_z, spread = draws.log_z + gain + fit.widening, np.hypot(draws.error, spread)
    return Sampled(float(log_z), float(spread), calls, mean, sd, error, way, draws.n_eff)


def _resample(draws: Draws, count: int, seed: int) -> np.ndarray:
    """Points drawn by their weights."""
    chance = np.random.default_rng(seed)
    return draws.points[chance.choice(len(draws.points), size=count, p=draws.weights)]


def _on_a_line(problem: Marginal) -> Draws:
    """The evidence over one parameter, by the trapezoidal rule, on steps over the whole prior and
    finer ones where Laplace sees the posterior."""
    (low, high), own = problem.limits[0], problem.own.start
    ends = [z[own] for z in (problem.fit.z, *problem.fit.ends)]
    sd = np.sqrt(problem.fit.covariance[own, own])
    steps = sd * np.linspace(-_NEAR_SD, _NEAR_SD, _NEAR)
    near = np.clip(np.add.outer(ends, steps).ravel(), low, high)
    z = np.unique(np.concatenate([np.linspace(low, high, _STEPS), near]))
    width = np.convolve(np.diff(z), [0.5, 0.5])
    log_l = problem.log_likelihood(z[:, None])
    cut = np.log(norm.cdf(high) - norm.cdf(low))
    log_w = log_l + norm.logpdf(z) + np.log(width) - cut
    log_z = float(logsumexp(log_w))
    return Draws(z[:, None], np.exp(log_w - log_z), log_z, np.inf, 0.0)
