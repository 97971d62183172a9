"""Simulation-based calibration: do intervals hold the truth as often as they say?

For truths drawn from the prior and data made from them, the rank of the truth among draws of the
posterior is even (Talts, Betancourt, Simpson, Vehtari and Gelman, arXiv:1804.06788, 2018).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from fenics_joints.errors import InputError, real, reals, wanted, whole


@dataclass(frozen=True, eq=False)
class Calibration:
    """Ranks of truths.

    Attributes:
        counts: Ranks in each bin, (n_bins,).
        p_value: Of a chi-square test of their evenness.
        covered: Share of truths inside of the central 90 % of the draws.
        covered_half: Likewise of the central half.
    """

    counts: np.ndarray
    p_value: float
    covered: float
    covered_half: float

    def __repr__(self) -> str:
        return f"Calibration({int(self.counts.sum())} truths, p = {self.p_value:.2g})"


def rank(truth: float, draws: np.ndarray, n: int) -> int:
    """Rank of the truth among n draws, taken evenly from a chain: 0 to n.

    Raises:
        InputError: If there are fewer draws.
    """
    truth, draws = real("truth", truth), np.ravel(reals("draws", draws))
    whole("n", n)
    if len(draws) < n:
        raise InputError(f"n = {n}: expected at most {len(draws)}, the number of draws.")
    picked = draws[np.linspace(0, len(draws) - 1, n).astype(int)]
    return int(np.sum(picked < truth))


def calibrate(ranks: np.ndarray, n: int, bins: int = 10) -> Calibration:
    """Test whether ranks are even.

    Args:
        ranks: Of the truths, each 0 to n, (n_truths,).
        n: Number of draws that they are ranks among; n + 1 is a multiple of ``bins``.
        bins: Number of bins.

    Raises:
        InputError: If the bins do not divide the ranks, or there are fewer than five for each.
    """
    whole("n", n)
    whole("bins", bins)
    ranks = np.asarray(ranks)
    if ranks.ndim != 1 or ranks.dtype.kind not in "iu" or np.any((ranks < 0) | (ranks > n)):
        raise wanted("ranks", ranks.tolist(), f"whole numbers from 0 to {n}")
    if (n + 1) % bins or len(ranks) < 5 * bins:
        raise InputError(
            f"bins = {bins}: expected a divisor of n + 1 = {n + 1}, and at least {5 * bins} ranks."
        )
    counts = np.bincount(ranks * bins // (n + 1), minlength=bins)

    def inside(share: float) -> float:
        """Of the central ones of n + 1 equally likely ranks."""
        edge = 0.5 * (1 - share) * (n + 1)
        return float(np.mean((ranks >= edge) & (ranks < n + 1 - edge)))

    p_value = float(stats.chisquare(counts).pvalue)
    return Calibration(counts, p_value, inside(0.9), inside(0.5))
