"""Contacts under preload on the terminal."""

from __future__ import annotations

from rich.console import Console
from rich.text import Text

from fenics_joints.commands.preload.applied import applied_rows
from fenics_joints.commands.preload.contacts import contact_rows, forces_in_words
from fenics_joints.commands.preload.result import PreloadReport
from fenics_joints.formatting import hertz, percent
from fenics_joints.report.terminal import new_table, say


def show_preload(console: Console, p: PreloadReport) -> None:
    """Print the contacts and what the preload does to the frequencies."""
    say(console, f"{p.case.name}: contact under preload", "bold")
    forces = forces_in_words(p.result)
    iterations = f"{p.result.iterations} iterations, {p.result.model.jumps.n} degrees of freedom"
    say(console, f"{forces}; {iterations}" if forces else iterations)
    console.print()
    if p.applied:
        rows = new_table("what acts", "", "moved by", "force on the bodies")
        for row in applied_rows(p.applied):
            rows.add_row(*map(Text, row))
        console.print(rows)
        console.print()
    for c in contact_rows(p.contacts):
        rows = new_table(f"contact {c['name']}", ">")
        for name, value in c["facts"]:
            rows.add_row(Text(name), value)
        console.print(rows)
        console.print()
    rows = new_table(">elastic mode", ">stuck, Hz", ">preloaded, Hz", ">change")
    for i, (a, b) in enumerate(p.rows):
        name = str(i + 1) if i < len(p.stuck_hz) else ""
        rows.add_row(name, hertz(a), hertz(b), percent(b / a - 1, sign=True))
    console.print(rows)
    for note in p.notes:
        say(console, note)
    for path in p.written:
        say(console, f"wrote {path}")
