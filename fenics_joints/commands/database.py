"""``fenics-joints database``: query, add, sweep, show and web."""

from __future__ import annotations

import importlib
import json as json_module
import re
from pathlib import Path
from typing import Annotated

import typer

from fenics_joints.commands.arguments import DebugOption, file_option, tell, use_cores
from fenics_joints.commands.line import new_app
from fenics_joints.machine import ranks

app = new_app(
    "database",
    "Contact radius, pressure and interface parameters of bolted joints by bolt, force, thickness "
    "and roughness.",
)

_SHIPPED = "The database; by default the published tables that come with the package."
DatabaseOption = Annotated[Path | None, file_option("--db", _SHIPPED)]
OwnDatabaseOption = Annotated[Path, file_option("--db", "The database; made if it does not exist.")]
ModelOption = Annotated[
    str | None, typer.Option("--model", help="Use the rows of this model only.")
]
JsonOption = Annotated[Path | None, file_option("--json", "Write the result as JSON.")]
AuthorOption = Annotated[
    str | None, typer.Option("--author", help="Who computed it; by default the user.")
]
BoltOption = Annotated[str, typer.Option("--bolt", help="Thread: M12, M12x1.25, 5/16-24, ...")]
ForceOption = Annotated[str | None, typer.Option(help="Bolt force, such as '50 kN'.")]
TorqueOption = Annotated[str | None, typer.Option(help="Tightening torque, such as '120 N·m'.")]
RoughnessOption = Annotated[str | None, typer.Option(help="Ra, such as '1.6 µm'.")]

#: What a message on a wrong quantity shows, by the option.
_EXAMPLES = {
    "force": "50 kN",
    "torque": "120 N·m",
    "thickness": "25 mm",
    "roughness": "1.6 µm",
    "radius": "43 mm",
    "pressure": "6 MPa",
    "E": "6.1 GPa",
    "h": "0.7 mm",
}


@app.command()
def query(
    bolt: BoltOption,
    thickness: Annotated[str, typer.Option(help="Thickness of one plate, such as '25 mm'.")],
    torque: TorqueOption = None,
    force: ForceOption = None,
    K: Annotated[float, typer.Option("--K", help="Nut factor of T = K d F.")] = 0.2,
    friction: Annotated[
        float | None, typer.Option(help="Friction in the thread: Motosh's equation instead of K.")
    ] = None,
    friction_head: Annotated[
        float | None, typer.Option(help="Friction under the head; by default that in the thread.")
    ] = None,
    roughness: RoughnessOption = None,
    extrapolate: Annotated[
        bool,
        typer.Option(
            "--extrapolate", help="Also answer outside the range of the data, with a mark."
        ),
    ] = False,
    db: DatabaseOption = None,
    model: ModelOption = None,
    json: JsonOption = None,
    debug: DebugOption = False,
) -> None:
    """Parameters of a joint from its torque (or force), bolt and plates.

    JSON: force_N and force_from, radius_m and pressure_Pa (value, sd, low, high of the 95 %
    interval, extrapolated), identified (the nearest joint with E, nu, h), identified_note, notes.
    """

    def run():
        from fenics_joints.commands.database_document import answer_document
        from fenics_joints.database import JointSurfaces, TorqueToForce
        from fenics_joints.database import query as ask

        question = _in_si(thickness=thickness, torque=torque, force=force, roughness=roughness)
        how = TorqueToForce(K, friction, friction_head)
        with _opened(db) as store:
            surfaces = JointSurfaces.fit(store, model)
            answer = ask(
                surfaces, bolt=bolt, torque_to_force=how, extrapolate=extrapolate, **question
            )
        return answer_document(answer)

    _on_one_rank(run, debug, {"--json": json}, db)


