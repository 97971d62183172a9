"""The document of a result, stated once: shown on a terminal, as a page, and as JSON.

`terminal.show` and `html.as_page` render a `Document`; ``data`` is its JSON. A block that stands in
neither `OnTerminal` nor `OnPage` is shown by both; a terminal leaves out headings, figures, views,
lists and what is folded away.

A table is made from records, dicts with plain numbers whose keys end in their unit
(``frequency_hz``): the rows in the JSON file are the same records. Pictures are drawn when the page
is made; a terminal needs none of them.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any
from urllib.parse import quote

from markupsafe import Markup

from fenics_joints.files import csv_text, dataframe, plain
from fenics_joints.formatting import MISSING, hertz, number, percent, quantity

#: Characters of the longest name of a table's file, and from which a name is long; chosen.
_LONGEST, _LONG = 40, 16
#: Units by the last part of a key, as they are written.
_UNITS = {"m": "m", "n": "N", "pa": "Pa", "j": "J", "kg": "kg"}


@dataclass(frozen=True)
class Cell:
    """A cell of a table.

    Attributes:
        text: The text.
        note: A second line on the page.
        css: Style of the cell on the page.
        kind: Class of the cell on the page: ``flag`` for a value to look at, ``rms``, ``nowrap``.
        indent: Columns that the terminal moves it to the right.
        share: Length of a bar, from 0 to 1, that stands there instead of a text; None without.
        value: Value in the CSV file; None for the text.
        pair: Places of a measured shape and of one of the page's view, with a comma between them,
            which a click shows; empty for none.
    """

    text: str = ""
    note: str = ""
    css: str = ""
    kind: str = ""
    indent: int = 0
    share: float | None = None
    value: object = None
    pair: str = ""


def bar(share: float) -> Cell:
    """A bar as long as a share from 0 to 1."""
    return Cell(share=min(max(share, 0.0), 1.0))


@dataclass(frozen=True)
class Row:
    """Cells of one row; ``style`` is ``dim``, ``lead`` or empty."""

    cells: Sequence[Cell]
    style: str = ""


class Table:
    """A table, filled from records by `of`, or row by row.

    The last cell of a row that is shorter than the table spans the columns that are left.

    Args:
        columns: Headings, in a text with | between them; one that starts with > is above
            right-aligned numbers.
        caption: Above the table on the page.
        id: On the page, unique there.
        kind: Class of the table on the page: ``heat``, ``frequencies``, ``axis``, ``contact``.
        most: Rows on the terminal; None for all.
        page_columns: How many of the last columns stand on the page alone.
    """

    def __init__(
        self,
        columns: str | Sequence[str],
        caption: str = "",
        id: str = "",
        kind: str = "",
        most: int | None = None,
        page_columns: int = 0,
    ):
        columns = columns.split("|") if isinstance(columns, str) else columns
        columns = [column.strip() for column in columns]
        self.names = [column.lstrip(">") for column in columns]
        self.right = [column.startswith(">") for column in columns]
        self.caption, self.id, self.kind = caption, id, kind
        self.most, self.page_columns = most, page_columns
        self.keys = self.names
        self.rows: list[Row] = []
        self.foot: list[Row] = []

    def __repr__(self) -> str:
        return f"Table({self.id!r}, {len(self.rows)} rows of {len(self.names)} columns)"

    @classmethod
    def of(
        cls,
        records: Sequence[Mapping[str, object]],
        columns: str | Mapping[str, str],
        *,
        write: Callable[[str, Any], str | Cell] | None = None,
        style: Callable[[Mapping[str, object]], str] = lambda record: "",
        on_page: Collection[str] = (),
        **options,
    ) -> Table:
        """A table with a row for each record.

        Args:
            records: Values by key, plain numbers or text; None for a missing one. A value that has
                to be written in a way of its own is a `Cell`.
            columns: Headings by key, or as text: ``name: mode | test_hz: >measured, Hz``. A column
                whose key no record has is left out.
            write: Writes a value, given with its key; `by_unit` by default.
            style: Style of a record's row.
            on_page: Keys of the last columns, which stand on the page alone.
            options: ``caption``, ``id``, ``kind`` and ``most``, as for `Table`.
        """
        if isinstance(columns, str):
            pairs = (column.partition(":") for column in columns.split("|"))
            columns = {key.strip(): heading.strip() for key, _, heading in pairs}
        there = [k for k in columns if not records or any(k in record for record in records)]
        hidden = sum(key in on_page for key in there)
        table = cls([columns[k] for k in there], page_columns=hidden, **options)
        table.keys, write = there, write or by_unit
        for record in records:
            cells = []
            for key in there:
                value = record.get(key)
                if not isinstance(value, Cell):
                    cell, own = write(key, value), "" if value is None else value
                    value = replace(cell if isinstance(cell, Cell) else Cell(cell), value=own)
                cells.append(value)
            table.rows.append(Row(cells, style(record)))
        return table

    @property
    def has_names(self) -> bool:
        """Whether the first column has names that are too long for a phone."""
        return any(len(row.cells[0].text) > _LONG for row in self.rows if row.cells)

    def add(self, *cells: str | Cell, style: str = "", foot: bool = False) -> None:
        """A further row, or one below a line at the end."""
        made = [cell if isinstance(cell, Cell) else Cell(cell) for cell in cells]
        (self.foot if foot else self.rows).append(Row(made, style))

    def to_csv(self) -> str:
        """The rows as CSV: the records' values below their keys, or the texts of the cells."""
        rows = [[_value(row, i) for i in range(len(row.cells))] for row in self.rows]
        return csv_text([self.keys, *rows])

    def to_dataframe(self):
        """The rows as a ``pandas.DataFrame``: as `to_csv`, with numbers and without apostrophes.

        Raises:
            InputError: If pandas is not installed.
        """
        return dataframe(
            {key: [_value(row, i) for row in self.rows] for i, key in enumerate(self.keys)}
        )

    def csv_link(self) -> str:
        """The CSV as the address of a link on a page."""
        return f"data:text/csv;charset=utf-8,{quote(self.to_csv().encode('utf-8', 'replace'))}"


