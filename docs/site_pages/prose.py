"""Docstrings as Sphinx wants them: `name` is code, as everywhere in this project."""

from __future__ import annotations

import inspect
import re
from typing import get_type_hints

from sphinx.application import Sphinx
from sphinx.util.inspect import stringify_signature


def setup(app: Sphinx) -> None:
    """Before napoleon reads the sections."""
    app.connect("autodoc-process-docstring", _code, priority=100)
    app.connect("autodoc-process-signature", _signature)


def _signature(app, what, name, obj, options, signature, returned):
    """Types without checks; ``...`` for defaults that are no Python, with which no type is a link.

    With a check, a length is ``Annotated[float, ...]`` over several lines.
    """
    if "Annotated[" in (signature or ""):
        hints, own = get_type_hints(obj), inspect.signature(obj)
        plain = [
            p.replace(annotation=hints.get(p.name, p.annotation)) for p in own.parameters.values()
        ]
        signature = stringify_signature(
            own.replace(parameters=plain), show_return_annotation=False, unqualified_typehints=True
        )
    return re.sub(r"<[^<>]*>", "...", signature or "") or signature, returned


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
