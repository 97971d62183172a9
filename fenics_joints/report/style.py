"""Charts for the report, as SVG to put into a page.

Text and axes take their colours from the page (CSS variables), so that a chart reads on a light and
on a dark page; only cells of a mesh are rasterised.
"""

from __future__ import annotations

import html
import io
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from fenics_joints.formatting import percent, prefixed

if TYPE_CHECKING:
    from fenics_joints.measurements.gap import Gap

__all__ = ["frequency_panels", "gap_bars", "new_figure", "parameter_panels", "style", "to_svg"]

#: Colours that the page replaces by its own, and those that suit light and dark pages alike.
_INK, _MUTED, _LINE, _PAPER = "#1b2027", "#5b6470", "#d3d8de", "#fdfdfc"
_PAGE = {_INK: "--ink", _MUTED: "--muted", _LINE: "--line", _PAPER: "--paper"}
CHOSEN, NOMINAL, PLACEBO, NOISE = "#2b7bba", "#8d949e", "#d9822b", "#4d9a6a"

_STYLE = {
    "font.size": 9.5,
    "font.family": "sans-serif",
    "svg.fonttype": "none",
    "svg.hashsalt": "fenics_joints",
    "text.color": _INK,
    "axes.labelcolor": _INK,
    "axes.edgecolor": _MUTED,
    "axes.facecolor": "none",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 10,
    "axes.grid": False,
    "grid.color": _LINE,
    "grid.linewidth": 0.7,
    "xtick.color": _MUTED,
    "ytick.color": _MUTED,
    "xtick.labelcolor": _INK,
    "ytick.labelcolor": _INK,
    "legend.frameon": False,
    "legend.labelcolor": _INK,
    "axes.unicode_minus": False,
}
_NO_METADATA = {"Date": None, "Creator": None, "Format": None, "Type": None}


def new_figure(width: float, height: float) -> Figure:
    """A transparent figure, inches, laid out so that nothing is cut off."""
    figure = Figure(figsize=(width, height), layout="constrained", facecolor="none")
    FigureCanvasAgg(figure)
    return figure


def style():
    """Context in which charts are drawn and saved."""
    return matplotlib.rc_context(_STYLE)


def to_svg(figure: Figure, name: str, alt: str, dpi: int = 150) -> str:
    """The figure as an ``<svg>`` element to put into a page. Call it within `style`.

    Args:
        figure: The figure.
        name: Unique in the page; prefix of the element's ids.
        alt: What the picture shows, in words.
        dpi: Resolution of its rasterised parts.
    """
    stream = io.StringIO()
    figure.savefig(stream, format="svg", dpi=dpi, transparent=True, metadata=_NO_METADATA)
    text = stream.getvalue()
    text = text[text.index("<svg") :].strip()
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = _unique_ids(text, name)
    for colour, variable in _PAGE.items():
        text = text.replace(colour, f"var({variable}, {colour})")
    # The page's own font; matplotlib's list would ask for what the reader may not have.
    text = re.sub(r"font-family: [^;\"]*", "font-family: inherit", text)
    label = html.escape(alt, quote=True)
    return re.sub(r"^<svg ", f'<svg role="img" aria-label="{label}" ', text, count=1)


def _unique_ids(text: str, name: str) -> str:
    """Drop ids that nothing refers to, and prefix the others: a page holds several pictures."""
    used = set(re.findall(r'(?:url\(#|href="#)([^)"]+)', text))

    def rename(match: re.Match) -> str:
        return f' id="{name}-{match[1]}"' if match[1] in used else ""

    text = re.sub(r' id="([^"]+)"', rename, text)
    return re.sub(r'(url\(#|href="#)', rf"\g<1>{name}-", text)


# -- gap -------------------------------------------------------------------------------------------


