"""PETSc's option database and its errors, in words."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import contextmanager

from petsc4py import PETSc

__all__ = ["last_line", "petsc_defaults", "reason_of"]


@contextmanager
def petsc_defaults(prefix: str, ours: Mapping[str, object]):
    """Options under ``prefix`` for a while; those of the command line stand above them."""
    options = PETSc.Options(prefix)
    new = {k: v for k, v in ours.items() if not options.hasName(k)}
    for key, value in new.items():
        options.setValue(key, value)
    try:
        yield
    finally:
        for key in new:
            options.delValue(key)


def reason_of(solver: PETSc.Object) -> str:
    """PETSc's or SLEPc's name of why a solver stopped, or why a preconditioner failed."""
    if isinstance(solver, PETSc.PC):
        enum, value = solver.FailedReason, solver.getFailedReason()
    else:
        enum, value = solver.ConvergedReason, solver.getConvergedReason()
    names = [key for key, number in vars(enum).items() if number == value and key[0] != "_"]
    return names[0] if names else str(value)


def last_line(error: PETSc.Error) -> str:
    """What PETSc says of an error, without the way there."""
    return str(error).strip().splitlines()[-1]
