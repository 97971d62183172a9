"""The exceptions of the suite: what is wrong, and what was expected."""

from __future__ import annotations

__all__ = ["ConvergenceError", "InputError", "JointsError", "MeshError"]


class JointsError(Exception):
    """Base of every exception that the suite raises on purpose."""


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
