"""``fenics-joints database``: query, add, sweep, show and web."""

from __future__ import annotations

import importlib
import json as json_module
import re
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from fenics_joints.commands.arguments import named_path, tell
from fenics_joints.commands.line import new_app

app = new_app(
    "database",
    "Contact radius, pressure and interface parameters of bolted joints by bolt, force, thickness "
    "and roughness.",
)

_SHIPPED = "The database; by default the published tables that come with the package."
DatabaseOption = Annotated[
    Path | None, typer.Option("--db", metavar="FILE", parser=named_path, help=_SHIPPED)
]
OwnDatabaseOption = Annotated[
    Path,
    typer.Option(
        "--db", metavar="FILE", parser=named_path, help="The database; made if it is not there."
    ),
]
ModelOption = Annotated[
    str | None, typer.Option("--model", help="Whose rows, if there are those of several models.")
]
JsonOption = Annotated[
    Path | None,
    typer.Option("--json", metavar="FILE", parser=named_path, help="Write the result as JSON."),
]
AuthorOption = Annotated[
    str | None, typer.Option("--author", help="Who computed it; by default the user.")
]
DebugOption = Annotated[bool, typer.Option("--debug", help="Show Python's traceback of an error.")]
BoltOption = Annotated[str, typer.Option("--bolt", help="Thread: M12, M12x1.25, 5/16-24, ...")]


