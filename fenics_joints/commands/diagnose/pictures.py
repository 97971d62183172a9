"""Pictures of a diagnosis that no other page has."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from fenics_joints.diagnosis.result import Diagnosis
from fenics_joints.diagnosis.shrinkage import Shrinkage
from fenics_joints.formatting import error_percent, percent
from fenics_joints.report.style import CHOSEN, INK, NOISE, NOMINAL, PLACEBO, drawing, to_svg

#: What was stated before, behind what was found.
_STATED = "#b9d4ea"
#: Relative error at which a bar ends: a longer one would hide the others.
_LONGEST = 1.0


def forecasts(s: Shrinkage) -> str:
    """Errors on held-out data, fold by fold: as stated before they were looked at, and as found.

    Args:
        s: The folds.
    """
    with drawing(7.6, 0.36 * len(s.folds) + 1.2) as figure:
        axes = figure.subplots()
        for y, fold in enumerate(s.folds):
            low, high = (100 * x for x in fold.predicted_after)
            axes.barh(y, high - low, 0.62, left=low, color=_STATED, zorder=1)
            axes.vlines(100 * fold.noise, y - 0.34, y + 0.34, NOISE, lw=1.8, zorder=2)
            for value, mark, colour in (
                (fold.before, "s", NOMINAL),
                (fold.placebo, "X", PLACEBO),
                (fold.after, "o", CHOSEN),
            ):
                axes.plot(100 * value, y, mark, ms=6.5, color=colour, zorder=3)
        axes.set_yticks(range(len(s.folds)), [fold.name for fold in s.folds])
        axes.tick_params(axis="y", length=0)
        axes.invert_yaxis()
        _axis(axes, s)
        figure.legend(handles=_legend(), loc="outside upper left", ncols=3)
        return to_svg(figure, "forecasts", _in_words(s))


def _axis(axes, s: Shrinkage) -> None:
    """Logarithmic where errors differ by more than a decade, since all of them matter."""
    values = 100 * np.array([[f.before, f.after, f.placebo, f.noise] for f in s.folds])
    values = values[np.isfinite(values) & (values > 0)]
    if len(values) and values.max() > 10 * values.min():
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
        # An interval may reach far below noise, which shows nothing.
        axes.set_xlim(0.6 * values.min(), None)
    axes.grid(axis="x")
    axes.set_axisbelow(True)
    axes.set_xlabel("error on held-out data, % (root mean square, relative)")


def _legend() -> list:
    def mark(symbol: str, colour: str, label: str) -> Line2D:
        return Line2D([], [], ls="", marker=symbol, ms=6.5, color=colour, label=label)

    return [
        mark("s", NOMINAL, "baseline model"),
        mark("X", PLACEBO, "placebo"),
        mark("o", CHOSEN, "cause chosen without these data"),
        Patch(color=_STATED, label="its predicted interval (90 %)"),
        Line2D([], [], color=NOISE, lw=1.8, label="noise"),
    ]


def _in_words(s: Shrinkage) -> str:
    rows = [
        f"{f.name}: {error_percent(f.before)} to {error_percent(f.after)}, predicted "
        f"{error_percent(f.predicted_after[0])} to {error_percent(f.predicted_after[1])}"
        for f in s.folds
    ]
    return f"Errors on held-out data, before and after, by fold. {'; '.join(rows)}."


def gap_bars(rows: Sequence[tuple[str, float, float, float]], noise: float) -> str:
    """Errors as bars in groups, with the measurement's noise as a line.

    Args:
        rows: Name of the data, and the relative errors of the baseline model, of the placebo and
            with the cause. A bar that is nan is left out.
        noise: Root mean square of the measurement's standard deviation, relative.
    """
    kinds = (("baseline model", NOMINAL), ("placebo", PLACEBO), ("with the cause", CHOSEN))
    groups = []
    for name, *gaps in rows:
        pairs = zip(kinds, gaps, strict=True)
        bars = [(label, gap, colour) for (label, colour), gap in pairs if np.isfinite(gap)]
        if bars:
            groups.append((name, bars))
    count = sum(len(bars) for _, bars in groups)
    with drawing(7.6, 0.34 * count + 0.42 * len(groups) + 0.55) as figure:
        axes = figure.subplots()
        y, ticks, labels, largest = 0.0, [], [], 100 * noise
        for name, bars in groups:
            axes.annotate(
                name, (0, y), (2, -2), textcoords="offset points", va="center", weight="bold"
            )
            y -= 0.9
            for label, value, colour in bars:
                shown = min(value, _LONGEST)
                axes.barh(y, 100 * shown, 0.72, color=colour)
                axes.annotate(
                    error_percent(value),
                    (100 * max(shown, noise), y),
                    (6, 0),
                    textcoords="offset points",
                    va="center",
                )
                ticks.append(y)
                labels.append(label)
                largest = max(largest, 100 * shown)
                y -= 1
            # Only across the bars, so as not to strike through the group's name.
            axes.vlines(100 * noise, y + 0.5, y + len(bars) + 0.5, NOISE, (0, (4, 2)), lw=1.6)
            y -= 0.15
        axes.annotate(
            f"measurement noise {percent(noise)}",
            (100 * noise, y + 0.35),
            (5, 0),
            textcoords="offset points",
            color=NOISE,
            va="center",
            weight="bold",
        )
        axes.set_yticks(ticks, labels)
        axes.tick_params(axis="y", length=0)
        axes.set_xlim(0, 1.14 * largest)
        axes.set_ylim(y - 0.1, 0.5)
        axes.set_xlabel("RMS relative frequency error, %")
        words = "; ".join(
            f"{name}: " + ", ".join(f"{label} {error_percent(v)}" for label, v, _ in bars)
            for name, bars in groups
        )
        return to_svg(figure, "gap", f"Bars of the error. {words}. Noise {percent(noise)}.")


def level_panels(d: Diagnosis, log_sd: np.ndarray | None) -> str | None:
    """Frequency and damping of every mode over the level, measured and of the leading hypothesis.

    Args:
        d: The diagnosis of a test by level.
        log_sd: Standard deviations of the measured ln f, shape (n, m), for error bars of two.

    Returns:
        None where no mode was measured at two levels.
    """
    there = np.isfinite(d.after.test_hz)
    shown = np.flatnonzero(there.sum(axis=0) > 1)
    if not d.by_level or not len(shown):
        return None
    levels, columns = d.after.conditions, 1 if d.damping is None else 2
    with drawing(7.6, 2.3 * len(shown) + 0.5) as figure:
        grid = figure.subplots(len(shown), columns, squeeze=False)
        for row, i in zip(grid, shown, strict=True):
            at, name = there[:, i], d.after.mode_names[i]
            sd = None if log_sd is None else 2 * log_sd[at, i] * d.after.test_hz[at, i]
            pair = d.after.test_hz[at, i], d.after.model_hz[at, i]
            _over_level(row[0], levels[at], *pair, sd, f"{name}, Hz")
            if columns > 1:
                measured, model = (100 * ratios[at, i] for ratios in d.damping)
                _over_level(row[1], levels[at], measured, model, None, f"{name}, damping, %")
        for axes in grid[-1]:
            axes.set_xlabel(", ".join(word for word in d.condition if word))
        figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
        names = ", ".join(d.after.mode_names[i] for i in shown)
        kinds = f"Frequency{' and damping' * (columns > 1)}"
        alt = f"{kinds} of {names} over the level; the numbers are in the tables of this page."
        return to_svg(figure, "levels", alt)


def _over_level(axes, x, measured, model, sd, title: str) -> None:
    style = {"fmt": "o", "ms": 4.2, "color": INK, "elinewidth": 0.9, "capsize": 2, "zorder": 4}
    label = "measured" if sd is None else "measured (± 2 s.d.)"
    axes.errorbar(x, measured, sd, label=label, **style)
    axes.plot(x, model, color=CHOSEN, lw=1.8, label="leading hypothesis")
    axes.set_title(title, loc="left")
    axes.ticklabel_format(axis="y", useOffset=False)
    axes.grid(axis="y")
    axes.margins(x=0.05, y=0.1)
