"""Rates with intervals, and how well stated probabilities agree with what came true."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import beta

__all__ = ["Calibration", "Rate", "calibration", "clopper_pearson", "median_interval"]

_RESAMPLES = 2000


def clopper_pearson(k: int, n: int, level: float = 0.95) -> tuple[float, float]:
    """Exact interval of a probability after k of n (Clopper and Pearson, Biometrika 26, 1934).

    Two-sided: each end leaves (1 - level) / 2. The one-sided limit of 95 % is that of level 0.9.
    """
    if n == 0:
        return 0.0, 1.0
    tail = (1 - level) / 2
    low = float(beta.ppf(tail, k, n - k + 1)) if k > 0 else 0.0
    high = float(beta.ppf(1 - tail, k + 1, n - k)) if k < n else 1.0
    return low, high


@dataclass(frozen=True)
class Rate:
    """``k`` of ``n``."""

    k: int
    n: int

    @classmethod
    def of(cls, hits) -> Rate:
        """Of a sequence of truth values."""
        hits = [bool(hit) for hit in hits]
        return cls(sum(hits), len(hits))

    @property
    def value(self) -> float:
        """The share; nan of nothing."""
        return self.k / self.n if self.n else float("nan")

    def to_json(self) -> dict:
        """Keys k, n, value, low, high: the 95 % interval of Clopper and Pearson."""
        low, high = clopper_pearson(self.k, self.n)
        value = self.value if self.n else None
        return {"k": self.k, "n": self.n, "value": value, "low": low, "high": high}


@dataclass(frozen=True)
class Calibration:
    """Stated probability beside the share that came true, in bins of equal count.

    Attributes:
        stated: Mean stated probability in each bin, (b,).
        found: Share that came true, (b,).
        count: Statements in each bin, (b,).
        right: Those that came true, (b,).
        error: Expected calibration error: the mean |stated - found|, weighted by the counts.
        low, high: Its 95 % interval by resampling the statements. The estimate is biased upwards.
        by_chance: Median error that a perfect forecaster would be found to have who stated
            these very probabilities: what the number of statements can show at best.
    """

    stated: np.ndarray
    found: np.ndarray
    count: np.ndarray
    right: np.ndarray
    error: float
    low: float
    high: float
    by_chance: float

    def to_json(self) -> dict:
        """All attributes."""
        bins = [
            {"stated": float(s), "found": float(f), "count": int(n), "right": int(k)}
            for s, f, n, k in zip(self.stated, self.found, self.count, self.right, strict=True)
        ]
        return {
            "bins": bins, "ece": self.error, "low": self.low, "high": self.high,
            "by_chance": self.by_chance,
        }  # fmt: skip


def calibration(stated, came_true, bins: int = 10, seed: int = 0) -> Calibration | None:
    """Calibration of statements; None of nothing.

    Args:
        stated: Probabilities, (n,).
        came_true: Whether each came true, (n,).
        bins: Bins, each with the same number of statements within one.
        seed: Of the resampling.
    """
    p, y = np.asarray(stated, dtype=float), np.asarray(came_true, dtype=float)
    if len(p) == 0:
        return None
    random = np.random.default_rng(seed)
    drawn = [random.integers(len(p), size=len(p)) for _ in range(_RESAMPLES)]
    resampled = [_error(*_bins(p[i], y[i], bins)) for i in drawn]
    perfect = [_error(*_bins(p, random.random(len(p)) < p, bins)) for _ in range(_RESAMPLES)]
    low, high = np.quantile(resampled, [0.025, 0.975])
    s, f, n = _bins(p, y, bins)
    right = np.round(f * n).astype(int)
    return Calibration(
        s, f, n, right, _error(s, f, n), float(low), float(high), float(np.median(perfect))
    )


def _bins(p: np.ndarray, y: np.ndarray, bins: int):
    """Mean statement, share and count of each bin; equal statements keep their order."""
    parts = np.array_split(np.argsort(p, kind="stable"), min(bins, len(p)))
    means = [(p[i].mean(), y[i].mean(), len(i)) for i in parts]
    return tuple(np.array(column) for column in zip(*means, strict=True))


def _error(stated, found, count) -> float:
    return float(np.sum(count * np.abs(stated - found)) / np.sum(count))


def median_interval(values, level: float = 0.95, seed: int = 0) -> dict:
    """Median with its interval by resampling; keys n, median, low, high (None of nothing)."""
    values = np.asarray([v for v in values if v is not None and np.isfinite(v)], dtype=float)
    if len(values) == 0:
        return {"n": 0, "median": None, "low": None, "high": None}
    random = np.random.default_rng(seed)
    drawn = random.choice(values, size=(_RESAMPLES, len(values)))
    low, high = np.quantile(np.median(drawn, axis=1), [(1 - level) / 2, (1 + level) / 2])
    return {
        "n": len(values), "median": float(np.median(values)), "low": float(low), "high": float(high)
    }  # fmt: skip
