"""Arguments and options that several commands have."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import click
import typer
from typer.core import TyperOption

from fenics_joints.machine import ranks
from fenics_joints.progress import loudness

#: What `--out` writes, by the format.
FORMATS = ("html", "json", "csv")


def named_path(text: str | Path) -> Path:
    """The path that an argument names.

    Raises:
        BadParameter: If it is empty: as a path that would be the folder one is in.
    """
    if not str(text).strip():
        raise typer.BadParameter("is empty, expected the name of a file")
    return Path(text)


def tell(line: str) -> None:
    """Print a line on standard output, unless the user asked for silence."""
    if loudness() != "quiet":
        typer.echo(line)


def file_option(option: str, words: str, metavar: str = "FILE"):
    """An option that names a file."""
    return typer.Option(option, metavar=metavar, parser=named_path, help=words)


CaseArgument = Annotated[
    Path,
    typer.Argument(
        metavar="CASE", parser=named_path, help="A folder with a case.toml, or the file."
    ),
]
_FIELDS = "Write fields (of modes, all elastic shapes) for ParaView: .bp, or .xdmf."
VtxOption = Annotated[Path | None, file_option("--vtx", _FIELDS)]
DebugOption = Annotated[bool, typer.Option("--debug", help="Show Python's traceback of an error.")]


@dataclass
class CaseOptions:
    """Options of all commands that read a case.

    Attributes:
        json: File of the results.
        report: File of the page.
        out: Folder of page, results and tables.
        formats: Which of `FORMATS` go to ``out``.
        changes: Keys of the case with other values, ``KEY=VALUE``.
        large: Whether a model goes on that seems too large for the machine.
        debug: Whether errors keep Python's traceback.
        ranks: How many processes compute; None for one per core.
    """

    json: Path | None = None
    report: Path | None = None
    out: Path | None = None
    formats: Sequence[str] = FORMATS
    changes: Sequence[str] = ()
    large: bool = False
    debug: bool = False
    ranks: int | None = None

    @classmethod
    def given(cls) -> CaseOptions:
        """Those of the command that is running."""
        return click.get_current_context().meta.setdefault(__name__, cls())

    def outputs(self) -> dict[str, Path | None]:
        """The files to be by the option that names them."""
        return {"--json": self.json, "--report": self.report}


def case_options(name: str | None, params: Sequence[click.Parameter]) -> Iterator[TyperOption]:
    """The options of `CaseOptions` and ``--allow-code``, for a command that reads a case; of them
    ``--ranks`` for the sweep."""
    reads = any(param.name == "case" for param in params)
    if name == "sweep" or (reads and name != "check"):  # the others compute nothing
        yield TyperOption(
            param_decls=["--ranks"],
            expose_value=False,
            callback=_keep,
            type=click.IntRange(min=1),
            metavar="N",
            envvar=ranks.VARIABLE,
            show_envvar=False,
            help=f"Processes that compute; by default one per core, at most {ranks.MOST}, or as "
            f"{ranks.VARIABLE} of the environment says. mpirun and batch systems start their own.",
        )
    if not reads:
        return
    several = f"With --out: {', '.join(FORMATS)}, or some of them with commas; all by default."
    files = {"type": click.types.FuncParamType(named_path)}
    flag = {"is_flag": True, "default": False}
    for name, words, settings in (
        ("json", "Write the results as JSON.", {"metavar": "FILE.json", **files}),
        ("report", "Write a page of HTML.", {"metavar": "FILE.html", **files}),
        ("out", "Write page, JSON and all tables as CSV.", {"metavar": "FOLDER", **files}),
        ("format", several, {"metavar": "NAMES", "type": str}),
        (
            "set",
            "Another value for a key of the case: --set parts.NAME.E='70 GPa'; several times.",
            {"metavar": "KEY=VALUE", "type": str, "multiple": True},
        ),
        ("large", "Go on where the model seems too large for the memory there is.", flag),
        ("debug", "Show Python's traceback of an error.", flag),
        ("allow-code", "Run laws, effects and meshes of modules beside the case.", flag),
    ):
        yield TyperOption(
            param_decls=[f"--{name}"], expose_value=False, callback=_keep, help=words, **settings
        )


def _keep(ctx: click.Context, param: click.Parameter, value):
    given = ctx.meta.setdefault(__name__, CaseOptions())
    if param.name == "allow_code":
        if value:
            from fenics_joints.case.own_code import trust_cases

            trust_cases()
    elif param.name == "format":
        if value is not None:
            given.formats = _formats(value)
    else:
        setattr(given, "changes" if param.name == "set" else str(param.name), value)
    return value


def _formats(text: str) -> list[str]:
    """Formats with commas between them, in the order of `FORMATS`."""
    names = [name.strip().lower() for name in text.split(",")]
    if unknown := [name for name in names if name not in FORMATS]:
        raise typer.BadParameter(f"{unknown[0]!r}: expected {', '.join(FORMATS)}")
    return [name for name in FORMATS if name in names]


def use_cores() -> None:
    """Run the command on the cores of the machine, and end as it did, unless this is a rank."""
    asked = CaseOptions.given().ranks
    number = (asked or min(ranks.cores(), ranks.MOST)) if ranks.may_start() else 1
    if number == 1:
        return
    end = ranks.run_on(number)
    if isinstance(end, int):
        raise typer.Exit(end)
    if loudness() != "quiet":
        typer.echo(f"note: one rank computes, not {number}: {end}", err=True)
