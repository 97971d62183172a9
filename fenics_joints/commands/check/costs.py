"""How long the commands will take on a case, and how much memory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from fenics_joints.case import Case, Estimate, estimate
from fenics_joints.case.machine import available_bytes
from fenics_joints.case.mesh import MeshFile, OffsetBeamsMesh
from fenics_joints.case.size import estimate_of

__all__ = ["Cost", "costs_of", "known", "too_much"]

#: Modal solutions that an update takes with one parameter, and more for each further one; and
#: seconds of a diagnosis at one condition and more for each further one, without and with sampled
#: evidence, the latter for each hypothesis of it (the lap plates', README.md, at eleven torques:
#: 628 s of which 50 are solutions). All within a factor of two or three.
_UPDATE, _EACH, _DIAGNOSE, _NESTED = 8, 3, (20.0, 4.0), (10.0, 7.0)


@dataclass(frozen=True)
class Cost:
    """What a command will take; rough.

    Attributes:
        command: Its name.
        seconds: Its time, on a quiet machine.
        bytes: Memory.
    """

    command: str
    seconds: float
    bytes: float


def costs_of(case: Case, found: Estimate, dofs: int | None, ranks: int) -> tuple[Cost, ...]:
    """What each command that the case is for will take.

    Args:
        case: The case.
        found: The estimate of its model.
        dofs: Degrees of freedom that the model has, if it was made.
        ranks: How many processes share it.
    """
    return tuple(_costs(case, known(case, found, dofs, ranks), ranks))


def known(case: Case, found: Estimate, dofs: int | None, ranks: int) -> Estimate:
    """An estimate by the degrees of freedom that a file's mesh has; builders' are known before."""
    if not dofs or not isinstance(case.mesh, MeshFile):
        return found
    return estimate_of(dofs, case.mesh.degree, ranks=ranks)


def _costs(case: Case, found: Estimate, ranks: int) -> Iterator[Cost]:
    once = found.seconds
    yield Cost("modes", once, found.bytes)
    if case.measured is None and case.frfs() is None:
        return
    if case.update is not None and case.update.cutoff is None:
        count = _UPDATE + _EACH * len(case.update.parameters)
        rows = 1 if case.combined() or case.measured is None else len(case.measured)
        yield Cost("update", count * once * (1 if rows == 1 else 2), found.bytes)
    if case.measured is None:
        return
    coarse = case.diagnosed()
    if coarse is not case and not isinstance(case.mesh, OffsetBeamsMesh):
        found = estimate(coarse, ranks=ranks)
    solutions = case.diagnose.samples + case.diagnose.patches
    more = len(case.measured) - 1
    fits, nested = (once + more * each for once, each in (_DIAGNOSE, _NESTED))
    fits += nested * case.diagnose.nested
    yield Cost("diagnose", solutions * found.seconds + fits, found.bytes)


def too_much(costs: tuple[Cost, ...]) -> list[str]:
    """A sentence on commands that need more memory than there is."""
    there = available_bytes()
    names = [cost.command for cost in costs if cost.bytes > there]
    if not names:
        return []
    most = max(cost.bytes for cost in costs)
    return [
        f"{', '.join(names)}: about {most / 2**30:.2g} GiB of memory, of which this machine has "
        f"{there / 2**30:.2g} GiB free; larger elements, or modes --iterative"
    ]
