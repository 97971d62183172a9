"""The ``diagnose --plan`` command."""

from __future__ import annotations

from pathlib import Path

from mpi4py import MPI

from fenics_joints.case import Case
from fenics_joints.case.check_structure import refuse_applied
from fenics_joints.commands.outcome import Outcome
from fenics_joints.commands.plan.page import plan_html
from fenics_joints.commands.plan.summary import show_plan
from fenics_joints.diagnosis.plan.planned import Plan, plan
from fenics_joints.progress import Progress


def run_plan(
    case: Case, comm: MPI.Intracomm, progress: Progress, *, keep: Path | None = None
) -> Outcome[Plan]:
    """Which causes a test could tell apart, before any data. Collective.

    Args:
        case: The case.
        comm: Communicator.
        progress: Told what is being done.
        keep: Folder of the reduced model, which the next run goes on from.

    Raises:
        JointsError: If the case, the mesh or a solution fails.
    """
    refuse_applied(case, "diagnose --plan")
    return Outcome.of(plan(case, comm, progress, keep=keep), plan_html, show_plan)