def _value(row: Row, i: int) -> object:
    """Value of a row's cell; None behind its last one."""
    if i >= len(row.cells):
        return None
    cell = row.cells[i]
    if cell.value is None:
        return cell.text if cell.share is None else cell.share
    return cell.value


def named_tables(blocks: Sequence[object]) -> dict[str, Table]:
    """All tables with rows in some blocks and in those inside them, by unique names for files."""
    found: dict[str, Table] = {}
    for block in blocks:
        inside = getattr(block, "blocks", ())
        for table in [block] if isinstance(block, Table) else _inside(inside):
            if table.rows and not any(table is other for other in found.values()):
                words = re.sub(r"\W+", "_", table.id or table.caption or table.names[0]).strip("_")
                name = words.lower()[:_LONGEST].strip("_") or "table"
                n = sum(
                    re.fullmatch(rf"{re.escape(name)}(_\d+)?", other) is not None for other in found
                )
                found[f"{name}_{n + 1}" if n else name] = table
    return found


def _inside(blocks: object) -> list[Table]:
    """Tables of blocks that are there already."""
    return [] if callable(blocks) else list(named_tables(blocks).values())


def records(**columns: Sequence) -> list[dict[str, object]]:
    """Records of columns of equal length, such as arrays; None for what is no number."""
    return [
        dict(zip(columns, row, strict=True))
        for row in plain(list(zip(*columns.values(), strict=True)))
    ]


def by_unit(key: str, value: Any) -> str:
    """A value as the unit at the end of its key asks for: ``_hz`` to a hundredth of a hertz."""
    unit = key.rpartition("_")[2]
    if isinstance(value, str):
        return value
    if unit == "hz":
        return hertz(value)
    if unit == "percent":
        return percent(None if value is None else value / 100, sign=True)
    if unit in _UNITS:
        return quantity(value, _UNITS[unit])
    if value is None:
        return MISSING
    return number(value) if isinstance(value, float) else str(value)


