"""The commands that begin a case, and how any command shows its outcome."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from fenics_joints.commands.arguments import (
    CaseArgument,
    DebugOption,
    JsonOption,
    LargeOption,
    ReportOption,
    tell,
)

if TYPE_CHECKING:
    from fenics_joints.commands.outcome import Outcome

__all__ = ["check", "schema", "show"]


def check(
    case: CaseArgument,
    json: JsonOption = None,
    report: ReportOption = None,
    large: LargeOption = False,
    debug: DebugOption = False,
) -> None:
    """All that is wrong or unlikely in a case, at once and in seconds; nothing is solved.

    Masses by part and in all, where sensors and bolts are, what the commands will take. Fails if
    something is wrong; what is unlikely is said.

    JSON: errors and notes in sentences, masses (name, kind, kg, weighed_kg), mass_kg, places (kind,
    name, at_m, direction, off_mm), bolts, test in words, size_m, dofs, costs (command, seconds,
    bytes).
    """
    from fenics_joints.parallel import guarded

    with guarded(debug):
        from mpi4py import MPI

        from fenics_joints.commands.check.run import run_check
        from fenics_joints.files import check_outputs, json_text
        from fenics_joints.parallel import on_root
        from fenics_joints.progress import Progress

        comm = MPI.COMM_WORLD
        outputs = {"--json": json, "--report": report}
        on_root(comm, lambda: check_outputs(outputs))
        with Progress(silent=comm.rank != 0) as progress:
            outcome = run_check(case, comm, progress, large=large)
            found = outcome.result
            files = [found.path] if found.case is None else found.case.files()
            on_root(comm, lambda: check_outputs(outputs, files))
            contents = []
            if json is not None:
                contents.append((json, json_text(outcome.json())))
            if report is not None:
                contents.append((report, outcome.page()))
        show(comm, outcome, contents)


def schema(debug: DebugOption = False) -> None:
    """The JSON schema of a case file, for editors that complete and check what is typed.

    Put it into a file, and name that in the first line of case.toml: #:schema case.schema.json
    """
    from fenics_joints.parallel import guarded

    with guarded(debug):
        from fenics_joints.case.schema import case_schema
        from fenics_joints.files import json_text

        typer.echo(json_text(case_schema()), nl=False)


def show(comm, outcome: Outcome, contents: list[tuple[Path, str]]) -> None:
    """Write and show an outcome; then fail, where it says that it is none."""
    from fenics_joints.errors import ConvergenceError
    from fenics_joints.files import shown_path, write_text
    from fenics_joints.parallel import on_root

    def write() -> None:
        from fenics_joints.report.terminal import new_console

        for path, text in contents:
            write_text(path, text)
        outcome.summary(new_console())
        for path, _ in contents:
            tell(f"wrote {shown_path(path)}")

    on_root(comm, write)
    if outcome.failure is not None:
        raise ConvergenceError(outcome.failure)
