"""A checked case on the terminal."""

from __future__ import annotations

from rich.console import Console
from rich.text import Text

from fenics_joints.commands.check.result import Checked
from fenics_joints.formatting import extents, number, quantity
from fenics_joints.report.terminal import more, new_table, say, tell

#: Rows of a table, so that all of it fits on a screen.
_ROWS = 16


def show_check(console: Console, result: Checked) -> None:
    """Print masses, places, costs, and then all that is wrong or unlikely."""
    say(console, f"{result.title}: checked", "bold")
    if result.weights:
        rows = weight_rows(result)
        weighed = any(row[3] for row in rows)
        table = new_table("mass of", "", ">in the model", *[">on the scales"] * weighed)
        for row in rows[:_ROWS]:
            table.add_row(*map(Text, row[: 3 + weighed]))
        more(table, len(rows) - _ROWS)
        console.print(table)
    size = f"{extents(result.size_m)}, " if len(result.size_m) else ""
    dofs = f"{result.dofs} degrees of freedom" if result.dofs else str(result.estimate or "")
    if size or dofs:
        tell(console, f"{size}{dofs}")
    test = f"test: {w}" if (w := result.test_words()) else ""
    for words in (place_words(result), test, result.solved):
        if words:
            tell(console, words)
    if result.costs:
        tell(
            console,
            "; ".join(f"{name}: {time}, {size}" for name, time, size in cost_rows(result))
            + " (rough)",
        )
    for i, error in enumerate(result.errors, start=1):
        tell(console, f"error {i}: {error}", "red")
    for note in result.notes:
        tell(console, f"note: {note}", "yellow")
    if not result.errors and not result.notes:
        tell(console, "nothing is wrong or unlikely", "green")


def weight_rows(result: Checked) -> list[tuple[str, str, str, str]]:
    """Name, kind, mass and what was weighed; a last row with all that is in the model."""
    rows = [
        (
            w.name,
            "attached, not in the model" if w.kind == "attached" else w.kind,
            quantity(w.mass, "kg"),
            "" if w.weighed is None else quantity(w.weighed, "kg"),
        )
        for w in result.weights
    ]
    test = None if result.case is None else result.case.test
    weighed = "" if test is None or test.mass is None else quantity(test.mass, "kg")
    return [*rows, ("all", "in the model", quantity(result.mass, "kg", 4), weighed)]


def place_words(result: Checked) -> str:
    """How many sensors, forces, bolts there are, and what acts on faces."""
    counts = dict.fromkeys(("sensor", "force", "obstacle", "displacement", "load"), 0)
    for place in result.places:
        if place.kind in counts:
            counts[place.kind] += 1
    words = [f"{n} {kind}{'s' if n > 1 else ''}" for kind, n in counts.items() if n]
    if result.bolts:
        n, rings = len(result.bolts), result.case is not None and not result.case.bolts
        # A bolt has a ring on each pair of faces that it presses together.
        words.append(
            f"{n} {'ring' if rings else 'bolt'}{'s' if n > 1 else ''}{' at bolts' if rings else ''}"
        )
    return ", ".join(words)


def cost_rows(result: Checked) -> list[tuple[str, str, str]]:
    """Each command with its time and memory in words."""
    return [
        (cost.command, f"about {duration(cost.seconds)}", f"{number(cost.bytes / 2**30, 2)} GiB")
        for cost in result.costs
    ]


def duration(seconds: float) -> str:
    """A time in the unit that suits it."""
    for unit, length in (("days", 86400.0), ("hours", 3600.0), ("minutes", 60.0)):
        if seconds > 2 * length:
            return f"{number(seconds / length, 2)} {unit}"
    return f"{number(seconds, 2)} s"