@dataclass(frozen=True)
class Heading:
    """A heading on the page."""

    text: str
    id: str = ""
    level: int = 2


@dataclass(frozen=True)
class Text:
    """Sentences. ``style`` is ``note``, ``bold``, ``warn``, ``bad``, ``good`` or empty."""

    text: str
    style: str = ""
    id: str = ""


@dataclass(frozen=True)
class Remarks:
    """Remarks on a result, a line each; nothing is shown without lines.

    Attributes:
        heading: Above them on the page.
        lines: Sentences.
        before: Before each on the terminal; ``{}`` is its number.
        style: As that of `Text`.
        id: Of their list on the page.
    """

    heading: str
    lines: Sequence[str]
    before: str = ""
    style: str = "warn"
    id: str = ""


@dataclass(frozen=True)
class Verdict:
    """The answer: a heading, and sentences with a bold word before each, or none.

    Attributes:
        heading: Beside the title on the terminal.
        sentences: Pairs of such a word, or "", and a sentence.
        kind: Class on the page, which has a colour of its own.
        style: Of the heading on the terminal.
    """

    heading: str
    sentences: Sequence[tuple[str, str]]
    kind: str = ""
    style: str = "bold"


@dataclass(frozen=True)
class Keys:
    """Numbers that a document begins with.

    Attributes:
        entries: Triples of the id on the page, the number and words behind it.
    """

    entries: Sequence[tuple[str, object, str]]


@dataclass(frozen=True)
class Figure:
    """A picture, or a function that draws it as ``<svg>``, or returns None for no picture.

    A ``wide`` one scrolls, by the keyboard as well.
    """

    picture: str | Callable[[], str | None]
    caption: str = ""
    wide: bool = False

    def svg(self) -> Markup | None:
        """The picture, whose maker has escaped what it shows."""
        drawn = self.picture() if callable(self.picture) else self.picture
        return None if drawn is None else Markup(drawn)


@dataclass(frozen=True)
class Items:
    """A list on the page."""

    lines: Sequence[str]
    kind: str = "plain"
    id: str = ""


@dataclass(frozen=True)
class Terms:
    """Words with their explanations, or questions with their answers, on the page."""

    entries: Sequence[tuple[str, str]]
    id: str = ""


@dataclass(frozen=True)
class Folded:
    """Blocks that the page shows when its reader asks for them."""

    summary: str
    blocks: Sequence[object]
    id: str = ""


@dataclass(frozen=True)
class Beside:
    """Blocks beside one another on the page: tables as a ``pair``, pictures as ``shapes``."""

    kind: str
    blocks: Sequence[object]


@dataclass(frozen=True)
class View:
    """What the page's script draws, or None; and blocks in its place on paper.

    Attributes:
        view: A `view.scene`, or the curves of `chart.curve_chart`.
        blocks: In its place.
        kind: ``view`` or ``chart``.
    """

    view: Markup | None
    blocks: Sequence[object] = ()
    kind: str = "view"


@dataclass(frozen=True)
class OnTerminal:
    """Blocks that the page leaves out."""

    blocks: Sequence[object]


@dataclass(frozen=True)
class OnPage:
    """Blocks that the terminal leaves out, or a function that makes them.

    The function is called on every rank, and returns None on ranks that write no page.
    """

    blocks: Sequence[object] | Callable[[], Sequence[object] | None]


@dataclass(frozen=True)
class Document:
    """The result of a command for readers.

    Attributes:
        title: Of the case.
        subject: Kind of result, behind the title in a tab and in the terminal's first line.
        about: The same in more words, above the title of the page.
        blocks: In their order.
        data: Makes the content of the JSON file.
    """

    title: str
    subject: str
    about: str = ""
    blocks: Sequence[object] = ()
    data: Callable[[], dict[str, object]] = field(default=dict, repr=False)


def sentence(text: str) -> str:
    """A text as a sentence: a capital, and a full stop."""
    return f"{text[:1].upper()}{text[1:]}."
