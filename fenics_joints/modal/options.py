"""PETSc's option database and its errors, in words."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from petsc4py import PETSc

__all__ = ["give_room", "last_line", "petsc_defaults", "reason_of"]


@contextmanager
def petsc_defaults(
    prefix: str, ours: Mapping[str, object], above: Mapping[str, object] | None = None
) -> Iterator[PETSc.Options]:
    """Options under ``prefix`` for a while.

    Args:
        prefix: The prefix.
        ours: Those below what the command line says.
        above: Those above it.
    """
    options = PETSc.Options(prefix)
    new = {k: v for k, v in ours.items() if not options.hasName(k)} | dict(above or {})
    before = {key: options.getString(key) for key in new if options.hasName(key)}
    for key, value in new.items():
        options.setValue(key, value)
    try:
        yield options
    finally:
        for key in new:
            options.delValue(key)
        for key, value in before.items():
            options.setValue(key, value)


def give_room(ksp: PETSc.KSP) -> None:
    """Factorise again with more slack where MUMPS underestimated its work space (INFOG(1) = -9).

    Collective; for a solver that is set up, within the options that it was set up with.
    """
    pc, A = ksp.getPC(), ksp.getOperators()[1]
    for slack in (100, 300):
        if pc.getFailedReason() != PETSc.PC.FailedReason.FACTOR_OUTMEMORY:
            return
        if pc.getFactorSolverType() != "mumps":
            return
        PETSc.Options(ksp.getOptionsPrefix()).setValue("mat_mumps_icntl_14", slack)
        pc.reset()  # PETSc keeps the error with the factor, and would not try it again
        ksp.setOperators(A)
        ksp.setUp()


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
