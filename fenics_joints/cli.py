"""The ``fenics-joints`` command: reads the arguments, runs, writes files, and says how it went."""

from __future__ import annotations

import os
import resource
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fenics_joints import __version__
from fenics_joints.commands.arguments import (
    CaseArgument,
    DebugOption,
    JsonOption,
    LargeOption,
    ReportOption,
    VtxOption,
    file_option,
)
from fenics_joints.commands.database import app as database_app
from fenics_joints.commands.line import new_app
from fenics_joints.commands.start import check, new, prepared, schema
from fenics_joints.formatting import printable
from fenics_joints.machine.imports import guard
from fenics_joints.machine.streams import environment, open_streams
from fenics_joints.progress import LAUNCHED, loudness

if TYPE_CHECKING:
    from fenics_joints.case import Case


#: Bytes of address space that importing the libraries takes; with less some wait for it for ever,
#: or end by a fault.
_LIBRARIES = 640 * 2**20

app = new_app(
    "",
    "Where a model of a bolted structure and its vibration test disagree, why, and how far the gap "
    "shrinks.",
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
            help="What contacts are: stuck, or as the preload leaves them.", metavar="stuck|preload"
        ),
    ] = "stuck",
    iterative: Annotated[
        bool,
        typer.Option(
            "--iterative",
            help="Multigrid instead of a factorisation: slower, in a "
            "fraction of the memory; not for contacts.",
        ),
    ] = False,
    draw_all: Annotated[
        bool,
        typer.Option(
            "--all-shapes",
            help="Draw all modes on the page, also those that the test does not see.",
        ),
    ] = False,
    json: JsonOption = None,
    report: ReportOption = None,
    vtx: VtxOption = None,
    large: LargeOption = False,
    debug: DebugOption = False,
) -> None:
    """Natural frequencies and modes of the nominal model.

    JSON: version, title, dofs, frequencies_hz (0 for rigid-body modes), rigid_body_modes (their
    number), visible (whether the test could see each mode; null if the case does not say), size_m
    (extents of the mesh), rings (the bolts': name, centre_m, thickness_m, r_nei_m, r_wai_m, parts),
    test (the modes beside those of the test: condition, pairs, gap, mac_matrix, mac_modes; null
    without data), notes (on the test's data).
    """
    options = {"n_modes": n, "state": contacts, "draw_all": draw_all, "fields": vtx}
    options["method"] = "iterative" if iterative else "direct"
    outputs = {"--json": json, "--report": report, **_field_files(vtx)}
    _command("run_modes", options, case, outputs, large, debug)


@app.command()
def preload(
    case: CaseArgument,
    json: JsonOption = None,
    report: ReportOption = None,
    large: LargeOption = False,
    vtx: VtxOption = None,
    debug: DebugOption = False,
) -> None:
    """Contact at the case's bolt forces and loads, and what it does to the frequencies.

    JSON: bolt_forces_n, iterations, contacts (force_n, peak_pressure_pa, mean_pressure_pa,
    area_m2, area_above_1_mpa_m2, radius_m and equal_radius_m by bolt, open, slip, stick), applied
    (obstacles, displacements and loads: name, kind, displacement_m, force_n), frequencies_hz
    (stuck, preloaded, stuck_become), free_motions, notes.
    """

    outputs = {"--json": json, "--report": report, **_field_files(vtx)}
    _command("run_preload", {"fields": vtx}, case, outputs, large, debug)


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
            "With --bayes: keep the chains there (NetCDF), and go on from what is there.",
            "FILE.nc",
        ),
    ] = None,
    json: JsonOption = None,
    report: ReportOption = None,
    large: LargeOption = False,
    debug: DebugOption = False,
) -> None:
    """Fit the parameters, or the cut-off pressure, that the case names to what was measured.

    To frequencies; with test.frfs and [damping], a parameter of damping and test.damping, or
    update.data, to any mix of frequencies, shapes, damping ratios and frequency response functions
    at one condition.

    JSON: method, data, parameters (name, value, unit, standard deviation), frequencies_hz (test,
    before and after), errors_percent, modes (the same by mode, MAC, damping_test, damping_before,
    damping_after), functions_db (RMS of |H| in dB, all, fitted and held out), held_modes
    (predicted_hz, error_percent, damping_predicted), condition_numbers (before and after
    weighting), identifiability (in_words, undetermined, weakest_direction), fit (chi2,
    evaluations), history; on frequencies alone also torque_fits, curves and curve_gap.

    For a cut-off pressure: schemes (cutoff_pa, objective, frequencies_hz, crossings_pa,
    stuck_area_m2, minimum, sweep), test and stuck frequencies.

    With --bayes instead: converged and problems, parameters (name, mean, sd, median, low and high
    of 90 %, rhat, ess_bulk, ess_tail, unit), correlation, prior, likelihood and doubts in words,
    frequencies (measured and predicted, held or not), predictive_check (scatter and correlation of
    specimens), independent_check (of the paper's likelihood), sampler, model. Chains that did not
    converge predict nothing; what they are is written, and the command fails.
    """
    if keep is not None and not bayes:
        raise typer.BadParameter("there are no chains without --bayes", param_hint="--keep")
    name, options = ("run_bayes", {"keep": keep}) if bayes else ("run_update", {})
    outputs = {"--json": json, "--report": report, "--keep": keep}
    if keep is not None:
        outputs["--keep (its model)"] = keep.with_suffix(".model.h5")
    _command(name, options, case, outputs, large, debug)


