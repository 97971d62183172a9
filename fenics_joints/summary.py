"""Summaries of one screen for the terminal, 80 columns or more."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from fenics_joints.formatting import (
    condition_value,
    hertz,
    interval,
    percent,
    probability,
    quantity,
)

if TYPE_CHECKING:
    from fenics_joints.diagnosis.result import Diagnosis
    from fenics_joints.updating import UpdateReport

__all__ = ["diagnosis", "modes", "update"]

#: Rows of each table, so that all of it fits on a screen.
_REGIONS, _EFFECTS, _PARAMETERS, _MODES = 4, 5, 6, 26
_STYLES = {"cause": "bold cyan", "no gap": "bold green", "ambiguous": "bold yellow"}
_BAR = 20


def _table(*headings: str) -> Table:
    """A plain table; headings that start with > are right-aligned."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False)
    for heading in headings:
        right = heading.startswith(">")
        table.add_column(
            heading.lstrip(">"), justify="right" if right else "left", no_wrap=right,
            overflow="ellipsis" if right else "fold",
        )  # fmt: skip
    return table


def _bar(share: float) -> Text:
    return Text("█" * round(_BAR * min(max(share, 0.0), 1.0)), style="blue")


def _line(text: str) -> Text:
    """Text on one line, cut off where the terminal ends; no markup is read in it."""
    return Text(text, no_wrap=True, overflow="ellipsis")


def diagnosis(console: Console, d: Diagnosis) -> None:
    """Print the diagnosis: verdict, gap, where, which and the leading hypothesis' parameters."""
    console.print(_line(d.title), style="bold")
    verdict = Text(d.verdict.upper(), style=_STYLES.get(d.verdict, "bold red"))
    console.print(Text.assemble(verdict, ": ", d.summary))
    console.print()
    gaps = _table("gap (RMS relative error)", ">nominal", ">placebo", ">chosen")
    gaps.add_row("all data, fitted", percent(d.before.rms), "", percent(d.after.rms))
    gaps.add_row(
        "held out, predicted", percent(d.heldout_before), percent(d.placebo_after),
        percent(d.heldout_after), style="bold",
    )  # fmt: skip
    if d.validation is not None:
        old, new = d.validation
        at = ", ".join(condition_value(x, d.condition[1]) for x in new.conditions)
        gaps.add_row(f"validation, {at}", percent(old.rms), "", percent(new.rms))
    gaps.add_row("noise of the test", "", "", percent(d.noise))
    console.print(gaps)
    console.print()
    _where(console, d)
    _which(console, d)
    _lead(console, d)


def _where(console: Console, d: Diagnosis) -> None:
    table = _table("where", ">share", "")
    for zone in d.where[:_REGIONS]:
        table.add_row(Text(zone.region), percent(zone.share, 1), _bar(zone.share))
    _more(table, len(d.where) - _REGIONS)
    console.print(table)
    console.print()


def _which(console: Console, d: Diagnosis) -> None:
    table = _table("which effect", "class", ">probability", "")
    for effect in d.effects[:_EFFECTS]:
        own = effect.class_name == effect.name
        table.add_row(
            _line(effect.name), _line("" if own else effect.class_name),
            probability(effect.probability), _bar(effect.probability),
        )  # fmt: skip
    _more(table, len(d.effects) - _EFFECTS)
    console.print(table)
    if d.separations and d.effects:
        # The class that matters is the most probable effect's.
        lead = [s for s in d.separations if s.class_name == d.effects[0].class_name]
        best = max(lead or d.separations, key=lambda s: s.distance)
        console.print(_line(f"to split {best.class_name}: {best.measurement}"))
    console.print()


def _lead(console: Console, d: Diagnosis) -> None:
    if not d.hypotheses:
        return
    lead = d.hypotheses[0]
    fitted = [p for p in lead.parameters if not p["nuisance"]]
    if fitted:
        table = _table("fitted in the leading hypothesis", ">value", "68 % interval")
        for p in fitted[:_PARAMETERS]:
            span = interval(p["low"], p["high"], p["unit"])
            table.add_row(_line(p["name"]), quantity(p["value"], p["unit"]), _line(span))
        _more(table, len(fitted) - _PARAMETERS)
        console.print(table)
    if lead.at_bound:
        console.print(_line(f"at a limit: {', '.join(lead.at_bound)}"), style="yellow")


def _more(table: Table, n: int) -> None:
    if n > 0:
        table.add_row(f"and {n} more", style="dim")


def update(console: Console, u: UpdateReport) -> None:
    """Print the update: parameters, frequencies before and after, and the curves' gaps."""
    at = condition_value(u.at, u.condition[1])
    console.print(_line(f"{u.title}: update at {u.condition[0]} {at}"), style="bold")
    gaps = f"gap {percent(u.gap_before.rms)} -> {percent(u.gap_after.rms)}"
    console.print(_line(f"{gaps} in {u.iterations} iterations. {u.message}"))
    console.print()
    table = _table("parameter", ">start", ">identified", ">relative s.d.")
    for p in u.parameters[: 2 * _PARAMETERS]:
        start, value = (quantity(p[key], p["unit"]) for key in ("start", "value"))
        table.add_row(Text(p["name"]), start, value, percent(p["sd"], 1))
    _more(table, len(u.parameters) - 2 * _PARAMETERS)
    console.print(table)
    console.print()
    table = _table("mode", ">test, Hz", ">before, Hz", ">after, Hz", ">before", ">after")
    old, new = u.gap_before, u.gap_after
    for j, mode in enumerate(new.mode_names[:10]):
        table.add_row(
            Text(mode), hertz(new.test_hz[0, j]), hertz(old.model_hz[0, j]),
            hertz(new.model_hz[0, j]), percent(old.relative[0, j], sign=True),
            percent(new.relative[0, j], sign=True),
        )  # fmt: skip
    _more(table, len(new.mode_names) - 10)
    console.print(table)
    if u.identifiability.undetermined:
        words = ", ".join(u.identifiability.undetermined)
        console.print(_line(f"not determined by these data: {words}"), style="yellow")
    if u.curves:
        console.print()
        gap = f"fitted {percent(u.curve_gap_fitted)}, held out {percent(u.curve_gap_heldout)}"
        if u.curve_gap_validation is not None:
            gap += f", validation {percent(u.curve_gap_validation)}"
        console.print(_line(f"curves over the {u.condition[0]}: gap {gap}"))


def modes(
    console: Console,
    title: str,
    frequencies_hz: Sequence[float],
    kinds: Sequence[str],
    n_dofs: int,
) -> None:
    """Print natural frequencies.

    Args:
        console: Where to.
        title: The case's title.
        frequencies_hz: Natural frequencies, Hz, shape (n,).
        kinds: What each mode is, in words, length n; see `report.mode_kinds`.
        n_dofs: Degrees of freedom.
    """
    console.print(_line(title), style="bold")
    table = _table(">mode", ">frequency, Hz", "what it is")
    for i, (f, kind) in enumerate(zip(frequencies_hz, kinds, strict=True)):
        if i == _MODES:
            break
        dim = kind.startswith(("rigid", "not"))
        table.add_row(str(i + 1), hertz(float(np.real(f))), kind, style="dim" if dim else None)
    console.print(table)
    if len(frequencies_hz) > _MODES:
        console.print(_line(f"and {len(frequencies_hz) - _MODES} more"), style="dim")
    console.print(_line(f"{n_dofs} degrees of freedom"))
