"""What one could know who knew the generator: the ceiling for any diagnosis, and D of a case.

The generator's own likelihood: its own predictions of every effect at every size that it draws,
Gaussian noise, and its nuisance errors and discrepancy taken as linear. It has no model error.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import logsumexp

__all__ = ["Whitened", "posterior", "separability"]


class Whitened:
    """Predictions in standard deviations of all that varies besides the effects.

    Args:
        noise: Covariance of noise and discrepancy, (n, n).
        nuisance: Change of the data per standard deviation of each nuisance, (n, p).
    """

    def __init__(self, noise: np.ndarray, nuisance: np.ndarray):
        self._lower = np.linalg.cholesky(noise + nuisance @ nuisance.T)

    def __call__(self, data: np.ndarray) -> np.ndarray:
        """Data (n,) or rows of them (k, n), whitened."""
        return solve_triangular(self._lower, np.asarray(data).T, lower=True).T


def separability(truth: np.ndarray, rivals: Mapping[str, np.ndarray], white: Whitened) -> float:
    """D: half the whitened distance from the truth to the nearest that a rival predicts.

    With Gaussian noise the nearest rival is then taken for the truth with probability Phi(-D).

    Args:
        truth: The case's prediction, (n,).
        rivals: Of every other effect its predictions by rising size, (k, n); that of no effect has
            one row. Between sizes they are taken as straight.
        white: The metric.
    """
    place = white(truth)
    return 0.5 * min(_to_curve(place, white(np.atleast_2d(c))) for c in rivals.values())


def _to_curve(point: np.ndarray, curve: np.ndarray) -> float:
    """Distance of a point (n,) from a polygon with corners (k, n)."""
    if len(curve) == 1:
        return float(np.linalg.norm(point - curve[0]))
    start, way = curve[:-1], np.diff(curve, axis=0)
    square = np.maximum(np.sum(way**2, axis=1), 1e-300)
    t = np.clip(np.sum((point - start) * way, axis=1) / square, 0.0, 1.0)
    return float(np.min(np.linalg.norm(point - start - t[:, None] * way, axis=1)))


def posterior(
    data: np.ndarray, families: Mapping[str, Sequence[np.ndarray]], white: Whitened
) -> dict[str, float]:
    """Probability of each family of effects, equal before the test, given the data.

    Args:
        data: What was measured, (n,).
        families: Predictions of each at sizes that the generator draws equally often, (k, n); an
            effect with several places has them all among its rows.
        white: The metric.
    """
    place = white(data)
    score = {}
    for name, predictions in families.items():
        misfit = np.sum((white(np.atleast_2d(predictions)) - place) ** 2, axis=1)
        score[name] = logsumexp(-0.5 * misfit) - np.log(len(misfit))
    total = logsumexp(list(score.values()))
    return {name: float(np.exp(value - total)) for name, value in score.items()}
