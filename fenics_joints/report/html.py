"""Reports as HTML: one page each that holds its own style and pictures and needs nothing else."""

from __future__ import annotations

import base64
import hashlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import MappingProxyType

import jinja2
import numpy as np
from markupsafe import Markup

import fenics_joints
from fenics_joints import formatting
from fenics_joints.formatting import spaced
from fenics_joints.measurements.gap import Gap
from fenics_joints.report.document import Document, OnPage, OnTerminal, View
from fenics_joints.report.mesh_pictures import diverging

#: What draws a view, in this order.
_SCRIPTS = ("viewer_shapes.js", "viewer.js")


def _environment(filters: Mapping[str, Callable]) -> jinja2.Environment:
    env = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent / "templates"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    env.globals["version"] = fenics_joints.__version__
    env.globals["script"], env.globals["policy"] = _script()
    public = (name for name in vars(formatting) if not name.startswith("_"))
    env.filters.update({name: getattr(formatting, name) for name in public}, **filters)
    return env


@cache
def _script() -> tuple[Markup, str]:
    """The script of pages with a view, and the one policy that lets nothing else run."""
    folder = Path(__file__).parent / "templates"
    text = "".join((folder / name).read_text("utf-8") for name in _SCRIPTS)
    key = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
    return Markup(text), f"script-src 'sha256-{key}'"


def render(template: str, filters: Mapping[str, Callable] = MappingProxyType({}), **values) -> str:
    """A page from one of the templates.

    Args:
        template: File in ``templates``.
        filters: Filters of this page, beside those of all.
        values: What the template shows; ``view``, a `view.scene`, brings the script that draws it.
    """
    return _environment(filters).get_template(template).render(**values)


def as_page(document: Document) -> str:
    """A document as a page; empty on ranks that make none. Collective where its pictures are."""
    blocks = _on_page(document.blocks)
    if blocks is None:
        return ""
    view = any(isinstance(b, View) and b.view for b in blocks)
    return render("document.html", document=document, blocks=blocks, view=view)


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


def noted(page: str, notes: Sequence[str]) -> str:
    """A page with what is unusual in its case under its heading."""
    if not notes:
        return page
    box = Markup('</header>\n<div class="doubts" id="unusual"><strong>Unusual in the case</strong>')
    lines = Markup("").join(Markup("<li>{}</li>").format(note) for note in notes)
    return page.replace("</header>", f"{box}<ul>{lines}</ul></div>", 1)


# -- shared parts ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class HeatCell:
    """A cell of a heat map: its text, and its colours as CSS."""

    text: str
    style: str


def heat_map(gap: Gap, largest: float | None = None) -> list[list[HeatCell]]:
    """Relative errors as coloured cells, shape (n, m).

    Args:
        gap: The gap.
        largest: Relative error that gets the full colour; by default its own largest.
    """
    largest = _largest(gap) if largest is None else largest
    return [[_heat_cell(e, largest) for e in row] for row in np.atleast_2d(gap.relative)]


def _heat_cell(error: float, largest: float) -> HeatCell:
    if not np.isfinite(error):
        return HeatCell(formatting.MISSING, "")
    # A square root, so that errors of a tenth of the largest still show.
    strength = math.copysign(math.sqrt(min(abs(error) / largest, 1.0)), error) if largest else 0.0
    colour = diverging(0.5 + 0.5 * 0.9 * strength)[:3]
    background = "#" + "".join(f"{round(255 * c):02x}" for c in colour)
    style = f"background:{background};color:{ink_on(colour)}"
    return HeatCell(formatting.percent(error, 1, sign=True), style)


def ink_on(colour: Sequence[float]) -> str:
    """White or dark, whichever is told better from a colour from 0 to 1 (WCAG 2.1)."""
    return "#ffffff" if _luminance(colour) < 0.179 else "#000000"


def mac_cells(values: np.ndarray) -> list[list[HeatCell]]:
    """Values of the modal assurance criterion as coloured cells."""
    return [[_mac_cell(float(v)) for v in row] for row in values]


def _mac_cell(value: float) -> HeatCell:
    share = min(max(value, 0.0), 1.0)
    # White to the accent's blue; ink by contrast.
    white, blue = np.array([247, 249, 250]), np.array([31, 95, 150])
    colour = white + share * (blue - white)
    background = "#" + "".join(f"{round(c):02x}" for c in colour)
    return HeatCell(f"{value:.2f}", f"background:{background};color:{ink_on(colour / 255)}")


def _luminance(colour: Sequence[float]) -> float:
    """Relative luminance of an sRGB colour (WCAG 2.1)."""
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in colour]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def _largest(*gaps: Gap) -> float:
    """Largest error of several gaps: the common scale of their heat maps."""
    return max(float(np.nanmax(np.abs(g.relative), initial=0.0)) for g in gaps)


def heat_pair(before: Gap, after: Gap, names: tuple[str, str]) -> list[dict]:
    """Two gaps with their names and cells, on one scale of colours."""
    largest = _largest(before, after)
    return [
        {"name": name, "gap": gap, "cells": heat_map(gap, largest)}
        for name, gap in zip(names, (before, after), strict=True)
    ]


def svg(text: str) -> Markup:
    """A picture of `to_svg`, which escapes what it is given."""
    return Markup(text)


#: Facts on the model, in words.
_FACTS = {
    "dofs": "degrees of freedom of the finite-element model",
    "basis": "vectors of the reduced model's basis",
    "samples": "parameter sets the basis was made from",
    "frequency_error": "largest frequency error of the reduced model against the full one",
    "solutions": "eigenproblems solved",
    "seconds": "seconds that the diagnosis took",
    "reduced_solutions": "eigenproblems of the reduced model solved",
    "not_converged": "conditions at which the identification did not converge, left out",
    "mesh_error": "error of the mesh alone, by the same mesh one degree higher, taken off",
    "crossing_modes": "modes of the test that change places in the model (followed by MAC)",
}


def facts(model: Mapping[str, object]) -> list[tuple[str, str]]:
    """Facts on a model for the page: names in words, and values."""
    return [(_FACTS.get(key, spaced(key)), _fact(key, value)) for key, value in model.items()]


def _fact(key: str, value) -> str:
    if key == "frequency_error":
        return formatting.percent(float(value), 4)
    if isinstance(value, list):
        return ", ".join(value) or "none"
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {formatting.percent(x)}" for name, x in value.items()) or "none"
    if isinstance(value, bool) or not isinstance(value, int | float | np.number):
        return str(value)
    if key == "seconds":
        return f"{value:.1f}"
    whole = float(value).is_integer()
    return f"{int(value):,}".replace(",", "\N{NO-BREAK SPACE}") if whole else f"{value:.4g}"
