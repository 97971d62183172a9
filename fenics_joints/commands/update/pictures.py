"""Charts of an update: measured functions beside the model's, and the parameters' way."""

from __future__ import annotations

import numpy as np
from matplotlib.ticker import MaxNLocator

from fenics_joints.commands.update.result import Functions, UpdateReport
from fenics_joints.formatting import prefixed
from fenics_joints.report.chart import Curve, curve_chart
from fenics_joints.report.document import View
from fenics_joints.report.panels import panel_chart, plain_log, with_unit
from fenics_joints.report.style import CHOSEN, NOISE, NOMINAL

#: The model after lies on what was measured, and has to stand out from it.
_AFTER = "#f08a24"
#: Functions that get a panel, at most; more would fill pages.
_PANELS = 6
#: Highest over lowest value from which a parameter's axis is logarithmic; nothing depends on it.
_LOGARITHMIC = 5.0


def shown_functions(functions: Functions) -> list[tuple[int, int]]:
    """Which functions to draw: those held out, then those that are worst after, in their order."""
    measured = np.argwhere(~np.isnan(functions.measured[0]))
    error = functions.frac(functions.after)
    held = functions.held.all(axis=0)
    rank = sorted(measured.tolist(), key=lambda ij: (not held[tuple(ij)], error[tuple(ij)]))
    return sorted(tuple(ij) for ij in rank[:_PANELS])


def function_charts(functions: Functions) -> View:
    """Magnitudes of measured FRFs and of the model's, before and after, a panel for each."""
    f, shown, curves, panels = functions.frequencies_hz, shown_functions(functions), [], []
    unit = functions.unit.replace("s2", "s²")
    for panel, (i, j) in enumerate(shown):
        at = (slice(None), i, j)
        held, lines = functions.held[at], functions.lines & ~functions.held[at]
        before, measured, after = (
            np.abs(H[at]) for H in (functions.before, functions.measured, functions.after)
        )
        floor = np.full(len(f), np.nanmin(np.concatenate([measured, after])) / 1.5)
        for curve in (
            Curve("model before", f, before, NOMINAL, 1.1, (4, 2), panel=panel),
            Curve("measured", f, measured, width=2.4, panel=panel),
            Curve("model after", f, after, _AFTER, 1.2, panel=panel),
            Curve("fitted lines", f[lines], floor[lines], CHOSEN, 0, mark="|", panel=panel),
            Curve("held out", f, np.where(held, floor, np.nan), NOISE, 5.0, panel=panel),
        ):
            curves += [curve] if np.isfinite(curve.y).any() else []
        words = " (held out: no line fitted)" if held.all() else ""
        panels.append(f"{functions.names[0][i]} by {functions.names[1][j]}, {unit}{words}")
    alt = (
        f"Magnitude of {len(shown)} measured FRFs over frequency, with the model's before and "
        "after; the numbers are in the tables of this page."
    )
    look = {"file": "frfs", "log": (False, True), "size": (8.6, 2.25)}
    return curve_chart(curves, "frequency, Hz", panels, alt, **look)


def convergence_chart(report: UpdateReport) -> str:
    """Every parameter over the iterations, with its standard deviation at the end."""
    history, parameters = report.update.history, report.parameters
    moved = np.array([i.moved for i in history])

    def draw(axes, k: int) -> None:
        p = parameters[k]
        factor, unit = prefixed(p["value"], p["unit"])
        step, shown = np.arange(len(history)), factor * np.array([i.values[k] for i in history])
        end, sd = factor * p["value"], p["relative_standard_deviation"]
        if np.isfinite(sd):
            span = end * np.exp(np.array([-2, 2]) * min(sd, 3.0))
            axes.axhspan(*span, color=CHOSEN, alpha=0.15, lw=0, label="± 2 s.d. at the end")
        axes.plot(step, shown, color=NOMINAL, lw=1.2)
        for mask, colour, label in (
            (moved, NOMINAL, "lines moved with the resonances"),
            (~moved, CHOSEN, "iteration"),
        ):
            if mask.any():
                axes.plot(step[mask], shown[mask], "o", ms=4, color=colour, label=label)
        low, high = shown.min(), shown.max()
        if low > 0 and high / low > _LOGARITHMIC:
            plain_log(axes.yaxis, shown)
            axes.set_ylim(low / 1.3, high * 1.3)
        else:
            room = 0.12 * max(high - low, 1e-3 * abs(high))
            axes.set_ylim(low - room, high + room)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=4))
        axes.set_title(with_unit(p["name"], unit), loc="left")
        axes.set_xlabel("step")

    names = ", ".join(p["name"] for p in parameters)
    alt = f"{names} over the iterations, from start to end."
    size = {"width": 8.6, "height": 1.9, "columns": 4}
    return panel_chart(range(len(parameters)), draw, "convergence", alt, **size)
