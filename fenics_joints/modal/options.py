"""PETSc's option database, and PETSc's errors in words."""

from __future__ import annotations

import ctypes
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from numbers import Real

from petsc4py import PETSc

from fenics_joints.errors import InputError, mapping, shown, wanted


def given_options(petsc_options: object) -> dict[str, object]:
    """PETSc's options as a user gives them; an empty dict for None.

    Raises:
        InputError: If they are not a mapping from names to strings, numbers, booleans or None.
    """
    expected = "PETSc options by name, such as {'eps_type': 'krylovschur'}"
    found = mapping("petsc_options", petsc_options, expected)
    for name, value in found.items():
        key = f"petsc_options[{name!r}]"
        if not name or any(c.isspace() for c in name):
            raise wanted(key, value, "a name without spaces")
        if not isinstance(value, str | Real | None):
            raise wanted(key, value, "a text, a number, True, False or None")
    return found


def say_unused(prefix: str, options: Mapping[str, object]) -> None:
    """Warn of options that no solver has read: PETSc does not notice a misspelt name."""
    library = ctypes.CDLL(PETSc.__file__)  # petsc4py has no call for it
    for name in options:
        used = ctypes.c_int(0)
        library.PetscOptionsUsed(None, f"{prefix}{name}".encode(), ctypes.byref(used))
        if not used.value:
            warnings.warn(
                f"petsc_options: no solver read {name!r}; is its name right?", stacklevel=4
            )


#: PETSC_ERR_UNKNOWN_TYPE.
_UNKNOWN_TYPE = 86


@contextmanager
def petsc_defaults(
    prefix: str, ours: Mapping[str, object], above: Mapping[str, object] | None = None
) -> Iterator[PETSc.Options]:
    """Set options under ``prefix`` while the context lasts; then the former ones are back.

    Args:
        prefix: The prefix.
        ours: Defaults; options that are set already, as by the command line, override them.
        above: Options that override even those.

    Raises:
        InputError: If PETSc refuses a value when a solver is set up within the context.
    """
    options = PETSc.Options(prefix)
    new = {k: v for k, v in ours.items() if not options.hasName(k)} | dict(above or {})
    before = {key: options.getString(key) for key in new if options.hasName(key)}
    for key, value in new.items():
        options.setValue(key, value)
    try:
        yield options
    except PETSc.Error as error:
        if error.ierr != _UNKNOWN_TYPE and "SetFromOptions" not in str(error):
            raise
        raise InputError(
            f"petsc_options: PETSc refuses one of {shown(new)} ({last_line(error)})"
        ) from error
    finally:
        for key in new:
            options.delValue(key)
        for key, value in before.items():
            options.setValue(key, value)


def give_room(ksp: PETSc.KSP) -> None:
    """Factorise again with more work space if MUMPS had too little of it (INFOG(1) = -9).

    Collective; to be called after ``setUp``, within the same `petsc_defaults`.
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
    """PETSc's or SLEPc's name of the reason why a solver stopped, or a preconditioner failed."""
    if isinstance(solver, PETSc.PC):
        enum, value = solver.FailedReason, solver.getFailedReason()
    else:
        enum, value = solver.ConvergedReason, solver.getConvergedReason()
    names = [key for key, number in vars(enum).items() if number == value and key[0] != "_"]
    return names[0] if names else str(value)


def last_line(error: PETSc.Error) -> str:
    """The last line of PETSc's message, which follows its traceback."""
    return str(error).strip().splitlines()[-1]