@app.command()
def add(
    db: OwnDatabaseOption,
    csv: Annotated[Path | None, file_option("--csv", "Rows as 'show --csv' writes them.")] = None,
    bolt: Annotated[str | None, typer.Option("--bolt", help="Thread of a single row.")] = None,
    force: ForceOption = None,
    torque: TorqueOption = None,
    thickness: Annotated[
        str | None, typer.Option(help="Thickness of one plate, such as '25 mm'.")
    ] = None,
    roughness: RoughnessOption = None,
    radius: Annotated[str | None, typer.Option(help="Contact radius, such as '43 mm'.")] = None,
    pressure: Annotated[str | None, typer.Option(help="Mean pressure, such as '6 MPa'.")] = None,
    E: Annotated[
        str | None, typer.Option("--E", help="Modulus of the interface, such as '6.1 GPa'.")
    ] = None,
    nu: Annotated[float | None, typer.Option("--nu", help="Poisson's ratio.")] = None,
    h: Annotated[
        str | None, typer.Option("--h", help="Thickness of the interface, such as '0.7 mm'.")
    ] = None,
    model: Annotated[str | None, typer.Option(help="Name of the model or test.")] = None,
    author: AuthorOption = None,
    source: Annotated[str | None, typer.Option(help="Where it is published.")] = None,
    debug: DebugOption = False,
) -> None:
    """Add the rows of a CSV file, or one row."""
    given = {"force": force, "torque": torque, "thickness": thickness, "roughness": roughness}
    given |= {"radius": radius, "pressure": pressure, "E": E, "h": h}

    def run() -> None:
        from fenics_joints.database.joints import JointRow
        from fenics_joints.database.store import Store
        from fenics_joints.database.sweep import now, user_name
        from fenics_joints.errors import InputError
        from fenics_joints.preload.threads import thread

        if (csv is None) == (bolt is None):
            raise InputError("expected either --csv FILE, or --bolt with its values")
        row = None
        if bolt is not None:
            t = thread(bolt)
            known = {"bolt": t.name, "diameter": t.diameter, "nu": nu, **_in_si(**given)}
            named = {"model": model, "author": author or user_name(), "source": source}
            row = JointRow(**known, **named, date=now())
        with Store(db, create=True) as store:
            n = store.import_csv(csv) if row is None else store.add([row])
            tell(f"added {n} rows to {db}, which has {len(store.joints())} now")

    _on_one_rank(run, debug)


@app.command()
def sweep(
    db: OwnDatabaseOption,
    bolt: Annotated[list[str], typer.Option(help="Thread; may be repeated.")],
    force: Annotated[str, typer.Option(help="Forces, such as '12.5, 25, 37.5 kN'.")],
    thickness: Annotated[str, typer.Option(help="Thicknesses, such as '10, 15, 20 mm'.")],
    roughness: Annotated[str | None, typer.Option(help="Ra, such as '0.8, 1.6 µm'.")] = None,
    analysis: Annotated[
        str,
        typer.Option(metavar="MODULE:FUNCTION", help="Called with each sample and the settings."),
    ] = "fenics_joints.database.analysis:bolted_plates_radius",
    setting: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="NAME=VALUE", help="Setting of the analysis; may be repeated."
        ),
    ] = None,
    retry: Annotated[
        bool, typer.Option("--retry", help="Repeat samples that failed before.")
    ] = False,
    author: AuthorOption = None,
    debug: DebugOption = False,
) -> None:
    """Analyse all combinations, and keep each result at once.

    By default: contact radius at 1 MPa and mean pressure inside it, of two equal round plates of
    steel, 300 mm across, without friction, pressed by rings as wide as the bolt's washers. Change
    it with --set model=washers or model=bolt, friction, washer_friction, loaded_diameter,
    plate_radius, upper_thickness, E, nu, penalty, size, degree, P_lim (SI units; all are in
    fenics_joints.database.analysis.BoltedPlates).

    The ranks share the samples. Started again after an interruption, it computes only what was not
    finished. Exit code 1 if a sample failed.
    """
    from fenics_joints.parallel import guarded

    use_cores()
    with guarded(debug):
        from mpi4py import MPI

        ranks.join(MPI.COMM_WORLD.rank, MPI.COMM_WORLD.size)
        from fenics_joints.database import Store, grid
        from fenics_joints.database import sweep as run_sweep
        from fenics_joints.machine import form_cache
        from fenics_joints.parallel import on_root
        from fenics_joints.progress import Progress, compiling

        form_cache.install(compiling)
        comm = MPI.COMM_WORLD
        rough = [None] if roughness is None else _list("roughness", roughness)
        samples = grid(bolt, _list("force", force), _list("thickness", thickness), rough)
        analyse, settings = _analysis(analysis), _settings(setting or [])
        on_root(comm, lambda: Store(db, create=True).close())
        how = {"model": analysis, "settings": settings, "author": author, "retry": retry}
        with Store(db) as store, Progress(silent=comm.rank != 0) as progress:
            result = run_sweep(samples, analyse, store, comm, progress, **how)
        on_root(comm, lambda: _show_sweep(result, db))


@app.command()
def show(
    db: DatabaseOption = None,
    model: ModelOption = None,
    csv: Annotated[Path | None, file_option("--csv", "Write all rows as CSV.")] = None,
    leave_one_out: Annotated[
        bool, typer.Option("--leave-one-out", help="Predict each row from all others.")
    ] = False,
    json: JsonOption = None,
    debug: DebugOption = False,
) -> None:
    """The rows, and how well each is predicted by the others.

    JSON: rows (in SI units), and with --leave-one-out for radius and pressure: kriging in words,
    predicted, error, standardised, mean_absolute_error.
    """

    def run():
        from fenics_joints.commands.database_document import rows_document
        from fenics_joints.database.query import JointSurfaces
        from fenics_joints.files import shown_path

        with _opened(db) as store:
            surfaces = JointSurfaces.fit(store, model) if leave_one_out else None
            name = "published tables" if db is None else shown_path(db)
            document = rows_document(name, store.joints(model=model), surfaces)
            if csv is not None:
                store.export_csv(csv)
                tell(f"wrote {shown_path(csv)}")
        return document

    _on_one_rank(run, debug, {"--json": json, "--csv": csv}, db)


