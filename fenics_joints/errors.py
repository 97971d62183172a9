"""The exceptions of the suite: what is wrong, and what was expected."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from fenics_joints.formatting import printable

__all__ = ["ConvergenceError", "InputError", "JointsError", "MeshError", "located"]


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
    """Says where an input error inside is from: its message begins with ``where``.

    Raises:
        InputError: Of the same class as the one inside.
    """
    try:
        yield
    except InputError as error:
        raise type(error)(f"{where}: {error}") from error
