"""How long the commands will take on a case, and how much memory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from fenics_joints.case import Case, CostEstimate, estimate
from fenics_joints.case.size import BEGIN, available_bytes, estimate_of, gibibytes
from fenics_joints.diagnosis.model.resolution import MOST
from fenics_joints.errors import InputError

#: Modal solutions that an update takes with one parameter, and more for each further one.
_UPDATE, _EACH = 8, 3
#: Those of a diagnosis: for each of its samples, of which it takes as many of parts as of effects,
#: and to measure the mesh's error and to check what is fitted.
_SAMPLE, _CHECKS = 2, 20
#: Seconds of its fits, held-out fits and evaluations on one rank at one condition, and more for
#: each further one; and of sampled evidence. The lap plates at eleven torques: 126 and 56 s beside
#: 138 s of solutions; the bolted beams at one condition, which take none: 50 s in all. All within a
#: factor of two or three: it depends on how many effects a case can have and how many count.
_FITS, _SAMPLED = (20.0, 10.5), (25.0, 3.0)
#: Memory of a rank's samples, fits and draws beside the model: box and lap plates, 0.9 and 0.8 GB.
_BESIDE = 0.9e9
#: Degrees of freedom and memory of a model of one degree more, relative to the model's.
_FINER = 3


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


def costs_of(case: Case, found: CostEstimate, dofs: int | None, ranks: int) -> tuple[Cost, ...]:
    """What each command that the case is for will take.

    Args:
        case: The case.
        found: The estimate of its model.
        dofs: Degrees of freedom that the model has, if it was made.
        ranks: How many processes share it.
    """
    return tuple(_costs(case, known(case, found, dofs, ranks), ranks))


def known(case: Case, found: CostEstimate, dofs: int | None, ranks: int) -> CostEstimate:
    """An estimate by the degrees of freedom that a file's mesh has; builders' are known before."""
    if not dofs or case.mesh.origin not in ("file", "own"):
        return found
    return estimate_of(dofs, case.mesh.degree, ranks=ranks)


def _costs(case: Case, found: CostEstimate, ranks: int) -> Iterator[Cost]:
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
    if coarse is not case and case.mesh.origin != "beams":
        found = estimate(coarse, ranks=ranks)
    solutions = _SAMPLE * case.diagnose.samples + _CHECKS
    once = max(found.seconds - BEGIN, 0.0)
    more = _conditions(case) - 1
    ways = (_FITS, _SAMPLED) if case.diagnose.nested else (_FITS,)
    fits = sum(first + more * each for first, each in ways) / ranks
    memory = found.bytes + ranks * _BESIDE
    if case.diagnose.mesh_error and case.mesh.origin != "beams" and _FINER * found.dofs < MOST:
        memory = max(memory, _FINER * found.bytes)
    yield Cost("diagnose", found.seconds + solutions * once + fits, memory)


def _conditions(case: Case) -> int:
    """Number of the test's torques or levels, with those of modes over their amplitude."""
    try:
        return len(case.diagnosed_test())
    except InputError:
        return len(case.measured)  # why it is none stands among the errors


def too_much(costs: tuple[Cost, ...]) -> list[str]:
    """A sentence on commands that need more memory than there is."""
    there = available_bytes()
    names = [cost.command for cost in costs if cost.bytes > there]
    if not names:
        return []
    most = max(cost.bytes for cost in costs)
    return [
        f"{', '.join(names)}: about {gibibytes(most)} of memory, of which this machine has "
        f"{gibibytes(there)} free; larger elements, or modes --iterative"
    ]