@app.command()
def web(
    db: DatabaseOption = None,
    model: ModelOption = None,
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Port of the page; 0 for any free one.")
    ] = 8088,
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Open the page in the browser.")
    ] = True,
    debug: DebugOption = False,
) -> None:
    """A page on this machine with the inputs, the answer, the Kriging surface and the data.

    Needs no internet; only this machine can open it. Ctrl-C ends it.
    """

    def run() -> None:
        from fenics_joints.database.query import JointSurfaces
        from fenics_joints.database.web import serve

        with _opened(db) as store:
            serve(JointSurfaces.fit(store, model), port=port, browser=browser)

    _on_one_rank(run, debug)


# -- helpers ---------------------------------------------------------------------------------------


def _on_one_rank(
    run, debug: bool, outputs: dict[str, Path | None] | None = None, *inputs: Path | None
) -> None:
    """Run on rank 0, where no output is an input; show and write the document that comes of it,
    if any; exit with the right code on all ranks."""
    from fenics_joints.parallel import guarded

    with guarded(debug):
        from mpi4py import MPI

        from fenics_joints.files import check_outputs, json_text, shown_path, write_text
        from fenics_joints.parallel import on_root

        def checked() -> None:
            check_outputs(outputs or {}, [path for path in inputs if path is not None])
            document = run()
            if document is None:
                return
            from fenics_joints.report import terminal

            terminal.show(terminal.new_console(), document)
            if (path := outputs["--json"]) is not None:
                write_text(path, json_text(document.data()))
                tell(f"wrote {shown_path(path)}")

        on_root(MPI.COMM_WORLD, checked)


def _opened(db: Path | None):
    from fenics_joints.database.store import Store, seed_database

    return seed_database() if db is None else Store(db, readonly=True)


def _in_si(**texts: str | None) -> dict[str, float | None]:
    """Numbers with their units, by option; the command line takes no bare numbers."""
    return {name: None if text is None else _si(name, text) for name, text in texts.items()}


def _si(name: str, text: str) -> float:
    from fenics_joints.database.joints import UNITS
    from fenics_joints.errors import InputError
    from fenics_joints.units import to_si

    try:
        return to_si(text, UNITS[name])
    except InputError as error:
        expected = f"expected a number with its unit, such as {_EXAMPLES[name]!r}"
        raise InputError(f"--{name} {text!r}: {expected}") from error


def _list(name: str, text: str) -> list[float]:
    """``12.5, 25 kN``: numbers with commas between, the unit after the last or after each."""
    parts = [part.strip() for part in text.split(",")]
    last = re.fullmatch(r"[-+.\deE]+\s*(.*)", parts[-1])
    own = last[1] if last else ""
    with_unit = [p if re.search(r"[^-+.\deE\s]", p) else f"{p} {own}" for p in parts]
    return [_si(name, part) for part in with_unit]


def _analysis(name: str):
    from fenics_joints.errors import InputError

    module, _, function = name.partition(":")
    try:
        return getattr(importlib.import_module(module), function)
    except (ImportError, AttributeError, ValueError) as error:
        raise InputError(
            f"--analysis {name!r}: {error}; expected MODULE:FUNCTION that Python can import"
        ) from error


def _settings(pairs: list[str]) -> dict[str, object]:
    """Values as JSON where they are JSON, else as text."""
    from fenics_joints.errors import InputError

    settings = {}
    for pair in pairs:
        name, sign, value = pair.partition("=")
        if not sign or not name.isidentifier():
            raise InputError(f"--set {pair!r}: expected NAME=VALUE")
        try:
            settings[name] = json_module.loads(value)
        except ValueError:
            settings[name] = value
    return settings


def _show_sweep(result, db: Path) -> None:
    from fenics_joints.errors import JointsError
    from fenics_joints.formatting import quantity

    tell(f"{result.computed} samples analysed, {result.finished_before} were there before: {db}")
    if result.failed:
        lines = [
            f"{s.bolt}, {quantity(s.force, 'N')}, {quantity(s.thickness, 'm')}: {message}"
            for s, message in result.failed.items()
        ]
        raise JointsError(
            f"{len(lines)} samples failed and are recorded as such (--retry computes them again):\n"
            + "\n".join(lines)
        )
