"""Page and summary of an update on frequencies."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from rich.console import Console
from rich.text import Text

from fenics_joints.commands.update.sweep import UpdateReport
from fenics_joints.formatting import condition_value, hertz, percent, quantity, spread
from fenics_joints.report.html import facts, heat_map, render, svg
from fenics_joints.report.panels import frequency_panels, parameter_panels
from fenics_joints.report.terminal import more, new_table, say

__all__ = ["curve_line", "parameter_rows", "show_update", "update_html"]

#: Rows of each table on the terminal.
_PARAMETERS, _MODES = 6, 10


def update_html(u: UpdateReport, *, log_sd: np.ndarray | None = None) -> str:
    """The result of an update as a page.

    Args:
        u: The result.
        log_sd: Standard deviations of the measured ln f over the torques, shape (n, m).

    Returns:
        HTML without any reference to other files.
    """
    curves = None
    if u.curve_frequencies is not None:
        curves = svg(
            frequency_panels(
                None, u.curve_frequencies, u.condition, labels=("", "model on the curves"),
                log_sd=log_sd, held_out=_held_out(u),
                validation=None if u.validation is None else (None, u.validation),
            )
        )  # fmt: skip
    panels = parameter_rows(u)
    identifiability = u.identifiability
    return render(
        "update.html",
        u=u,
        published=u.published,
        facts=facts(u.model),
        weakest=sorted(
            zip(identifiability.names, np.asarray(identifiability.weakest), strict=True),
            key=lambda pair: -abs(pair[1]),
        ),
        units={p["name"]: p["unit"] for p in u.parameters},
        panels=svg(parameter_panels(panels, u.condition)) if panels else None,
        curves=curves,
        curve_heat=None
        if u.curve_frequencies is None
        else heat_map(u.curve_frequencies),
    )


def _held_out(u: UpdateReport) -> np.ndarray:
    """Which rows of the curve's frequencies were left out of the curves, shape (n,)."""
    left = {fit["condition"] for fit in u.torque_fits if fit["held_out"]}
    return np.array([condition in left for condition in u.curve_frequencies.conditions])


def parameter_rows(u: UpdateReport) -> list[dict]:
    """What `parameter_panels` draws, a row for each parameter."""
    if len(u.torque_fits) < 2:
        return []
    fits = sorted(u.torque_fits, key=lambda fit: fit["condition"])
    x = np.array([fit["condition"] for fit in fits], dtype=float)
    by_name = {curve["name"]: curve for curve in u.curves}
    rows = []
    for parameter in u.parameters:
        name = parameter["name"]
        rows.append(
            {
                "name": name,
                "unit": parameter["unit"],
                "x": x,
                "value": np.array([fit["parameters"][name] for fit in fits]),
                "sd": np.array([fit["sd"].get(name, np.nan) for fit in fits], dtype=float),
                "held_out": np.array([bool(fit["held_out"]) for fit in fits]),
                "curve": curve_line(by_name.get(name), x),
            }
        )
    return rows


def curve_line(curve: Mapping | None, x: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Points on a parameter's curve, or None if it is not known how it runs.

    Args:
        curve: Row of ``UpdateReport.curves``. Its ``samples``, pairs (condition, value), are taken
            if it has any; a pure power law is evaluated; other formulas are not guessed at.
        x: Conditions to span, shape (n,), ascending.
    """
    if curve is None:
        return None
    if curve.get("samples"):
        points = np.asarray(curve["samples"], dtype=float)
        return points[:, 0], points[:, 1]
    if curve["form"] != "a (T/T0)^b" or np.any(x <= 0):
        return None
    fine = np.geomspace(x[0], x[-1], 60)
    return fine, curve["a"] * (fine / curve["T0"]) ** curve["b"]


def show_update(console: Console, u: UpdateReport) -> None:
    """Print the update: parameters, frequencies before and after, and the curves' gaps."""
    at = condition_value(u.at, u.condition[1])
    say(console, f"{u.title}: update at {u.condition[0]} {at}", "bold")
    gaps = f"gap {percent(u.gap_before.rms)} -> {percent(u.gap_after.rms)}"
    say(console, f"{gaps} in {u.iterations} model evaluations. {u.message}")
    console.print()
    table = new_table("parameter", ">start", ">identified", ">s.d.")
    for p in u.parameters[: _PARAMETERS]:
        start, value = (quantity(p[key], p["unit"]) for key in ("start", "value"))
        table.add_row(Text(p["name"]), start, value, spread(p["sd"]))
    more(table, len(u.parameters) - _PARAMETERS)
    console.print(table)
    console.print()
    table = new_table("mode", ">test, Hz", ">before, Hz", ">after, Hz", ">before", ">after")
    old, new = u.gap_before, u.gap_after
    for j, mode in enumerate(new.mode_names[:_MODES]):
        table.add_row(
            Text(mode), hertz(new.test_hz[0, j]), hertz(old.model_hz[0, j]),
            hertz(new.model_hz[0, j]), percent(old.relative[0, j], sign=True),
            percent(new.relative[0, j], sign=True),
        )  # fmt: skip
    more(table, len(new.mode_names) - _MODES)
    console.print(table)
    if u.identifiability.undetermined:
        words = ", ".join(u.identifiability.undetermined)
        say(console, f"not determined by these data: {words}", "yellow")
    if u.curves:
        console.print()
        gap = f"fitted {percent(u.curve_gap_fitted)}"
        if u.curve_gap_heldout is not None:
            gap += f", held out {percent(u.curve_gap_heldout)}"
        if u.curve_gap_validation is not None:
            gap += f", validation {percent(u.curve_gap_validation)}"
        say(console, f"curves over the {u.condition[0]}: gap {gap}")
