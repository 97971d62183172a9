"""An update on the terminal."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from rich.console import Console
from rich.text import Text

from fenics_joints.case.notes import OF_MODEL
from fenics_joints.commands.update.page import at_words, data_words, theirs
from fenics_joints.commands.update.result import (
    Compared,
    Functions,
    HeldMode,
    ModeTable,
    UpdateReport,
)
from fenics_joints.commands.update.words import (
    accuracy,
    decibel,
    in_words,
    ratio_words,
    start_words,
)
from fenics_joints.formatting import hertz, number, percent, quantity
from fenics_joints.report.terminal import new_table, say

#: Rows of each table.
_PARAMETERS, _MODES = 8, 10


def show_update(console: Console, r: UpdateReport) -> None:
    """Print the result on one screen."""
    at, found = at_words(r), r.update.identifiability
    end = "" if r.update.converged else ": NOT CONVERGED"
    end = end if r.failure is None else ": EXPLAINS NOTHING"
    say(console, f"{r.title}: update{' at ' + at if at else ''} on {data_words(r)}{end}", "bold")
    gaps = ", ".join(f"{what} {before} -> {after}" for what, before, after in r.changes())
    gaps += f" in {r.update.evaluations} evaluations of the model; {r.update.message}"
    console.print(gaps, markup=False, highlight=False)
    for note in r.notes:
        shown = note if note.startswith(OF_MODEL) else f"but: {note}"
        console.print(shown, style="yellow", markup=False, highlight=False)
    console.print()
    table = new_table("parameter", ">start", ">identified", ">s.d.")
    for p in r.parameters[:_PARAMETERS]:
        start, value = (quantity(p[key], p["unit"], 4) for key in ("start", "value"))
        table.add_row(Text(p["name"]), start, value, accuracy(p["sd"]))
    console.print(table)
    _rest(console, len(r.parameters) - _PARAMETERS)
    determined = in_words(found) if r.failure is None else []
    for words in (*determined, start_words(found, r.pull)):
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
            say(console, f"* its frequency was not fitted{_why_not(r)}", "dim")
        if r.modes.damping is not None:
            console.print()
            console.print(_ratio_rows(r.modes.names, r.modes.damping))
            if not r.modes.damping.fitted[r.modes.damping.measured].all():
                say(console, "* its damping ratio was not fitted", "dim")
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
    if r.sweep is not None and r.sweep.curves:
        found = zip(("fitted", "held out", "validation"), r.sweep.gaps().values(), strict=True)
        gaps = [f"{name} {percent(gap)}" for name, gap in found if gap is not None]
        console.print()
        say(console, f"curves over the {r.condition[0]}: gap {', '.join(gaps)}")


def _why_not(r: UpdateReport) -> str:
    """Why some frequencies were not fitted, behind a sentence that says so."""
    open_, left = set(np.flatnonzero(~r.modes.fitted).tolist()), set(r.update.widths.without)
    reasons = ["held out"] * bool(open_ - left and r.held)
    reasons += ["left out for the reason given above"] * bool(open_ & left)
    return f": {' or '.join(reasons)}" if reasons else ""


def _rest(console: Console, more: int) -> None:
    if more > 0:
        say(console, f"{more} more: see --report or --json", "dim")


def _mode_rows(modes: ModeTable):
    headings = ("mode", ">test, Hz", ">before, Hz", ">after, Hz", ">before", ">after")
    macs = None if modes.mac_after is None else np.diag(modes.mac_after)
    return _compared(modes, modes.names, headings, hertz, 2, range(len(modes.names)), macs)


def _ratio_rows(names: Sequence[str], damping: Compared):
    headings = ("damping ratio", ">test", ">before", ">after", ">error before", ">error after")
    return _compared(damping, names, headings, ratio_words, 1, damping.measured)


def _compared(
    found: Compared,
    names: Sequence[str],
    headings: Sequence[str],
    words: Callable[[float], str],
    digits: int,
    rows: Sequence[int],
    macs: Sequence[float] | None = None,
):
    """A table of modes, before and after."""
    table = new_table(*headings, *([] if macs is None else [">MAC"]))
    for j in rows[:_MODES]:
        name = names[j] if found.fitted[j] else f"{names[j]} *"
        cells = [words(values[j]) for values in (found.test, found.before, found.after)]
        errors = found.error_before[j], found.error_after[j]
        cells += [percent(e, digits, sign=True) for e in errors]
        cells += [] if macs is None else [f"{macs[j]:.2f}"]
        table.add_row(Text(name), *cells)
    return table


def _held_ratio_rows(held: Sequence[HeldMode]):
    table = new_table("damping ratio, held out", ">test", ">predicted", ">error", ">± s.d.")
    for h in held[:_MODES]:
        d = h.damping
        table.add_row(
            Text(h.name),
            ratio_words(d.test),
            ratio_words(d.predicted),
            percent(d.error, 1, sign=True),
            accuracy(d.sd),
        )
    return table


def _level_rows(functions: Functions):
    found = functions.summary()
    table = new_table("functions, rms of |H| in dB", ">before", ">after")
    for key, words in (
        ("all", "all lines"),
        ("fitted", "lines that were fitted"),
        ("held", "held out"),
    ):
        if found[f"{key}_after"] is not None:
            table.add_row(words, decibel(found[f"{key}_before"]), decibel(found[f"{key}_after"]))
    return table


def _held_rows(r: UpdateReport):
    published = theirs(r)
    alone = all(h.alone for h in r.held)
    more = [">published fit"] if published else []
    heading = "held out in turn" if alone and len(r.held) > 1 else "held out"
    table = new_table(heading, ">test, Hz", ">predicted, Hz", ">error", ">± s.d.", *more)
    for h in r.held[:_MODES]:
        row = [hertz(h.test), hertz(h.predicted), percent(h.error, sign=True), accuracy(h.sd)]
        if published:
            row.append(percent(published.get(h.name), sign=True))
        table.add_row(Text(h.name), *row)
    return table
