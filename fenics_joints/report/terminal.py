"""Tables and lines for summaries of one screen on the terminal, 80 columns or more."""

from __future__ import annotations

from rich import box
from rich.console import Console
from rich.table import Table

__all__ = ["more", "new_table", "say", "tell"]


def new_table(*headings: str) -> Table:
    """A plain table; headings that start with > are right-aligned."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False)
    for heading in headings:
        right = heading.startswith(">")
        table.add_column(
            heading.lstrip(">"), justify="right" if right else "left", no_wrap=right,
            overflow="ellipsis" if right else "fold",
        )  # fmt: skip
    return table


def say(console: Console, text: str, style: str | None = None) -> None:
    """Print one line, cut off where the terminal ends; no markup is read in it."""
    console.print(
        text, style=style, no_wrap=True, overflow="ellipsis", markup=False, highlight=False
    )


def more(table: Table, n: int) -> None:
    """A last row that says how many were left out."""
    if n > 0:
        table.add_row(f"and {n} more", style="dim")


def tell(console: Console, text: str, style: str | None = None) -> None:
    """Print a text over as many lines as it takes; no markup is read in it."""
    console.print(text, style=style, markup=False, highlight=False)
