"""Docstrings as Sphinx wants them: `name` is code, as everywhere in this project."""

from __future__ import annotations

import re

from sphinx.application import Sphinx


def setup(app: Sphinx) -> None:
    """Before napoleon reads the sections."""
    app.connect("autodoc-process-docstring", _code, priority=100)


def _code(app, what, name, obj, options, lines: list[str]) -> None:
    """Single backquotes to double ones; stars and bars that are no markup, escaped."""
    lines[:] = [_line(line) for line in lines]


def _line(line: str) -> str:
    parts = re.split(r"(``[^`]+``|`[^`]+`)", line)
    for i, part in enumerate(parts):
        if part.startswith("``"):
            continue
        if part.startswith("`"):
            parts[i] = f"`{part}`"
        else:
            parts[i] = re.sub(r"(?<!\\)([*|])", r"\\\1", part)
            parts[i] = re.sub(r"(\w)_(?=\W|$)", r"\1\\_", parts[i])
    return "".join(parts)
