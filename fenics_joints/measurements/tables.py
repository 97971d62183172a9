"""Tables of measured numbers, from CSV or TOML."""

from __future__ import annotations

import csv
import difflib
import math
import re
from collections import Counter
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from fenics_joints.errors import InputError, Problems, located
from fenics_joints.files import path_of, read_text, read_toml
from fenics_joints.formatting import control_character
from fenics_joints.units import factor_to_si, plain_number

__all__ = ["LISTED", "Table", "column_head", "read_table"]

_COMMA = re.compile(r"^([+-]?\d+),(\d+(?:[eE][+-]?\d+)?)$")
#: A number that a comma of thousands may have, too.
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}")
#: How many wrong cells, or rows, a message names.
_NAMED = 10
#: How many columns a message names.
LISTED = 30


@dataclass(frozen=True)
class Table:
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
        return f"Table({self.path.name}: {len(self.values)} rows of {len(self.names)} columns)"

    @cached_property
    def _index(self) -> dict[str, int]:
        return {name: i for i, name in enumerate(self.names)}

    def unit(self, name: str) -> str:
        """Unit of a column that is there, as written; empty where there is none."""
        return self.units[self._index[name]]

    def column(self, name: str, unit: str | None = None) -> np.ndarray:
        """A column, in SI ``unit``, or as written when that is None.

        Raises:
            InputError: If there is no such column, or its unit measures something else.
        """
        i = self._index.get(name)
        if i is None:
            known = self.names[:LISTED]
            near = difflib.get_close_matches(name, known, 1)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            more = f" and {len(self.names) - LISTED} more" if len(self.names) > LISTED else ""
            raise InputError(
                f"{self.path}: has no column {name!r}{hint} Expected one of: "
                f"{', '.join(known)}{more}"
            )
        if unit is None:
            return self.values[:, i]
        with located(f"{self.path}: head of column {name!r}"):
            if unit and not self.units[i]:
                raise InputError(f"expected its unit in brackets, such as '{name} [{unit}]'")
            return self.values[:, i] * factor_to_si(self.units[i], unit)


def column_head(text: str) -> tuple[str, str]:
    """Name and unit of a column's head such as ``torque [N·m]``; the unit is empty if not there."""
    text = text.strip()
    start = text.find("[", text.rfind("]", 0, -1) + 1)
    if start < 0 or not text.endswith("]"):
        return text, ""
    return text[:start].rstrip(), text[start + 1 : -1].strip()


def read_table(path: str | Path) -> Table:
    """Read columns of numbers from CSV, or from TOML with an array for each column.

    A column's head is its name and its unit in brackets, such as ``torque [N·m]``. An empty CSV
    cell, or ``nan`` in TOML, is a value that was not measured. Lines that begin with # are skipped.
    Between the cells of CSV stand commas, or semicolons or tabs and then perhaps decimal commas.

    Raises:
        InputError: Names the file, the row (the line, for CSV), the column and what was expected.
    """
    path = path_of(path)
    problems = Problems(path)
    if path.suffix == ".toml":
        heads, rows, notes = _toml_rows(path)
    else:
        heads, rows, notes = _csv_rows(path, problems)
    split = [column_head(head) for head in heads]
    names = tuple(name for name, _ in split)
    for hidden in (head for head in heads if control_character(head)):
        problems.add(InputError(
            f"{path}: the head {hidden[:40]!r} has the control character "
            f"{control_character(hidden)}; expected text that can be printed"
        ))  # fmt: skip
    for name, count in Counter(names).items():
        if not name or count > 1:
            what = f"column name {name!r}, expected a name for each, used once"
            problems.add(InputError(f"{path}: {what}"))
    values = problems.tried(lambda: _numbers(path, heads, rows))
    problems.check()
    return Table(path, names, tuple(unit for _, unit in split), values, notes)


