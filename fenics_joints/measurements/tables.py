"""Tables of measured numbers, from CSV or TOML."""

from __future__ import annotations

import csv
import difflib
import math
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from fenics_joints.errors import InputError, Problems, located, shown
from fenics_joints.files import check_size, is_file, path_of, read_toml, shown_path
from fenics_joints.formatting import control_character, first_of
from fenics_joints.progress import reading
from fenics_joints.units import factor_to_si, plain_number

_COMMA = re.compile(r"^([+-]?\d+),(\d+(?:[eE][+-]?\d+)?)$")
#: A number that a comma of thousands may have, too.
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}")
#: How many wrong cells, or rows, a message names.
_NAMED = 10
#: How many columns a message names.
LISTED = 30
_EXPECTED = "measured data in CSV or TOML"
_NO_NUMBER = "expected a number, or an empty cell where nothing was measured"
#: Rows between reports of progress, and characters of a line above which a file has no lines.
_STEP, _LONGEST = 1000, 50_000_000


@dataclass(frozen=True)
class DataTable:
    """Columns of numbers from a file.

    Attributes:
        path: The file.
        names: Names of the columns, without their units.
        units: Units in brackets in the columns' heads; empty where there is none.
        values: Shape (n_rows, n_columns); nan where a cell is empty.
        notes: How cells were read that could be read in two ways, in sentences.
    """

    path: Path
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: np.ndarray
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"DataTable({self.path.name}: {len(self.values)} rows of {len(self.names)} columns)"

    @cached_property
    def _index(self) -> dict[str, int]:
        return {name: i for i, name in enumerate(self.names)}

    def unit(self, name: str) -> str:
        """Unit of a column that is there, as written; empty where there is none."""
        return self.units[self._index[name]]

    def column(self, name: str, unit: str | None = None) -> np.ndarray:
        """A column in an SI unit, or as written if ``unit`` is None.

        Raises:
            InputError: If there is no such column, or its unit measures something else.
        """
        i = self._index.get(name)
        if i is None:
            known = self.names[:LISTED]
            near = difflib.get_close_matches(name, known, 1)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            raise InputError(
                f"{self.path}: has no column {name!r}{hint} Expected one of: "
                f"{first_of(self.names, LISTED)}"
            )
        if unit is None:
            return self.values[:, i]
        with located(f"{self.path}: head of column {name!r}"):
            if unit and not self.units[i]:
                raise InputError(f"expected its unit in brackets, such as '{name} [{unit}]'")
            return self.values[:, i] * factor_to_si(self.units[i], unit)

    def numbers(
        self, name: str, unit: str | None = None, *, above: float = -math.inf
    ) -> np.ndarray:
        """`column` with a number above a bound in every row.

        Raises:
            InputError: As `column`; names the first row without one.
        """
        values = self.column(name, unit)
        bad = ~(np.isfinite(values) & (values > above))
        if bad.any():
            row = int(np.argmax(bad))
            found = "is empty" if np.isnan(values[row]) else f"= {values[row]:g}"
            bound = "" if above == -math.inf else f" above {above:g}"
            raise InputError(
                f"{self.path}: column {name!r}, data row {row + 1} {found}; expected a "
                f"number{bound}"
            )
        return values

    def phase(self, name: str = "phase") -> np.ndarray:
        """A column of phases, rad.

        Raises:
            InputError: If its unit is none of an angle, or a row has no number.
        """
        unit = self.unit(name)
        if unit not in ("deg", "°", "rad"):
            raise InputError(
                f"{self.path}: column {name!r}: unit {unit!r}, expected [deg] or [rad]"
            )
        values = self.numbers(name)
        return values if unit == "rad" else np.deg2rad(values)


def column_head(text: str) -> tuple[str, str]:
    """Name and unit of a column's head such as ``torque [N·m]``; the unit is empty if not there."""
    text = text.strip()
    start = text.find("[", text.rfind("]", 0, -1) + 1)
    if start < 0 or not text.endswith("]"):
        return text, ""
    return text[:start].rstrip(), text[start + 1 : -1].strip()


