"""Files that are either whole or not there."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import os
import re
import sys
import tempfile
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

import numpy as np

from fenics_joints.errors import InputError, items, wanted
from fenics_joints.formatting import control_character, printable
from fenics_joints.machine.private import changed_by_others

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


#: How deep tables and arrays of TOML may be nested, and the limit of its whole numbers (64 bits, by
#: its specification).
_DEEPEST, _LARGEST = 50, 2**63
#: Characters of the longest path that a message shows in full; bytes of the longest name of a file:
#: file systems take 255, and a file has a sibling with a longer name while it is written.
_LONGEST_SHOWN, _LONGEST_NAME = 300, 230
#: Text before the SHA-256 of the content at the end of a sealed file.
_SEAL = b"\nSHA-256 "
#: Hexadecimal digits of a SHA-256.
_DIGITS = 64
#: Bytes of the largest file of measured data, and of the largest text that is read at once; chosen
#: for memory.
_LARGEST_FILE, _LARGEST_TEXT = 2_000_000_000, 50_000_000
#: Ends of names of files by the option that names them, the usual one first.
SUFFIXES = {"--report": (".html", ".htm"), "--json": (".json",)}
#: A signed number with a unit, which no spreadsheet runs.
_SIGNED = re.compile(r"[-+]\d+(\.\d+)? [%A-Za-z/\u00b0-\u00b7]+")
#: First characters of a spreadsheet's formula, or of a formula written as text.
FORMULA = re.compile(r"'*\s*[=+\-@\uff1d\uff0b\uff0d\uff20]|'*[\t\r\n]")


def shown_path(path: str | Path) -> str:
    """A path for a message: long ones not whole, and nothing in it that a terminal obeys."""
    text = str(path)
    return printable(text if len(text) <= _LONGEST_SHOWN else f"{text[:_LONGEST_SHOWN]}...")


def path_of(value: object) -> Path:
    """The path that a user gave.

    Raises:
        InputError: If it is none.
    """
    if not isinstance(value, str | Path) or not str(value):
        raise wanted("path", value, "the name of a file")
    return Path(value)


def paths_of(value: object) -> list[Path]:
    """One path that a user gave, or several.

    Raises:
        InputError: If it is none.
    """
    if isinstance(value, str | Path):
        return [path_of(value)]
    return [path_of(each) for each in items("paths", value, (str, Path), "names of files")]


def is_file(path: str | Path) -> bool:
    """Whether a path is a file; False for names that no file can have."""
    return os.path.isfile(path)  # a Path raises for some of those


def check_size(path: str | Path, most: int = _LARGEST_FILE) -> None:
    """Raise InputError for a file with more bytes than allowed."""
    size = os.path.getsize(path)
    if size > most:
        raise InputError(
            f"{shown_path(path)}: has {size / 1e6:,.0f} MB, expected at most {most / 1e6:,.0f} MB: "
            "keep only the data that you need"
        )


def check_unpacked(path: str | Path, most: int) -> None:
    """Raise InputError for a packed file that holds more bytes than allowed."""
    with zipfile.ZipFile(path) as packed:
        size = sum(member.file_size for member in packed.infolist())
    if size > most:
        raise InputError(
            f"{shown_path(path)}: unpacks to {size / 1e9:.3g} GB, expected at most "
            f"{most / 1e9:g} GB"
        )


def read_text(path: str | Path, expected: str) -> str:
    """Text of a file in UTF-8; a mark that editors put at its begin is left out.

    Args:
        path: The file.
        expected: What it should hold, for messages.

    Raises:
        InputError: If there is no such file, or it cannot be read as text.
    """
    name = shown_path(path)
    if not is_file(path):
        raise InputError(f"{name}: no such file, expected {expected}")
    try:
        check_size(path, _LARGEST_TEXT)
        content = Path(path).read_bytes()
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
            raise InputError(f"{name}: is text in UTF-16, expected it in UTF-8") from error
        raise InputError(f"{name}: cannot be read ({error}), expected text in UTF-8") from error
    except OSError as error:
        raise InputError(f"{name}: cannot be read ({error.strerror})") from error


def read_toml(path: str | Path, expected: str) -> dict:
    """Content of a TOML file, not deeper than a reader can follow, its whole numbers of 64 bits.

    Raises:
        InputError: As `read_text`; if it is no such TOML.
    """
    text = read_text(path, expected)
    if _DOTTED.search(text):  # which a reader takes minutes for
        raise InputError(f"{path}: {_TOO_DEEP}")
    try:
        content = tomllib.loads(text)
    except RecursionError:
        raise InputError(f"{path}: {_TOO_DEEP}") from None
    except ValueError as error:  # a TOMLDecodeError, or Python's for a number of 4,300 digits
        reason = _TOO_LARGE if "integer string conversion" in str(error) else f"({error})"
        line = re.search(r"at line (\d+)", str(error))
        said = text.splitlines()[int(line[1]) - 1] if line else ""
        if bare := _BARE.search(said):
            reason += f'; a value with a unit needs quotes: "{bare[1].strip()}"'
        raise InputError(f"{path}: cannot be read as TOML: {reason}") from error
    _check_toml(path, content)
    return content


def toml_value(text: str) -> dict | None:
    """Content of a line of TOML, not deeper than that of a file; None if it is none."""
    if _DOTTED.search(text):
        return None
    try:
        content = tomllib.loads(text)
        _check_toml("--set", content)
    except (ValueError, RecursionError):
        return None
    return content


#: A quantity without the quotes that TOML wants.
_BARE = re.compile(r"=\s*([-+]?\d[\d.]*(?:e[-+]?\d+)?\s*[A-Za-z%\u00b5][\w/%\u00b7.^ ]*)")
_TOO_DEEP = f"tables or arrays are nested more than {_DEEPEST} deep, expected fewer"
_DOTTED = re.compile(
    rf"(?<![\w-])(?:(?:[\w-]+|\"[^\"\n]*\"|'[^'\n]*')[ \t]*\.[ \t]*){{{_DEEPEST}}}"
)
_TOO_LARGE = "a whole number has more than the 64 bits that TOML allows"


def _check_toml(path: str | Path, content: dict) -> None:
    level: list[dict | list] = [content]
    for _ in range(_DEEPEST):
        below = []
        for item in level:
            values = [*item, *item.values()] if isinstance(item, dict) else item
            for value in values:
                if isinstance(value, dict | list):
                    below.append(value)
                elif isinstance(value, str) and control_character(value):
                    raise InputError(
                        f"{path}: the text {value[:40]!r} has the control character "
                        f"{control_character(value)}; expected text that can be printed"
                    )
                elif isinstance(value, int) and not -_LARGEST <= value < _LARGEST:
                    raise InputError(f"{path}: cannot be read as TOML: {_TOO_LARGE}")
        level = below
    if level:
        raise InputError(f"{path}: {_TOO_DEEP}")


def check_writable(path: str | Path, what: str) -> Path:
    """Raise before the work starts if a file could not be written after it.

    Args:
        path: The file to be.
        what: Name of the option, for the message.

    Raises:
        InputError: If the folder does not exist or cannot be written to, or the path is a folder.
    """
    path = Path(path)
    folder = path.parent
    if len(os.fsencode(path.name)) > _LONGEST_NAME:
        raise InputError(
            f"{what} {path.name[:40]}...: a name of {len(path.name)} characters; expected at most "
            f"{_LONGEST_NAME}"
        )
    if not os.path.isdir(folder):
        raise InputError(
            f"{what} {shown_path(path)}: no folder {shown_path(folder)}; expected one that exists"
        )
    if os.path.isdir(path):
        raise InputError(f"{what} {path}: is a folder; expected the name of a file")
    if not os.access(path if _is_stream(path) else folder, os.W_OK):
        raise InputError(f"{what} {path}: {folder} cannot be written to; expected one that can")
    return path


def writable_folder(path: str | Path, what: str) -> Path:
    """A folder to keep things in, made if it is not there. Raise before the work starts.

    Args:
        path: The folder.
        what: Name of the option, for the message.

    Raises:
        InputError: If it cannot be made or written to.
    """
    path, named = Path(path), f"{what} {shown_path(path)}"
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{named}: cannot be made ({error.strerror})") from error
    if not os.access(path, os.W_OK | os.X_OK):
        raise InputError(f"{named}: cannot be written to; expected a folder that can")
    return path


def check_outputs(
    outputs: Mapping[str, Path | None],
    inputs: Iterable[str | Path] = (),
    folder: Path | None = None,
) -> None:
    """Raise before the work starts if a file of results would take the place of another file.

    Args:
        outputs: The files to be by the option that names them; None for none.
        inputs: Files that the work reads.
        folder: A folder of results, made later; None for none.

    Raises:
        InputError: If one could not be written, is an input, by whatever name or link, is
            named by two options, or has a name of another format; if inputs are in the folder.
    """
    taken: dict[str, str] = {}
    read = [file for file in inputs if os.path.exists(file)]
    if folder is not None:
        _check_folder(folder, read)
    for option, path in outputs.items():
        if path is None:
            continue
        check_writable(path, option)
        if _is_stream(path):
            continue
        there = os.path.exists(path)
        for file in read:
            if there and os.path.samefile(path, file):
                raise InputError(
                    f"{option} {shown_path(path)}: is read as {shown_path(file)}, and would be "
                    "overwritten; expected another name"
                )
        other = taken.setdefault(os.path.realpath(path), option)
        if other != option:
            raise InputError(f"{option} {path}: is {other}'s file too; expected another")
    for option, path in outputs.items():
        expected = SUFFIXES.get(option, ())
        if path is None or not path.suffix or not expected or _is_stream(path):
            continue
        if path.suffix.lower() not in expected:
            raise InputError(
                f"{option} {shown_path(path)}: writes {expected[0][1:].upper()}; expected a name "
                f"that ends in {expected[0]}"
                + (" (a browser prints the page to PDF)" if option == "--report" else "")
            )


def _check_folder(folder: Path, read: Sequence[str | Path]) -> None:
    """Raise if results cannot be written to a folder, or if there are files in it that are read."""
    there = next(path for path in (folder, *folder.absolute().parents) if os.path.exists(path))
    if not os.path.isdir(there):
        raise InputError(
            f"--out {shown_path(folder)}: {shown_path(there)} is a file; expected a folder"
        )
    if not os.access(there, os.W_OK | os.X_OK):
        raise InputError(f"--out {shown_path(folder)}: {shown_path(there)} cannot be written to")
    for file in read:
        if os.path.realpath(os.path.dirname(os.path.abspath(file))) == os.path.realpath(folder):
            raise InputError(
                f"--out {shown_path(folder)}: {shown_path(os.path.basename(file))} is read from "
                "there; expected a folder of its own, so that nothing is overwritten"
            )


@contextmanager
def replaced(path: str | Path, own: bool = False) -> Iterator[Path]:
    """A temporary sibling to write to, which takes the file's place at the end, or disappears.

    Args:
        path: The file.
        own: Whether nobody else may write to it, whatever the user's mask.

    Raises:
        InputError: If it cannot be written; what was there before is still there.
    """
    path, part = Path(path), None
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".part")
        os.close(handle)
        part = Path(name)
        yield part
        mask = os.umask(0o077)
        os.umask(mask)
        with suppress(OSError):  # a file system without modes
            os.chmod(part, (0o644 if own else 0o666) & ~mask)
        os.replace(part, path)
    except OSError as error:
        reason = error.strerror or error
        raise InputError(f"{path}: cannot be written ({reason})") from error
    finally:
        if part is not None:
            part.unlink(missing_ok=True)


@contextmanager
def sealed(path: str | Path) -> Iterator[Path]:
    """As `replaced`, of the user's own, for a file that ends with a digest of its content.

    HDF5 files may be followed by other bytes, so that their own readers open the file.
    """
    with replaced(path, own=True) as part:
        yield part
        with part.open("r+b") as file:
            file.write(_SEAL + _digest(file, part.stat().st_size))


@contextmanager
def unsealed(path: str | Path, own: bool = True) -> Iterator[BinaryIO]:
    """Open a file of `sealed`, if it has not changed since.

    Args:
        path: The file.
        own: Whether the file has to belong to the user, with nobody else able to write to it.

    Raises:
        InputError: If it cannot be opened, is another user's, or its content does not match the
            digest.
    """
    name = shown_path(path)
    if not is_file(path):
        raise InputError(f"{name}: there is no such file")
    try:
        with open(path, "rb") as file:
            # Of the file that is open, whatever has its name by now.
            reason = changed_by_others(os.fstat(file.fileno())) if own else ""
            if reason:
                raise InputError(f"{name}: {reason}; expected a file of your own")
            length = os.fstat(file.fileno()).st_size - len(_SEAL) - _DIGITS
            if length < 0 or _SEAL + _digest(file, length) != file.read():
                raise InputError(
                    f"{name}: is damaged, truncated, or not a kept file: its checksum does not "
                    "match its content"
                )
            file.seek(0)
            yield file
    except OSError as error:
        raise InputError(f"{name}: cannot be read ({error.strerror or error})") from error


def _digest(file: BinaryIO, length: int) -> bytes:
    """SHA-256 of a file's first bytes, in hexadecimal digits; the file then stands after them."""
    digest = hashlib.sha256()
    while length > 0 and (block := file.read(min(length, 1 << 20))):
        digest.update(block)
        length -= len(block)
    return digest.hexdigest().encode()


