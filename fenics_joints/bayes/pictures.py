"""Pictures of chains, by ArviZ, and of what they predict, as SVG for a page."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np

from fenics_joints.bayes.arviz_files import arviz, data_tree
from fenics_joints.bayes.chains import Chains
from fenics_joints.bayes.predictive import PredictiveCheck
from fenics_joints.pictures import CHOSEN, NOMINAL, new_figure, style, to_svg

__all__ = ["correlations", "frequencies", "pairs", "traces"]

#: Draws of a chain that are shown: more would only make the page larger.
_SHOWN, _PAIRS, _MOST = 600, 400, 6


def traces(chains: Chains, names: Sequence[str]) -> str:
    """Draws in their order, by chain."""
    az = arviz()
    return _drawn(
        lambda tree: az.plot_trace(tree, backend="matplotlib"), chains, names, _SHOWN, "trace",
        "Draws of each quantity in their order, a colour for each chain",
    )  # fmt: skip


def pairs(chains: Chains, names: Sequence[str]) -> str | None:
    """Draws of each two quantities; None for a single one."""
    if len(names) < 2:
        return None
    az = arviz()
    return _drawn(
        lambda tree: az.plot_pair(tree, backend="matplotlib"), chains, names, _PAIRS, "pair",
        "Draws of each two quantities against each other",
    )  # fmt: skip


def _drawn(draw, chains: Chains, names, shown: int, name: str, alt: str) -> str:
    from matplotlib import pyplot

    every = chains.by_name()
    some = np.unique(np.linspace(0, chains.values.shape[1] - 1, shown).astype(int))
    tree = data_tree({n: every[n][:, some] for n in names[:_MOST]})
    with style(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        before = set(pyplot.get_fignums())
        draw(tree)
        made = [n for n in pyplot.get_fignums() if n not in before]
        figure = pyplot.figure(made[-1])
        for axes in figure.axes:
            for artist in (*axes.lines, *axes.collections):
                artist.set_rasterized(True)
        text = to_svg(figure, name, alt, dpi=90)
        for n in made:
            pyplot.close(n)
    return text


def frequencies(
    mode_names: Sequence[str], measured_hz: np.ndarray, sd: np.ndarray, predicted_hz: np.ndarray
) -> str:
    """Predicted frequencies relative to the measured ones, with the measurement's noise.

    Args:
        mode_names: Names of the modes, m of them.
        measured_hz: One set of frequencies, (m,); nan where not measured.
        sd: Their relative standard deviation, (m,).
        predicted_hz: Draws, (n, m).
    """
    there = np.flatnonzero(np.isfinite(measured_hz))
    off = 100 * (predicted_hz[:, there] / measured_hz[there] - 1)
    low, quarter, median, three, high = np.quantile(off, [0.05, 0.25, 0.5, 0.75, 0.95], axis=0)
    with style():
        figure = new_figure(7.2, 0.42 * len(there) + 0.9)
        axes, y = figure.subplots(), -np.arange(len(there), dtype=float)
        axes.axvline(0, color=NOMINAL, lw=0.8)
        for k, i in enumerate(there):
            axes.plot(
                200 * sd[i] * np.array([-1, 1]), [y[k]] * 2, color=NOMINAL, lw=7, alpha=0.35,
                solid_capstyle="butt", label="measured, 95 %" if k == 0 else None,
            )  # fmt: skip
        axes.hlines(y, low, high, color=CHOSEN, lw=1.2, label="predicted, 90 %")
        axes.hlines(y, quarter, three, color=CHOSEN, lw=4)
        axes.plot(median, y, "o", color=CHOSEN, ms=5)
        axes.set_yticks(y, [mode_names[i] for i in there])
        axes.set_ylim(y[-1] - 0.6, 0.6)
        axes.set_xlabel("predicted over measured frequency less one, %")
        axes.legend(loc="upper left", bbox_to_anchor=(1, 1))
        return to_svg(figure, "frequencies", "Predicted frequencies relative to the measured ones")


def correlations(check: PredictiveCheck) -> str:
    """Correlation and scatter of new specimens beside those of the measured ones."""
    m = len(check.sd)
    first, second = np.triu_indices(m, 1)
    with style():
        figure = new_figure(7.2, 3.1)
        left, right = figure.subplots(1, 2)
        own = check.correlation[first, second]
        low, median, high = (
            a[first, second]
            for a in (check.correlation_low, check.correlation_median, check.correlation_high)
        )
        _against(left, own, low, median, high, "correlation of two frequencies")
        _against(right, 100 * check.sd, 100 * check.sd_low, 100 * check.sd_median,
                 100 * check.sd_high, "standard deviation, %")  # fmt: skip
        return to_svg(figure, "correlations", "Correlation and scatter: new specimens, measured")


def _against(axes, own, low, median, high, title: str) -> None:
    axes.vlines(own, low, high, color=CHOSEN, lw=1.2)
    axes.plot(own, median, "o", color=CHOSEN, ms=4)
    ends = [min(own.min(), low.min()), max(own.max(), high.max())]
    axes.plot(ends, ends, color=NOMINAL, lw=0.8)
    axes.set_title(title)
    axes.set_xlabel("measured specimens")
    axes.set_ylabel("new specimens, 90 %")