def _csv_rows(path: Path, problems: Problems):
    """Heads, (line number, cells) of each row that has as many, and notes."""
    lines = read_text(path, "measured data in CSV or TOML").splitlines()
    kept = [(i, s) for i, s in enumerate(lines, 1) if s.strip() and not s.lstrip().startswith("#")]
    if len(kept) < 2:
        raise InputError(f"{path}: has {len(kept)} rows, expected a head and rows of numbers")
    comma = next((sign for sign in ",;\t" if sign in kept[0][1]), ",")
    cells = [_cells(path, line, text, comma) for line, text in kept]
    heads = cells[0]
    wrong = [f"row {line} has {len(row)} cells" for (line, _), row
             in zip(kept[1:], cells[1:], strict=True) if len(row) != len(heads)]  # fmt: skip
    if wrong:
        more = f" and {len(wrong) - _NAMED} more" if len(wrong) > _NAMED else ""
        problems.add(InputError(
            f"{path}: {'; '.join(wrong[:_NAMED])}{more}, expected {len(heads)} as in the head"
        ))  # fmt: skip
    whole = [(line, row) for (line, _), row in zip(kept[1:], cells[1:], strict=True)
             if len(row) == len(heads)]  # fmt: skip
    rows = [row for _, row in whole]
    rows, notes = (rows, ()) if comma == "," else _with_points(path, rows)
    return heads, [(line, row) for (line, _), row in zip(whole, rows, strict=True)], notes


def _cells(path: Path, line: int, text: str, comma: str) -> list[str]:
    try:
        row = next(csv.reader([text], delimiter=comma, skipinitialspace=True))
    except csv.Error as error:
        raise InputError(f"{path}: row {line}: {error}; expected cells of numbers") from error
    return [cell.strip() for cell in row]


def _with_points(path: Path, rows: list[list[str]]):
    """Cells of a table without decimal points, with decimal commas made into such points.

    And what has to be said of it: a comma before three digits may be one of thousands.
    """
    if any("." in cell for row in rows for cell in row):
        return rows, ()
    read = [[_COMMA.sub(r"\1.\2", cell) for cell in row] for row in rows]
    either = [cell for row in rows for cell in row if _THOUSANDS.fullmatch(cell)]
    if not either:
        return read, ()
    cell = either[0]
    more = f" (and {len(either) - 1} cells like it)" if len(either) > 1 else ""
    note = (
        f"{path}: {cell!r}{more} is read as {float(cell.replace(',', '.')):g}, with a decimal "
        f"comma; for {cell.replace(',', '')} write it without a comma"
    )
    return read, (note,)


def _toml_rows(path: Path):
    columns = read_toml(path, "measured data in CSV or TOML")
    for head, column in columns.items():
        if not isinstance(column, list) or not column:
            shown = repr(column)[:80]
            raise InputError(f"{path}: {head!r} = {shown}, expected an array of numbers")
    lengths = {head: len(column) for head, column in columns.items()}
    if len(set(lengths.values())) != 1:
        shown = ", ".join(f"{head}: {n}" for head, n in list(lengths.items())[:_NAMED])
        raise InputError(f"{path}: the arrays have lengths {shown}, expected one and the same")
    return list(columns), list(enumerate(zip(*columns.values(), strict=True), 1)), ()


def _numbers(path: Path, heads, rows) -> np.ndarray:
    values, errors = np.full((len(rows), len(heads)), np.nan), []
    for i, (row, cells) in enumerate(rows):
        for j, cell in enumerate(cells):
            if cell == "":
                continue
            try:
                values[i, j] = plain_number(cell) if isinstance(cell, str) else float(cell)
                good = not math.isinf(values[i, j]) and not isinstance(cell, bool)
            except (TypeError, ValueError):
                good = False
            if not good:
                errors.append(f"row {row}, column {heads[j]!r} = {_short(cell)}")
    if errors:
        more = f" and {len(errors) - _NAMED} more" if len(errors) > _NAMED else ""
        raise InputError(
            f"{path}: {'; '.join(errors[:_NAMED])}{more}: expected a number, or nothing where none "
            "was measured"
        )
    return values


def _short(cell: object) -> str:
    shown = repr(cell)
    return shown if len(shown) <= 60 else f"{shown[:57]}..."
