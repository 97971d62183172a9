"""The ``diagnose`` command."""

from __future__ import annotations

from pathlib import Path

from mpi4py import MPI
from rich.console import Console

from fenics_joints.case import Case, labelled
from fenics_joints.case.check_structure import refuse_applied
from fenics_joints.case.notes import OF_MODEL
from fenics_joints.commands.diagnose.assumptions import assumptions
from fenics_joints.commands.diagnose.explanation import explain
from fenics_joints.commands.diagnose.page import diagnosis_html
from fenics_joints.commands.diagnose.summary import show_diagnosis
from fenics_joints.commands.outcome import Outcome
from fenics_joints.diagnosis import Diagnosis, diagnose
from fenics_joints.progress import Progress
from fenics_joints.report.terminal import tell


def run_diagnose(
    case: Case, comm: MPI.Intracomm, progress: Progress, *, keep: Path | None = None
) -> Outcome[Diagnosis]:
    """Where a case's model is wrong, which effect causes it, and how far the gap goes. Collective.

    Args:
        case: The case.
        comm: Communicator.
        progress: Told what is being done.
        keep: Folder of the reduced model, which the next run takes.

    Raises:
        JointsError: If the case, the mesh or a solution fails.
    """
    refuse_applied(case, "diagnose")
    found, data = diagnose(case, comm, progress, keep=keep), case.diagnosed_test()
    notes = found.model.get("notes", ())
    assumed = assumptions(case, data)
    for note in notes:
        of = "of the model" if note.startswith(OF_MODEL) else "of the test's data"
        assumed = [*assumed, (of, note.removeprefix(OF_MODEL))]

    def summary(console: Console) -> None:
        show_diagnosis(console, found)
        for note in notes:
            tell(console, labelled(note), "yellow")

    return Outcome(
        found,
        lambda: {**found.to_json(), "in_words": explain(found).to_json()},
        lambda: diagnosis_html(found, log_sd=data.log_sd(), assumed=assumed),
        summary,
    )
