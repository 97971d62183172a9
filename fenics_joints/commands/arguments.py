"""Arguments and options that several commands have."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fenics_joints.progress import loudness


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
JsonOption = Annotated[Path | None, file_option("--json", "Write the results as JSON.")]
ReportOption = Annotated[Path | None, file_option("--report", "Write a page of HTML.")]
_FIELDS = "Write fields (of modes, all elastic shapes) for ParaView: .bp, or .xdmf."
VtxOption = Annotated[Path | None, file_option("--vtx", _FIELDS)]
LargeOption = Annotated[
    bool,
    typer.Option("--large", help="Go on where the model seems too large for the memory there is."),
]
DebugOption = Annotated[bool, typer.Option("--debug", help="Show Python's traceback of an error.")]
