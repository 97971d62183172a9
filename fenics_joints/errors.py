"""The exceptions of the suite, and checks that raise them.

A check takes the name for its message and the value, and returns the value as a plain type. Texts,
None, truth values, NaN and infinities do not count as numbers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from numbers import Integral, Real
from textwrap import shorten
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from fenics_joints.formatting import printable

#: No quantity of mechanics in SI units is larger; the products of two that are overflow.
MOST = 1e100
#: No count is larger: it would not fit the index of an array.
MOST_OF = 2**31 - 1
#: Errors of one file that are shown, and places of one error that are named; more are counted.
_SHOWN, _PLACES = 10, 4

T = TypeVar("T")


class JointsError(Exception):
    """Base of every exception that the suite raises on purpose."""

    def __str__(self) -> str:
        # Messages quote what users and files say, and go to terminals.
        return printable(super().__str__())


class InputError(JointsError, ValueError):
    """A value that a user gave is not usable: names the key, the value and what was expected."""


class MeshError(InputError):
    """A mesh is not usable: inverted cells, unnamed groups, a missing interface."""


class ConvergenceError(JointsError, RuntimeError):
    """A solver stopped before it converged.

    Args:
        message: What was being solved and what to try.
        reason: PETSc's or SLEPc's reason in words, if there is one.
    """

    def __init__(self, message: str, reason: str | None = None):
        super().__init__(message if reason is None else f"{message} (reason: {reason})")
        self.reason = reason


@contextmanager
def located(where: object) -> Iterator[None]:
    """Put ``where`` in front of the message of an input error that is raised inside.

    Raises:
        InputError: Of the same class as the one inside.
    """
    try:
        yield
    except InputError as error:
        raise type(error)(f"{where}: {error}") from error


class Problems:
    """Errors of independent steps, collected so that all are reported and not the first alone.

    Args:
        where: Where all of them are, such as a file, to be named once. Without it they are of
            several files.
    """

    def __init__(self, where: object = ""):
        self._where, self._found = str(where), []

    def tried(self, step: Callable[[], T]) -> T | None:
        """What a step returns; None if it fails, and its error is kept."""
        try:
            return step()
        except InputError as error:
            self.add(error)
            return None

    def add(self, error: InputError | str) -> None:
        """Keep an error, or the text of one; of a list of several files those of each."""
        error = InputError(error) if isinstance(error, str) else error
        self._found += getattr(error, "of_files", ()) or [error]

    def __bool__(self) -> bool:
        return bool(self._found)

    def texts(self) -> list[str]:
        """The messages."""
        return [str(error) for error in self._found]

    def check(self) -> None:
        """Raise what was found, ten of them at most and how many more there are.

        Raises:
            InputError: The error, or a list of several; a MeshError if they all are.
        """
        if not self._found:
            return
        if len(self._found) == 1:
            raise self._found[0]
        texts = list(dict.fromkeys(str(error) for error in self._found))
        head = f"{len(texts)} errors in the files:"
        if self._where:
            head, texts = f"{self._where}: {len(texts)} errors:", self._alike(texts)
        lines = [text.replace("\n", "\n  ") for text in texts]
        kind = MeshError if all(isinstance(e, MeshError) for e in self._found) else InputError
        several = kind("\n  ".join([head, *lines]))
        several.of_files = () if self._where else tuple(self._found)
        raise several

    def _alike(self, texts: list[str]) -> list[str]:
        """Errors in one file, with one line for several places that have the same error."""
        places: dict[str, list[str]] = {}
        for text in texts:
            place, colon, said = text.removeprefix(f"{self._where}: ").partition(": ")
            places.setdefault(said if colon else place, []).extend([place] if colon else [])
        lines = []
        for said, named in places.items():
            more = f" and {len(named) - _PLACES} more" if len(named) > _PLACES else ""
            lines.append(": ".join([*[f"{', '.join(named[:_PLACES])}{more}"][: len(named)], said]))
        left = len(lines) - _SHOWN
        return [*lines[:_SHOWN], f"and {left} more"] if left > 0 else lines


def shown(value: object) -> str:
    """A value as a message shows it: on one line, and short."""
    line = " ".join(repr(value).split())
    return line if len(line) <= 80 else f"{line[:77]}..."


def raised(where: str, error: Exception) -> str:
    """What code of somebody else's raised, as a message shows it: on one line, and short."""
    return shorten(f"{where}: {type(error).__name__}: {error}", 300)


