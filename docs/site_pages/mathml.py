"""Formulas as MathML, by docutils: browsers draw it without a script or a font from elsewhere."""

from __future__ import annotations

import re

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx


def setup(app: Sphinx) -> None:
    """Make it a renderer of Sphinx's."""
    app.add_html_math_renderer("mathml", (_inline, _nothing), (_display, _nothing))
    app.config.html_math_renderer = "mathml"


def _inline(writer, node) -> None:
    writer.body.append(f'<span class="math">{_drawn(node.astext(), False)}</span>')
    _skip()


def _display(writer, node) -> None:
    writer.body.append(f'<div class="math">{_drawn(node.astext(), True)}</div>')
    _skip()


def _drawn(text: str, block: bool) -> str:
    """MathML of a formula; Greek letters upright, since few fonts have slanted ones."""
    found = tex2mathml(text, as_block=block)
    return re.sub(r"<mi>([^\x00-\x7f])</mi>", r'<mi mathvariant="normal">\1</mi>', found)


def _skip() -> None:
    raise nodes.SkipNode


def _nothing(writer, node) -> None:
    return None
