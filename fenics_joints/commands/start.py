"""The commands that begin a case, and how any command shows its outcome."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fenics_joints.commands.arguments import (
    CaseArgument,
    CaseOptions,
    DebugOption,
    file_option,
    named_path,
    tell,
)

if TYPE_CHECKING:
    from fenics_joints.commands.outcome import Outcome
    from fenics_joints.progress import Progress


def new(
    folder: Annotated[
        Path,
        typer.Argument(metavar="FOLDER", parser=named_path, help="Where case.toml is written."),
    ],
    step: Annotated[Path | None, file_option("--step", "An assembly from CAD.")] = None,
    mesh: Annotated[
        Path | None,
        typer.Option(
            "--mesh",
            "--msh",
            metavar="FILE",
            parser=named_path,
            help="A mesh or deck: .msh, .bdf, .inp, .cdb, .unv, .vtu.",
        ),
    ] = None,
    matrices: Annotated[
        list[Path] | None,
        file_option("--matrices", "Stiffness of a part from another code; several times."),
    ] = None,
    beams: Annotated[bool, typer.Option("--beams", help="Lapped beams, without a mesh.")] = False,
    builder: Annotated[
        str | None,
        typer.Option("--builder", metavar="NAME", help="A builder, such as half_lap_beam."),
    ] = None,
    frequencies: Annotated[
        Path | None, file_option("--frequencies", "A table with a column for each mode.")
    ] = None,
    shapes: Annotated[
        Path | None, file_option("--shapes", "Mode shapes: a universal file, or a table.")
    ] = None,
    frfs: Annotated[
        list[Path] | None, file_option("--frfs", "Measured FRFs; may be given several times.")
    ] = None,
    time: Annotated[
        list[Path] | None,
        file_option("--time", "Time records of forces and responses; several times."),
    ] = None,
    uff: Annotated[
        list[Path] | None, file_option("--uff", "Universal files of shapes or FRFs.")
    ] = None,
    amplitude: Annotated[
        list[Path] | None,
        file_option(
            "--amplitude", "A mode over its amplitude (levels, sweeps, ring-downs); several times."
        ),
    ] = None,
    material: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="Of parts whose label names none: steel, aluminium, "
            "cast-iron, ductile-iron, stainless, titanium or brass.",
        ),
    ] = "steel",
    preload: Annotated[
        bool,
        typer.Option(
            "--preload", help="Parts of --step in contact under their bolts, for preload."
        ),
    ] = False,
    yes: Annotated[
        bool, typer.Option("--yes", help='Ask nothing: guesses are marked in the case by a "?".')
    ] = False,
    debug: DebugOption = False,
) -> None:
    """Write a case from the files of a test lab, with comments where a value is a guess.

    It finds solids or groups, touching faces, holes and bolts with their thread, sensors, modes
    and units. Files in FOLDER or beside it are referred to, others copied. Then it is checked.
    """
    from fenics_joints.parallel import guarded

    with guarded(debug):
        from mpi4py import MPI

        from fenics_joints.commands.new.run import Source, run_new, show_new
        from fenics_joints.commands.new.tests import TestFiles
        from fenics_joints.parallel import on_root
        from fenics_joints.progress import Progress
        from fenics_joints.report.terminal import new_console

        comm = MPI.COMM_WORLD
        if beams and builder is not None:
            raise typer.BadParameter("has a builder of its own", param_hint="--beams")
        chosen = "offset_beams" if beams else builder
        source = Source(step, mesh, chosen, tuple(matrices) if matrices else None, preload)
        tests = TestFiles(
            frequencies,
            shapes,
            (*(frfs or ()), *(time or ())),
            tuple(uff or ()),
            tuple(amplitude or ()),
        )
        ask = _prompt if not yes and comm.size == 1 and sys.stdin.isatty() else _silent

        def write() -> None:
            with Progress(silent=ask is _prompt) as progress:
                written = run_new(folder, source, tests, ask, progress, material)
            show_new(new_console(), folder, written)

        on_root(comm, write)


def _silent(question: str, answer: str, check) -> str:
    """The answer that is taken for granted."""
    return answer


def _prompt(question: str, answer: str, check) -> str:
    """The user's answer on the terminal, once it is a valid one."""
    from fenics_joints.errors import InputError

    while True:
        try:
            said = str(typer.prompt(question, default=answer)).strip()
        except typer.Abort:
            raise InputError("no answer, so no case; --yes takes the guesses") from None
        try:
            check(said)
        except ValueError as error:  # an InputError is one
            typer.echo(str(error), err=True)
        else:
            return said


