"""Documents as HTML: one page each that holds its own style and pictures and needs nothing else."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import jinja2
from markupsafe import Markup

import fenics_joints
from fenics_joints.report.document import Document, OnPage, OnTerminal, Table, View, named_tables

TEMPLATES = Path(__file__).parent / "templates"
#: Scripts of every page, and those of the kinds of views.
_SCRIPTS = {
    "": ("page.js",),
    "view": ("viewer_shapes.js", "viewer_export.js", "viewer.js"),
    "chart": ("charts/chart.umd.min.js", "charts/chartjs-plugin-zoom.min.js", "chart.js"),
}


@dataclass(frozen=True, eq=False)
class DocumentPage:
    """A document with what is made for its page.

    Attributes:
        document: The document.
        blocks: Its blocks on the page; None on ranks that make none.
    """

    document: Document
    blocks: Sequence[object] | None

    def __repr__(self) -> str:
        return f"DocumentPage({self.document.title!r}, {len(self.blocks or ())} blocks)"

    @classmethod
    def of(cls, document: Document) -> DocumentPage:
        """The page of a document. Collective where its pictures are."""
        return cls(document, _on_page(document.blocks))

    def tables(self) -> dict[str, Table]:
        """All tables of the document by the names of their files, without ``.csv``."""
        return named_tables([*(self.blocks or ()), *self.document.blocks])

    def html(self, run: Mapping[str, object] | None = None) -> str:
        """The page as HTML; empty on ranks that make none.

        Args:
            run: What the result comes from, see `fenics_joints.commands.provenance`.
        """
        if self.blocks is None:
            return ""
        script, policy = _script(_kinds(self.blocks))
        return (
            page_environment()
            .get_template("document.html")
            .render(
                document=self.document,
                blocks=self.blocks,
                version=fenics_joints.__version__,
                run=run or {},
                paper=_on_paper(self.document.title, run or {}),
                script=script,
                policy=policy,
                files={table: name for name, table in self.tables().items()},
            )
        )


def page_environment(*folders: Path) -> jinja2.Environment:
    """Jinja's environment of pages: `TEMPLATES` and others before them; all texts are escaped."""
    return jinja2.Environment(
        loader=jinja2.FileSystemLoader([*folders, TEMPLATES]),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )


def _on_paper(title: str, run: Mapping[str, object]) -> str:
    """What stands below each printed page, as a text of CSS in which nothing ends it."""
    words = re.sub(r"[^\w .,:()+-]", " ", f"{title[:60]}, {str(run.get('date', ''))[:10]}")
    return f"{words}, fenics_joints {fenics_joints.__version__}"


def as_page(document: Document) -> str:
    """A document as a page; empty on ranks that make none. Collective where its pictures are."""
    return DocumentPage.of(document).html()


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


def _kinds(blocks: Sequence[object]) -> tuple[str, ...]:
    """Kinds of the views among blocks and inside them."""
    found = {""}
    for block in blocks:
        if isinstance(block, View) and block.view:
            found.add(block.kind)
        found.update(_kinds(getattr(block, "blocks", ())))
    return tuple(kind for kind in _SCRIPTS if kind in found)


@cache
def _script(kinds: tuple[str, ...]) -> tuple[Markup, str]:
    """The script of a page, and the one policy that lets nothing else run."""
    names = [name for kind in kinds for name in _SCRIPTS[kind]]
    text = "\n;".join((TEMPLATES / name).read_text("utf-8") for name in names)
    key = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
    return Markup(text), f"script-src 'sha256-{key}'"
