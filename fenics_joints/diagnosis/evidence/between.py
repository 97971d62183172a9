"""What changes between the levels of a test and no law explains: drift, settling, temperature.

A structure that is tested at one level after another warms, settles and is touched, and an
identified frequency or damping ratio is off by more at one level than at another. How much, a test
does not say. So each kind of data, ln f and ln damping, has an error between levels of its own: an
Ornstein-Uhlenbeck process over the logarithm of the level, for each mode by itself, whose standard
deviation the data infer. It is log-normal before the test, and summed over a grid in every
hypothesis, so that one that leaves a trend pays for the drift that it calls for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product

import numpy as np
from scipy.special import logsumexp

__all__ = ["Scales", "correlation", "grid", "medians", "squares", "weighed"]

#: Standard deviations of ln f and ln damping between levels: guessed medians, within a factor of 3
#: either way. Frequencies of steel fall by 0.01 % per kelvin, of bolted joints that settle by some
#: 0.1 %; damping ratios of one joint repeat to some 5 or 10 %.
_MEDIANS, _SPREAD = (5e-4, 0.05), np.log(3.0)
#: The grid of both, in standard deviations of their logarithms.
_GRID = np.arange(-2.0, 3.25, 0.5)
#: Change of the logarithm of the level over which the error forgets itself.
_MEMORY = 0.7

#: Standard deviations between levels of ln f and, if it is used, of ln damping.
Scales = tuple[float, ...]


def medians(damped: bool) -> Scales:
    """Expected standard deviations between levels, of ln f and, if it is used, ln damping."""
    return _MEDIANS[: 2 if damped else 1]


def squares(scales: Scales) -> float:
    """Squared distance of standard deviations from the expected ones, in those of their prior."""
    return float(np.sum((np.log(np.array(scales) / _MEDIANS[: len(scales)]) / _SPREAD) ** 2))


def grid(damped: bool) -> list[tuple[Scales, float]]:
    """Standard deviations that are tried, each with ln of its prior probability."""
    steps = list(product(_GRID, repeat=2 if damped else 1))
    log_weights = np.array([-0.5 * np.dot(z, z) for z in steps])
    log_weights -= logsumexp(log_weights)
    values = [np.array(_MEDIANS[: len(z)]) * np.exp(_SPREAD * np.array(z)) for z in steps]
    return [(tuple(map(float, v)), float(w)) for v, w in zip(values, log_weights, strict=True)]


def weighed(
    tried: Sequence[tuple[Scales, float]], log_evidence: Callable[[Scales], float]
) -> tuple[Scales, Callable[[Scales], float]]:
    """The most probable of them, and ln(evidence of all / that at some).

    Args:
        tried: From `grid`.
        log_evidence: ln of the evidence at given standard deviations.
    """
    known = {scales: log_evidence(scales) for scales, _ in tried}
    scores = np.array([known[scales] + weight for scales, weight in tried])
    total = float(logsumexp(scores))
    return tried[int(np.argmax(scores))][0], lambda scales: total - known[scales]


def correlation(levels: np.ndarray) -> np.ndarray:
    """Correlation of the error between levels, (n, n); by order where not all are positive."""
    x = np.log(levels) if np.all(levels > 0) else _MEMORY * np.arange(len(levels), dtype=float)
    return np.exp(-np.abs(x[:, None] - x[None, :]) / _MEMORY)
