"""A diagnosis on the terminal."""

from __future__ import annotations

from collections import Counter

from rich.console import Console
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from fenics_joints.commands.diagnose.explanation import explain
from fenics_joints.commands.diagnose.reading import (
    by_effect,
    by_reason,
    effect_classes,
    heading_of,
    in_words,
    leading,
    sure_causes,
)
from fenics_joints.commands.diagnose.words import value_words
from fenics_joints.diagnosis.result import Diagnosis
from fenics_joints.formatting import (
    bounded,
    condition_value,
    error_percent,
    percent,
    probability,
    spaced,
)
from fenics_joints.report.terminal import more, new_table, tell

#: Rows of each table; the page has all of them.
_REGIONS, _PARAMETERS = 3, 3
#: Classes of effects that have rows, named causes besides; and their members.
_CLASSES, _MEMBERS = 2, 3
_STYLES = {
    "cause": "bold cyan",
    "likely": "bold yellow",
    "no gap": "bold green",
    "ambiguous": "bold yellow",
}
_BAR = 20


def show_diagnosis(console: Console, d: Diagnosis) -> None:
    """Print the diagnosis: where, which and how far in a sentence each, then the numbers."""
    words = explain(d)
    heading = heading_of(d).upper()
    verdict = Text(heading, style=_STYLES.get(d.verdict, "bold red"))
    console.print(Text.assemble((d.title, "bold"), ": ", verdict))
    for heading, sentence in words.sentences:
        console.print(Text.assemble((f"{heading}. ", "bold"), sentence))
    for doubt in words.doubts:
        tell(console, f"but: {doubt}", "yellow")
    console.print()
    gaps = new_table("gap (RMS relative error)", ">nominal", ">best wrong", ">chosen")
    gaps.add_row("all data, fitted", error_percent(d.before.rms), "", error_percent(d.after.rms))
    gaps.add_row(
        "held out, predicted",
        error_percent(d.heldout_before),
        error_percent(d.placebo_after),
        error_percent(d.heldout_after),
        style="bold",
    )
    if d.validation is not None:
        old, new = d.validation
        at = ", ".join(condition_value(x, d.condition[1]) for x in new.conditions)
        gaps.add_row(f"validation, {at}", error_percent(old.rms), "", error_percent(new.rms))
    gaps.add_row("noise of the test", "", "", percent(d.noise))
    console.print(gaps)
    console.print()
    _where(console, d)
    _which(console, d)
    _lead(console, d)


def _where(console: Console, d: Diagnosis) -> None:
    table = new_table("where", ">share", "")
    for zone in d.where[:_REGIONS]:
        table.add_row(Text(spaced(zone.region)), percent(zone.share, 1), _bar(zone.share))
    console.print(table)
    console.print()


def _which(console: Console, d: Diagnosis) -> None:
    classes, often = effect_classes(d), Counter(effect.name for effect in d.effects)
    table = new_table("which effect", "class", ">probability", "")
    # Every cause that is named has its row; a class takes one of its own beside its members'.
    named, shown = {group.name for group in sure_causes(d)}, 0
    for i, group in enumerate(classes):
        if i >= _CLASSES and group.name not in named:
            continue
        members = group.effects[: _MEMBERS if group.letter else 1]
        if group.letter:
            name = f"one of {len(group.effects)} in"
            _effect_row(table, name, group.letter, group.probability, indent=0)
        for effect in members:
            # Which of several of one name, as the loose bolts.
            name = effect.name if often[effect.name] == 1 else in_words(effect)
            _effect_row(table, name, group.letter, effect.probability)
        shown += len(members)
    more(table, len(d.effects) - shown)
    console.print(table)
    letters = {group.name: group.letter for group in classes if group.letter}
    for s in [s for s in d.separations if s.class_name in letters][:2]:
        apart = f"to tell class {letters[s.class_name]} apart: {s.measurement}"
        tell(console, f"{apart} (up to {s.distance:.1f} standard deviations)")
    for reason, names in by_reason(d.silent):
        tell(console, f"this test says nothing of {', '.join(names)}: {reason}", "dim")
    console.print()


def _effect_row(table: Table, name: str, letter: str, p: float, indent: int = 2) -> None:
    """A member of a class stands to the right of it, all lines of its name."""
    text = Padding(Text(name), (0, 0, 0, indent if letter else 0))
    table.add_row(text, letter, probability(p), _bar(bounded(p)))


def _lead(console: Console, d: Diagnosis) -> None:
    lead = leading(d)
    if lead is None:
        return
    table = new_table("fitted", ">value", "68 % interval", "in the leading hypothesis")
    left = _PARAMETERS
    for effect, rows in by_effect(lead.parameters):
        for i, p in enumerate(rows[: max(left, 0)]):
            value, span = value_words(p)
            of = Text("" if i else spaced(effect))
            table.add_row(Text(p["name"]), value, Text(span, no_wrap=True), of)
        left -= len(rows)
    more(table, -left)
    if table.rows:
        console.print(table)


def _bar(share: float) -> Text:
    return Text("█" * round(_BAR * min(max(share, 0.0), 1.0)), style="blue")