def gap_bars(groups: Sequence[tuple[str, Sequence[tuple[str, float, str]]]], noise: float) -> str:
    """Gaps as bars in groups, with the measurement's noise as a line.

    Args:
        groups: Name of the group, and its bars: label, relative gap, and kind, one of
            ``nominal``, ``placebo`` and ``chosen``. Bars that are nan are left out.
        noise: Root mean square of the measurement's standard deviation, relative.
    """
    colours = {"nominal": NOMINAL, "placebo": PLACEBO, "chosen": CHOSEN}
    groups = [(name, [b for b in bars if np.isfinite(b[1])]) for name, bars in groups]
    groups = [(name, bars) for name, bars in groups if bars]
    rows = sum(len(bars) for _, bars in groups)
    with style():
        figure = new_figure(7.6, 0.34 * rows + 0.42 * len(groups) + 0.55)
        axes = figure.subplots()
        y, ticks, labels, largest = 0.0, [], [], 100 * noise
        for name, bars in groups:
            axes.annotate(
                name, (0, y), (2, -2), textcoords="offset points", va="center", weight="bold"
            )
            y -= 0.9
            for label, value, kind in bars:
                axes.barh(y, 100 * value, 0.72, color=colours[kind])
                axes.annotate(
                    percent(value), (100 * max(value, noise), y), (6, 0),
                    textcoords="offset points", va="center",
                )  # fmt: skip
                ticks.append(y)
                labels.append(label)
                largest = max(largest, 100 * value)
                y -= 1
            # Only across the bars, so as not to strike through the group's name.
            axes.vlines(100 * noise, y + 0.5, y + len(bars) + 0.5, NOISE, (0, (4, 2)), lw=1.6)
            y -= 0.15
        axes.annotate(
            f"measurement noise {percent(noise)}", (100 * noise, y + 0.35), (5, 0),
            textcoords="offset points", color=NOISE, va="center", weight="bold",
        )  # fmt: skip
        axes.set_yticks(ticks, labels)
        axes.tick_params(axis="y", length=0)
        axes.set_xlim(0, 1.14 * largest)
        axes.set_ylim(y - 0.1, 0.5)
        axes.set_xlabel("gap: root mean square relative frequency error, %")
        words = "; ".join(
            f"{name}: " + ", ".join(f"{label} {percent(v)}" for label, v, _ in bars)
            for name, bars in groups
        )
        return to_svg(figure, "gap", f"Bars of the gap. {words}. Noise {percent(noise)}.")


# -- curves over the condition ---------------------------------------------------------------------


