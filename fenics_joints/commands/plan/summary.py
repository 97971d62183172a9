"""A plan on the terminal."""

from __future__ import annotations

from rich.console import Console
from rich.text import Text

from fenics_joints.commands.diagnose.reading import by_reason
from fenics_joints.commands.plan.page import likeliest
from fenics_joints.diagnosis.evidence.classes import APART
from fenics_joints.diagnosis.plan.planned import Plan
from fenics_joints.formatting import condition_value, percent, probability, spaced
from fenics_joints.report.terminal import new_table, say, tell

#: Rows of each table.
_EFFECTS, _ADDITIONS = 12, 4


def show_plan(console: Console, p: Plan) -> None:
    """Print the plan on one screen."""
    say(console, f"{p.title}: what the planned test could tell", "bold")
    for sentence in p.sentences():
        tell(console, sentence)
    console.print()
    places = {e.key: f"{i + 1}" for i, e in enumerate(p.effects)}
    table = new_table(">", "effect", "", ">D: no gap", ">named", ">or taken for", ">share")
    for i, e in enumerate(p.effects[:_EFFECTS]):
        found = likeliest(p, i)
        shares = ["–"] * 3
        if found is not None:
            named, other, share = found
            shares = [probability(named), places.get(other, other), probability(share)]
        table.add_row(
            places[e.key],
            Text(spaced(e.key)),
            e.letter or ("" if e.seen else "unseen"),
            f"{e.distance:.1f}",
            *shares,
            style=None if e.seen else "dim",
        )
    if len(p.effects) > _EFFECTS:
        table.add_row("", f"and {len(p.effects) - _EFFECTS} more", style="dim")
    console.print(table)
    console.print()
    if p.additions:
        table = new_table("measured besides", ">apart", ">seen", ">mean gain of D")
        for a in p.additions[:_ADDITIONS]:
            table.add_row(Text(a.name), str(a.classes), str(a.seen), f"{a.mean:.2f}")
        console.print(table)
    for reason, names in by_reason(p.silent):
        tell(console, f"this test says nothing of {', '.join(names)}: {reason}", "dim")
    values = ", ".join(condition_value(x, p.condition[1]) for x in p.conditions)
    tell(
        console,
        f"D above {APART} is less than 1 % confusion. Named, or taken for another (by its number): "
        "mean probabilities in simulated tests of that cause, of any probable size",
        "dim",
    )
    text = f"{', '.join(p.measured)} of {len(p.mode_names)} modes at {p.condition[0]} {values}"
    say(console, text, "dim")
    text = f"noise {percent(p.noise)}, discrepancy {percent(p.discrepancy)}"
    say(console, text, "dim")
