"""Importance sampling from a mixture that learns: few likelihoods where the posterior is no maze.

Points are drawn in rounds: from Student's t distributions about the ends of the fits, as wide as
Laplace has it, and from the prior; then from a mixture like the weighted points so far, and from
the prior. All points are weighed by the mixture of all rounds (adaptive multiple importance
sampling; Cornuet et al., Scand. J. Stat. 39, 2012), so that an early proposal that missed something
does no harm once another has it. What says whether it worked is the effective sample size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln, logsumexp
from scipy.stats import chi2, norm, qmc

from fenics_joints.diagnosis.evidence.marginal import Marginal

__all__ = ["Draws", "draw"]

#: Points of each round, two at least, and effective sample size at which there are no more.
_ROUNDS, _ENOUGH = (256, 128, 128, 256, 256, 512), 200.0
#: Degrees of freedom of Student's t; how much wider than Laplace's posterior the first are.
_FREEDOM, _WIDER = 5.0, 1.2
#: Share of the first round, and of each other, that is drawn from the prior: it may find what no
#: fit was started near, and bounds the weights.
_AT_FIRST, _PRIOR = 0.5, 0.1
#: Distributions of a further round at most, steps to find them, and points' worth that each is
#: taken to be known beforehand; powers of the weights.
_MOST, _STEPS, _FEW = 6, 12, 1.0
_LEVELS = (1.0, 0.7, 0.5, 0.35, 0.25, 0.15, 0.1, 0.05)


@dataclass(frozen=True)
class Draws:
    """Weighted points of a posterior.

    Attributes:
        points: Of the effects' parameters, (n, d_e).
        weights: Of each, their sum 1, (n,).
        log_z: ln of the evidence.
        n_eff: Effective sample size.
        error: Standard deviation of ``log_z``.
    """

    points: np.ndarray
    weights: np.ndarray
    log_z: float
    n_eff: float
    error: float


@dataclass(frozen=True)
class _Proposal:
    """A mixture of Student's t distributions, and some of the prior.

    Attributes:
        centres: Of the distributions, (k, d).
        lowers: Cholesky factors of their scales, (k, d, d).
        shares: Of each, their sum 1, (k,).
        limits: Of the prior, (d, 2).
        prior: Share of the prior.
    """

    centres: np.ndarray
    lowers: np.ndarray
    shares: np.ndarray
    limits: np.ndarray
    prior: float = _PRIOR

    def draw(self, count: int, seed: int) -> np.ndarray:
        """Points, (count, d); some may be beyond the limits."""
        d = self.centres.shape[1]
        unit = np.clip(qmc.Sobol(d + 2, seed=seed).random(count), 1e-12, 1 - 1e-12)
        low, high = norm.cdf(self.limits.T)
        prior = norm.ppf(low + unit[:, :d] * (high - low))
        # Which it is of, by a dimension of its own: that of its number goes with the others.
        share = (unit[:, d + 1] - self.prior) / (1 - self.prior)
        which = np.searchsorted(np.cumsum(self.shares)[:-1], share)
        normal = (self.lowers[which] @ norm.ppf(unit[:, :d])[:, :, None])[:, :, 0]
        stretch = np.sqrt(_FREEDOM / chi2.ppf(unit[:, d, None], _FREEDOM))
        return np.where(share[:, None] < 0, prior, self.centres[which] + normal * stretch)

    def log_density(self, points: np.ndarray, log_prior: np.ndarray) -> np.ndarray:
        """ln of the density, (n,)."""
        d = self.centres.shape[1]
        square, log_det = _squares(points, self.centres, self.lowers)
        constant = gammaln((_FREEDOM + d) / 2) - gammaln(_FREEDOM / 2)
        constant -= 0.5 * d * np.log(_FREEDOM * np.pi)
        t = constant - log_det[:, None] - 0.5 * (_FREEDOM + d) * np.log1p(square / _FREEDOM)
        kernels = logsumexp(t, axis=0, b=self.shares[:, None])
        return np.logaddexp(np.log(1 - self.prior) + kernels, np.log(self.prior) + log_prior)


def _squares(points, centres, lowers) -> tuple[np.ndarray, np.ndarray]:
    """Squared distances of points from centres in their scales, (k, n); half ln of the scales'
    determinants, (k,)."""
    away = np.linalg.solve(lowers, np.swapaxes(points[None] - centres[:, None], 1, 2))
    log_det = np.sum(np.log(np.diagonal(lowers, axis1=1, axis2=2)), axis=1)
    return np.sum(away**2, axis=1), log_det


def draw(problem: Marginal, ends: Sequence[np.ndarray], seed: int) -> Draws:
    """Points of the posterior and the evidence.

    Args:
        problem: The likelihood and the prior.
        ends: Where fits ended, (d_e,) each.
        seed: Of the random numbers.
    """
    limits, own = problem.limits, problem.own
    lower = _WIDER * _root(problem.fit.covariance[own, own])
    k = len(ends)
    proposals = [
        _Proposal(np.array(ends), np.array([lower] * k), np.full(k, 1 / k), limits, _AT_FIRST)
    ]
    points, log_l, counts = np.zeros((0, len(limits))), np.zeros(0), []
    for i, count in enumerate(_ROUNDS):
        new = proposals[-1].draw(count, seed + i)
        new = new[np.all((new >= limits[:, 0]) & (new <= limits[:, 1]), axis=1)]
        counts.append(count)  # what lies beyond the limits counts, with a weight of nought
        points = np.vstack([points, new])
        log_l = np.append(log_l, problem.log_likelihood(new) if len(new) else [])
        log_prior = _log_prior(points, limits)
        shares = np.log(np.array(counts) / sum(counts))
        mixed = [p.log_density(points, log_prior) for p in proposals]
        log_w = log_l + log_prior - logsumexp(np.array(mixed) + shares[:, None], axis=0)
        n_eff = float(np.exp(2 * logsumexp(log_w) - logsumexp(2 * log_w)))
        if i and n_eff >= _ENOUGH:
            break
        proposals.append(_learnt(points, log_w, limits, seed + i))
    log_z = float(logsumexp(log_w) - np.log(sum(counts)))
    error = np.sqrt(max(1 / n_eff - 1 / sum(counts), 0.0))
    return Draws(points, np.exp(log_w - logsumexp(log_w)), log_z, n_eff, float(error))


def _log_prior(points, limits) -> np.ndarray:
    """ln of the normal prior, cut off at its limits, (n,)."""
    low, high = norm.cdf(limits.T)
    return np.sum(norm.logpdf(points) - np.log(high - low), axis=1)


def _learnt(points, log_w, limits, seed: int) -> _Proposal:
    """A mixture like the weighted points, by expectation and maximisation; while few of them have
    most of the weight the weights are levelled, or a lucky one would be all that is looked at."""
    d = points.shape[1]
    for power in _LEVELS:
        w = np.exp(power * (log_w - log_w.max()))
        w /= w.sum()
        n_eff = 1 / np.sum(w**2)
        if n_eff >= 4 * (d + 1):
            break
    k = int(np.clip(n_eff / (2 * (d + 1)), 1, _MOST))
    # Systematic draws: one in each of equal shares of the weight.
    place = (np.arange(k) + np.random.default_rng(seed).random()) / k
    centres = points[np.minimum(np.searchsorted(np.cumsum(w), place), len(points) - 1)]
    mean = w @ points
    whole = (w[:, None] * (points - mean)).T @ (points - mean)
    shares, lowers = np.full(k, 1 / k), np.array([_root(whole / k ** (2 / d))] * k)
    for _ in range(_STEPS):
        square, log_det = _squares(points, centres, lowers)
        log_of = np.log(shares)[:, None] - log_det[:, None] - 0.5 * square
        of = w * np.exp(log_of - logsumexp(log_of, axis=0))
        shares = of.sum(axis=1) + 1e-3 / k
        centres = (of @ points + 1e-3 / k * centres) / shares[:, None]
        away = points[None] - centres[:, None]
        spread = np.einsum("kn,kni,knj->kij", of, away, away, optimize=True)
        # What little is known of one's width is filled up by that of all.
        few = _FEW / n_eff
        spread = (spread + few * whole / k ** (2 / d)) / (shares + few)[:, None, None]
        lowers, shares = np.array([_root(each) for each in spread]), shares / shares.sum()
    return _Proposal(centres, lowers, shares, limits)


def _root(covariance: np.ndarray) -> np.ndarray:
    """Cholesky factor, of what may be next to singular."""
    d = len(covariance)
    return np.linalg.cholesky(covariance + (1e-10 + 1e-8 * np.trace(covariance) / d) * np.eye(d))
