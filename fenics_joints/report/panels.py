"""Charts of panels and matrices: measured and modelled frequencies, parameters, their curves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.colors import Normalize
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from fenics_joints.formatting import prefixed
from fenics_joints.report.style import CHOSEN, INK, NOMINAL, drawing, grid, to_svg
from fenics_joints.report.tables import ink_on

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Colormap

    from fenics_joints.measurements.gap import Gap


def frequency_panels(
    before: Gap | None,
    after: Gap,
    condition: tuple[str, str],
    *,
    labels: tuple[str, str] = ("baseline model", "model with the cause"),
    log_sd: np.ndarray | None = None,
    validation: tuple[Gap | None, Gap] | None = None,
    held_out: np.ndarray | None = None,
    changed: np.ndarray | None = None,
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
        changed: Rows after a known change of the structure, shape (n,), bool: points of their own,
            beside the lines.
        name: Unique in the page.
    """

    def draw(panel, i: int) -> None:
        _frequency_panel(panel, i, before, after, labels, log_sd, held_out, changed)
        if validation is not None:
            _validation_points(panel, i, validation, labels)
        panel.margins(x=0.05, y=0.1)
        if len(at := np.unique(after.conditions)) == 1 and validation is None:
            panel.set_xticks(at)
        panel.set_title(f"{after.mode_names[i]}, Hz", loc="left")

    m = len(after.mode_names)
    alt = (
        f"Frequency against {condition[0]} for {m} modes: measured points and the lines of "
        "the models; the numbers are in the tables of this page."
    )
    return panel_chart(range(m), draw, name, alt, height=2.35, xlabel=with_unit(*condition))