def read_table(path: str | Path) -> DataTable:
    """Read columns of numbers from CSV, or from TOML with an array for each column.

    A column's head is its name and its unit in brackets, such as ``torque [N·m]``. An empty CSV
    cell, or ``nan`` in TOML, is a value that was not measured. Lines that begin with # are skipped.
    Between the cells of CSV stand commas, or semicolons or tabs and then perhaps decimal commas.
    CSV is text in UTF-8, UTF-16 with its mark, or Latin-1; columns without a head and a cell at the
    right are left out. A table whose heads stand in its first column is turned.

    Raises:
        InputError: Names the file, the row (the line, for CSV), the column and what was expected.
    """
    path = path_of(path)
    problems = Problems(path)
    if path.suffix == ".toml":
        (heads, values), notes = _toml_columns(path, problems), ()
    else:
        file = _Csv(path)
        heads = file.heads
        values, notes = problems.tried(lambda: file.read(problems)) or (None, ())
    split = [column_head(head) for head in heads]
    names = tuple(name for name, _ in split)
    for hidden in (head for head in heads if control_character(head)):
        problems.add(
            f"{path}: the head {hidden[:40]!r} has the control character "
            f"{control_character(hidden)}; expected text that can be printed"
        )
    for name, count in Counter(names).items():
        if not name or count > 1:
            what = f"column name {name!r}, expected a name for each, used once"
            problems.add(f"{path}: {what}")
    problems.check()
    return DataTable(path, names, tuple(unit for _, unit in split), values, notes)


#: A number, as the cells of the first row are where heads stand in the first column; and rows of
#: such a table at most.
_PLAIN, _WIDE = re.compile(r"[-+]?\d+([.,]\d+)?([eE][-+]?\d+)?"), 10_000


class _Csv:
    """Rows of a CSV file, read line by line: a table takes the memory of its numbers alone."""

    def __init__(self, path: Path):
        if not is_file(path):
            raise InputError(f"{shown_path(path)}: no such file, expected {_EXPECTED}")
        check_size(path)
        self.path, self.size = path, path.stat().st_size
        with path.open("rb") as stream:
            mark = stream.read(2)
        self.encoding = "utf-16" if mark in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
        self._turned: list[str] = []
        try:
            self._look()
        except UnicodeDecodeError:
            self.encoding = "latin-1"
            self._look()
        except OSError as error:
            raise InputError(f"{shown_path(path)}: cannot be read ({error.strerror})") from error
        if rows := self._rows_by_quantity():
            width = max(map(len, rows))
            columns = zip(*(row + [""] * (width - len(row)) for row in rows), strict=True)
            self._turned = [self.comma.join(column) for column in columns if any(column)]
            self._look()

    def _rows_by_quantity(self) -> list[list[str]]:
        """The rows, if heads stand in the first column and numbers in the first row; else none."""
        first, *rest = self.heads
        numbers = rest and all(_PLAIN.fullmatch(cell) for cell in rest)
        if not numbers or _PLAIN.fullmatch(first) or self.n_rows >= _WIDE:
            return []
        rows = [self._cells(i, text) for i, text in self._lines()]
        return [] if any(_PLAIN.fullmatch(row[0]) for row in rows if row) else rows

    def _lines(self) -> Iterator[tuple[int, str]]:
        if self._turned:
            yield from enumerate(self._turned, 1)
            return
        with self.path.open(encoding=self.encoding) as stream:
            for i, text in enumerate(iter(lambda: stream.readline(_LONGEST), ""), 1):
                if len(text) == _LONGEST:
                    raise InputError(
                        f"{self.path}: row {i} has {_LONGEST:,} characters or more, expected a "
                        "table with a line for each row"
                    )
                if text.strip() and not text.lstrip().startswith("#"):
                    yield i, text

    def _look(self) -> None:
        """Heads, and whether cells have decimal points, which takes the whole file."""
        self.n_rows, self.comma, self.heads, self.pointed = -1, ",", [], False
        for i, text in self._lines():
            self.n_rows += 1
            if self.n_rows == 0:
                self.comma = next((sign for sign in ",;\t" if sign in text), ",")
                self.heads = self._cells(i, text)
            elif self.comma != "," and not self.pointed:
                self.pointed = "." in text
        while len(self.heads) > 1 and not self.heads[-1]:
            self.heads.pop()
        if self.n_rows < 1:
            raise InputError(
                f"{self.path}: has {self.n_rows + 1} rows, expected a head and rows of numbers"
            )

    def _cells(self, line: int, text: str) -> list[str]:
        text = text.rstrip("\r\n")
        if '"' not in text and len(text) < csv.field_size_limit():
            return [cell.strip() for cell in text.split(self.comma)]
        try:
            row = next(csv.reader([text], delimiter=self.comma, skipinitialspace=True))
        except csv.Error as error:
            raise InputError(
                f"{self.path}: row {line}: {error}; expected cells of numbers"
            ) from error
        return [cell.strip() for cell in row]

    def read(self, problems: Problems) -> tuple[np.ndarray, tuple[str, ...]]:
        """Values, (n_rows, n_columns), and notes."""
        n, commas = len(self.heads), self.comma != "," and not self.pointed
        # A cell takes at least a byte: a table with fewer bytes than cells has wrong rows.
        values = np.full((self.n_rows if self.n_rows * n <= self.size else 0, n), np.nan)
        wrong, bad, either, row = _Some(), _Some(), _Some(), 0
        lines = self._lines()
        next(lines)
        progress = reading(self.path.name, self.size, self.n_rows)
        for i, text in lines:
            row += 1
            if row % _STEP == 0:
                progress.advance(_STEP)
            cells = self._cells(i, text)
            while len(cells) > n and not cells[-1]:
                cells.pop()
            if len(cells) != n:
                wrong.add(f"row {i} has {len(cells)} cells")
            if len(cells) != n or not len(values):
                continue
            if commas:
                for cell in cells:
                    if _THOUSANDS.fullmatch(cell):
                        either.add(cell)
                cells = [_COMMA.sub(r"\1.\2", cell) for cell in cells]
            try:
                values[row - 1] = cells
                good = "_" not in text and not np.isinf(values[row - 1]).any()
            except ValueError:
                good = False
            if not good:
                values[row - 1] = [
                    _number(cell, i, h, bad) for cell, h in zip(cells, self.heads, strict=True)
                ]
        if wrong:
            problems.add(f"{self.path}: {wrong}, expected {n} as in the head")
        if bad:
            problems.add(f"{self.path}: {bad}: {_NO_NUMBER}")
        return values, self._notes(either)

    def _notes(self, either: _Some) -> tuple[str, ...]:
        """Notes on a table that was turned, and on a comma before three digits, which may separate
        thousands."""
        turned = (
            (f"{self.path}: has a row for each quantity, and was turned",) if self._turned else ()
        )
        if not either:
            return turned
        cell = either.first[0]
        more = f" (and {either.count - 1} cells like it)" if either.count > 1 else ""
        return (
            *turned,
            f"{self.path}: {cell!r}{more} is read as {float(cell.replace(',', '.')):g}, with a "
            f"decimal comma; for {cell.replace(',', '')} write it without a comma",
        )


