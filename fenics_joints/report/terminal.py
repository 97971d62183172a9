"""Tables and lines for summaries on the terminal, 80 columns or more; no sentence is cut."""

from __future__ import annotations

import os
import sys

from rich import box
from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.table import Table
from rich.text import Text

from fenics_joints.progress import is_terminal, loudness

#: Columns of what is written into a file.
_COLUMNS = 100
#: Columns between those of a table, and the fewest that a name is wrapped into.
_BETWEEN, _NAME = 3, 16


def new_console() -> Console:
    """A console on standard output: as wide as the terminal, 100 columns where it is a file.

    Without escape codes in a file, under ``mpirun`` and where NO_COLOR is set; silent where the
    user asked for that.
    """
    terminal = is_terminal(sys.stdout)
    plain = not terminal or bool(os.environ.get("NO_COLOR"))
    return Console(
        width=None if terminal or "COLUMNS" in os.environ else _COLUMNS,
        color_system=None if plain else "auto",
        force_terminal=None if terminal else False,
        quiet=loudness() == "quiet",
    )


def new_table(*headings: str) -> Table:
    """A plain table of which nothing is cut; headings that start with > are right-aligned.

    Where it is too wide, columns of names wrap first; those of numbers, and those without a
    heading, only where that is not enough.
    """
    table = _WrappedTable(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False)
    for heading in headings:
        right = heading.startswith(">")
        table.add_column(
            heading.lstrip(">"),
            justify="right" if right else "left",
            overflow="fold",
            no_wrap=right or not heading,
        )
    return table


class _WrappedTable(Table):
    """Rich crops what does not wrap, so all columns do where the others are not enough."""

    def add_row(self, *cells: RenderableType | None, **settings) -> None:
        for cell in cells:
            if isinstance(cell, Text):
                cell.no_wrap, cell.overflow = None, "fold"
        super().add_row(*cells, **settings)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        if self._needed(console) > options.max_width:
            for column in self.columns:
                column.no_wrap = False
        return super().__rich_console__(console, options)

    def _needed(self, console: Console) -> int:
        """Columns of the terminal that it takes with the names wrapped."""
        total = 0
        for column in self.columns:
            sizes = [console.measure(cell) for cell in (column.header, *column.cells)]
            rigid, least = max(s.maximum for s in sizes), max(s.minimum for s in sizes)
            total += (rigid if column.no_wrap else min(least, _NAME)) + _BETWEEN
        return total


def say(console: Console, text: str, style: str | None = None) -> None:
    """Print a line, wrapped where the terminal ends; no markup is read in it."""
    tell(console, text, style)


def more(table: Table, n: int) -> None:
    """A last row that says how many were left out."""
    if n > 0:
        table.add_row(f"and {n} more", style="dim")


def tell(console: Console, text: str, style: str | None = None) -> None:
    """Print a text over as many lines as it takes; no markup is read in it."""
    console.print(text, style=style, markup=False, highlight=False)
