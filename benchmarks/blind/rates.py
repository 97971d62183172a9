"""Rates with intervals, and how well stated probabilities agree with what came true."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import beta

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
            "bins": bins,
            "ece": self.error,
            "low": self.low,
            "high": self.high,
            "by_chance": self.by_chance,
        }


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
    drawn = random.integers(len(p), size=(_RESAMPLES, len(p)))
    resampled = _error(*_bins(p[drawn], y[drawn], bins))
    perfect = _error(*_bins(np.tile(p, (_RESAMPLES, 1)), random.random(drawn.shape) < p, bins))
    low, high = np.quantile(resampled, [0.025, 0.975])
    s, f, n = _bins(p, y, bins)
    right = np.round(f * n).astype(int)
    chance = float(np.median(perfect))
    return Calibration(s, f, n, right, float(_error(s, f, n)), float(low), float(high), chance)


def _bins(p: np.ndarray, y: np.ndarray, bins: int):
    """Mean statement and share of each bin, (..., b), and counts, (b,), of statements (..., n).

    Equal statements keep their order.
    """
    order = np.argsort(p, axis=-1, kind="stable")
    parts = np.array_split(np.arange(p.shape[-1]), min(bins, p.shape[-1]))
    first, count = np.array([part[0] for part in parts]), np.array([len(part) for part in parts])
    sums = [
        np.add.reduceat(np.take_along_axis(np.asarray(a, dtype=float), order, -1), first, axis=-1)
        for a in (p, y)
    ]
    return sums[0] / count, sums[1] / count, count


def _error(stated, found, count):
    return np.sum(count * np.abs(stated - found), axis=-1) / np.sum(count)


def median_interval(values, level: float = 0.95, seed: int = 0) -> dict:
    """Median with its interval by resampling; keys n, median, low, high (None of nothing)."""
    values = np.asarray([v for v in values if v is not None and np.isfinite(v)], dtype=float)
    if len(values) == 0:
        return {"n": 0, "median": None, "low": None, "high": None}
    random = np.random.default_rng(seed)
    drawn = random.choice(values, size=(_RESAMPLES, len(values)))
    low, high = np.quantile(np.median(drawn, axis=1), [(1 - level) / 2, (1 + level) / 2])
    return {
        "n": len(values),
        "median": float(np.median(values)),
        "low": float(low),
        "high": float(high),
    }


def grouped_rate(groups, seed: int = 0) -> dict:
    """Share of hits in groups that belong together, such as the folds of a case.

    Keys as `Rate.to_json`; the 95 % interval resamples whole groups, since the hits within one are
    not independent.
    """
    kept = [[bool(hit) for hit in group] for group in groups if len(group)]
    if not kept:
        return Rate(0, 0).to_json()
    hits = np.array([sum(group) for group in kept])
    sizes = np.array([len(group) for group in kept])
    drawn = np.random.default_rng(seed).integers(len(kept), size=(_RESAMPLES, len(kept)))
    shares = hits[drawn].sum(axis=1) / sizes[drawn].sum(axis=1)
    low, high = (float(x) for x in np.quantile(shares, [0.025, 0.975]))
    rate = Rate(int(hits.sum()), int(sizes.sum()))
    return {"k": rate.k, "n": rate.n, "value": rate.value, "low": low, "high": high}
