"""The database file: SQLite, safe when several processes write and when one is killed.

Each change is one transaction, synced to disk before the call returns. The journal is SQLite's
rollback journal, not WAL, since that one must not lie on a network file system, where sweeps run.
"""

from __future__ import annotations

import csv
import io
import os
import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from importlib import resources
from pathlib import Path
from tempfile import TemporaryDirectory

from fenics_joints.database.joints import NUMBERS, TEXTS, UNITS, JointRow
from fenics_joints.errors import InputError, located
from fenics_joints.files import FORMULA, check_writable, csv_text, is_file, write_text
from fenics_joints.units import factor_to_si, plain_number

#: SQLite's application_id of such a file, "FJDB", and the version of its tables.
_APPLICATION, _SCHEMA = 0x464A4442, 1
_COLUMNS = NUMBERS + TEXTS
#: Seconds to wait for another process's transaction.
_PATIENCE = 60.0
_TABLES = f"""
CREATE TABLE joints (
  id INTEGER PRIMARY KEY,
  {", ".join(f"{c} REAL" for c in NUMBERS)},
  {", ".join(f"{c} TEXT" for c in TEXTS)},
  task TEXT UNIQUE
);
CREATE TABLE failures (task TEXT PRIMARY KEY, sample TEXT, message TEXT, date TEXT);
"""