def wanted(key: str, value: object, expected: str) -> InputError:
    """The error that ``key = value`` is not what was expected."""
    return InputError(f"{key} = {shown(value)}: expected {expected}.")


def real(
    key: str,
    value: object,
    unit: str = "",
    *,
    least: float = -math.inf,
    most: float = math.inf,
    above: float = -math.inf,
) -> float:
    """A finite number, no truth value, of a size that mechanics has.

    Args:
        key: Its name.
        value: What was given; an array of no dimension is a number.
        unit: For the message.
        least: Lower bound, inclusive.
        most: Upper bound, inclusive.
        above: Lower bound, exclusive.

    Raises:
        InputError: If it is no such number.
    """
    given = value.item() if isinstance(value, np.ndarray) and value.ndim == 0 else value
    size = ""
    if isinstance(given, Real) and not isinstance(given, bool):
        try:
            number = float(given)
        except OverflowError:
            number = math.inf
        if abs(number) <= MOST and least <= number <= most and number > above:
            return number
        size = f", not beyond {MOST:g}" if MOST < abs(number) else ""
    raise wanted(key, value, _range(unit, least, most, above) + size)


def _range(unit: str, least: float, most: float, above: float, many: bool = False) -> str:
    """What numbers should be, in words."""
    words = []
    if math.isfinite(above):
        words = [f"above {above:g}"]
    elif math.isfinite(least):
        words = [f"of at least {least:g}"]
    if math.isfinite(most):
        words.append(f"at most {most:g}" if words else f"of at most {most:g}")
    number = "numbers" if many else "a number"
    if not words:
        return f"{number.replace('number', 'finite number')}{unit and ' in '}{unit}"
    return f"{number} {' and '.join(words)} {unit}".rstrip()


def whole(key: str, value: object, least: int = 1, most: int = MOST_OF) -> int:
    """A whole number, no truth value.

    Raises:
        InputError: If it is none, or out of its range.
    """
    if isinstance(value, Integral) and not isinstance(value, bool):
        number = int(value)
        if least <= number <= most:
            return number
    top = f" and at most {most}" if most < MOST_OF else ""
    raise wanted(key, value, f"a whole number of at least {least}{top}")


def reals(
    key: str,
    value: ArrayLike,
    shape: tuple[int | None, ...] | None = None,
    unit: str = "",
    **bounds: float,
) -> np.ndarray:
    """Finite numbers as an array of floats.

    Args:
        key: Their name.
        value: What was given.
        shape: The shape that they must have, None for any length along an axis; None for any.
        unit: For the message.
        **bounds: ``least``, ``most`` and ``above``, as of `real`, of each.

    Raises:
        InputError: If one is no such number, or their shape is another.
    """
    low, high = bounds.get("least", -math.inf), bounds.get("most", math.inf)
    above = bounds.get("above", -math.inf)

    def refused() -> InputError:  # made when it is needed: large arrays take long to show
        return wanted(key, value, _range(unit, low, high, above, many=True))

    try:
        array = np.asarray(value)
        numeric = array.dtype.kind in "iuf" or (array.size == 0 and array.dtype.kind == "O")
        array = array.astype(float) if numeric else array
    except (TypeError, ValueError, OverflowError):
        raise refused() from None
    if not numeric:
        raise refused()
    if shape is not None and not _fits(array.shape, shape):
        sizes = ", ".join("n" if n is None else str(n) for n in shape)
        raise InputError(f"{key} has shape {array.shape}: expected ({sizes}).")
    if not np.all((np.abs(array) <= MOST) & (array >= low) & (array <= high) & (array > above)):
        raise refused()
    return array


