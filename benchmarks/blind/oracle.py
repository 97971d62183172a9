"""What one could know who knew the generator: the ceiling for any diagnosis, and D of a case.

The generator's own likelihood: its own predictions of every effect at every size, Gaussian noise,
and its nuisance errors taken as linear. It has no model error. Predictions of an effect by size are
a polygon, along which the size has equal chances on every side.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import log_ndtr, logsumexp

_LEAST = 1e-9  # length of a side, below which it is a point


@dataclass(frozen=True)
class Curve:
    """What an effect shows, by its size.

    Attributes:
        points: Predictions at rising sizes, (k, n); one row is one prediction.
        scatter: Of each side (or of the one point) the change of the data per standard deviation
            of what scatters only where this effect is at work, such as the preload, (k - 1, n, q);
            None if nothing does.
    """

    points: np.ndarray
    scatter: np.ndarray | None = None

    def sides(self):
        """Start, way (zero for a lone point) and scatter, or None, of each side."""
        points = np.atleast_2d(self.points)
        ways = np.diff(points, axis=0) if len(points) > 1 else np.zeros_like(points)
        for i, way in enumerate(ways):
            yield points[i], way, None if self.scatter is None else self.scatter[i]


class Whitened:
    """Data in standard deviations of all that varies besides the effects.

    Args:
        noise: Covariance of noise and discrepancy, (n, n).
        nuisance: Change of the data per standard deviation of each nuisance, (n, p).
    """

    def __init__(self, noise: np.ndarray, nuisance: np.ndarray):
        self._lower = np.linalg.cholesky(noise + nuisance @ nuisance.T)

    def __call__(self, data: np.ndarray) -> np.ndarray:
        """Columns (n,) or (n, k), whitened."""
        return solve_triangular(self._lower, data, lower=True)


def _to_side(place: np.ndarray, side, white: Whitened) -> tuple[float, float, float, float]:
    """Of a point (n,) and a side the distance beside it, the place along it, its length, ln det."""
    start, way, scatter = side
    gap, way = white(place - start), white(way)
    log_det = 0.0
    if scatter is not None and np.any(scatter):
        u, s, _ = np.linalg.svd(white(scatter), full_matrices=False)
        shrink = 1 - 1 / np.sqrt(1 + s**2)
        gap, way = (v - u @ (shrink * (u.T @ v)) for v in (gap, way))
        log_det = float(np.sum(np.log1p(s**2)))
    length = float(np.linalg.norm(way))
    along = float(gap @ way) / length if length > _LEAST else 0.0
    beside = float(np.sqrt(max(gap @ gap - along**2, 0.0)))
    return beside, along, length, log_det


def separability(
    truth: np.ndarray, rivals: Mapping[str, Sequence[Curve]], white: Whitened
) -> float:
    """D: half the whitened distance from the truth to the nearest that a rival predicts.

    With Gaussian noise the nearest rival is then taken for the truth with probability Phi(-D).

    Args:
        truth: The case's prediction, (n,).
        rivals: Curves of every other effect, and of none.
        white: The metric.
    """
    nearest = np.inf
    for curves in rivals.values():
        for curve in curves:
            for side in curve.sides():
                beside, along, length, _ = _to_side(truth, side, white)
                nearest = min(nearest, np.hypot(beside, along - np.clip(along, 0.0, length)))
    return 0.5 * float(nearest)


def posterior(
    data: np.ndarray, families: Mapping[str, Sequence[Curve]], white: Whitened
) -> dict[str, float]:
    """Probability of each family of effects, equal before the test, given the data.

    Args:
        data: What was measured, (n,).
        families: Curves of each effect, equally likely, as are their sides.
        white: The metric.
    """
    score = {}
    for name, curves in families.items():
        parts = [
            logsumexp([_along(*_to_side(data, side, white)) for side in sides]) - np.log(len(sides))
            for sides in (list(curve.sides()) for curve in curves)
        ]
        score[name] = logsumexp(parts) - np.log(len(parts))
    total = logsumexp(list(score.values()))
    return {name: float(np.exp(value - total)) for name, value in score.items()}


def _along(beside: float, along: float, length: float, log_det: float) -> float:
    """ln of the mean Gaussian density along a side, up to the constant that all share."""
    across = -0.5 * (beside**2 + log_det)
    if length <= _LEAST:
        return across - 0.5 * along**2
    # The integral of a normal density from 0 to the length; its smaller tails keep their digits.
    low, high = sorted((-along, length - along), key=abs)
    if low * high < 0 or low == 0:
        inside = np.log(max(np.exp(log_ndtr(length - along)) - np.exp(log_ndtr(-along)), 1e-300))
    else:
        a, b = log_ndtr(-abs(low)), log_ndtr(-abs(high))
        inside = a + np.log1p(-np.exp(min(b - a, -1e-16)))
    return float(across + 0.5 * np.log(2 * np.pi) + inside - np.log(length))
