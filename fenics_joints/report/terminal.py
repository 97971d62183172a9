"""Documents on the terminal, 80 columns or more; no sentence and no cell is cut."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence

from rich import box
from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.padding import Padding
from rich.table import Table as RichTable
from rich.text import Text as RichText

from fenics_joints.progress import is_terminal, loudness
from fenics_joints.report.document import (
    Cell,
    Document,
    Keys,
    OnTerminal,
    Remarks,
    Table,
    Text,
    Verdict,
)

#: Characters of a line in a file.
_COLUMNS = 100
#: Characters between columns, the fewest of a wrapped name, and the length of a full bar; chosen.
_BETWEEN, _NAME, _BAR = 3, 16, 20
_STYLES = {"note": "dim", "warn": "yellow", "bad": "red", "good": "green", "bold": "bold"}
_ROWS = {"dim": "dim", "lead": "bold"}


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


def show(console: Console, document: Document) -> None:
    """Print a document; no markup is read in its texts."""
    answer = next((b for b in document.blocks if isinstance(b, Verdict)), None)
    subject = (document.subject, "bold")
    if answer is not None:
        subject = (answer.heading, answer.style)
    console.print(RichText.assemble((f"{document.title}: ", "bold"), subject))
    before = None
    for block in _shown(document.blocks):
        if isinstance(block, Table):
            if before is not None:
                console.print()
            console.print(rich_table(block))
        else:
            if before is Table:
                console.print()
            for line in _lines(block):
                say(console, line, _STYLES.get(getattr(block, "style", "")))
        before = type(block)


def say(console: Console, text: str | RichText, style: str | None = None) -> None:
    """Print a text over as many lines as it takes; no markup is read in it."""
    console.print(text, style=style, markup=False, highlight=False)


def _shown(blocks: Sequence[object]) -> Iterator[Text | Keys | Remarks | Verdict | Table]:
    """The blocks that a terminal shows."""
    for block in blocks:
        if isinstance(block, OnTerminal):
            yield from _shown(block.blocks)
        elif isinstance(block, Table) and block.rows or isinstance(block, Text | Keys | Verdict):
            yield block
        elif isinstance(block, Remarks) and block.lines:
            yield block


def _lines(block: Text | Keys | Remarks | Verdict) -> list[str | RichText]:
    if isinstance(block, Text):
        return [block.text]
    if isinstance(block, Keys):
        return [", ".join(f"{value} {words}" for _, value, words in block.entries)]
    if isinstance(block, Remarks):
        return [f"{block.before.format(i)}{line}" for i, line in enumerate(block.lines, start=1)]
    return [
        RichText.assemble((f"{name}. " if name else "", "bold"), words)
        for name, words in block.sentences
    ]


def rich_table(table: Table) -> RichTable:
    """A plain table of which nothing is cut.

    Where it is too wide, columns of names wrap first; columns of numbers, and columns without a
    heading, wrap only where that is not enough.
    """
    shown = len(table.names) - table.page_columns
    headed = any(table.names)
    look = {"box": box.SIMPLE_HEAD if headed else None, "show_header": headed}
    made = _WrappedTable(pad_edge=False, show_edge=False, **look)
    for name, right in list(zip(table.names, table.right, strict=True))[:shown]:
        justify = "right" if right else "left"
        made.add_column(name, justify=justify, overflow="fold", no_wrap=right or not name)
    rows = [*table.rows, *table.foot]
    for row in rows[: table.most]:
        made.add_row(*map(_text, row.cells[:shown]), style=_ROWS.get(row.style))
    if table.most is not None and len(rows) > table.most:
        made.add_row(f"and {len(rows) - table.most} more", style="dim")
    return made


def _text(cell: Cell) -> RenderableType:
    if cell.share is not None:
        return RichText("█" * round(_BAR * cell.share), style="blue")
    text = RichText(cell.text, no_wrap=None, overflow="fold")
    return Padding(text, (0, 0, 0, cell.indent)) if cell.indent else text


class _WrappedTable(RichTable):
    """Rich crops columns that may not wrap: let all wrap where the others do not suffice."""

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