def measured(key: str, value: ArrayLike, kinds: str = "iuf") -> np.ndarray:
    """Numbers as an array, nan where one is missing.

    Args:
        key: Their name.
        value: What was given.
        kinds: Kinds of numbers, as NumPy's ``dtype.kind``; with ``c`` complex ones too.

    Raises:
        InputError: If one is no number.
    """
    try:
        array = np.asarray(value)
    except (TypeError, ValueError):
        array = np.array("")
    if array.dtype.kind not in kinds and array.size:
        raise wanted(key, value, "numbers, nan where one is missing")
    if array.size and np.any(np.isfinite(array) & (np.abs(array) > MOST)):
        raise wanted(key, value, f"numbers not beyond {MOST:g}, nan where one is missing")
    return array if array.dtype.kind == "c" else array.astype(float)


def _fits(found: tuple[int, ...], shape: tuple[int | None, ...]) -> bool:
    return len(found) == len(shape) and all(
        n is None or n == m for n, m in zip(shape, found, strict=True)
    )


def direction(key: str, value: ArrayLike, sizes: Iterable[int] = (2, 3)) -> tuple[float, ...]:
    """A unit vector along a given one, which may have any length but zero.

    Raises:
        InputError: If it is none, or has another number of components.
    """
    sizes = tuple(sizes)
    expected = f"a vector of {' or '.join(map(str, sizes))} finite numbers, not all of them zero"
    try:
        vector = reals(key, value)
    except InputError:
        raise wanted(key, value, expected) from None
    length = float(np.linalg.norm(vector)) if vector.size else 0.0
    if vector.ndim != 1 or len(vector) not in sizes or not length > 0:
        raise wanted(key, value, expected)
    # A unit vector stays what it is, to the last bit.
    return tuple((vector if abs(length - 1) < 1e-14 else vector / length).tolist())


def text(key: str, value: object) -> str:
    """A text that is not empty.

    Raises:
        InputError: If it is none.
    """
    if not isinstance(value, str) or not value.strip():
        raise wanted(key, value, "a text that is not empty")
    return value


def capable(key: str, value: object, calls: Iterable[str], what: str) -> None:
    """Refuse an object that lacks one of the calls.

    Raises:
        InputError: If it does; says ``what`` was expected.
    """
    if isinstance(value, type) or not all(hasattr(value, call) for call in calls):
        raise wanted(key, value, what)


def flag(key: str, value: object) -> bool:
    """A truth value.

    Raises:
        InputError: If it is none, such as the text ``"no"``, which counts as true.
    """
    if not isinstance(value, bool | np.bool_):
        raise wanted(key, value, "True or False")
    return bool(value)


def member(key: str, value: object, known: Iterable[str]) -> str:
    """One of the known words.

    Raises:
        InputError: If it is none of them.
    """
    known = tuple(known)
    if not isinstance(value, str) or value not in known:
        raise wanted(key, value, f"one of: {', '.join(known)}")
    return value


def items(key: str, value: object, kinds: type | tuple[type, ...], what: str) -> tuple:
    """All of a sequence, each of some kind.

    Raises:
        InputError: If it is no sequence, or one of it is something else.
    """
    if isinstance(value, str | bytes | Mapping) or not isinstance(value, Iterable):
        raise wanted(key, value, f"a sequence of {what}")
    found = tuple(value)
    for i, each in enumerate(found):
        if not isinstance(each, kinds):
            raise wanted(f"{key}[{i}]", each, f"one of: {what}")
    return found


def mapping(key: str, value: object, what: str) -> dict[str, object]:
    """Values by name; None is none of them.

    Raises:
        InputError: If it is no mapping from texts; says ``what`` was expected.
    """
    if value is None:
        return {}
    if not isinstance(value, Mapping) or not all(isinstance(name, str) for name in value):
        raise wanted(key, value, what)
    return dict(value)
