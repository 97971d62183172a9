"""What is wrong in several files, in one list."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from fenics_joints.errors import InputError

__all__ = ["Problems"]

T = TypeVar("T")


class _Several(InputError):
    """A list of errors."""

    errors: tuple[InputError, ...] = ()


class Problems:
    """Errors of steps that do not need one another."""

    def __init__(self):
        self._found: list[InputError] = []

    def tried(self, step: Callable[[], T]) -> T | None:
        """What a step returns; None if it fails, and its error is kept."""
        try:
            return step()
        except InputError as error:
            self.add(error)
            return None

    def add(self, error: InputError) -> None:
        """Keep an error, or those of a list."""
        self._found += getattr(error, "errors", ()) or [error]

    def check(self) -> None:
        """Raise what was found.

        Raises:
            InputError: The error, or a list of several.
        """
        if len(self._found) == 1:
            raise self._found[0]
        if self._found:
            lines = dict.fromkeys(str(error).replace("\n", "\n  ") for error in self._found)
            several = _Several("\n  ".join([f"{len(lines)} errors in the files:", *lines]))
            several.errors = tuple(self._found)
            raise several