def frequency_panels(
    before: Gap | None,
    after: Gap,
    condition: tuple[str, str],
    *,
    labels: tuple[str, str] = ("nominal model", "model with the cause"),
    log_sd: np.ndarray | None = None,
    validation: tuple[Gap | None, Gap] | None = None,
    held_out: np.ndarray | None = None,
    name: str = "frequencies",
) -> str:
    """Measured and modelled frequencies against the condition, a panel for each mode.

    Args:
        before: The model before, or None.
        after: The model after.
        condition: Name and unit of the condition.
        labels: Names of the two models.
        log_sd: Standard deviations of the measured ln f, shape (n, m), for error bars of two.
        validation: Before and after on data that were never fitted.
        held_out: Conditions that were left out of the fit, shape (n,), bool: hollow points.
        name: Unique in the page.
    """
    m = len(after.mode_names)
    columns = 2 if m > 1 else 1
    rows = -(-m // columns)
    with style():
        figure = new_figure(7.6, 2.35 * rows + 0.5)
        panels = np.atleast_1d(figure.subplots(rows, columns, sharex=True, squeeze=False)).ravel()
        for i in range(m):
            _frequency_panel(panels[i], i, before, after, labels, log_sd, validation, held_out)
            panels[i].set_title(f"{after.mode_names[i]}, Hz", loc="left")
        for panel in panels[m:]:
            panel.set_visible(False)
        for panel in panels[max(m - columns, 0) : m]:
            panel.set_xlabel(_with_unit(*condition))
            panel.tick_params(labelbottom=True)
        handles, names = _legend_of(panels[:m])
        figure.legend(handles, names, loc="outside upper center", ncols=3)
        alt = (
            f"Frequency against {condition[0]} for {m} modes: measured points and the lines of "
            "the models; the numbers are in the tables of this page."
        )
        return to_svg(figure, name, alt)


def _frequency_panel(axes, i, before, after, labels, log_sd, validation, held_out) -> None:
    order = np.argsort(after.conditions)
    x, single = after.conditions[order], len(after.conditions) == 1
    measured = after.test_hz[order, i]
    sd = None if log_sd is None else 2 * np.asarray(log_sd)[order, i] * measured
    hollow = np.zeros(len(x), bool) if held_out is None else np.asarray(held_out)[order]
    shown = [(~hollow, _INK, "measured"), (hollow, "none", "measured, held out")]
    for mask, face, label in shown:
        if not mask.any():
            continue
        axes.errorbar(
            x[mask], measured[mask], None if sd is None else sd[mask], fmt="o", ms=4.2,
            color=_INK, mfc=face, elinewidth=0.9, capsize=2, zorder=4,
            label=label + ("" if sd is None else " (± 2 s.d.)"),
        )  # fmt: skip
    marks = [(before, NOMINAL, labels[0], (0, (5, 2)), "s"), (after, CHOSEN, labels[1], "-", "D")]
    for gap, colour, label, dashes, mark in marks:
        if gap is not None:
            line = mark if single else ""
            axes.plot(
                x, gap.model_hz[order, i], color=colour, ls=dashes, lw=1.8, marker=line, label=label
            )
    if validation is not None:
        _validation_points(axes, i, validation, labels)
    axes.grid(axis="y")
    axes.margins(x=0.05, y=0.1)


def _validation_points(axes, i, validation, labels) -> None:
    old, new = validation
    axes.plot(
        new.conditions, new.test_hz[:, i], "o", ms=6.5, mfc="none", color=_INK, zorder=4,
        label="measured, never fitted",
    )  # fmt: skip
    for gap, colour, label in ((old, NOMINAL, labels[0]), (new, CHOSEN, labels[1])):
        if gap is not None:
            axes.plot(
                gap.conditions, gap.model_hz[:, i], "x", ms=6.5, mew=2, color=colour, zorder=3,
                label=f"{label}, predicted",
            )  # fmt: skip


def _legend_of(panels) -> tuple[list, list[str]]:
    """Each label once, over all panels."""
    found: dict[str, object] = {}
    for panel in panels:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    names = sorted(found, key=lambda label: not label.startswith("measured"))
    return [found[label] for label in names], names


def _with_unit(name: str, unit: str) -> str:
    return f"{name}, {unit}" if unit else name


def parameter_panels(rows: Sequence[dict], condition: tuple[str, str]) -> str:
    """Fitted parameters against the condition with their curves, a logarithmic panel for each.

    Args:
        rows: For each parameter: ``name``, ``unit``, ``x``, ``value``, ``sd`` (relative), and
            ``held_out`` arrays of shape (n,), and ``curve``, arrays (x, value), or None.
        condition: Name and unit of the condition.
    """
    columns = 2 if len(rows) > 1 else 1
    n = -(-len(rows) // columns)
    with style():
        figure = new_figure(7.6, 2.2 * n + 0.5)
        panels = figure.subplots(n, columns, sharex=True, squeeze=False).ravel()
        for panel, row in zip(panels, rows, strict=False):
            _parameter_panel(panel, row)
        for panel in panels[len(rows) :]:
            panel.set_visible(False)
        for panel in panels[max(len(rows) - columns, 0) : len(rows)]:
            panel.set_xlabel(_with_unit(*condition))
            panel.tick_params(labelbottom=True)
        handles, names = _legend_of(panels[: len(rows)])
        figure.legend(handles, names, loc="outside upper center", ncols=3)
        names = ", ".join(row["name"] for row in rows)
        alt = f"{names} against {condition[0]}, identified at each and the curve through them."
        return to_svg(figure, "parameters", alt)


def _log_steps(values: np.ndarray) -> tuple[float, ...]:
    """Ticks within a decade: the fewer, the more decades there are."""
    decades = np.log10(np.nanmax(values) / np.nanmin(values))
    return (1.0, 2.0, 5.0) if decades < 2.0 else (1.0,)


def _parameter_panel(axes, row) -> None:
    x, value, held_out = (np.asarray(row[key]) for key in ("x", "value", "held_out"))
    factor, unit = prefixed(float(np.nanmedian(value)), row["unit"])
    value = factor * value
    sd = np.nan_to_num(np.clip(np.asarray(row["sd"], dtype=float), 0, 5))
    bars = np.array([value * (1 - np.exp(-2 * sd)), value * (np.exp(2 * sd) - 1)])
    shown = [(~held_out, CHOSEN, "fitted"), (held_out, "none", "identified, held out of the curve")]
    for mask, face, label in shown:
        if mask.any():
            axes.errorbar(
                x[mask], value[mask], bars[:, mask], fmt="o", ms=4.5, color=CHOSEN, mfc=face,
                elinewidth=0.9, capsize=2, label=f"{label} (± 2 s.d.)",
            )  # fmt: skip
    shown = value
    if row.get("curve") is not None:
        fine, curve = row["curve"]
        axes.plot(fine, factor * np.asarray(curve), color=_INK, lw=1.4, label="curve")
        shown = np.concatenate([value, factor * np.asarray(curve)])
    axes.set_yscale("log")
    # Limits by values and curve: the bars of what the data do not determine have no end.
    axes.set_ylim(np.nanmin(shown) / 2.5, np.nanmax(shown) * 2.5)
    axes.yaxis.set_major_locator(LogLocator(subs=_log_steps(shown)))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda tick, _: f"{tick:g}"))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.set_title(_with_unit(row["name"], unit), loc="left")
    axes.grid(axis="y")
