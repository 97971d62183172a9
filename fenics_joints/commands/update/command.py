"""The ``update`` command: which update a case asks for."""

from __future__ import annotations

from mpi4py import MPI

from fenics_joints.case import Case
from fenics_joints.commands.cutoff.run import run_cutoff
from fenics_joints.commands.outcome import Outcome
from fenics_joints.commands.update.page import combined_outcome
from fenics_joints.commands.update.run import run_combined
from fenics_joints.commands.update.sweep import run
from fenics_joints.commands.update.sweep_page import show_update, update_html
from fenics_joints.progress import Progress

__all__ = ["run_update"]


def run_update(case: Case, comm: MPI.Intracomm, progress: Progress) -> Outcome:
    """Fit what a case names to what was measured. Collective."""
    if case.combined():
        return combined_outcome(run_combined(case, comm, progress))
    if case.update is not None and case.update.cutoff is not None:
        return run_cutoff(case, comm, progress)
    found, log_sd = run(case, comm, progress), case.measurements().log_sd()
    return Outcome(
        found, found.to_json, lambda: update_html(found, log_sd=log_sd),
        lambda console: show_update(console, found),
    )  # fmt: skip