def file_digest(path: str | Path) -> str:
    """SHA-256 of a file's content, in hexadecimal digits; raises OSError if it cannot be read."""
    with open(path, "rb") as file:
        return _digest(file, os.path.getsize(path)).decode()


def json_digest(content: object, default: Callable[[object], object] | None = None) -> str:
    """SHA-256 of a content's JSON with sorted keys, in hexadecimal digits.

    Args:
        content: Nested values.
        default: See `json.dumps`.
    """
    text = json.dumps(content, sort_keys=True, default=default)
    return hashlib.sha256(text.encode()).hexdigest()


def write_text(path: str | Path, text: str, own: bool = False) -> None:
    """Write a file through a temporary sibling, so that no reader ever sees a part of it.

    Args:
        path: The file.
        text: Its content.
        own: See `replaced`.

    Raises:
        InputError: If it cannot be written; what was there before is still there.
    """
    path = Path(path)
    if lost := re.search("[\ud800-\udfff]", text):  # bytes of a name that are no UTF-8
        near = printable(text[max(lost.start() - 40, 0) : lost.start() + 40])
        raise InputError(
            f"{shown_path(path)}: cannot be written in UTF-8, since it names {near!r}; expected "
            "file names in UTF-8"
        )
    if not _is_stream(path):
        with replaced(path.resolve(), own) as part:  # a link stays a link
            with part.open("w", encoding="utf-8") as stream:
                stream.write(text)
                stream.flush()
                os.fsync(stream.fileno())
        return
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from error