@app.command()
def query(
    bolt: BoltOption,
    thickness: Annotated[str, typer.Option(help="Of one plate, such as '25 mm'.")],
    torque: Annotated[
        str | None, typer.Option(help="Tightening torque, such as '120 N·m'.")
    ] = None,
    force: Annotated[str | None, typer.Option(help="Bolt force instead, such as '50 kN'.")] = None,
    K: Annotated[float, typer.Option("--K", help="Nut factor of T = K d F.")] = 0.2,
    friction: Annotated[
        float | None, typer.Option(help="Friction in the thread: Motosh's equation instead of K.")
    ] = None,
    friction_head: Annotated[
        float | None, typer.Option(help="Friction under the head; by default that in the thread.")
    ] = None,
    roughness: Annotated[str | None, typer.Option(help="Ra, such as '1.6 µm'.")] = None,
    extrapolate: Annotated[
        bool, typer.Option("--extrapolate", help="Answer outside the data too, marked as such.")
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

    def run() -> None:
        from fenics_joints.database import JointSurfaces, TorqueToForce
        from fenics_joints.database import query as ask
        from fenics_joints.database.tables import show_answer
        from fenics_joints.report.terminal import new_console

        question = dict(
            bolt=bolt,
            thickness=_si("--thickness", thickness, "m", "25 mm"),
            torque=_si("--torque", torque, "N·m", "120 N·m"),
            force=_si("--force", force, "N", "50 kN"),
            roughness=_si("--roughness", roughness, "m", "1.6 µm"),
            torque_to_force=TorqueToForce(K, friction, friction_head),
            extrapolate=extrapolate,
        )
        with _opened(db) as store:
            answer = ask(JointSurfaces.fit(store, model), **question)
        show_answer(new_console(), answer)
        _write_json(json, answer.json())

    _on_one_rank(run, debug, {"--json": json}, db)


@app.command()
def add(
    db: OwnDatabaseOption,
    csv: Annotated[
        Path | None,
        typer.Option(
            "--csv", metavar="FILE", parser=named_path, help="Rows as 'show --csv' writes them."
        ),
    ] = None,
    bolt: Annotated[str | None, typer.Option("--bolt", help="Thread of a single row.")] = None,
    force: Annotated[str | None, typer.Option(help="Such as '50 kN'.")] = None,
    torque: Annotated[str | None, typer.Option(help="Such as '120 N·m'.")] = None,
    thickness: Annotated[str | None, typer.Option(help="Of one plate, such as '25 mm'.")] = None,
    roughness: Annotated[str | None, typer.Option(help="Ra, such as '1.6 µm'.")] = None,
    radius: Annotated[str | None, typer.Option(help="Contact radius, such as '43 mm'.")] = None,
    pressure: Annotated[str | None, typer.Option(help="Mean, such as '6 MPa'.")] = None,
    E: Annotated[str | None, typer.Option("--E", help="Such as '6.1 GPa'.")] = None,
    nu: Annotated[float | None, typer.Option("--nu", help="Poisson's ratio.")] = None,
    h: Annotated[
        str | None, typer.Option("--h", help="Of the interface, such as '0.7 mm'.")
    ] = None,
    model: Annotated[str | None, typer.Option(help="Name of the model or test.")] = None,
    author: AuthorOption = None,
    source: Annotated[str | None, typer.Option(help="Where it is published.")] = None,
    debug: DebugOption = False,
) -> None:
    """Add the rows of a CSV file, or one row."""

    def run() -> None:
        from fenics_joints.database.store import Store
        from fenics_joints.errors import InputError

        if (csv is None) == (bolt is None):
            raise InputError(
                "expected --csv FILE, or --bolt and what is known of it, one of the two"
            )
        row = None
        if bolt is not None:
            row = _row(
                bolt,
                {
                    "force": _si("--force", force, "N", "50 kN"),
                    "torque": _si("--torque", torque, "N·m", "120 N·m"),
                    "thickness": _si("--thickness", thickness, "m", "25 mm"),
                    "roughness": _si("--roughness", roughness, "m", "1.6 µm"),
                    "radius": _si("--radius", radius, "m", "43 mm"),
                    "pressure": _si("--pressure", pressure, "Pa", "6 MPa"),
                    "E": _si("--E", E, "Pa", "6.1 GPa"),
                    "nu": nu,
                    "h": _si("--h", h, "m", "0.7 mm"),
                    "model": model,
                    "author": author,
                    "source": source,
                },
            )
        with Store(db, create=True) as store:
            n = store.import_csv(csv) if row is None else store.add([row])
            tell(f"added {n} rows to {db}, which has {len(store.joints())} now")

    _on_one_rank(run, debug)


@app.command()
def sweep(
    db: OwnDatabaseOption,
    bolt: Annotated[list[str], typer.Option(help="Thread; may be repeated.")],
    force: Annotated[str, typer.Option(help="Such as '12.5, 25, 37.5 kN'.")],
    thickness: Annotated[str, typer.Option(help="Such as '10, 15, 20 mm'.")],
    roughness: Annotated[str | None, typer.Option(help="Ra, such as '0.8, 1.6 µm'.")] = None,
    analysis: Annotated[
        str,
        typer.Option(metavar="MODULE:FUNCTION", help="Called with each sample and the settings."),
    ] = "fenics_joints.database.analysis:bolted_plates_radius",
    setting: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="Of the analysis; may be repeated."),
    ] = None,
    retry: Annotated[bool, typer.Option("--retry", help="Also what failed before.")] = False,
    author: AuthorOption = None,
    debug: DebugOption = False,
) -> None:
    """Analyse all combinations, and keep each result at once.

    By default: contact radius at 1 MPa and mean pressure inside it, of two equal round plates of
    steel, 300 mm across, without friction, pressed by rings as wide as the bolt's washers. Change
    it with --set model=washers or model=bolt, friction, washer_friction, loaded_diameter,
    plate_radius, upper_thickness, E, nu, penalty, size, degree, P_lim (SI units; all are in
    fenics_joints.database.analysis.BoltedPlates).

    Under mpirun the ranks share the samples. Started again after an interruption, it computes only
    what was not finished. Exit code 1 if a sample failed.
    """
    from fenics_joints.parallel import guarded

    with guarded(debug):
        from mpi4py import MPI

        from fenics_joints.database import Store, grid
        from fenics_joints.database import sweep as run_sweep
        from fenics_joints.machine import form_cache
        from fenics_joints.parallel import on_root
        from fenics_joints.progress import Progress

        form_cache.install()
        comm = MPI.COMM_WORLD
        roughnesses = (
            [None] if roughness is None else _list("--roughness", roughness, "m", "1.6 µm")
        )
        samples = grid(
            bolt,
            _list("--force", force, "N", "12.5, 25 kN"),
            _list("--thickness", thickness, "m", "10, 20 mm"),
            roughnesses,
        )
        analyse, settings = _analysis(analysis), _settings(setting or [])
        on_root(comm, lambda: Store(db, create=True).close())
        with Store(db) as store, Progress(silent=comm.rank != 0) as progress:
            result = run_sweep(
                samples,
                analyse,
                store,
                comm,
                progress,
                model=analysis,
                settings=settings,
                author=author,
                retry=retry,
            )
        on_root(comm, lambda: _show_sweep(result, db))


