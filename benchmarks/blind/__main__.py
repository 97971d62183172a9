"""The blind check: ``python3 -m benchmarks.blind COMMAND``, or ``python3 benchmarks/blind``."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Annotated

ROOT = Path(__file__).resolve().parents[2]
if __package__ in (None, ""):
    # Started as a folder: the modules beside this file must not be found by their bare names.
    sys.path[0] = str(ROOT)

import typer  # noqa: E402

from benchmarks.blind import seal  # noqa: E402
from fenics_joints.errors import JointsError  # noqa: E402
from fenics_joints.files import json_text, write_text  # noqa: E402

app = typer.Typer(no_args_is_help=True, pretty_exceptions_enable=False, help=__doc__)

Folder = Annotated[Path, typer.Argument(metavar="FOLDER", help="The folder of the check.")]
Key = Annotated[
    Path | None,
    typer.Option(help="File of the answers' key, outside FOLDER. [FOLDER's name and .key]"),
]
World = Annotated[str, typer.Option(help="Which makes the cases: first, or calculix.")]
Jobs = Annotated[int, typer.Option(min=1, help="Processes at a time.")]


def _key_path(folder: Path, key: Path | None) -> Path:
    folder = folder.resolve()
    return key or folder.with_name(f"{folder.name}.key")


@app.command()
def generate(
    folder: Folder,
    cases: Annotated[int, typer.Option(min=1, help="How many.")] = 200,
    seed: Annotated[
        int | None, typer.Option(help="Of the plan; drawn and sealed if left out.")
    ] = None,
    final: Annotated[bool, typer.Option(help="With what is for scoring only.")] = False,
    world: World = "first",
    only: Annotated[str | None, typer.Option(help="A geometry of that world.")] = None,
    so_far: Annotated[
        bool, typer.Option("--so-far", help="Seal what an earlier call made, and make no more.")
    ] = False,
    jobs: Jobs = 2,
    key: Key = None,
) -> None:
    """Make cases and seal their answers. Goes on where an earlier call stopped."""
    from benchmarks.blind.make import make_cases

    folder.mkdir(parents=True, exist_ok=True)
    secret = seal.make_key(_key_path(folder, key), folder)
    listed = make_cases(
        folder,
        secret,
        cases,
        seed,
        final=final,
        jobs=jobs,
        world=world,
        only=only,
        so_far=so_far,
        say=_say,
    )
    _say(f"{len(listed['cases'])} cases sealed; publish {folder / seal.SEALED}")


@app.command()
def diagnose(
    folder: Folder,
    jobs: Jobs = 2,
    seconds: Annotated[float, typer.Option(min=1, help="Time that a case may take.")] = 3600,
    retry: Annotated[bool, typer.Option(help="Those that failed once more.")] = False,
) -> None:
    """Diagnose the cases from their data. Goes on where an earlier call stopped."""
    from benchmarks.blind.run import diagnose_cases

    failed = diagnose_cases(folder, jobs=jobs, seconds=seconds, retry=retry, say=_say)
    _say(f"{failed} diagnoses failed" if failed else "all diagnosed")


@app.command()
def unseal(
    folder: Folder,
    partial: Annotated[bool, typer.Option(help="Only what is diagnosed so far.")] = False,
    key: Key = None,
) -> None:
    """Check the answers against their seals and open them, once all cases are diagnosed."""
    answers = seal.unseal(folder, seal.read_key(_key_path(folder, key)), partial=partial)
    _say(f"{len(answers)} answers are those that were sealed; opened into {seal.UNSEALED}")


@app.command()
def score(
    folder: Folder,
    report: Annotated[Path | None, typer.Option(metavar="FILE", help="Write a page.")] = None,
    oracle: Annotated[bool, typer.Option(help="Compute D and the oracle.")] = True,
) -> None:
    """Score the diagnoses against the open answers, into ``scores.json``."""
    scores = _scored(folder, oracle)
    for t in scores["targets"]:
        value = "no cases" if t["value"] is None else f"{t['value']:.3f}"
        if t["value"] is not None:
            value += f" ({t['low']:.3f} to {t['high']:.3f})"
        sign = "at least" if t["at_least"] else "at most"
        typer.echo(f"{t['what']}: {value}; asked {sign} {t['asked']:g}: {t['outcome']}")
    if report is not None:
        from benchmarks.blind.page import page

        write_text(report, page(scores, seal.read_json(folder / seal.SEALED)))


@app.command()
def misses(folder: Folder) -> None:
    """The cases that were wrong, as Markdown, from what `score` wrote."""
    from benchmarks.blind.misses import told

    typer.echo(told(folder))


def _scored(folder: Path, oracle: bool) -> dict:
    from benchmarks.blind.score import read_records
    from benchmarks.blind.score import score as score_of
    from benchmarks.blind.targets import targets

    reckon, sealed = None, seal.read_json(folder / seal.SEALED)
    if oracle:
        if sealed.get("world", "first") == "calculix":
            from benchmarks.blind.signatures import Reckoning
        else:
            from benchmarks.blind.reckoning import Reckoning
        reckon = Reckoning(folder, say=_say)
    scores = score_of(read_records(folder, reckon))
    scores["rules_changed"] = sealed["rules_sha256"] != seal.source_digest(*seal.RULES)
    if scores["rules_changed"]:
        _say("The rules of scoring were changed after the answers were sealed.")
    found = targets(scores["summary"], sealed.get("world", "first"))
    scores["targets"] = [t.to_json() for t in found]
    write_text(folder / "scores.json", json_text(scores))
    return scores


@app.command()
def ablate(
    folders: Annotated[list[Path], typer.Argument(help="Opened checks, unpacked.")],
    out: Annotated[Path, typer.Option(metavar="FILE", help="Results, which go on where they are.")],
    keep: Annotated[Path, typer.Option(metavar="FOLDER", help="Of the models that are kept.")],
    cases: Annotated[int, typer.Option(min=1, help="How many of each geometry.")] = 8,
    geometry: Annotated[str, typer.Option(help="Which, with commas.")] = "t_tubes,flanged_pipe",
) -> None:
    """What each mechanism of the diagnosis is worth, on opened cases, as Markdown."""
    from benchmarks.blind.ablation import ablate as run
    from benchmarks.blind.ablation import table

    typer.echo(
        table(run(folders, keep, out, cases=cases, geometries=geometry.split(","), say=_say))
    )


@app.command()
def small(
    cases: Annotated[int, typer.Option(min=1, help="How many.")] = 3,
    world: World = "first",
    jobs: Jobs = 2,
    keep: Annotated[Path | None, typer.Option(help="Folder to keep it in.")] = None,
) -> None:
    """All steps on a handful of cases, for the tests."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = (keep or Path(scratch)) / "small"
        generate(folder, cases=cases, seed=1, world=world, jobs=jobs)
        diagnose(folder, jobs=jobs)
        unseal(folder)
        score(folder, report=folder / "report.html", oracle=False)


def _say(text: str) -> None:
    typer.echo(text, err=True)


def main() -> None:
    """Run the command; what is wrong is said without a traceback."""
    try:
        app(prog_name="python3 -m benchmarks.blind")
    except JointsError as error:
        typer.echo(f"Error: {error}", err=True)
        sys.exit(1)


if __name__ == "__main__":
    main()