def panel_chart(
    items: Sequence[object],
    draw: Callable[[Axes, object], None],
    name: str,
    alt: str,
    *,
    columns: int = 2,
    height: float = 2.2,
    width: float = 7.6,
    xlabel: str | None = None,
) -> str:
    """A panel for each of some items, in rows, with one legend for all.

    Args:
        items: What the panels show.
        draw: Called with each panel and its item.
        name: Unique in the page.
        alt: What the picture shows, in words.
        columns: In each row, at most.
        height: Of a row, inches.
        width: Of the picture, inches.
        xlabel: Of the axis that all panels share; None where each has its own.
    """
    columns = min(columns, len(items))
    with drawing(width, height * -(-len(items) // columns) + 0.5) as figure:
        panels = grid(figure, len(items), columns, xlabel)
        for panel, item in zip(panels, items, strict=True):
            draw(panel, item)
            panel.grid(axis="y")
        handles, names = _legend_of(panels)
        if handles:
            figure.legend(handles, names, loc="outside upper center", ncols=3)
        return to_svg(figure, name, alt)


def draw_matrix(
    axes: Axes,
    values: np.ndarray,
    colours: Colormap,
    limits: tuple[float, float],
    write: Callable[[float], str] | None = None,
    size: float = 8.5,
):
    """A matrix in colours, without the cells that are no number.

    Args:
        axes: Where.
        values: The matrix.
        colours: From the lower limit to the upper one.
        limits: Values at the ends of the colours.
        write: Makes the text in each cell; None for none.
        size: Of the font.

    Returns:
        The picture, for a colour bar.
    """
    drawn = axes.imshow(np.ma.masked_invalid(values), colours, Normalize(*limits, clip=True))
    for i, j in np.argwhere(np.isfinite(values)) if write is not None else ():
        ink = ink_on(drawn.to_rgba(values[i, j])[:3])
        centre = {"ha": "center", "va": "center", "fontsize": size, "color": ink}
        axes.text(j, i, write(values[i, j]), **centre)
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    return drawn


def _frequency_panel(axes, i, before, after, labels, log_sd, held_out, changed) -> None:
    n = len(after.conditions)
    changed = np.zeros(n, bool) if changed is None else np.asarray(changed)
    hollow = np.zeros(n, bool) if held_out is None else np.asarray(held_out)
    order = np.argsort(after.conditions, kind="stable")
    own, after_change = (order[mask[order]] for mask in (~changed, changed))
    _measured_points(axes, i, after, log_sd, own[~hollow[own]], "o", INK, "measured")
    _measured_points(axes, i, after, log_sd, own[hollow[own]], "o", "none", "measured, held out")
    _measured_points(axes, i, after, log_sd, after_change, "^", INK, "measured after the change")
    marks = [(before, NOMINAL, labels[0], (0, (5, 2)), "s"), (after, CHOSEN, labels[1], "-", "D")]
    for gap, colour, label, dashes, mark in marks:
        if gap is None:
            continue
        for rows, line, marker in (
            (own, dashes, mark if len(own) == 1 else ""),
            (after_change, "", mark),
        ):
            x, model = after.conditions[rows], gap.model_hz[rows, i]
            axes.plot(x, model, color=colour, ls=line, lw=1.8, marker=marker, label=label)


def _bars(axes, x, y, sd, face: str, label: str, mark: str = "o", colour: str = INK) -> None:
    """Points with bars of two standard deviations; ``sd`` None for points alone."""
    look = {"ms": 4.3, "color": colour, "mfc": face, "elinewidth": 0.9, "capsize": 2, "zorder": 4}
    label += "" if sd is None else " (± 2 s.d.)"
    axes.errorbar(x, y, sd, fmt=mark, label=label, **look)


def _measured_points(axes, i, gap, log_sd, rows, mark: str, face: str, label: str) -> None:
    if len(rows):
        measured = gap.test_hz[rows, i]
        sd = None if log_sd is None else 2 * np.asarray(log_sd)[rows, i] * measured
        _bars(axes, gap.conditions[rows], measured, sd, face, label, mark)


def _validation_points(axes, i, validation, labels) -> None:
    old, new = validation
    look = {"mfc": "none", "color": INK, "zorder": 4, "label": "measured, never fitted"}
    axes.plot(new.conditions, new.test_hz[:, i], "o", ms=6.5, **look)
    for gap, colour, label in ((old, NOMINAL, labels[0]), (new, CHOSEN, labels[1])):
        if gap is not None:
            look = {"color": colour, "zorder": 3, "label": f"{label}, predicted"}
            axes.plot(gap.conditions, gap.model_hz[:, i], "x", ms=6.5, mew=2, **look)


def _legend_of(panels) -> tuple[list, list[str]]:
    """Each label once, over all panels."""
    found: dict[str, object] = {}
    for panel in panels:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    names = sorted(found, key=lambda label: not label.startswith("measured"))
    return [found[label] for label in names], names


def with_unit(name: str, unit: str) -> str:
    """A heading or an axis such as ``torque, N·m``."""
    return f"{name}, {unit}" if unit else name


def parameter_panels(rows: Sequence[dict], condition: tuple[str, str]) -> str:
    """Fitted parameters against the condition with their curves, a logarithmic panel for each.

    Args:
        rows: For each parameter: ``name``, ``unit``, ``x``, ``value``, ``sd`` (relative), and
            ``held_out`` arrays of shape (n,), and ``curve``, arrays (x, value), or None.
        condition: Name and unit of the condition.
    """
    names = ", ".join(row["name"] for row in rows)
    alt = f"{names} against {condition[0]}, identified at each and the curve through them."
    return panel_chart(rows, _parameter_panel, "parameters", alt, xlabel=with_unit(*condition))


def plain_log(axis, values: np.ndarray) -> None:
    """A logarithmic axis whose ticks are plain numbers: the fewer, the more decades there are."""
    axis.axes.set_yscale("log")
    decades = np.log10(np.nanmax(values) / np.nanmin(values))
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if decades < 2.0 else (1.0,)))
    axis.set_major_formatter(FuncFormatter(lambda tick, _: f"{tick:g}"))
    axis.set_minor_locator(NullLocator())


def _parameter_panel(axes, row) -> None:
    x, value, held_out = (np.asarray(row[key]) for key in ("x", "value", "held_out"))
    factor, unit = prefixed(float(np.nanmedian(value)), row["unit"])
    value = factor * value
    sd = np.nan_to_num(np.clip(np.asarray(row["sd"], dtype=float), 0, 5))
    bars = np.array([value * (1 - np.exp(-2 * sd)), value * (np.exp(2 * sd) - 1)])
    shown = [(~held_out, CHOSEN, "fitted"), (held_out, "none", "identified, held out of the curve")]
    for mask, face, label in shown:
        if mask.any():
            _bars(axes, x[mask], value[mask], bars[:, mask], face, label, colour=CHOSEN)
    shown = value
    if row.get("curve") is not None:
        fine, curve = row["curve"]
        axes.plot(fine, factor * np.asarray(curve), color=INK, lw=1.4, label="curve")
        shown = np.concatenate([value, factor * np.asarray(curve)])
    plain_log(axes.yaxis, shown)
    # Limits by values and curve: the bars of what the data do not determine have no end.
    axes.set_ylim(np.nanmin(shown) / 2.5, np.nanmax(shown) * 2.5)
    axes.set_title(with_unit(row["name"], unit), loc="left")
