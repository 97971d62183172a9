"""The damping of a case's model: its ``[damping]``, and the c of laps of beams."""

from __future__ import annotations

from fenics_joints.case.case import Case
from fenics_joints.structure import Damped, Damping


def model_damping(case: Case, structure: Damped) -> Damping:
    """The damping of a case, its values as parameters; none where it has none.

    Args:
        case: The case.
        structure: Its structure, built with ``damping``.
    """
    named = Damping() if case.damping is None else case.damping.damping()
    return structure.resolved(named)
