"""Usable standard streams and environment variables, however the command was started."""

from __future__ import annotations

import codecs
import os
import sys
import unicodedata
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from fenics_joints.machine.private import folder_of_process

#: Plain forms of characters without one, for terminals and files that are not in UTF-8.
_PLAIN = {
    "·": "*",
    "×": "x",
    "–": "-",
    "—": "-",
    "−": "-",
    "µ": "u",
    "μ": "u",
    "°": "deg",
    "∞": "inf",
    "→": "->",
    "≤": "<=",
    "≥": ">=",
    "±": "+-",
    "√": "sqrt",
    "Σ": "sum",
}
#: Least columns that a variable may ask for: tables need room for their numbers.
_NARROWEST = 20


def environment() -> None:
    """Correct environment variables on which libraries fail, before their import.

    A terminal with zero columns shows nothing; Open MPI does not start without a home, nor PETSc in
    a folder that was removed.

    Raises:
        SystemExit: With a sentence, in a removed folder, where relative file names mean nothing.
    """
    try:
        os.getcwd()
    except OSError as error:
        sys.exit(f"error: the current folder: {error.strerror}; change to an existing folder")
    for name in ("COLUMNS", "LINES"):
        value = os.environ.get(name, "")
        if not value.isdecimal() or int(value) < _NARROWEST:
            os.environ.pop(name, None)
    if not os.environ.get("HOME"):
        home = os.path.expanduser("~")  # by the list of users
        # Libraries load what a file in the home says, as PETSc does: nobody else may put one there.
        os.environ["HOME"] = home if os.path.isdir(home) else str(folder_of_process())


@contextmanager
def open_streams() -> Iterator[None]:
    """Open standard streams; output that could not be written is an error at the end.

    A closed stream is opened, so that no file takes its number: standard input is then empty,
    standard error is dropped, and standard output fails at the first output. Characters that an
    encoding lacks are written in plain letters.

    Raises:
        SystemExit: With 1 and a sentence, if standard output could not be written.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY if name == "stderr" else os.O_RDONLY), number)
        if getattr(sys, name) is None:
            stream = open(number, "r" if name == "stdin" else "w", encoding="utf-8", closefd=False)
            setattr(sys, name, stream)
            setattr(sys, f"__{name}__", stream)
        elif name != "stdin" and hasattr(getattr(sys, name), "reconfigure"):
            getattr(sys, name).reconfigure(errors=_plain_letters.__name__)
    leaving = failed = None
    try:
        yield
    except BaseException as error:
        leaving = error
    if isinstance(leaving, OSError):  # of help and versions; commands report their own
        failed = leaving
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError as error:
            _drop(stream)
            if stream is sys.stdout and not isinstance(error, BrokenPipeError):
                failed = failed or error
    if failed is not None and (leaving in (None, failed) or leaving.args in ((), (0,), (None,))):
        with suppress(OSError):
            print(f"error: standard output: {failed.strerror}", file=sys.stderr, flush=True)
        sys.exit(1)
    if leaving is not None:
        raise leaving


def _drop(stream) -> None:
    """Drop a stream's pending output: at exit Python would fail to write it again."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
        stream.flush()


def _plain_letters(error: UnicodeError):
    if not isinstance(error, UnicodeEncodeError):
        raise error
    text = error.object[error.start : error.end]
    return "".join(map(_plain, text)), error.end


def _plain(character: str) -> str:
    text = _PLAIN.get(character) or unicodedata.normalize("NFKD", character)
    text = text.encode("ascii", "ignore").decode()
    return text or ascii(character)[1:-1]


codecs.register_error(_plain_letters.__name__, _plain_letters)
