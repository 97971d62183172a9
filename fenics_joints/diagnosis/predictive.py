"""What hypotheses predict of data that were held out, with its spread, and how well they did."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from fenics_joints.diagnosis.evidence.entries import DAMPING, FREQUENCY
from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.fitted import Fit

__all__ = ["gain", "held", "predictive"]


def predictive(
    refit: Fit, blind: Evidence, scored: np.ndarray, *, mended: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """Mean and a square root of the covariance of the scored entries given the fitted ones.

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
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    return mean, vectors * np.sqrt(np.maximum(values, 0.0))


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
        mean, root = predictive(refits[i], blind, scored, mended=False)
        logs[i] = multivariate_normal.logpdf(
            data[scored], mean, root @ root.T, allow_singular=True
        )
    sides = []
    for side in (known & holds, known & ~holds):
        weight = score[side] - logsumexp(score[side])
        sides.append(float(logsumexp(weight + logs[side])))
    return sides[0] - sides[1]
