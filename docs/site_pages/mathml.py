"""Formulas as MathML, by docutils: browsers draw it without a script or a font from elsewhere."""

from __future__ import annotations

from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx


def setup(app: Sphinx) -> None:
    """Make it a renderer of Sphinx's."""
    app.add_html_math_renderer("mathml", (_inline, _nothing), (_display, _nothing))
    app.config.html_math_renderer = "mathml"


def _inline(writer, node) -> None:
    writer.body.append(f'<span class="math">{tex2mathml(node.astext(), as_block=False)}</span>')
    _skip()


def _display(writer, node) -> None:
    writer.body.append(f'<div class="math">{tex2mathml(node.astext(), as_block=True)}</div>')
    _skip()


def _skip() -> None:
    from docutils import nodes

    raise nodes.SkipNode


def _nothing(writer, node) -> None:
    return None
