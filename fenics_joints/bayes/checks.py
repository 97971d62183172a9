"""Checks of a prior before sampling, of draws against measured specimens, and of samplers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from fenics_joints.bayes.chains import Chains
from fenics_joints.bayes.priors import PriorDensity
from fenics_joints.errors import InputError, real, reals, wanted, whole
from fenics_joints.measurements.least_squares import LeastSquares

#: Probability on either side below which scatter or correlation is called wrong; convention.
_DOUBT = 0.025
#: Specimens without gaps of which scatter and correlation are checked.
FEWEST = 5
#: Standard deviations from the prediction beyond which a measured frequency is doubted; convention.
_FAR = 3.0


@dataclass(frozen=True, eq=False)
class PredictiveCheck:
    """Measured specimens beside as many new ones, many times.

    Attributes:
        mode_names: Names of the modes, m of them.
        sd: Standard deviations of the measured frequencies, relative, (m,).
        sd_low, sd_median, sd_high: 5, 50 and 95 % of those of new sets.
        correlation: Of the measured frequencies, (m, m).
        correlation_low, correlation_median, correlation_high: 5, 50, 95 % of that of new sets.
        p_sd: Share of new sets with more scatter (its mean over the modes, of the logarithm).
        p_correlation: Share of new sets whose frequencies correlate more (mean over the pairs).
    """

    mode_names: tuple[str, ...]
    sd: np.ndarray
    sd_low: np.ndarray
    sd_median: np.ndarray
    sd_high: np.ndarray
    correlation: np.ndarray
    correlation_low: np.ndarray
    correlation_median: np.ndarray
    correlation_high: np.ndarray
    p_sd: float
    p_correlation: float

    def __repr__(self) -> str:
        values = f"p of scatter {self.p_sd:.2g}, of correlation {self.p_correlation:.2g}"
        return f"PredictiveCheck({values})"

    @property
    def mean_correlation(self) -> tuple[float, float]:
        """Mean correlation of two modes, measured and the median of new sets."""
        pairs = np.triu_indices(len(self.sd), 1)
        return float(self.correlation[pairs].mean()), float(self.correlation_median[pairs].mean())

    def words(self) -> list[str]:
        """What the check says, in sentences."""
        ratio = float(np.exp(np.mean(np.log(self.sd_median / self.sd))))
        measured, model = self.mean_correlation
        return [
            _said("scatter", f"new specimens scatter {ratio:.2f} times as the measured", self.p_sd),
            _said(
                "correlation",
                f"frequencies of new specimens correlate by {model:.2f} on average, of the "
                f"measured by {measured:.2f}",
                self.p_correlation,
            ),
        ]

    def to_json(self) -> dict:
        """All numbers."""
        return {
            key: value.tolist() if isinstance(value, np.ndarray) else value
            for key, value in vars(self).items()
        } | {"mode_names": list(self.mode_names), "in_words": self.words()}


def _said(what: str, text: str, p: float) -> str:
    if p < _DOUBT:
        return f"{text}: the {what} is under-stated (p = {p:.3f})"
    if p > 1 - _DOUBT:
        return f"{text}: the {what} is over-stated (p = {1 - p:.3f})"
    return f"{text}: within what chance allows (p = {min(p, 1 - p):.2f})"


def _share(more: np.ndarray) -> float:
    return float((np.sum(more) + 0.5) / (len(more) + 1))


def replicate(
    chains: Chains,
    model: Callable[[np.ndarray], np.ndarray],
    n_specimens: int,
    n_sets: int = 200,
    seed: int = 0,
) -> np.ndarray:
    """ln f of new sets of specimens, (n_sets, n_specimens, m), each a draw of the posterior.

    That is how the paper takes its posterior: as the distribution of the specimens' parameters.

    Args:
        chains: Draws of the parameters.
        model: From values (n, d) to ln f, (n, m).
        n_specimens: Specimens of a set.
        n_sets: Number of sets.
        seed: Of the draws.

    Raises:
        ConvergenceError: If the chains did not converge.
    """
    draws = chains.draws()
    rows = np.random.default_rng([seed, 5]).choice(len(draws), n_sets * n_specimens)
    return model(draws[rows]).reshape(n_sets, n_specimens, -1)


def outside(
    mode_names: Sequence[str],
    measured_hz: np.ndarray,
    predicted_hz: np.ndarray,
    log_sd: np.ndarray | float = 0.0,
) -> list[str]:
    """Modes whose measured frequency is not among what is predicted, a line each.

    Args:
        mode_names: Names of the modes, m of them.
        measured_hz: Shape (m,); nan where not measured.
        predicted_hz: Draws, (n, m).
        log_sd: Relative standard deviation by which the two may differ and that the draws do not
            have, (m,); nan counts as none.
    """
    logs = np.log(predicted_hz)
    off = logs.mean(axis=0) - np.log(measured_hz)
    sd = np.hypot(logs.std(axis=0), np.nan_to_num(np.broadcast_to(log_sd, off.shape)))
    return [
        f"{name}: predicted {100 * abs(np.expm1(o)):.2g} % {'above' if o > 0 else 'below'} the "
        f"measured {f:.2f} Hz, {abs(o) / s:.0f} standard deviations of the prediction: the model "
        "lacks something that this mode feels"
        for name, f, o, s in zip(mode_names, measured_hz, off, sd, strict=True)
        if abs(o) > _FAR * s
    ]


def check_predictive(
    mode_names: Sequence[str], frequencies_hz: np.ndarray, replicates: np.ndarray
) -> PredictiveCheck:
    """Compare measured specimens with new ones.

    Args:
        mode_names: Names of the modes, m of them.
        frequencies_hz: Measured, (S, m); specimens with gaps are left out.
        replicates: ln f of new sets, (n_sets, S, m); as many specimens of each as have no gaps.

    Raises:
        InputError: For fewer than two modes or `FEWEST` specimens without gaps.
    """
    logs = np.log(np.asarray(frequencies_hz, dtype=float))
    logs = logs[np.all(np.isfinite(logs), axis=1)]
    replicates = replicates[np.all(np.isfinite(replicates), axis=(1, 2))]
    if logs.ndim != 2 or logs.shape[1] < 2 or len(logs) < FEWEST or not len(replicates):
        raise InputError(
            f"frequencies of specimens have shape {logs.shape} without gaps: expected two modes or "
            f"more of at least {FEWEST} specimens."
        )
    # Sets of the size of the measured one: larger ones would scatter less from set to set.
    replicates = replicates[:, : len(logs)]
    sds = replicates.std(axis=1, ddof=1)
    own_sd, own = logs.std(axis=0, ddof=1), np.corrcoef(logs.T)
    every = np.array([np.corrcoef(one.T) for one in replicates])
    pairs = np.triu_indices(len(own), 1)
    # The measured set is one of those that it may be: no share is nought.
    p_sd = _share(np.mean(np.log(sds), axis=1) >= np.mean(np.log(own_sd)))
    p_correlation = _share(np.mean(every[:, pairs[0], pairs[1]], axis=1) >= np.mean(own[pairs]))
    levels = [0.05, 0.5, 0.95]
    return PredictiveCheck(
        tuple(mode_names),
        own_sd,
        *np.quantile(sds, levels, axis=0),
        own,
        *np.quantile(every, levels, axis=0),
        p_sd,
        p_correlation,
    )


# -- simulation-based calibration ------------------------------------------------------------------


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


# -- before sampling: whether values within the prior can explain the data -------------------------


#: How far into its tails a prior is searched, where its edge begins, and how far off a frequency
#: may be at the best values, all in standard deviations; draws from the best of which the search
#: starts. Chosen.
_TAIL, _EDGE, _MISSED, _DRAWS = 4.0, 3.5, 6.0, 64
#: Residual of a mode that the model lacks, in standard deviations.
_LACKS = 1e3


def check_prior(
    prior: PriorDensity,
    frequencies: Callable[[np.ndarray], np.ndarray],
    mode_names: Sequence[str],
    log_f: np.ndarray,
    sd: np.ndarray,
) -> list[str]:
    """Refuse a prior that excludes the data; warn of a model that cannot have them.

    Args:
        prior: Of the parameters.
        frequencies: From values (n, d) to ln f, (n, m).
        mode_names: Names of the modes, m of them.
        log_f: Measured, (m,); nan where not measured.
        sd: Standard deviation of ln f about the model's that is allowed for, (m,).

    Returns:
        Modes that the model cannot have, in words, where that is not for the prior's edges.

    Raises:
        InputError: If the values that come nearest to the data, yet not near, are at a prior's
            edge.
    """
    there = np.isfinite(log_f) & np.isfinite(sd)

    def residuals(values: np.ndarray) -> np.ndarray:
        off = (frequencies(values)[:, there] - log_f[there]) / sd[there]
        return np.nan_to_num(off, nan=_LACKS)

    def allowed(z: np.ndarray) -> np.ndarray:
        """Values at normal scores of the prior."""
        shares = stats.norm.cdf(z)
        values = np.array([d.ppf(p) for d, p in zip(prior.densities, shares, strict=True)])
        low, high = np.array([(max(p.lower, 0.0), p.upper) for p in prior.parameters]).T
        return np.clip(values, np.maximum(low, 1e-12 * np.abs(values)), high)

    draws = prior.values(prior.sample(_DRAWS, np.random.default_rng(10)))
    best = draws[np.argmin(np.sum(residuals(draws) ** 2, axis=1))]
    shares = [d.cdf(v) for d, v in zip(prior.densities, best, strict=True)]
    fit = LeastSquares(lambda z: residuals(allowed(z)[None])[0], bounds=(-_TAIL, _TAIL))
    z = fit.solve(np.clip(stats.norm.ppf(shares), -_EDGE, _EDGE), 60, diff_step=1e-4).x
    off = residuals(allowed(z)[None])[0]
    if np.abs(off).max() <= _MISSED:
        return []
    names = [name for name, is_there in zip(mode_names, there, strict=True) if is_there]
    said = [
        f"{name} no nearer to its measured frequency than "
        f"{100 * abs(np.expm1(miss * s)):.2g} %, {abs(miss):.0f} standard deviations of noise, "
        "scatter and discrepancy"
        for name, miss, s in zip(names, off, sd[there], strict=True)
        if abs(miss) > _MISSED
    ]
    edge = [name for name, score in zip(prior.names, z, strict=True) if abs(score) > _EDGE]
    if edge:
        raise InputError(
            f"prior of {', '.join(edge)}: excludes the data: up to its tails it brings {said[0]}. "
            "Expected a prior that reaches the values which have these frequencies."
        )
    return [f"the model brings {line}: give it a discrepancy, or better it" for line in said]