@app.command()
def show(
    db: DatabaseOption = None,
    model: ModelOption = None,
    csv: Annotated[
        Path | None,
        typer.Option("--csv", metavar="FILE", parser=named_path, help="Write all rows as CSV."),
    ] = None,
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

    def run() -> None:
        from fenics_joints.database.tables import leave_one_out_json, show_leave_one_out, show_rows
        from fenics_joints.report.terminal import new_console

        console = new_console()
        with _opened(db) as store:
            rows = store.joints(model=model)
            content: dict[str, object] = {"rows": [asdict(j) for j in rows]}
            show_rows(console, rows)
            if leave_one_out:
                from fenics_joints.database.query import JointSurfaces

                surfaces = JointSurfaces.fit(store, model)
                show_leave_one_out(console, surfaces)
                content["leave_one_out"] = leave_one_out_json(surfaces)
            if csv is not None:
                store.export_csv(csv)
                tell(f"wrote {csv}")
        _write_json(json, content)

    _on_one_rank(run, debug, {"--json": json, "--csv": csv}, db)


@app.command()
def web(
    db: DatabaseOption = None,
    model: ModelOption = None,
    port: Annotated[int, typer.Option(min=0, max=65535, help="0 for any that is free.")] = 8088,
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
    """Run on rank 0, where no output is an input; exit with the right code on all."""
    from fenics_joints.parallel import guarded

    with guarded(debug):
        from mpi4py import MPI

        from fenics_joints.files import check_outputs
        from fenics_joints.parallel import on_root

        def checked() -> None:
            check_outputs(outputs or {}, [path for path in inputs if path is not None])
            run()

        on_root(MPI.COMM_WORLD, checked)


def _opened(db: Path | None):
    from fenics_joints.database.store import Store, seed_database

    return seed_database() if db is None else Store(db, readonly=True)


def _si(option: str, text: str | None, unit: str, example: str) -> float | None:
    """A number with its unit; the command line takes no bare numbers."""
    from fenics_joints.errors import InputError
    from fenics_joints.units import to_si

    if text is None:
        return None
    try:
        return to_si(text, unit)
    except InputError as error:
        raise InputError(
            f"{option} {text!r}: expected a number with its unit, such as {example!r}"
        ) from error


def _list(option: str, text: str, unit: str, example: str) -> list[float]:
    """``12.5, 25 kN``: numbers with commas between, the unit after the last or after each."""
    parts = [part.strip() for part in text.split(",")]
    last = re.fullmatch(r"[-+.\deE]+\s*(.*)", parts[-1])
    own = last[1] if last else ""
    with_unit = [p if re.search(r"[^-+.\deE\s]", p) else f"{p} {own}" for p in parts]
    return [_si(option, part, unit, example) for part in with_unit]


def _row(bolt: str, values: dict):
    import datetime

    from fenics_joints.database.joints import JointRow
    from fenics_joints.database.sweep import user_name
    from fenics_joints.preload.threads import thread

    t = thread(bolt)
    values["author"] = values["author"] or user_name()
    date = datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds")
    return JointRow(diameter=t.diameter, bolt=t.name, date=date, **values)


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


def _write_json(path: Path | None, content: dict) -> None:
    from fenics_joints.files import json_text, shown_path, write_text

    if path is not None:
        write_text(path, json_text(content))
        tell(f"wrote {shown_path(path)}")


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