class Store:
    """A database of joint parameters; a context that closes it.

    Args:
        path: The file, or ``:memory:``.
        create: Make the file if it is not there.
        readonly: Never write to it.

    Raises:
        InputError: If there is no such file, it is not such a database, or cannot be opened.
    """

    def __init__(self, path: str | Path, *, create: bool = False, readonly: bool = False):
        self.path, self.readonly = str(path), readonly
        memory = self.path == ":memory:"
        if create and not readonly and not memory and not os.path.lexists(path):
            _make(Path(path))
        if not memory and not create and not is_file(path):
            raise InputError(f"{path}: no such file, expected a database of joint parameters")
        uri = (
            self.path if memory else f"{Path(path).absolute().as_uri()}?mode={_mode(path, create)}"
        )
        try:
            self._connection = sqlite3.connect(
                uri,
                uri=not memory,
                timeout=_PATIENCE,
                isolation_level=None,
                check_same_thread=False,
            )
        except sqlite3.Error as error:
            raise InputError(f"{path}: cannot be opened ({error})") from error
        try:
            with self._told():
                self._prepare(create or memory)
        except InputError:
            self.close()
            raise

    def __repr__(self) -> str:
        return f"Store({self.path!r})"

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *exception) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._connection.close()

    def add(self, joints: Iterable[JointRow]) -> int:
        """Add rows, all or none; returns how many."""
        rows = [_row(joint) for joint in joints]
        with self._writing() as connection:
            connection.executemany(_insert(), rows)
        return len(rows)

    def joints(self, *, model: str | None = None) -> list[JointRow]:
        """Rows in the order in which they came, of all models or one."""
        where, values = ("", ()) if model is None else ("WHERE model = ?", (model,))
        with self._told():
            rows = self._connection.execute(
                f"SELECT {', '.join(_COLUMNS)} FROM joints {where} ORDER BY id", values
            ).fetchall()
        return [JointRow(**dict(zip(_COLUMNS, row, strict=True))) for row in rows]

    # -- tasks of a sweep --------------------------------------------------------------------------

    def finished(self, tasks: Iterable[str]) -> set[str]:
        """Which of the tasks (`JointRow.task`) have a row, computed here or imported."""
        return set(tasks) & {joint.task for joint in self.joints()}

    def failed(self, tasks: Iterable[str]) -> dict[str, str]:
        """Which of the tasks failed, with the message."""
        with self._told():
            failures = dict(self._connection.execute("SELECT task, message FROM failures"))
        return {task: failures[task] for task in tasks if task in failures}

    def finish(self, joint: JointRow) -> None:
        """Record a task's row; a second one for the same task is dropped."""
        task = joint.task
        with self._writing() as connection:
            connection.execute(_insert("task", "OR IGNORE"), (*_row(joint), task))
            connection.execute("DELETE FROM failures WHERE task = ?", (task,))

    def fail(self, task: str, sample: str, message: str, date: str) -> None:
        """Record that a task failed, instead of what was recorded before."""
        with self._writing() as connection:
            connection.execute(
                "INSERT OR REPLACE INTO failures VALUES (?, ?, ?, ?)", (task, sample, message, date)
            )

    # -- CSV ---------------------------------------------------------------------------------------

    def csv_text(self) -> str:
        """All rows as CSV; numbers with all their digits, units in the heads. Text that a
        spreadsheet would take for a formula begins with an apostrophe, which `import_csv` drops."""
        return csv_text([[_head(c) for c in _COLUMNS], *map(_row, self.joints())])

    def export_csv(self, path: str | Path) -> None:
        """Write `csv_text` to a file. Raises InputError if it cannot be written."""
        write_text(path, self.csv_text())

    def import_csv(self, path: str | Path) -> int:
        """Add the rows of a file as `export_csv` writes it, all or none; returns how many.

        Columns may be missing; units may be others than SI.

        Raises:
            InputError: Names the file, the line and what was expected.
        """
        try:
            with open(path, encoding="utf-8-sig", newline="") as stream:
                text = stream.read()
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(f"{path}: cannot be read ({error}), expected CSV in UTF-8") from error
        try:
            return self.add(_from_csv(str(path), text))
        except csv.Error as error:
            raise InputError(f"{path}: {error}; expected short cells") from error

    # -- SQLite ------------------------------------------------------------------------------------

    def _prepare(self, create: bool) -> None:
        # Definitions in a stranger's file may only call SQLite's harmless functions.
        self._connection.execute("PRAGMA trusted_schema = OFF")
        self._connection.execute("PRAGMA cell_size_check = ON")
        self._connection.execute("PRAGMA synchronous = FULL")
        if self.readonly:
            self._connection.execute("PRAGMA query_only = ON")
        if create and not self.readonly:
            with self._writing() as connection:
                empty = not connection.execute("SELECT 1 FROM sqlite_master").fetchone()
                if empty and not self._pragma("application_id"):
                    for statement in _TABLES.split(";"):
                        connection.execute(statement)
                    connection.execute(f"PRAGMA application_id = {_APPLICATION}")
                    connection.execute(f"PRAGMA user_version = {_SCHEMA}")
        if self._pragma("application_id") != _APPLICATION:
            raise InputError(
                f"{self.path}: is an SQLite file of another program, expected a database of "
                "joint parameters"
            )
        more = "SELECT name FROM sqlite_master WHERE type IN ('view', 'trigger')"
        for (name,) in self._connection.execute(more):
            raise InputError(
                f"{self.path}: has the view or trigger {name!r}, expected tables only, as in "
                "a database of joint parameters"
            )
        if self._pragma("user_version") != _SCHEMA:
            raise InputError(
                f"{self.path}: has schema {self._pragma('user_version')}, expected {_SCHEMA}: "
                "export it to CSV with the version that wrote it, and import that"
            )

    def _pragma(self, name: str) -> int:
        return self._connection.execute(f"PRAGMA {name}").fetchone()[0]

    @contextmanager
    def _told(self) -> Iterator[None]:
        try:
            yield
        except (sqlite3.Error, UnicodeDecodeError) as error:
            raise InputError(
                f"{self.path}: {error}; expected a database of joint parameters"
                + (" that can be written to" if "readonly" in str(error) else "")
            ) from error

    @contextmanager
    def _writing(self) -> Iterator[sqlite3.Connection]:
        """A transaction: committed whole at the end, or rolled back."""
        with self._told():
            self._connection.execute("BEGIN IMMEDIATE")
            try:
                yield self._connection
                self._connection.execute("COMMIT")
            except BaseException:
                self._connection.rollback()
                raise


