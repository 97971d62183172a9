"""Charts of an update to frequencies, shapes and functions."""

from __future__ import annotations

import numpy as np
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullFormatter

from fenics_joints.commands.update.result import Functions, UpdateReport
from fenics_joints.formatting import prefixed
from fenics_joints.report.style import CHOSEN, NOISE, NOMINAL, drawing, grid, to_svg

_INK, _MUTED, _LINE = "#1b2027", "#5b6470", "#d3d8de"
#: The model after lies on what was measured, and has to stand out from it.
_AFTER = "#f08a24"
#: Functions that get a panel, at most.
_PANELS = 6


def shown_functions(functions: Functions) -> list[tuple[int, int]]:
    """Which functions to draw: those held out, then those that are worst after, in their order."""
    measured = np.argwhere(~np.isnan(functions.measured[0]))
    error = functions.frac(functions.after)
    held = functions.held.all(axis=0)
    rank = sorted(measured.tolist(), key=lambda ij: (not held[tuple(ij)], error[tuple(ij)]))
    return sorted(tuple(ij) for ij in rank[:_PANELS])


def function_charts(functions: Functions) -> str:
    """Magnitudes of measured functions and of the model's, before and after, a panel for each."""
    shown = shown_functions(functions)
    columns = 2 if len(shown) > 1 else 1
    with drawing(8.6, 2.25 * -(-len(shown) // columns) + 0.7) as figure:
        panels = grid(figure, len(shown), columns, "frequency, Hz")
        for panel, (i, j) in zip(panels, shown, strict=True):
            _function(panel, functions, i, j)
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))
        alt = (
            f"Magnitude of {len(shown)} measured functions over frequency, with the model's before "
            "and after; the numbers are in the tables of this page."
        )
        return to_svg(figure, "functions", alt)


def _function(axes, functions: Functions, i: int, j: int) -> None:
    f, lines = functions.frequencies_hz, functions.lines & ~functions.held[:, i, j]
    measured = np.abs(functions.measured[:, i, j])
    axes.plot(
        f,
        np.abs(functions.before[:, i, j]),
        color=NOMINAL,
        lw=1.1,
        ls=(0, (4, 2)),
        label="model before",
    )
    axes.plot(f, measured, color=_INK, lw=2.4, label="measured")
    axes.plot(f, np.abs(functions.after[:, i, j]), color=_AFTER, lw=1.2, label="model after")
    axes.plot(
        f[lines],
        np.full(lines.sum(), 0.03),
        "|",
        ms=5,
        mew=0.8,
        color=CHOSEN,
        transform=axes.get_xaxis_transform(),
        label="line that was fitted",
    )
    held = functions.held[:, i, j]
    if held.all():
        axes.annotate(
            "held out: no line fitted",
            (1, 1),
            (-4, -4),
            xycoords="axes fraction",
            color=NOISE,
            textcoords="offset points",
            ha="right",
            va="top",
            weight="bold",
        )
    else:
        for low, high in _bands(f, held):
            axes.axvspan(low, high, color=NOISE, alpha=0.18, lw=0, label="held out")
    axes.set_yscale("log")
    axes.yaxis.set_minor_formatter(NullFormatter())
    inside = np.concatenate([measured, np.abs(functions.after[:, i, j])])
    axes.set_ylim(np.nanmin(inside) / 2, np.nanmax(inside) * 2)
    axes.set_xlim(f[0], f[-1])
    names = functions.names
    unit = functions.unit.replace("s2", "s²")
    axes.set_title(f"{names[0][i]} by {names[1][j]}, {unit}", loc="left")
    axes.grid(axis="y")


def _bands(f: np.ndarray, held: np.ndarray) -> list[tuple[float, float]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], held.astype(int), [0]])))
    return [(f[a], f[b - 1]) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def convergence_chart(report: UpdateReport) -> str:
    """Every parameter over the iterations, with its standard deviation at the end."""
    history, parameters = report.update.history, report.parameters
    values = np.array([i.values for i in history])
    moved = np.array([i.moved for i in history])
    columns = min(len(parameters), 4)
    with drawing(8.6, 1.9 * -(-len(parameters) // columns) + 0.5) as figure:
        panels = grid(figure, len(parameters), columns)
        for k, (panel, p) in enumerate(zip(panels, parameters, strict=True)):
            _parameter(panel, p, values[:, k], moved)
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))
        names = ", ".join(p["name"] for p in parameters)
        return to_svg(figure, "convergence", f"{names} over the iterations, from start to end.")


def _parameter(axes, p: dict, values: np.ndarray, moved: np.ndarray) -> None:
    factor, unit = prefixed(p["value"], p["unit"])
    step, shown = np.arange(len(values)), factor * values
    end, sd = factor * p["value"], p["sd"]
    if np.isfinite(sd):
        axes.axhspan(
            end * np.exp(-2 * min(sd, 3.0)),
            end * np.exp(2 * min(sd, 3.0)),
            color=CHOSEN,
            alpha=0.15,
            lw=0,
            label="± 2 s.d. at the end",
        )
    axes.plot(step, shown, color=_MUTED, lw=1.2)
    for mask, colour, label in (
        (moved, NOMINAL, "lines moved with the resonances"),
        (~moved, CHOSEN, "iteration"),
    ):
        if mask.any():
            axes.plot(step[mask], shown[mask], "o", ms=4, color=colour, label=label)
    low, high = shown.min(), shown.max()
    if low > 0 and high / low > 5:
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter(FuncFormatter(lambda tick, _: f"{tick:g}"))
        axes.yaxis.set_minor_formatter(NullFormatter())
        axes.set_ylim(low / 1.3, high * 1.3)
    else:
        room = 0.12 * max(high - low, 1e-3 * abs(high))
        axes.set_ylim(low - room, high + room)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=4))
    axes.set_title(f"{p['name']}{', ' + unit if unit else ''}", loc="left")
    axes.set_xlabel("step")
    axes.grid(axis="y")
