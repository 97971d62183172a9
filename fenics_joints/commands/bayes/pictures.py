"""Pictures of chains, by ArviZ, and of what they predict, as SVG for a page."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping

import matplotlib
import numpy as np
from matplotlib.ticker import FuncFormatter, MaxNLocator

from fenics_joints.bayes.arviz_files import draw
from fenics_joints.bayes.chains import Chains
from fenics_joints.bayes.predictive import PredictiveCheck
from fenics_joints.commands.bayes.model import HeldModes
from fenics_joints.formatting import prefixed
from fenics_joints.report.style import CHOSEN, NOMINAL, PLACEBO, drawing, style, to_svg

#: Draws of a chain that are shown: more would only make the page larger. Quantities in a grid, and
#: against each other; columns of a grid.
_SHOWN, _PAIRS, _MOST, _AGAINST, _COLUMNS = 600, 300, 12, 6, 3
#: Letters of a line of a label in a panel of pairs.
_WIDE = 17


class Shown:
    """Chains in pictures, each quantity with its unit.

    Args:
        chains: The draws.
        units: Units of the quantities by name; those without one are ratios.
    """

    def __init__(self, chains: Chains, units: Mapping[str, str]):
        self.n_draws = chains.values.shape[1]
        self.draws: dict[str, np.ndarray] = {}
        for name, values in list(chains.by_name().items())[:_MOST]:
            factor, label = _labelled(name, values, units.get(name, ""))
            # ArviZ takes a slash for a path: N/m with a division slash instead.
            label = label.replace("/", "\N{DIVISION SLASH}")
            self.draws[label] = factor * values

    def traces(self) -> str:
        """Draws in their order, by chain."""
        return self._grid(
            "trace", _SHOWN, "Draws of each quantity in their order, a colour for each chain"
        )

    def effective(self) -> str | None:
        """Effective sample sizes at each quantile; None for too few draws."""
        if self.n_draws < 50:
            return None
        return self._grid("ess", self.n_draws, "Effective sample size at each quantile")

    def pairs(self) -> str | None:
        """Draws of each two quantities; None for a single one."""
        names = list(self.draws)[:_AGAINST]
        if len(names) < 2:
            return None
        size = (1.45 * len(names) + 0.6,) * 2
        return self._drawn(
            "pair", names, _PAIRS, len(names), size, "Draws of each two quantities against another"
        )

    def _grid(self, kind: str, shown: int, alt: str) -> str:
        count = len(self.draws)
        columns = min(_COLUMNS, count)
        size = (2.75 * columns, 1.65 * -(-count // columns) + 0.4)
        return self._drawn(kind, list(self.draws), shown, columns, size, alt)

    def _drawn(self, kind: str, names, shown: int, columns: int, size, alt: str) -> str:
        from matplotlib import pyplot

        every = -(-self.n_draws // shown)
        with style(), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            before = set(pyplot.get_fignums())
            draw(kind, {n: self.draws[n][:, ::every] for n in names}, columns, size)
            made = [n for n in pyplot.get_fignums() if n not in before]
            figure = pyplot.figure(made[-1])
            figure.set_layout_engine("constrained")
            _tidied(figure, kind, len(names), columns, every)
            text = to_svg(figure, kind, alt, dpi=90)
            for n in made:
                pyplot.close(n)
        return text


def _tidied(figure, kind: str, count: int, columns: int, every: int) -> None:
    """Points and lines as pixels, thin; labels once where all panels have the same."""
    ink = matplotlib.rcParams["text.color"]
    for i, axes in enumerate(figure.axes):
        for artist in (*axes.lines, *axes.collections):
            artist.set_rasterized(True)
        for text in (axes.title, axes.xaxis.label, axes.yaxis.label):
            text.set_color(ink)
        if kind == "pair":
            _tidied_pair(axes)
            continue
        for line in axes.lines if kind == "trace" else ():
            line.set(linewidth=0.5, alpha=0.7)
        if kind == "trace" and axes.get_xlabel():
            axes.set_xlabel("draw" if every == 1 else f"draw, one in {every}")
        if i + columns < count:
            axes.set_xlabel("")
        if kind == "ess":
            axes.set_ylim(bottom=0)
            axes.set_ylabel("" if i % columns else "ESS")


def _wrapped(label: str) -> str:
    """A label in lines that fit a panel, broken where a name or a sentence may be."""
    lines = [""]
    for part in re.findall(r"[^ ._]+[ ._]*", label):
        if lines[-1] and len(lines[-1] + part.rstrip()) > _WIDE:
            lines.append("")
        lines[-1] += part
    return "\n".join(line.rstrip() for line in lines)


def _tidied_pair(axes) -> None:
    for artist in (*axes.lines, *axes.collections):
        artist.set_color(CHOSEN)  # of pixels, which take no colour from the page
    for text in (axes.xaxis.label, axes.yaxis.label):
        text.set_text(_wrapped(text.get_text()))
        text.set_fontsize(8)
    for axis in (axes.xaxis, axes.yaxis):  # a power of ten beside an axis would be over a label
        axis.set_major_formatter(FuncFormatter(lambda tick, _: f"{tick:.6g}"))
    axes.tick_params(labelsize=7)
    axes.xaxis.set_major_locator(MaxNLocator(2))
    for points in axes.collections:
        points.set(sizes=[4], alpha=0.4)
    if not axes.collections:  # a density, whose height says nothing
        axes.set_yticks([])
        return
    axes.yaxis.set_major_locator(MaxNLocator(3))
    if not axes.get_subplotspec().is_first_col():
        axes.tick_params(labelleft=False)


def _labelled(name: str, values: np.ndarray, unit: str) -> tuple[float, str]:
    """Factor and name for the axes: ``lap.k1, kN·m``; small ratios in per cent."""
    typical = float(np.median(np.abs(values)))
    if unit:
        factor, unit = prefixed(typical, unit)
        return factor, f"{name}, {unit}"
    return (100.0, f"{name}, %") if typical < 0.1 and "correlation" not in name else (1.0, name)


def frequencies(
    mode_names,
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
    rows = [
        (n, f, s, draws, CHOSEN)
        for n, f, s, draws in zip(mode_names, measured_hz, sd, predicted_hz.T, strict=True)
        if np.isfinite(f)
    ]
    if held is not None:
        rows += [
            (f"{n}, held out", f, s, draws, PLACEBO)
            for n, f, s, draws in zip(
                held.mode_names,
                held.measured_hz,
                held.measured_sd,
                held.predicted_hz.T,
                strict=True,
            )
            if np.isfinite(f)
        ]
    with drawing(7.8, 0.32 * len(rows) + 1.2) as figure:
        axes, y = figure.subplots(), -np.arange(len(rows), dtype=float)
        axes.axvline(0, color=NOMINAL, lw=0.8)
        said = set()
        for at, (_, f, s, draws, colour) in zip(y, rows, strict=True):
            off = 100 * (draws / f - 1)
            low, quarter, median, three, high = np.quantile(off, [0.05, 0.25, 0.5, 0.75, 0.95])
            if np.isfinite(s):
                axes.plot(
                    200 * s * np.array([-1, 1]),
                    [at] * 2,
                    color=NOMINAL,
                    lw=7,
                    alpha=0.35,
                    solid_capstyle="butt",
                    label="measured, 95 %" if "sd" not in said else None,
                )
                said.add("sd")
            words = "predicted, 90 %" + (", held out" if colour == PLACEBO else "")
            axes.hlines(
                at, low, high, color=colour, lw=1.2, label=words if words not in said else None
            )
            axes.hlines(at, quarter, three, color=colour, lw=4)
            axes.plot(median, at, "o", color=colour, ms=5)
            said.add(words)
        axes.set_yticks(y, [row[0] for row in rows])
        axes.set_ylim(y[-1] - 0.6, 0.6)
        axes.set_xlabel("predicted over measured frequency less one, %")
        figure.legend(loc="outside upper center", ncols=3)
        return to_svg(figure, "frequencies", "Predicted frequencies relative to the measured ones")


def correlations(check: PredictiveCheck, rival: PredictiveCheck | None) -> str:
    """Correlations of the measured frequencies, and of new specimens' (medians), as matrices.

    Args:
        check: Of the likelihood that was sampled.
        rival: Of the paper's likelihood beside it, or None.
    """
    panels = [
        ("measured specimens", check.correlation),
        ("new specimens", check.correlation_median),
    ]
    if rival is not None:
        panels.append(("new, independent frequencies", rival.correlation_median))
    m = len(check.sd)
    with drawing(2.6 * len(panels) + 0.6, 2.9) as figure:
        drawn = None
        for axes, (title, matrix) in zip(figure.subplots(1, len(panels)), panels, strict=True):
            drawn = axes.imshow(matrix, cmap="RdBu_r", vmin=-1, vmax=1)
            for i in range(m):
                for j in range(m):
                    dark = abs(matrix[i, j]) > 0.6
                    if m <= 8:
                        axes.text(
                            j,
                            i,
                            f"{matrix[i, j]:.2f}",
                            ha="center",
                            va="center",
                            fontsize=8 if m <= 6 else 6.5,
                            color="#ffffff" if dark else "#000000",
                        )
            axes.set_title(title)
            axes.set_xticks(range(m), _short(check.mode_names))
            axes.set_yticks(range(m), _short(check.mode_names))
            axes.tick_params(length=0)
            axes.spines[:].set_visible(False)
        figure.colorbar(drawn, ax=figure.axes, shrink=0.75, label="correlation")
        return to_svg(figure, "correlations", "Correlations of frequencies, as matrices")


def _short(names) -> list[str]:
    return [name.removeprefix("mode ") for name in names]


def scatter(check: PredictiveCheck, rival: PredictiveCheck | None) -> str:
    """Scatter of each frequency and correlation of each pair: new specimens, and the measured."""
    first, second = np.triu_indices(len(check.sd), 1)
    short = _short(check.mode_names)
    both = [("new specimens, 90 %", check, CHOSEN)]
    if rival is not None:
        both.append(("new, independent frequencies, 90 %", rival, PLACEBO))
    with drawing(7.8, 3.1) as figure:
        left, right = figure.subplots(1, 2, width_ratios=[1, 1.6])
        for axes, own, keys, names in (
            (left, 100 * check.sd, ("sd_low", "sd_median", "sd_high"), short),
            (
                right,
                check.correlation[first, second],
                ("correlation_low", "correlation_median", "correlation_high"),
                [f"{short[i]}, {short[j]}" for i, j in zip(first, second, strict=True)],
            ),
        ):
            places = np.arange(len(own), dtype=float)
            axes.plot(places, own, "_", color=NOMINAL, ms=15, mew=2.5, label="measured specimens")
            for k, (label, each, colour) in enumerate(both):
                low, median, high = (getattr(each, key) for key in keys)
                if axes is right:
                    low, median, high = (a[first, second] for a in (low, median, high))
                else:
                    low, median, high = (100 * a for a in (low, median, high))
                at = places + 0.28 * (k - 0.5 * (len(both) - 1))
                axes.vlines(at, low, high, color=colour, lw=1.4, label=label)
                axes.plot(at, median, "o", color=colour, ms=4)
            axes.set_xticks(places, names, rotation=90 if axes is right else 0)
        left.set_ylabel("standard deviation of a frequency, %")
        left.set_ylim(bottom=0)
        left.set_xlabel("mode")
        right.set_ylabel("correlation")
        right.set_xlabel("modes")
        handles, labels = right.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=3)
        return to_svg(figure, "scatter", "Scatter and correlation: new specimens, measured ones")