class _Some:
    """The first of many texts, and how many there are."""

    def __init__(self):
        self.first: list[str] = []
        self.count = 0

    def add(self, text: str) -> None:
        self.count += 1
        if len(self.first) < _NAMED:
            self.first.append(text)

    def __bool__(self) -> bool:
        return self.count > 0

    def __str__(self) -> str:
        more = f" and {self.count - _NAMED} more" if self.count > _NAMED else ""
        return "; ".join(self.first) + more


def _number(cell: object, row: int, head: str, bad: _Some) -> float:
    """A cell's number; nan where it is empty, or bad."""
    if cell == "":
        return np.nan
    try:
        value = plain_number(cell) if isinstance(cell, str) else float(cell)
        if not math.isinf(value) and not isinstance(cell, bool):
            return value
    except (TypeError, ValueError):
        pass
    bad.add(f"row {row}, column {head!r} = {shown(cell)}")
    return np.nan


def _toml_columns(path: Path, problems: Problems) -> tuple[list[str], np.ndarray]:
    columns = read_toml(path, _EXPECTED)
    for head, column in columns.items():
        if not isinstance(column, list) or not column:
            raise InputError(f"{path}: {head!r} = {shown(column)}, expected an array of numbers")
    lengths = {head: len(column) for head, column in columns.items()}
    if len(set(lengths.values())) != 1:
        each = first_of([f"{head}: {n}" for head, n in lengths.items()], _NAMED)
        raise InputError(f"{path}: the arrays have lengths {each}, expected one and the same")
    bad = _Some()
    values = [
        [_number(cell, i, head, bad) for i, cell in enumerate(column, 1)]
        for head, column in columns.items()
    ]
    if bad:
        problems.add(f"{path}: {bad}: {_NO_NUMBER}")
    return list(columns), np.array(values).T
