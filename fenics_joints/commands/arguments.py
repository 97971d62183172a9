"""What stands on the command line, as the commands take it."""

from __future__ import annotations

from pathlib import Path

import typer

__all__ = ["named_path"]


def named_path(text: str | Path) -> Path:
    """The path that an argument names.

    Raises:
        BadParameter: If it is empty: as a path that would be the folder one is in.
    """
    if not str(text).strip():
        raise typer.BadParameter("is empty, expected the name of a file")
    return Path(text)