def json_text(content: Mapping[str, object]) -> str:
    """Text of JSON; raises ValueError for nan or infinity, which JSON does not have."""
    return json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def csv_text(rows: Iterable[Sequence[object]]) -> str:
    """Rows as CSV. Text that a spreadsheet would run as a formula begins with an apostrophe (OWASP,
    CSV injection)."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")

    def runs(v: object) -> bool:
        return isinstance(v, str) and bool(FORMULA.match(v)) and not _SIGNED.fullmatch(v)

    for row in rows:
        writer.writerow([f"'{v}" if runs(v) else v for v in row])
    return stream.getvalue()


def dataframe(columns: Mapping[str, object]):
    """Columns of equal length as a ``pandas.DataFrame``.

    Raises:
        InputError: If pandas is not installed.
    """
    try:
        import pandas
    except ImportError:
        raise InputError(
            "to_dataframe needs pandas, which is not installed: pip install pandas"
        ) from None
    return pandas.DataFrame(dict(columns))


def plain(value):
    """Nested values for JSON: lists, Python's numbers, None in place of nan and infinity."""
    if isinstance(value, dict):
        return {key: plain(v) for key, v in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [plain(v) for v in value]
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, (float, np.floating)):
        return float(value) if np.isfinite(value) else None
    return value.item() if isinstance(value, np.generic) else value


def _is_stream(path: Path) -> bool:
    """A pipe or a device, such as /dev/stdout: nothing to rename."""
    return path.exists() and not path.is_file() and not path.is_dir()
