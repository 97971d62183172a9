"""The page of an update."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fenics_joints.commands.update.pictures import (
    convergence_chart,
    function_charts,
    shown_functions,
)
from fenics_joints.commands.update.result import Functions, UpdateReport
from fenics_joints.commands.update.view import shapes_view
from fenics_joints.commands.update.words import (
    accuracy,
    decibel,
    in_words,
    ratio_words,
    start_words,
)
from fenics_joints.formatting import condition_value
from fenics_joints.measurements.gap import rms
from fenics_joints.report.html import facts, heat_map, mac_cells, render, svg
from fenics_joints.report.panels import frequency_panels, parameter_panels

#: The method in words.
METHODS = {
    "log": "Maximum likelihood; frequencies, ratios and functions count by their logarithms",
    "weighted": "By the weighted equations of Machines 2022 (eqs. 15 to 20)",
}
_KINDS = {
    "frequencies": "frequencies",
    "shapes": "mode shapes",
    "damping": "damping ratios",
    "frfs": "functions",
}


def update_page(r: UpdateReport) -> str:
    """The result of an update as a page that needs nothing else."""
    functions, modes = r.functions, r.modes
    macs = (
        None
        if modes is None or modes.mac_after is None
        else [("Before", mac_cells(modes.mac_before)), ("After", mac_cells(modes.mac_after))]
    )
    found, view, stills = r.update.identifiability, None, []
    words = (
        in_words(found)
        if r.failure is None
        else ["This fit explains nothing of the test: do not use its values."]
    )
    if r.shapes is not None and modes is not None:
        best = None if modes.mac_after is None else np.diag(modes.mac_after)
        view, stills = shapes_view(r.shapes, modes.names, best)
    return render(
        "update.html",
        view=view,
        stills=stills,
        r=r,
        u=r.update,
        method=METHODS[r.update.method],
        data=data_words(r),
        at=at_words(r),
        words=words,
        verdict=verdict_words(r),
        pull=start_words(found, r.pull),
        levels=None if functions is None else functions.summary(),
        decibel=decibel,
        accuracy=accuracy,
        functions=functions,
        chart=None if functions is None else svg(function_charts(functions)),
        shown=0 if functions is None else len(shown_functions(functions)),
        rows=[] if functions is None else _function_rows(functions),
        modes=modes,
        rms=None if modes is None else modes.rms(),
        macs=macs,
        held=r.held,
        ratio=ratio_words,
        damping=None if modes is None else modes.damping,
        held_rms=rms(np.array([h.error for h in r.held])) if r.held else None,
        theirs=theirs(r),
        published=r.published,
        convergence=svg(convergence_chart(r)),
        conditions=r.conditions,
        misfit=_misfit(r),
        facts=_facts(r),
        sweep=_sweep(r),
        weakest=sorted(
            zip(found.names, found.weakest, strict=True), key=lambda pair: -abs(pair[1])
        ),
    )


def _sweep(r: UpdateReport) -> dict[str, object] | None:
    """What the page shows of all conditions."""
    if r.sweep is None:
        return None
    name, _, unit = r.condition
    panels, on = parameter_rows(r), r.sweep.frequencies
    shown = {
        "fits": r.sweep.fits,
        "curves": r.sweep.curves,
        "gaps": r.sweep.gaps(),
        "on": on,
        "validation": r.sweep.validation,
        "condition": (name, unit),
        "units": {p["name"]: p["unit"] for p in r.parameters},
        "panels": svg(parameter_panels(panels, (name, unit))) if panels else None,
        "picture": None,
    }
    if on is None:
        return shown
    picture = frequency_panels(
        None,
        on,
        (name, unit),
        labels=("", "model on the curves"),
        log_sd=r.sweep.log_sd,
        held_out=r.sweep.held_out,
        validation=None if r.sweep.validation is None else (None, r.sweep.validation),
    )
    return {**shown, "picture": svg(picture), "heat": heat_map(on)}


def data_words(r: UpdateReport) -> str:
    """The kinds of data, such as ``frequencies and functions``."""
    *others, last = [_KINDS[kind] for kind in r.kinds]
    return f"{', '.join(others)} and {last}" if others else last


def verdict_words(r: UpdateReport) -> str:
    """Errors before and after in a sentence; the MAC where shapes alone are data."""
    found = r.changes()
    if not found:
        return ""
    (what, before, after), *others = found
    if "MAC" in what:
        return f"The {what} {before} -> {after}."
    words = [f"The error of the {what} went from {before} to {after}"]
    words += [f"that of the {what} from {before} to {after}" for what, before, after in others]
    return f"{', '.join(words)}."


def at_words(r: UpdateReport) -> str:
    """The condition, such as ``torque 20 N·m``; empty without one."""
    if r.condition is None:
        return ""
    name, value, unit = r.condition
    return f"{name} {condition_value(value, unit)}"


def parameter_rows(r: UpdateReport) -> list[dict]:
    """What `parameter_panels` draws, a row for each parameter."""
    if r.sweep is None or len(r.sweep.fits) < 2:
        return []
    fits = sorted(r.sweep.fits, key=lambda fit: fit["condition"])
    x = np.array([fit["condition"] for fit in fits], dtype=float)
    by_name = {curve["name"]: curve for curve in r.sweep.curves}
    rows = []
    for parameter in r.parameters:
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
        curve: Row of ``Sweep.curves``. Its ``samples``, pairs (condition, value), are taken
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


def _misfit(r: UpdateReport) -> float | None:
    """Root mean square of the residuals in standard deviations; 1 if noise is all there is."""
    dof = r.update.degrees_of_freedom
    return float(np.sqrt(r.update.chi2 / dof)) if dof > 0 and np.isfinite(r.update.chi2) else None


def _function_rows(functions: Functions) -> list[dict]:
    rows = []
    before, after = functions.frac(functions.before), functions.frac(functions.after)
    for i, j in np.argwhere(~np.isnan(functions.measured[0])):
        one = np.zeros(functions.measured.shape, dtype=bool)
        one[:, i, j] = True
        rows.append(
            {
                "response": functions.names[0][i],
                "reference": functions.names[1][j],
                "before": decibel(functions.decibels(functions.before, one)),
                "after": decibel(functions.decibels(functions.after, one)),
                "frac_before": f"{before[i, j]:.3f}",
                "frac_after": f"{after[i, j]:.3f}",
                "held": bool(functions.held[:, i, j].all()),
            }
        )
    return rows


def theirs(r: UpdateReport) -> dict[str, float]:
    """Errors of the published frequencies, model over test minus one, by mode."""
    if r.published is None or r.modes is None:
        return {}
    return {
        name: f / test - 1
        for name, f, test in zip(
            r.modes.names, r.published["frequencies_hz"], r.modes.test, strict=False
        )
        if f is not None
    }


#: Facts that only this page has, in words.
_OWN = {
    "lines_fitted": "lines of the functions that were fitted",
    "lines_measured": "measured lines",
    "functions": "measured functions",
    "function_error": "largest error of the reduced model's functions against the full one's",
    "function_noise": "relative standard deviation of the functions, median",
    "damping_error": "largest error of the reduced model's damping ratios against the full one's",
    "solution_error": "largest error of the drawn functions against a direct solution, two lines",
}


def _facts(r: UpdateReport) -> list[tuple[str, str]]:
    own = {key: value for key, value in r.model.items() if key in _OWN}
    rest = {key: value for key, value in r.model.items() if key not in _OWN}
    return [*facts(rest), *((_OWN[key], str(value)) for key, value in own.items())]
