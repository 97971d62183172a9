"""What the commands run: from a case to a result that knows its JSON, page and summary."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from mpi4py import MPI

from fenics_joints.case.case import Case
from fenics_joints.progress import Progress

if TYPE_CHECKING:
    from rich.console import Console

    from fenics_joints.commands.preload.cutoff import CutoffReport
    from fenics_joints.commands.update.page import CombinedOutcome
    from fenics_joints.commands.update.sweep import UpdateReport
    from fenics_joints.diagnosis import Diagnosis

__all__ = ["run_diagnose", "run_update"]


@dataclass(frozen=True, eq=False)
class DiagnosisOutcome:
    """A diagnosis for the command line."""

    result: Diagnosis
    log_sd: object
    assumed: Sequence[tuple[str, str]] = ()

    def json(self) -> dict[str, object]:
        """See `Diagnosis.to_json`; and the same in words."""
        from fenics_joints.report.explanation import explain

        return {**self.result.to_json(), "in_words": explain(self.result).to_json()}

    def html(self) -> str:
        """The page."""
        from fenics_joints.report.html import diagnosis_html

        return diagnosis_html(self.result, log_sd=self.log_sd, assumed=self.assumed)

    def show(self, console: Console) -> None:
        """The summary."""
        from fenics_joints.report.terminal import diagnosis

        diagnosis(console, self.result)


@dataclass(frozen=True, eq=False)
class UpdateOutcome:
    """An updated model for the command line."""

    result: UpdateReport
    log_sd: object

    def json(self) -> dict[str, object]:
        """See `UpdateReport.to_json`."""
        return self.result.to_json()

    def html(self) -> str:
        """The page."""
        from fenics_joints.commands.update.sweep_page import update_html

        return update_html(self.result, log_sd=self.log_sd)

    def show(self, console: Console) -> None:
        """The summary."""
        from fenics_joints.commands.update.sweep_page import show_update

        show_update(console, self.result)


def run_diagnose(
    case: Case, comm: MPI.Intracomm, progress: Progress, *, keep: Path | None = None
) -> DiagnosisOutcome:
    """The ``diagnose`` command. Collective."""
    from fenics_joints.diagnosis import diagnose
    from fenics_joints.report.assumptions import assumptions

    found, data = diagnose(case, comm, progress, keep=keep), case.measurements()
    return DiagnosisOutcome(found, data.log_sd(), assumptions(case, data))


def run_update(
    case: Case, comm: MPI.Intracomm, progress: Progress
) -> UpdateOutcome | CutoffReport | CombinedOutcome:
    """The ``update`` command. Collective."""
    if case.combined():
        from fenics_joints.commands.update.page import CombinedOutcome
        from fenics_joints.commands.update.run import run_combined

        return CombinedOutcome(run_combined(case, comm, progress))
    if case.update is not None and case.update.cutoff is not None:
        from fenics_joints.commands.preload.cutoff import run_cutoff

        return run_cutoff(case, comm, progress)
    from fenics_joints.commands.update.sweep import run

    return UpdateOutcome(run(case, comm, progress), case.measurements().log_sd())
