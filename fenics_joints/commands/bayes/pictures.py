"""Pictures of chains and of what they predict, as SVG for a page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from textwrap import fill

import numpy as np
from matplotlib import colormaps
from matplotlib.ticker import FuncFormatter, MaxNLocator

from fenics_joints.bayes.arviz_files import quantile_ess
from fenics_joints.bayes.chains import Chains
from fenics_joints.bayes.checks import PredictiveCheck
from fenics_joints.commands.bayes.model import HeldModes
from fenics_joints.formatting import prefixed
from fenics_joints.report.panels import draw_matrix, panel_chart
from fenics_joints.report.style import CHOSEN, NOMINAL, PLACEBO, SERIES, drawing, to_svg

#: Draws of a chain that are shown, in their order and against each other: more would only make the
#: page larger.
_SHOWN, _PAIRS = 600, 300
#: Quantities that have a panel, and those drawn against each other: more do not fit a page.
_MOST, _AGAINST = 12, 6
#: Effective draws that quantiles need (Vehtari et al. 2021), and the quantiles that are drawn.
_ENOUGH, _QUANTILES = 400, np.linspace(0.05, 0.95, 19)
#: Draws of a chain below which effective sizes at quantiles say nothing; chosen.
_FEWEST = 50
#: Letters of a line of a label in a panel of pairs, at its font's size.
_WIDE = 17


def _labelled(chains: Chains, units: Mapping[str, str]) -> dict[str, np.ndarray]:
    """Draws, (n_chains, n_draws), by a name such as ``lap.k1, kN·m``; small ratios in per cent."""
    found = {}
    for name, values in list(chains.by_name().items())[:_MOST]:
        typical, unit = float(np.median(np.abs(values))), units.get(name, "")
        factor = 1.0
        if unit:
            factor, unit = prefixed(typical, unit)
        elif typical < 0.1 and "correlation" not in name:
            factor, unit = 100.0, "%"
        found[f"{name}, {unit}" if unit else name] = factor * values
    return found


def traces(chains: Chains, units: Mapping[str, str]) -> str:
    """Draws of each quantity in their order, a colour for each chain.

    Args:
        chains: The draws.
        units: Units of the quantities by name; those without one are ratios.
    """
    draws = _labelled(chains, units)
    at = np.arange(0, chains.values.shape[1], -(-chains.values.shape[1] // _SHOWN))

    def draw(axes, name: str) -> None:
        for chain, colour in zip(draws[name], np.resize(SERIES, len(draws[name])), strict=True):
            axes.plot(at, chain[at], color=colour, lw=0.5, alpha=0.7, rasterized=True)
        axes.set_title(name, loc="left")

    alt = "Draws of each quantity in sequence, a colour for each chain"
    return panel_chart(list(draws), draw, "trace", alt, columns=3, height=1.65, xlabel="draw")


def effective(chains: Chains, units: Mapping[str, str]) -> str | None:
    """Effective sample size at each quantile; None for too few draws."""
    if chains.values.shape[1] < _FEWEST:
        return None
    draws = _labelled(chains, units)

    def draw(axes, name: str) -> None:
        axes.plot(_QUANTILES, quantile_ess(draws[name], _QUANTILES), "o-", ms=3, color=CHOSEN)
        axes.axhline(_ENOUGH, color=NOMINAL, ls="--", lw=1.0)
        axes.set_ylim(bottom=0)
        axes.set_title(name, loc="left")

    alt = "Effective sample size at each quantile"
    return panel_chart(list(draws), draw, "ess", alt, columns=3, height=1.65, xlabel="quantile")


def pairs(chains: Chains, units: Mapping[str, str]) -> str | None:
    """Draws of each two quantities against each other; None for a single one."""
    draws = dict(list(_labelled(chains, units).items())[:_AGAINST])
    if len(draws) < 2:
        return None
    every = -(-chains.values.shape[1] // _PAIRS)
    values, names = [a[:, ::every].ravel() for a in draws.values()], list(draws)
    n = len(names)
    with drawing(1.45 * n + 0.6, 1.45 * n + 0.6) as figure:
        for (i, j), axes in np.ndenumerate(figure.subplots(n, n)):
            if j > i:
                axes.set_visible(False)
                continue
            axes.tick_params(labelsize=7, labelleft=j == 0 < i, labelbottom=i == n - 1)
            axes.xaxis.set_major_locator(MaxNLocator(2))
            axes.yaxis.set_major_locator(MaxNLocator(3))
            for axis in (axes.xaxis, axes.yaxis):  # a power of ten would lie over a label
                axis.set_major_formatter(FuncFormatter(lambda tick, _: f"{tick:.6g}"))
            if i == j:  # whose height says nothing
                axes.hist(values[i], bins=30, color=CHOSEN, histtype="stepfilled")
                axes.set_yticks([])
            else:
                look = {"color": CHOSEN, "alpha": 0.4, "ms": 2, "rasterized": True}
                axes.plot(values[j], values[i], "o", mew=0, **look)
            if i == n - 1:
                axes.set_xlabel(fill(names[j], _WIDE), fontsize=8)
            if j == 0 < i:
                axes.set_ylabel(fill(names[i], _WIDE), fontsize=8)
        return to_svg(figure, "pair", "Draws of each pair of quantities", dpi=90)


def frequencies(
    mode_names: Sequence[str],
    measured_hz: np.ndarray,
    sd: np.ndarray,
    predicted_hz: np.ndarray,
    held: HeldModes | None = None,
) -> str:
    """Predicted frequencies relative to the measured ones, with the measurement's noise.

    Args:
        mode_names: Names of the modes, m of them.
        measured_hz: One set of frequencies, (m,); nan where not measured.
        sd: Their relative standard deviation, (m,).
        predicted_hz: Draws, (n, m).
        held: Modes that were not fitted, shown below the others in another colour.
    """
    groups = [("", mode_names, measured_hz, sd, predicted_hz, CHOSEN)]
    if held is not None:
        more = (held.mode_names, held.measured_hz, held.measured_sd, held.predicted_hz)
        groups.append((", held out", *more, PLACEBO))
    n = sum(int(np.isfinite(group[2]).sum()) for group in groups)
    with drawing(7.8, 0.32 * n + 1.2) as figure:
        axes, ticks = figure.subplots(), []
        axes.axvline(0, color=NOMINAL, lw=0.8)
        for words, names, hz, noise, draws, colour in groups:
            there = np.isfinite(hz)
            y = -np.arange(len(ticks), len(ticks) + there.sum(), dtype=float)
            ticks += [f"{name}{words}" for name, has in zip(names, there, strict=True) if has]
            off = 100 * (draws[:, there] / hz[there] - 1)
            low, quarter, median, three, high = np.quantile(off, [0.05, 0.25, 0.5, 0.75, 0.95], 0)
            wide = 200 * np.nan_to_num(noise[there])
            band = {"color": NOMINAL, "lw": 7, "alpha": 0.35}
            axes.hlines(y, -wide, wide, label=None if words else "measured, 95 %", **band)
            axes.hlines(y, low, high, color=colour, lw=1.2, label=f"predicted, 90 %{words}")
            axes.hlines(y, quarter, three, color=colour, lw=4)
            axes.plot(median, y, "o", color=colour, ms=5)
        axes.set_yticks(-np.arange(n, dtype=float), ticks)
        axes.set_ylim(-n + 0.4, 0.6)
        axes.set_xlabel("predicted over measured frequency less one, %")
        figure.legend(loc="outside upper center", ncols=3)
        return to_svg(figure, "frequencies", "Predicted frequencies relative to the measured ones")


def correlations(check: PredictiveCheck, rival: PredictiveCheck | None) -> str:
    """Correlations of the measured frequencies, and of new specimens' (medians), as matrices.

    Args:
        check: Of the likelihood that was sampled.
        rival: Of the paper's likelihood beside it, or None.
    """
    panels = {"measured specimens": check.correlation, "new specimens": check.correlation_median}
    if rival is not None:
        panels["new, independent frequencies"] = rival.correlation_median
    names = _short(check.mode_names)
    m, write = len(names), "{:.2f}".format
    with drawing(2.6 * len(panels) + 0.6, 2.9) as figure:
        drawn = None
        for axes, (title, matrix) in zip(
            figure.subplots(1, len(panels)), panels.items(), strict=True
        ):
            size = 8 if m <= 6 else 6.5
            drawn = draw_matrix(
                axes, matrix, colormaps["RdBu_r"], (-1, 1), write if m <= 8 else None, size
            )
            axes.set_title(title)
            axes.set_xticks(range(m), names)
            axes.set_yticks(range(m), names)
        figure.colorbar(drawn, ax=figure.axes, shrink=0.75, label="correlation")
        return to_svg(figure, "correlations", "Correlations of frequencies, as matrices")


def _short(names: Sequence[str]) -> list[str]:
    return [name.removeprefix("mode ") for name in names]


def scatter(check: PredictiveCheck, rival: PredictiveCheck | None) -> str:
    """Scatter of each frequency and correlation of each pair: new specimens, and the measured."""
    pair, names = np.triu_indices(len(check.sd), 1), _short(check.mode_names)
    both = [("new specimens, 90 %", check, CHOSEN)]
    if rival is not None:
        both.append(("new, independent frequencies, 90 %", rival, PLACEBO))
    couples = [f"{names[i]}, {names[j]}" for i, j in zip(*pair, strict=True)]
    with drawing(7.8, 3.1) as figure:
        left, right = figure.subplots(1, 2, width_ratios=[1, 1.6])
        for axes, key, pick, factor, ticks in (
            (left, "sd", slice(None), 100, names),
            (right, "correlation", pair, 1, couples),
        ):
            places = np.arange(len(ticks), dtype=float)
            own = {"color": NOMINAL, "ms": 15, "mew": 2.5, "label": "measured specimens"}
            axes.plot(places, factor * getattr(check, key)[pick], "_", **own)
            for k, (label, each, colour) in enumerate(both):
                low, median, high = (
                    factor * getattr(each, f"{key}_{part}")[pick]
                    for part in ("low", "median", "high")
                )
                at = places + 0.28 * (k - 0.5 * (len(both) - 1))
                axes.vlines(at, low, high, color=colour, lw=1.4, label=label)
                axes.plot(at, median, "o", color=colour, ms=4)
            axes.set_xticks(places, ticks, rotation=90 if axes is right else 0)
        left.set(ylabel="standard deviation of a frequency, %", xlabel="mode")
        left.set_ylim(bottom=0)
        right.set(ylabel="correlation", xlabel="modes")
        handles, labels = right.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=3)
        return to_svg(figure, "scatter", "Scatter and correlation: new specimens, measured ones")