def seed_database() -> Store:
    """The tables of Machines 2022 that come with the package, in memory.

    Tables 2 and 3: 35 contact analyses of M12; Tables 7 and 11: two joints with E, nu and h.
    """
    store = Store(":memory:")
    text = resources.files(__package__).joinpath("seed000.csv").read_text(encoding="utf-8")
    store.add(_from_csv("seed000.csv", text))
    return store


def _make(path: Path) -> None:
    """An empty database, whole or not at all; one that another process makes meanwhile stays.

    SQLite itself would leave a file of no bytes where the disk is full.
    """
    check_writable(path, "database")
    with TemporaryDirectory(prefix=f".{path.name[:100]}.", dir=path.parent) as folder:
        whole = Path(folder) / "database"
        whole.touch()  # so that this is not called again
        Store(whole, create=True).close()
        try:
            os.link(whole, path)
        except FileExistsError:
            pass
        except OSError:  # a file system without links: SQLite makes it in place
            return


def _mode(path: str | Path, create: bool) -> str:
    """Mode to open a file in: SQLite's read-only mode only where nothing can be written.

    In that mode SQLite could not roll back what a killed process left half-written.
    """
    if create:
        return "rwc"
    writable = os.access(path, os.W_OK) and os.access(Path(path).absolute().parent, os.W_OK)
    return "rw" if writable else "ro"


def _row(joint: JointRow) -> tuple[float | str | None, ...]:
    """Its fields in the order of the columns."""
    return tuple(getattr(joint, column) for column in _COLUMNS)


def _insert(extra: str | None = None, or_what: str = "") -> str:
    columns = _COLUMNS if extra is None else (*_COLUMNS, extra)
    marks = ", ".join("?" * len(columns))
    return f"INSERT {or_what} INTO joints ({', '.join(columns)}) VALUES ({marks})"


def _head(column: str) -> str:
    unit = UNITS.get(column, "")
    return f"{column} [{unit}]" if unit else column


def _from_csv(name: str, text: str) -> list[JointRow]:
    reader = csv.reader(io.StringIO(text, newline=""))
    heads = next(reader, [])
    columns = [_column(name, head) for head in heads]
    if "diameter" not in [c for c, _ in columns]:
        raise InputError(f"{name}: expected columns {', '.join(map(_head, _COLUMNS))}")
    joints = []
    for row in reader:
        if not any(cell.strip() for cell in row):
            continue
        with located(f"{name}: line {reader.line_num}"):
            if len(row) != len(columns):
                raise InputError(f"{len(row)} cells, expected {len(columns)} as in the head")
            joints.append(JointRow(**_values(columns, row)))
    return joints


def _column(name: str, head: str) -> tuple[str, float]:
    """A column's field and the factor to SI of its unit."""
    field, _, unit = head.strip().rstrip("]").partition("[")
    field, unit = field.strip(), unit.strip()
    if field not in _COLUMNS:
        raise InputError(f"{name}: column {head!r}, expected one of {', '.join(_COLUMNS)}")
    if unit == UNITS.get(field, ""):
        return field, 1.0  # exactly as written, and without waiting for the units' library
    with located(f"{name}: column {head!r}"):
        return field, factor_to_si(unit, UNITS.get(field, ""))


def _values(columns, row) -> dict[str, float | str]:
    values = {}
    for (field, factor), cell in zip(columns, row, strict=True):
        if cell == "":
            continue
        if field in NUMBERS:
            try:
                values[field] = plain_number(cell) * factor
            except ValueError as error:
                raise InputError(f"{field} = {cell!r}: expected a number") from error
        else:
            values[field] = cell[1:] if cell[0] == "'" and FORMULA.match(cell) else cell
    if "diameter" not in values:
        raise InputError("diameter is empty, expected a number in m")
    return values
