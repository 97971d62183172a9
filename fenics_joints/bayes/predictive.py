"""Posterior-predictive checks: do new specimens scatter and correlate as the measured ones do?"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fenics_joints.bayes.chains import Chains
from fenics_joints.errors import InputError

_DOUBT = 0.025
#: Specimens without gaps of which scatter and correlation are checked.
FEWEST = 5
#: Standard deviations from the prediction beyond which a measured frequency is doubted.
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