def check(case: CaseArgument) -> None:
    """All errors and unlikely values of a case, at once and in seconds.

    Masses by part and in all, places of sensors and bolts, time and memory of each command. Modes
    of the baseline model are solved, on a coarser mesh if it is large, and compared with the test:
    wrong units, exchanged modes, dead sensors are reported. Fails on errors; unlikely values are
    notes.
    """
    from fenics_joints.parallel import guarded

    given = CaseOptions.given()
    with guarded(given.debug):
        from mpi4py import MPI

        from fenics_joints.commands.check.run import run_check
        from fenics_joints.commands.provenance import provenance
        from fenics_joints.files import check_outputs
        from fenics_joints.parallel import on_root
        from fenics_joints.progress import Progress

        comm = MPI.COMM_WORLD
        on_root(comm, lambda: check_outputs(given.outputs(), folder=given.out))
        with Progress(silent=comm.rank != 0) as progress:
            outcome = run_check(case, comm, progress, large=given.large, changes=given.changes)
            found = outcome.result
            files = [found.path] if found.case is None else found.case.files()
            on_root(comm, lambda: check_outputs(given.outputs(), files, given.out))
            run = provenance(comm, found.case, given.changes)
            finish = written(comm, "check", outcome, given, progress, run)
        finish()


def schema(
    of: Annotated[
        str | None,
        typer.Option("--of", metavar="COMMAND", help="Of a command's --json instead of a case."),
    ] = None,
    debug: DebugOption = False,
) -> None:
    """The JSON schema of a case file, for editors that complete and check what is typed.

    Put it into a file, and name that in the first line of case.toml: #:schema case.schema.json
    With --of it is that of the results of check, modes, preload, update, bayes (update --bayes),
    harmonic, diagnose or plan (diagnose --plan).
    """
    from fenics_joints.parallel import guarded

    with guarded(debug):
        from fenics_joints.case.schema import case_schema
        from fenics_joints.commands.results import result_schema
        from fenics_joints.files import json_text

        typer.echo(json_text(case_schema() if of is None else result_schema(of)), nl=False)


def written(
    comm,
    command: str,
    outcome: Outcome,
    given: CaseOptions,
    progress: Progress,
    run: Mapping[str, object],
    notes: Sequence[str] = (),
) -> Callable[[], None]:
    """Make what the files of ``--json``, ``--report`` and ``--out`` get. Collective.

    Args:
        comm: Communicator.
        command: Its name.
        outcome: Its outcome.
        given: Which files are wanted.
        progress: Told what is being done.
        run: What the result comes from, see `provenance`.
        notes: What is unusual in the case.

    Returns:
        What writes the files and shows the outcome, once no progress is shown any more; then it
        fails, where the outcome says that it is none.
    """
    from fenics_joints.commands.results import VERSION
    from fenics_joints.errors import ConvergenceError
    from fenics_joints.files import json_text, shown_path, writable_folder, write_text
    from fenics_joints.parallel import on_root

    folder, formats = given.out, () if given.out is None else given.formats
    contents: list[tuple[Path, str]] = []
    wanted = {"json": [given.json], "html": [given.report]}
    for format, paths in wanted.items():
        paths += [folder / f"{command}.{format}"] if folder and format in formats else []
    if paths := [path for path in wanted["json"] if path is not None]:
        made = outcome.json()
        said = dict.fromkeys([*notes, *made.get("notes", ())])
        head = {"schema": f"fenics-joints {command} {VERSION}", "run": run}
        text = json_text({**head, **made, "notes": list(said)})
        contents += [(path, text) for path in paths]
    pages = [path for path in wanted["html"] if path is not None]
    if pages or "csv" in formats:
        progress.step("writing the report")
        page = outcome.page(notes)
        text = page.html(run) if pages else ""
        contents += [(path, text) for path in pages]
        if folder and "csv" in formats:
            tables = page.tables()
            contents += [(folder / f"{command}_{k}.csv", t.to_csv()) for k, t in tables.items()]

    def write() -> None:
        from fenics_joints.report.terminal import new_console

        if folder is not None:
            writable_folder(folder, "--out")
        for path, text in contents:
            if path.parent == folder and path.is_symlink():
                path.unlink()  # what it leads to may be an input
            write_text(path, text)
        outcome.summary(new_console())
        tables = sum(path.suffix == ".csv" for path, _ in contents)
        for path, _ in contents:
            if path.suffix != ".csv":
                tell(f"wrote {shown_path(path)}")
        if tables:
            several = "tables" if tables > 1 else "table"
            tell(f"wrote {tables} {several} to {shown_path(folder)}/{command}_*.csv")

    def finish() -> None:
        on_root(comm, write)
        if outcome.failure is not None:
            raise ConvergenceError(outcome.failure)

    return finish