@app.command()
def diagnose(
    case: CaseArgument,
    plan: Annotated[
        bool,
        typer.Option("--plan", help="Before any data: which causes the test could tell apart."),
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
            help="What is looked for, instead of [diagnose] effects: a name, all, or module:name; "
            "several times.",
        ),
    ] = None,
    json: JsonOption = None,
    report: ReportOption = None,
    large: LargeOption = False,
    debug: DebugOption = False,
) -> None:
    """Where the model is wrong, which effect causes it, and how far the gap shrinks.

    JSON: in_words (which, how_far, apart, where), gap (before, after, heldout_before,
    heldout_after, placebo_after; relative RMS), where (region, share), effects (name, region,
    probability, class), classes, outside, verdict, location, shrinkage, frequencies_hz before and
    after; its schema is docs/diagnosis.schema.json.

    With --plan instead: apart (number of causes and groups of them told apart), effects (key,
    class, seen, size, distance from no gap and its range over the sizes), distance and confusion
    (mean probabilities in simulated tests), by the effect at work and what it is taken for,
    classes (members, collinearity, combination, left), additions (measurement, apart, seen,
    mean_gain, largest_gain, pair), the best first.
    """
    name = "run_plan" if plan else "run_diagnose"
    outputs = {"--json": json, "--report": report}
    _command(name, {"keep": keep, "effects": effects or None}, case, outputs, large, debug)


@app.command()
def harmonic(
    case: CaseArgument,
    json: JsonOption = None,
    report: ReportOption = None,
    large: LargeOption = False,
    branches: Annotated[
        Path | None,
        file_option(
            "--branches",
            "Keep every branch there as it grows, and go on from what is there.",
            "FOLDER",
        ),
    ] = None,
    debug: DebugOption = False,
) -> None:
    """Nonlinear frequency responses at the case's levels of force, and the mode's backbone.

    JSON: levels (level_n, peak_hz, peak, damping_ratio, joint_energy_j, branch), backbone
    (frequency_hz and damping_ratio over amplitude), interface_points, frequencies_at_rest_hz.
    """
    outputs = {"--json": json, "--report": report}
    _command("run_harmonic", {"branches": branches}, case, outputs, large, debug)


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
    if any(os.environ.get(key, "0") != "0" for key in LAUNCHED):
        # Help and usage errors come from every rank; one is enough.
        sys.stdout = sys.stderr = open(os.devnull, "w")  # noqa: SIM115
    guard()
    with open_streams():
        environment()
        arguments = sys.argv[1:]
        sys.argv[1:] = map(printable, arguments)  # DOLFINx reads them, too, and only UTF-8
        app(args=arguments, prog_name="fenics-joints")


# -- running ---------------------------------------------------------------------------------------


def _field_files(vtx: Path | None) -> dict[str, Path | None]:
    """The files of ``--vtx`` by the option; a ``.bp`` is a folder, and is checked as one later."""
    if vtx is None or vtx.suffix == ".bp":
        return {}
    return {"--vtx": vtx, "--vtx (its .h5)": vtx.with_suffix(".h5")}


def _command(
    name: str, options: dict, path: Path, outputs: dict[str, Path | None], large: bool, debug: bool
) -> None:
    """Read the case, run, write the files, show the summary; exit with the right code.

    Args:
        name: Of the function in `fenics_joints.commands`.
        options: Its keyword arguments.
        path: The case.
        outputs: Files of what it makes, by the option that names them, or None.
        large: Whether a model goes on that seems too large for the machine.
        debug: Whether errors keep Python's traceback.
    """
    from fenics_joints.parallel import guarded

    with guarded(debug):
        from mpi4py import MPI

        from fenics_joints import commands
        from fenics_joints.case import load_case, own_code
        from fenics_joints.files import check_outputs
        from fenics_joints.machine import form_cache, memory
        from fenics_joints.parallel import on_root
        from fenics_joints.progress import Progress

        form_cache.install()
        memory.hold_freed()
        comm = MPI.COMM_WORLD

        def read() -> Case:
            check_outputs(outputs)  # before data are read, which may take a while
            case = load_case(path)
            check_outputs(outputs, case.files())
            return case

        case = comm.bcast(on_root(comm, read))
        own_code.find_again(comm.bcast(own_code.references()), case.path.parent)
        _check_size(comm, case, name, options, large)
        notes = _say_unusual(comm, case, name)
        with Progress(silent=comm.rank != 0) as progress:
            outcome = getattr(commands, name)(case, comm, progress, **options)
            finish = prepared(comm, outcome, outputs, progress, notes)
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
