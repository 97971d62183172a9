"""Documents as HTML: one page each that holds its own style and pictures and needs nothing else."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import jinja2
from markupsafe import Markup

import fenics_joints
from fenics_joints.report.document import Document, OnPage, OnTerminal, View

#: Templates, and what draws a view, in this order.
TEMPLATES = Path(__file__).parent / "templates"
_SCRIPTS = ("viewer_shapes.js", "viewer.js")


def as_page(document: Document) -> str:
    """A document as a page; empty on ranks that make none. Collective where its pictures are."""
    blocks = _on_page(document.blocks)
    if blocks is None:
        return ""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    script, policy = _script()
    return environment.get_template("document.html").render(
        document=document,
        blocks=blocks,
        view=any(isinstance(b, View) and b.view for b in blocks),
        version=fenics_joints.__version__,
        script=script,
        policy=policy,
    )


def _on_page(blocks: Sequence[object]) -> list[object] | None:
    """The blocks of a page, those made that are made for it; None on ranks that make none."""
    found, missing = [], False
    for block in blocks:
        if isinstance(block, OnPage):
            made = block.blocks() if callable(block.blocks) else block.blocks
            missing |= made is None
            found += made or []
        elif not isinstance(block, OnTerminal):
            found.append(block)
    return None if missing else found


@cache
def _script() -> tuple[Markup, str]:
    """The script of pages with a view, and the one policy that lets nothing else run."""
    text = "".join((TEMPLATES / name).read_text("utf-8") for name in _SCRIPTS)
    key = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
    return Markup(text), f"script-src 'sha256-{key}'"
