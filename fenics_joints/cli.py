"""The ``fenics-joints`` command: reads the arguments, runs, writes files, and says how it went."""

from __future__ import annotations

import os
import resource
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click
import typer

from fenics_joints import __version__
from fenics_joints.commands.arguments import (
    FORMATS,
    CaseArgument,
    CaseOptions,
    VtxOption,
    file_option,
    use_cores,
)
from fenics_joints.commands.database import app as database_app
from fenics_joints.commands.line import new_app
from fenics_joints.commands.start import check, new, schema, written
from fenics_joints.formatting import printable
from fenics_joints.machine import ranks
from fenics_joints.machine.imports import guard
from fenics_joints.machine.streams import environment, open_streams
from fenics_joints.progress import loudness

if TYPE_CHECKING:
    from fenics_joints.case import Case


#: Bytes of address space that importing the libraries takes; with less some wait for it for ever,
#: or end by a fault.
_LIBRARIES = 640 * 2**20

app = new_app(
    "",
    "Where a model of a bolted structure disagrees with its vibration test, why, and by how much "
    "the error falls.",
)
for _first in (new, check, schema):
    app.command()(_first)
app.add_typer(database_app, name="database")


@app.command()
def modes(
    case: CaseArgument,
    n: Annotated[
        int | None,
        typer.Option("-n", min=1, max=10_000, help="Number of modes, rigid-body modes included."),
    ] = None,
    contacts: Annotated[
        str,
        typer.Option(
            help="Contacts: stuck, or as the preload leaves them.", metavar="stuck|preload"
        ),
    ] = "stuck",
    iterative: Annotated[
        bool,
        typer.Option(
            "--iterative",
            help="Multigrid instead of a factorisation, in a fraction of the "
            "memory; not for contacts.",
        ),
    ] = False,
    draw_all: Annotated[
        bool,
        typer.Option(
            "--all-shapes",
            help="Draw all modes on the page, also those that the test does not see.",
        ),
    ] = False,
    vtx: VtxOption = None,
) -> None:
    """Natural frequencies and modes of the baseline model."""
    options = {"n_modes": n, "state": contacts, "draw_all": draw_all, "fields": vtx}
    options["method"] = "iterative" if iterative else "direct"
    _command("modes", "run_modes", options, case, _field_files(vtx))


@app.command()
def preload(case: CaseArgument, vtx: VtxOption = None) -> None:
    """Contact under the case's bolt forces and loads, and its effect on the frequencies."""
    _command("preload", "run_preload", {"fields": vtx}, case, _field_files(vtx))


@app.command()
def update(
    case: CaseArgument,
    bayes: Annotated[
        bool, typer.Option("--bayes", help="The posterior of the parameters, by [update.bayes].")
    ] = False,
    keep: Annotated[
        Path | None,
        file_option(
            "--keep",
            "With --bayes: keep the chains in this file (NetCDF), and continue those in it.",
            "FILE.nc",
        ),
    ] = None,
) -> None:
    """Fit the case's update parameters, or its cut-off pressure, to the measured data.

    To frequencies; with test.frfs and [damping], a parameter of damping and test.damping, or
    update.data, to any mix of frequencies, shapes, damping ratios and frequency response functions
    at one condition.

    With --bayes, chains that did not converge predict nothing; they are written, and the
    command fails.
    """
    if keep is not None and not bayes:
        raise typer.BadParameter("there are no chains without --bayes", param_hint="--keep")
    name, options = ("run_bayes", {"keep": keep}) if bayes else ("run_update", {})
    files = {"--keep": keep}
    if keep is not None:
        files["--keep (its model)"] = keep.with_suffix(".model.h5")
    _command("bayes" if bayes else "update", name, options, case, files)


@app.command()
def diagnose(
    case: CaseArgument,
    plan: Annotated[
        bool,
        typer.Option("--plan", help="Before any data: which causes the test could distinguish."),
    ] = False,
    keep: Annotated[
        Path | None,
        file_option(
            "--keep",
            "Keep the reduced model there, and take it from there for the next test.",
            "FOLDER",
        ),
    ] = None,
    effects: Annotated[
        list[str] | None,
        typer.Option(
            "--effects",
            metavar="NAME",
            help="Effects to look for, instead of [diagnose] effects: a name, all, or module:name; "
            "several times.",
        ),
    ] = None,
) -> None:
    """Where the model is wrong, which effect causes it, and by how much the error falls."""
    name = "plan" if plan else "diagnose"
    _command(name, f"run_{name}", {"keep": keep, "effects": effects or None}, case, folder=keep)


@app.command()
def harmonic(
    case: CaseArgument,
    branches: Annotated[
        Path | None,
        file_option(
            "--branches",
            "Keep every branch in this folder as it grows, and continue those in it.",
            "FOLDER",
        ),
    ] = None,
) -> None:
    """Nonlinear frequency responses at the case's levels of force, and the mode's backbone."""
    _command("harmonic", "run_harmonic", {"branches": branches}, case, folder=branches)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"fenics-joints {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option("-V", "--version", callback=_version, is_eager=True, help="Show the version."),
    ] = False,
) -> None:
    allowed, _ = resource.getrlimit(resource.RLIMIT_AS)
    if -1 < allowed < _LIBRARIES and not {"-h", "--help"} & set(sys.argv):
        typer.echo(
            f"error: this process may have {allowed / 2**20:.0f} MiB of memory (ulimit -v); "
            f"expected {_LIBRARIES / 2**20:.0f} MiB or more, which the libraries alone take",
            err=True,
        )
        raise typer.Exit(1)


