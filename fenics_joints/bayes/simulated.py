"""Specimens simulated from a stated truth: Jalali et al. 2019 has their scatter in Figure 7 alone.

The raw data of the 25 specimens are not in print. Three fitted distributions are; a truth that is
anchored on one of them has its standard deviation in that mode, at that torque.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from fenics_joints.errors import InputError

#: Jalali et al. 2019, Figure 7: by torque, N m, the mode (from 1) and its distribution over
#: specimens, Hz.
FIGURE_7 = {
    23: (1, stats.norm(158.4, 0.625)),
    15: (4, stats.norm(1373.1, 5.827)),
    7: (5, stats.weibull_min(819.5, scale=2035.08)),
}


@dataclass(frozen=True, eq=False)
class Truth:
    """What specimens are made of.

    Attributes:
        median: Of the parameters over specimens, SI, (d,).
        covariance: Of their logarithms over specimens, (d, d).
        noise: Relative standard deviation of a measured frequency.
        offset: How far the model's frequencies are off, relative, (m,); 0 for not.
    """

    median: np.ndarray
    covariance: np.ndarray
    noise: float = 0.0
    offset: np.ndarray | float = 0.0

    def __repr__(self) -> str:
        return f"Truth({len(self.median)} parameters, noise {self.noise:g})"


def anchored(
    slope: np.ndarray,
    median: Sequence[float],
    mode: int,
    relative_sd: float,
    *,
    shares: Sequence[float] | None = None,
    correlation: float = 0.0,
    noise: float = 0.0,
) -> Truth:
    """A truth whose mode scatters as measured.

    Args:
        slope: d ln f / d ln p at the median, (m, d).
        median: Of the parameters, SI, (d,).
        mode: Which mode is anchored, from 0.
        relative_sd: Its standard deviation over specimens, relative.
        shares: Scatter of the parameters relative to each other; even by default.
        correlation: Between the parameters.
        noise: Relative standard deviation of a measured frequency, part of ``relative_sd``.

    Raises:
        InputError: If the noise alone is more, or the mode does not feel the parameters.
    """
    d = len(median)
    shares = np.ones(d) if shares is None else np.asarray(shares, dtype=float)
    unit = np.full((d, d), correlation) + (1 - correlation) * np.eye(d)
    unit = unit * np.outer(shares, shares)
    felt = float(slope[mode] @ unit @ slope[mode])
    if not (relative_sd > noise and felt > 0):
        raise InputError(
            f"relative_sd = {relative_sd:g}: expected more than the noise of {noise:g}, in a mode "
            "that feels the parameters."
        )
    scale = (relative_sd**2 - noise**2) / felt
    return Truth(np.asarray(median, dtype=float), scale * unit, noise)


def simulate(
    model: Callable[[np.ndarray], np.ndarray], truth: Truth, n: int, seed: int = 0
) -> np.ndarray:
    """Measured frequencies of n specimens, Hz, (n, m).

    Args:
        model: From values (n, d) to ln f, (n, m).
        truth: What they are made of.
        n: Number of specimens.
        seed: Of the random numbers.
    """
    rng = np.random.default_rng(seed)
    logs = rng.multivariate_normal(np.log(truth.median), truth.covariance, n, method="eigh")
    log_f = model(np.exp(logs)) + truth.offset
    return np.exp(log_f + truth.noise * rng.standard_normal(log_f.shape))
