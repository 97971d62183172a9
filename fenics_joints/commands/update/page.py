"""Page and summary of an update to frequencies, shapes, damping ratios and functions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from rich.console import Console
from rich.text import Text

from fenics_joints.commands.outcome import Outcome
from fenics_joints.commands.update.damping import DampingTable, ratio_words
from fenics_joints.commands.update.pictures import (
    convergence_chart,
    function_charts,
    shown_functions,
)
from fenics_joints.commands.update.report import (
    CombinedReport,
    Functions,
    HeldMode,
    ModeTable,
    accuracy,
    decibel,
    gap_words,
    in_words,
    start_words,
)
from fenics_joints.formatting import (
    condition_value,
    hertz,
    number,
    percent,
    quantity,
)
from fenics_joints.measurements.gap import rms
from fenics_joints.report.html import HeatCell, facts, render, svg
from fenics_joints.report.terminal import new_table, say

__all__ = ["combined_html", "combined_outcome", "show_combined"]

#: The method in words.
METHODS = {
    "log": "Maximum likelihood; frequencies, ratios and functions count by their logarithms",
    "weighted": "By the weighted equations of seed 000 (eqs. 15 to 20)",
}
_KINDS = {
    "frequencies": "frequencies", "shapes": "mode shapes", "damping": "damping ratios",
    "frfs": "functions",
}  # fmt: skip
#: Rows of each table on the terminal.
_PARAMETERS, _MODES = 8, 10


def combined_outcome(found: CombinedReport) -> Outcome[CombinedReport]:
    """A combined update for the command line."""
    return Outcome(
        found, found.json, lambda: combined_html(found),
        lambda console: show_combined(console, found),
    )  # fmt: skip


# -- page ------------------------------------------------------------------------------------------


def combined_html(r: CombinedReport) -> str:
    """The result of a combined update as a page that needs nothing else."""
    functions, modes = r.functions, r.modes
    macs = None if modes is None or modes.mac_after is None else [
        ("Before", _mac_cells(modes.mac_before)), ("After", _mac_cells(modes.mac_after)),
    ]  # fmt: skip
    return render(
        "combined.html",
        r=r, u=r.update, method=METHODS[r.update.method], data=data_words(r),
        at=_at(r), words=in_words(r.update.identifiability), verdict=verdict_words(r),
        pull=start_words(r),
        levels=None if functions is None else functions.summary(),
        decibel=decibel, accuracy=accuracy, functions=functions,
        chart=None if functions is None else svg(function_charts(functions)),
        shown=0 if functions is None else len(shown_functions(functions)),
        rows=[] if functions is None else _function_rows(functions),
        modes=modes, rms=_mode_rms(modes), macs=macs, held=r.held, ratio=ratio_words,
        damping=None if modes is None else modes.damping,
        held_rms=rms(np.array([h.error for h in r.held])) if r.held else None,
        theirs=_theirs(r), published=r.published,
        convergence=svg(convergence_chart(r)), conditions=r.conditions,
        misfit=_misfit(r), facts=_facts(r),
    )  # fmt: skip


def data_words(r: CombinedReport) -> str:
    """The kinds of data, such as ``frequencies and functions``."""
    *others, last = [_KINDS[kind] for kind in r.kinds]
    return f"{', '.join(others)} and {last}" if others else last


def verdict_words(r: CombinedReport) -> str:
    """Errors before and after in a sentence; the MAC where shapes alone are data."""
    parts = []
    if r.modes is not None and r.modes.fitted.any():
        errors = (rms(e[r.modes.fitted]) for e in (r.modes.before, r.modes.after))
        parts.append(("frequencies", *(percent(e) for e in errors)))
    if r.modes is not None and r.modes.damping is not None:
        parts.append(("damping ratios", *(percent(e, 1) for e in r.modes.damping.rms())))
    if r.functions is not None:
        found = r.functions.summary()
        levels = (decibel(found[key]) for key in ("all_before", "all_after"))
        parts.append(("functions", *levels))
    if not parts:
        words = gap_words(r)
        return f"The {words}." if words else ""
    (what, before, after), *others = parts
    words = [f"The error of the {what} went from {before} to {after}"]
    words += [f"that of the {what} from {before} to {after}" for what, before, after in others]
    return f"{', '.join(words)}."


def _at(r: CombinedReport) -> str:
    if r.condition is None:
        return ""
    name, value, unit = r.condition
    return f"{name} {condition_value(value, unit)}"


def _mode_rms(modes: ModeTable | None) -> dict[str, float | None]:
    if modes is None:
        return {}
    found = {}
    for name, errors in (("before", modes.before), ("after", modes.after)):
        found[name] = rms(errors[modes.fitted]) if modes.fitted.any() else None
    return found


def _misfit(r: CombinedReport) -> float | None:
    """Root mean square of the residuals in standard deviations; 1 if noise is all there is."""
    dof = r.update.degrees_of_freedom
    return float(np.sqrt(r.update.chi2 / dof)) if dof > 0 and np.isfinite(r.update.chi2) else None


def _mac_cells(values: np.ndarray) -> list[list[HeatCell]]:
    return [[_mac_cell(float(v)) for v in row] for row in values]


def _mac_cell(value: float) -> HeatCell:
    share = min(max(value, 0.0), 1.0)
    # White to the accent's blue; ink by contrast.
    white, blue = np.array([247, 249, 250]), np.array([31, 95, 150])
    colour = white + share * (blue - white)
    ink = "#ffffff" if share > 0.55 else "#14181d"
    background = "#" + "".join(f"{round(c):02x}" for c in colour)
    return HeatCell(f"{value:.2f}", f"background:{background};color:{ink}")


def _function_rows(functions: Functions) -> list[dict]:
    rows = []
    before, after = functions.frac(functions.before), functions.frac(functions.after)
    for i, j in np.argwhere(~np.isnan(functions.measured[0])):
        one = np.zeros(functions.measured.shape, dtype=bool)
        one[:, i, j] = True
        rows.append({
            "response": functions.names[0][i], "reference": functions.names[1][j],
            "before": decibel(functions.decibels(functions.before, one)),
            "after": decibel(functions.decibels(functions.after, one)),
            "frac_before": f"{before[i, j]:.3f}", "frac_after": f"{after[i, j]:.3f}",
            "held": bool(functions.held[:, i, j].all()),
        })  # fmt: skip
    return rows


def _theirs(r: CombinedReport) -> dict[str, float]:
    """Errors of the published frequencies, model over test minus one, by mode."""
    if r.published is None or r.modes is None:
        return {}
    return {
        name: f / test - 1
        for name, f, test in zip(
            r.modes.names, r.published["frequencies_hz"], r.modes.test_hz, strict=False
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
}  # fmt: skip


def _facts(r: CombinedReport) -> list[tuple[str, str]]:
    own = {key: value for key, value in r.model.items() if key in _OWN}
    rest = {key: value for key, value in r.model.items() if key not in _OWN}
    return [*facts(rest), *((_OWN[key], str(value)) for key, value in own.items())]


# -- terminal --------------------------------------------------------------------------------------


def show_combined(console: Console, r: CombinedReport) -> None:
    """Print the result on one screen."""
    at = _at(r)
    say(console, f"{r.title}: update{' at ' + at if at else ''} on {data_words(r)}", "bold")
    gaps = (
        f"{gap_words(r)} in {r.update.evaluations} evaluations of the model; "
        f"{r.update.message}"
    )
    console.print(gaps, markup=False, highlight=False)
    for note in r.notes:
        console.print(f"but: {note}", style="yellow", markup=False, highlight=False)
    console.print()
    table = new_table("parameter", ">start", ">identified", ">s.d.")
    for p in r.parameters[:_PARAMETERS]:
        start, value = (quantity(p[key], p["unit"], 4) for key in ("start", "value"))
        table.add_row(Text(p["name"]), start, value, accuracy(p["sd"]))
    console.print(table)
    _rest(console, len(r.parameters) - _PARAMETERS)
    for words in (*in_words(r.update.identifiability), start_words(r)):
        if words:
            console.print(words, style="dim", markup=False, highlight=False)
    before, after = r.conditions
    if len(r.parameters) > 1 and np.isfinite(before):
        how = "weighted" if r.update.method == "weighted" else "by logarithms"
        words = f"condition number at the start: {number(before, 2)} in SI units, "
        say(console, f"{words}{number(after, 2)} {how}", "dim")
    console.print()
    if r.modes is not None:
        console.print(_mode_rows(r.modes))
        _rest(console, len(r.modes.names) - _MODES)
        if not r.modes.fitted.all():
            say(console, "* no fit saw its frequency", "dim")
        if r.modes.damping is not None:
            console.print()
            console.print(_ratio_rows(r.modes.names, r.modes.damping))
            if not r.modes.damping.fitted[r.modes.damping.measured].all():
                say(console, "* no fit saw its damping ratio", "dim")
    if r.functions is not None:
        console.print()
        console.print(_level_rows(r.functions))
    if r.held:
        console.print()
        console.print(_held_rows(r))
        _rest(console, len(r.held) - _MODES)
        if any(h.damping is not None for h in r.held):
            console.print()
            console.print(_held_ratio_rows(r.held))


def _rest(console: Console, more: int) -> None:
    if more > 0:
        say(console, f"{more} more: see --report or --json", "dim")


def _mode_rows(modes: ModeTable):
    shapes = modes.mac_after is not None
    more = [">MAC"] if shapes else []
    table = new_table("mode", ">test, Hz", ">before, Hz", ">after, Hz", ">before", ">after", *more)
    for j, name in enumerate(modes.names[:_MODES]):
        row = [
            hertz(modes.test_hz[j]), hertz(modes.before_hz[j]), hertz(modes.after_hz[j]),
            percent(modes.before[j], sign=True), percent(modes.after[j], sign=True),
        ]  # fmt: skip
        if shapes:
            row.append(f"{modes.mac_after[j, j]:.2f}")
        table.add_row(Text(name if modes.fitted[j] else f"{name} *", no_wrap=True), *row)
    return table


def _ratio_rows(names: Sequence[str], damping: DampingTable):
    table = new_table(
        "damping ratio", ">test", ">before", ">after", ">error before", ">error after"
    )
    for j in damping.measured[:_MODES]:
        name = names[j] if damping.fitted[j] else f"{names[j]} *"
        errors = damping.error_before[j], damping.error_after[j]
        table.add_row(
            Text(name, no_wrap=True),
            *(ratio_words(z[j]) for z in (damping.test, damping.before, damping.after)),
            *(percent(e, 1, sign=True) for e in errors),
        )
    return table


def _held_ratio_rows(held: Sequence[HeldMode]):
    table = new_table("damping ratio, held out", ">test", ">predicted", ">error", ">± s.d.")
    for h in held[:_MODES]:
        d = h.damping
        table.add_row(Text(h.name), ratio_words(d.test), ratio_words(d.predicted),
                      percent(d.error, 1, sign=True), accuracy(d.sd))  # fmt: skip
    return table


def _level_rows(functions: Functions):
    found = functions.summary()
    table = new_table("functions, rms of |H| in dB", ">before", ">after")
    for key, words in (("all", "all lines"), ("fitted", "lines that were fitted"),
                       ("held", "held out")):  # fmt: skip
        if found[f"{key}_after"] is not None:
            table.add_row(words, decibel(found[f"{key}_before"]), decibel(found[f"{key}_after"]))
    return table


def _held_rows(r: CombinedReport):
    theirs = _theirs(r)
    alone = all(h.alone for h in r.held)
    more = [">published fit"] if theirs else []
    heading = "held out in turn" if alone and len(r.held) > 1 else "held out"
    table = new_table(heading, ">test, Hz", ">predicted, Hz", ">error", ">± s.d.", *more)
    for h in r.held[:_MODES]:
        row = [hertz(h.test_hz), hertz(h.predicted_hz), percent(h.error, sign=True),
               accuracy(h.sd)]  # fmt: skip
        if theirs:
            row.append(percent(theirs.get(h.name), sign=True))
        table.add_row(Text(h.name), *row)
    return table
