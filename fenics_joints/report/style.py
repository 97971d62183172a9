"""The style of charts, and their SVG for a page.

Text and axes take their colours from the page (CSS variables), so that a chart reads on a light and
on a dark page; only cells of a mesh are rasterised.
"""

from __future__ import annotations

import html
import io
import re
from collections.abc import Iterator
from contextlib import contextmanager

import matplotlib
import numpy as np
from cycler import cycler
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter

#: Colours that the page replaces by its own, and those that suit light and dark pages alike.
INK, _MUTED, _LINE, PAPER = "#1b2027", "#5b6470", "#d3d8de", "#fdfdfc"
_BLUE, _GREEN = "#0072b2", "#009e73"
#: Variables of the page by the colours that they take the place of.
PAGE = {
    INK: "--ink",
    _MUTED: "--muted",
    _LINE: "--line",
    PAPER: "--paper",
    _BLUE: "--blue",
    _GREEN: "--green",
}
CHOSEN, NOMINAL, PLACEBO, NOISE = "#2b7bba", "#8d949e", "#d9822b", "#4d9a6a"

#: Colours one after the other that all kinds of colour vision tell apart (Okabe and Ito 2008).
SERIES = (_BLUE, "#e69f00", _GREEN, "#cc79a7", "#56b4e9", "#d55e00")

_STYLE = {
    "text.parse_math": False,  # names are text, even with dollar signs
    "axes.prop_cycle": cycler(color=SERIES),
    "font.size": 9.5,
    "font.family": "sans-serif",
    "svg.fonttype": "none",
    "svg.hashsalt": "fenics_joints",
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": _MUTED,
    "axes.facecolor": "none",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 10,
    "axes.grid": False,
    "grid.color": _LINE,
    "grid.linewidth": 0.7,
    "xtick.color": _MUTED,
    "ytick.color": _MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "legend.frameon": False,
    "legend.labelcolor": INK,
    "axes.unicode_minus": False,
}
#: Pixels of a point below which a phone scrolls a chart instead of making it smaller.
_LEGIBLE = 1.1
_NO_METADATA = {"Date": None, "Creator": None, "Format": None, "Type": None}


@contextmanager
def drawing(width: float, height: float) -> Iterator[Figure]:
    """A transparent figure, inches, laid out so that nothing is cut off, to draw on in `style`."""
    with style():
        figure = Figure(figsize=(width, height), layout="constrained", facecolor="none")
        FigureCanvasAgg(figure)
        yield figure


def grid(figure: Figure, n: int, columns: int, xlabel: str | None = None) -> np.ndarray:
    """Panels in rows, (n,).

    Args:
        figure: Where.
        n: How many.
        columns: In each row; what the last one has beyond ``n`` is left empty.
        xlabel: Of the axis that all of them share, below the lowest of each column; None where
            each has its own.
    """
    shared = xlabel is not None
    panels = figure.subplots(-(-n // columns), columns, sharex=shared, squeeze=False).ravel()
    for panel in panels[n:]:
        panel.set_visible(False)
    for panel in panels[max(n - columns, 0) : n] if shared else ():
        panel.set_xlabel(xlabel)
        panel.tick_params(labelbottom=True)
    return panels[:n]


def style():
    """Context in which charts are drawn and saved."""
    return matplotlib.rc_context(_STYLE)


def to_svg(figure: Figure, name: str, alt: str, dpi: int = 150) -> str:
    """The figure as an ``<svg>`` element to put into a page.

    Args:
        figure: The figure.
        name: Unique in the page; prefix of the element's ids.
        alt: What the picture shows, in words.
        dpi: Resolution of its rasterised parts.
    """
    stream = io.StringIO()
    with style(), matplotlib.rc_context({"text.parse_math": True}):
        for axis in (axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)):
            powers = isinstance(axis.get_major_formatter(), LogFormatter)  # else names or numbers
            for label in axis.get_ticklabels(which="both"):
                label.set_parse_math(powers)
        figure.savefig(stream, format="svg", dpi=dpi, transparent=True, metadata=_NO_METADATA)
    text = stream.getvalue()
    text = text[text.index("<svg") :].strip()
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = _unique_ids(text, name)
    for colour, variable in PAGE.items():
        text = text.replace(colour, f"var({variable}, {colour})")
    # The page's own font; matplotlib's list would ask for what the reader may not have.
    text = re.sub(r"font-family: [^;\"]*", "font-family: inherit", text)
    label, least = html.escape(alt, quote=True), _LEGIBLE * 72 * figure.get_figwidth()
    named = f'<svg role="img" aria-label="{label}" style="--least: {least:.0f}px" '
    return re.sub(r"^<svg ", lambda _: named, text, count=1)


def _unique_ids(text: str, name: str) -> str:
    """Drop ids that nothing refers to, and prefix the others: a page holds several pictures."""
    used = set(re.findall(r'(?:url\(#|href="#)([^)"]+)', text))

    def rename(match: re.Match) -> str:
        return f' id="{name}-{match[1]}"' if match[1] in used else ""

    text = re.sub(r' id="([^"]+)"', rename, text)
    return re.sub(r'(url\(#|href="#)', rf"\g<1>{name}-", text)