def main() -> None:
    """Entry point of the ``fenics-joints`` command."""
    if any(os.environ.get(key, "0") != "0" for key in ranks.LAUNCHED):
        # Help and usage errors come from every rank; one is enough.
        sys.stdout = sys.stderr = open(os.devnull, "w")  # noqa: SIM115
    guard()
    with ranks.reported(), open_streams():
        environment()
        arguments = sys.argv[1:]
        sys.argv[1:] = map(printable, arguments)  # DOLFINx reads them, too, and only UTF-8
        app(args=arguments, prog_name="fenics-joints")


# -- running ---------------------------------------------------------------------------------------


def _field_files(vtx: Path | None) -> dict[str, Path | None]:
    """The files of ``--vtx`` by the option; a ``.bp`` is a folder, and is checked as one later."""
    if vtx is None or vtx.suffix == ".bp":
        return {"--vtx": None}
    return {"--vtx": vtx, "--vtx (its .h5)": vtx.with_suffix(".h5")}


def _command(
    command: str,
    name: str,
    options: dict,
    path: Path,
    files: dict[str, Path | None] | None = None,
    folder: Path | None = None,
) -> None:
    """Read the case, run, write the files, show the summary; exit with the right code.

    Args:
        command: Name of the command, for its files in the folder of ``--out``.
        name: Of the function in `fenics_joints.commands`.
        options: Its keyword arguments.
        path: The case.
        files: Files that it writes itself, by the option that names them, or None.
        folder: A folder that it writes to, or None.
    """
    from fenics_joints.parallel import guarded

    given = CaseOptions.given()
    outputs = {**given.outputs(), **(files or {})}
    if loudness() == "quiet" and not any(
        [*outputs.values(), given.out, folder, options.get("fields")]
    ):
        raise click.UsageError(
            "-q prints no results and no file is named for them; expected --out, --json or --report"
        )
    if given.formats != FORMATS and given.out is None:
        raise typer.BadParameter("chooses what --out writes; expected --out", param_hint="--format")
    use_cores()
    with guarded(given.debug):
        from mpi4py import MPI

        ranks.join(MPI.COMM_WORLD.rank, MPI.COMM_WORLD.size)
        from fenics_joints import commands
        from fenics_joints.case import load_case, own_code
        from fenics_joints.commands.provenance import provenance
        from fenics_joints.files import check_outputs
        from fenics_joints.machine import form_cache, memory
        from fenics_joints.parallel import on_root
        from fenics_joints.progress import Progress, compiling

        form_cache.install(compiling)
        memory.hold_freed()
        comm = MPI.COMM_WORLD

        def read() -> Case:
            check_outputs(outputs, folder=given.out)  # before data are read, which may take a while
            case = load_case(path, changes=given.changes)
            check_outputs(outputs, case.files(), given.out)
            return case

        case = comm.bcast(on_root(comm, read))
        own_code.find_again(comm.bcast(own_code.references()), case.path.parent)
        _check_size(comm, case, name, options, given.large)
        notes = _say_unusual(comm, case, name)
        run = provenance(comm, case, given.changes)
        with Progress(silent=comm.rank != 0) as progress:
            progress.outline((), _expected(case, command, comm.size))
            outcome = getattr(commands, name)(case, comm, progress, **options)
            finish = written(comm, command, outcome, given, progress, run, notes)
        finish()


def _check_size(comm, case: Case, name: str, options: dict, large: bool) -> None:
    """Refuse a model that the machine has no memory for."""
    from mpi4py import MPI

    from fenics_joints.case import check_size
    from fenics_joints.parallel import on_root

    local = comm.Split_type(MPI.COMM_TYPE_SHARED)
    hosts = comm.allreduce(int(local.rank == 0))
    local.Free()
    meshed = case.diagnosed() if name in ("run_diagnose", "run_plan") else case
    method = options.get("method", "direct")
    on_root(
        comm, lambda: check_size(meshed, method=method, ranks=comm.size, hosts=hosts, large=large)
    )


#: Seconds from which the end of a command is told.
_LONG = 20.0


def _expected(case: Case, command: str, ranks: int) -> float | None:
    """Seconds that a command will roughly take; None for few, or where nobody knows."""
    from fenics_joints.case import estimate
    from fenics_joints.commands.check.costs import costs_of

    costs = costs_of(case, estimate(case, ranks=ranks), None, ranks)
    seconds = next((cost.seconds for cost in costs if cost.command == command), 0.0)
    return seconds if seconds > _LONG else None


#: Commands whose own notes include the notes on the test's files.
_SAY_TEST_NOTES = ("run_modes", "run_update", "run_diagnose")


def _say_unusual(comm, case: Case, name: str) -> tuple[str, ...]:
    """Print notes on unusual values of the case and on its files, before the work starts."""
    from fenics_joints.case import own_code, plausibility

    own = () if name in _SAY_TEST_NOTES else (*case.test_notes(), *case.joint_notes())
    notes = (*own, *plausibility(case), *own_code.used())
    if comm.rank == 0 and loudness() != "quiet":
        for note in notes:
            typer.echo(f"note: {note}", err=True)
    return notes
