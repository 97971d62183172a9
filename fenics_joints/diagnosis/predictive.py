"""What hypotheses predict of data that were held out, with its spread, and how well they did."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from fenics_joints.diagnosis.evidence.entries import DAMPING, FREQUENCY
from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.fitted import Fit

#: Modes that what is stated of a model's error is worth. [decision: chosen]
_KNOWN = 1.0
#: Times what is stated that a model's error may be at most. [decision: chosen]
_MOST = 2.0


def predictive(
    refit: Fit, blind: Evidence, scored: np.ndarray, *, mended: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of the scored entries given the fitted ones.

    With r = data - prediction of the fitted entries, G = S_sf S_ff^-1 and S the covariance of
    noise and discrepancy, the scored entries are prediction_s + G r + (J_s - G J_f) dz + e,
    dz ~ N(0, C) the posterior and e ~ N(0, S_ss - G S_fs): Gaussian regression about the model.

    Args:
        refit: A hypothesis fitted without the held-out data.
        blind: The test without them.
        scored: Which entries, shape (N,).
        mended: Whether the prediction is mended by what it leaves on the fitted entries; if not,
            G = 0, and a hypothesis that is off by much at all levels is off at those held out.
    """
    fitted = blind.fitted
    # What is stated of a model's error has to hold where it is not looked at, however little of it
    # the fitted data call for.
    test = blind.at(refit.scales) if blind.drifts else blind
    total = test.full_covariance(refit.hypothesis.unknown)
    cross = total[np.ix_(scored, fitted)] * float(mended)
    gained = np.linalg.solve(total[np.ix_(fitted, fitted)], cross.T).T
    mean = refit.predicted[scored] + gained @ (blind.data[fitted] - refit.predicted[fitted])
    slope = refit.jacobian[scored] - gained @ refit.jacobian[fitted]
    covariance = total[np.ix_(scored, scored)] - gained @ cross.T
    covariance = covariance + slope @ refit.covariance @ slope.T
    return mean, 0.5 * (covariance + covariance.T)


def draws(
    refit: Fit, blind: Evidence, scored: np.ndarray, count: int, rng: np.random.Generator
) -> np.ndarray:
    """Values of the scored entries that a hypothesis has them take, (count, k).

    Those of `predictive`, but with as much of what is stated of the model's error and of its
    parameters as the fitted frequencies have of it, which is more or less (`share_of_stated`).

    Args:
        refit: See `predictive`.
        blind: Likewise.
        scored: Likewise.
        count: Number of draws.
        rng: Random numbers.
    """
    mean, covariance = predictive(refit, blind, scored)
    sd = np.nan_to_num(blind.noise_sd()[scored])
    values, vectors = np.linalg.eigh(covariance - np.diag(sd**2))
    rest = vectors * np.sqrt(np.maximum(values, 0.0))
    normal = rng.standard_normal((2, count, len(mean)))
    error, e = normal[0] @ rest.T, blind.entries
    _, at = np.unique(e.mode[scored], return_inverse=True)
    common = (at[:, None] == at) / np.bincount(at)[at]
    # Of a mode that was fitted at other conditions all is between these.
    common[np.isin(e.mode[scored], e.mode[blind.fitted & (e.kind == FREQUENCY)])] = 0.0
    shared = error @ common.T
    for part, between in ((shared, False), (error - shared, True)):
        square, known = share_of_stated(refit, blind, between)
        share = square * known / rng.chisquare(known, (count, 1)) if np.isfinite(known) else 1.0
        mean = mean + np.minimum(np.sqrt(share), _MOST) * part
    return mean + normal[1] * sd


def share_of_stated(refit: Fit, blind: Evidence, between: bool = False) -> tuple[float, float]:
    """Mean square of the fitted frequencies' distance from what a hypothesis predicts, 1 where all
    that is stated of it is there, and how many degrees of freedom know it.

    One number for all modes has an inverse chi-square prior about 1. It is of the modes' means over
    the conditions, or of what is between these. An unknown cause may do anything, and what changes
    between levels has scales of its own: these have all that is stated.

    Args:
        refit: The hypothesis fitted to a part of the test.
        blind: That part.
        between: Which of the two.
    """
    e = blind.entries
    used = np.flatnonzero(blind.fitted & (e.kind == FREQUENCY))
    if refit.hypothesis.unknown or blind.drifts:
        return 1.0, np.inf
    take = _over_conditions(e.mode[used], between)
    own = refit.hypothesis.own
    others = np.delete(np.arange(len(refit.z)), own)
    slope = refit.jacobian[np.ix_(used, others)]
    residual = take @ (blind.data[used] - refit.predicted[used] + slope @ refit.z[others])
    total = blind.full_covariance()[np.ix_(used, used)] + slope @ slope.T
    square = residual @ np.linalg.solve(take @ total @ take.T, residual)
    # Each of the effects' parameters may have taken one off.
    known = _KNOWN + max(len(take) - (own.stop - own.start), 0)
    return float((_KNOWN + square) / known), float(known)


def _over_conditions(modes: np.ndarray, between: bool) -> np.ndarray:
    """What makes of entries, of a mode each, (n,), the means of every mode, (m, n); or what all but
    the first of a mode have beyond that, (n - m, n)."""
    _, first, at = np.unique(modes, return_index=True, return_inverse=True)
    mean = (at == np.arange(len(first))[:, None]) / np.bincount(at)[:, None]
    return np.delete(np.eye(len(at)) - mean[at], first, axis=0) if between else mean


def held(evidence: Evidence, mask: np.ndarray) -> np.ndarray:
    """The held-out frequencies and damping ratios that were measured, as a mask of shape (N,)."""
    e = evidence.entries
    there = (mask & evidence.used)[e.row, e.mode] & np.isfinite(evidence.data)
    return there & np.isin(e.kind, (FREQUENCY, DAMPING))


def gain(
    refits: Sequence[Fit],
    score: np.ndarray,
    holds: np.ndarray,
    blind: Evidence,
    data: np.ndarray,
    scored: np.ndarray,
) -> float:
    """ln of how much more probable held-out data are with a cause than without it.

    Both sides are mixtures of hypotheses, weighed without the data: those that hold the cause and
    those that do not, an unknown cause among neither. Each speaks for itself: what it leaves on the
    fitted data is not taken off. nan if one side has none.

    Args:
        refits: Hypotheses fitted without the held-out data.
        score: ln of their evidence and prior odds, (len(refits),).
        holds: Which of them hold the cause.
        blind: The test without the held-out values.
        data: All of the test, shape (N,).
        scored: The held-out entries, shape (N,).
    """
    known = np.array([not f.hypothesis.unknown for f in refits])
    if not (known & holds).any() or not (known & ~holds).any():
        return float("nan")
    logs = np.full(len(refits), -np.inf)
    for i in np.flatnonzero(known):
        mean, covariance = predictive(refits[i], blind, scored, mended=False)
        logs[i] = multivariate_normal.logpdf(data[scored], mean, covariance, allow_singular=True)
    sides = []
    for side in (known & holds, known & ~holds):
        weight = score[side] - logsumexp(score[side])
        sides.append(float(logsumexp(weight + logs[side])))
    return sides[0] - sides[1]
