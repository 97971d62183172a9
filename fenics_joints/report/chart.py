"""Charts of curves to zoom and to read values from, in a page that needs nothing else.

`curve_chart` puts the numbers into the page; ``templates/chart.js`` draws them by Chart.js, which
is in ``templates/charts``. A page without scripts, or on paper, has a picture of the same curves.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.ticker import NullFormatter

from fenics_joints.report.document import Figure, View
from fenics_joints.report.panels import panel_chart
from fenics_joints.report.style import INK, PAGE
from fenics_joints.report.view import json_markup


@dataclass(frozen=True, repr=False)
class Curve:
    """Points of a chart in their order, joined by a line or not.

    Attributes:
        name: In the legend; curves of one name are shown and hidden together.
        x: Values along the horizontal axis, (n,).
        y: Along the vertical one, (n,); nan leaves a break.
        colour: Of CSS; that of the text by default.
        width: Of the line, points; 0 for none.
        dash: Lengths of dashes and breaks in widths of the line; none for a whole one.
        mark: Marks of the points, as matplotlib names them: ``o``, ``x``, ``s``; none by default.
        panel: Which of the chart's panels shows it.
    """

    name: str
    x: np.ndarray
    y: np.ndarray
    colour: str = INK
    width: float = 1.6
    dash: Sequence[float] = ()
    mark: str = ""
    panel: int = 0


#: Marks by the names of Chart.js.
_MARKS = {"": False, "o": "circle", "x": "crossRot", "s": "rect", "|": "line"}


def curve_chart(
    curves: Sequence[Curve],
    xlabel: str,
    panels: Sequence[str],
    alt: str,
    *,
    caption: str = "",
    file: str = "chart",
    log: tuple[bool, bool] = (False, False),
    size: tuple[float, float] = (7.6, 4.2),
    columns: int = 2,
) -> View:
    """A chart for a page, with a picture in its place on paper.

    Args:
        curves: What it shows.
        xlabel: Of the horizontal axis, with its unit.
        panels: Of the vertical axis, with its unit; if there are several, the page shows one of
            them at a time, and the picture all.
        alt: What it shows, in words.
        caption: Below it.
        file: Name of the files that its reader saves, without their ends.
        log: Which axes are logarithmic at first.
        size: Width of the picture and height of a row of panels, inches.
        columns: Of panels in the picture.
    """
    axes: dict[str, int] = {}
    rows = []
    for c in curves:
        look = {"width": c.width, "dash": [c.width * d for d in c.dash], "mark": _MARKS[c.mark]}
        colour = PAGE.get(c.colour, c.colour)
        x = axes.setdefault(_base64(c.x), len(axes))
        rows.append({"name": c.name, "x": x, "y": _base64(c.y), "colour": colour, **look})
        rows[-1]["panel"] = c.panel
    content = {
        "alt": alt,
        "file": file,
        "xlabel": xlabel,
        "panels": list(panels),
        "log": list(log),
        "axes": list(axes),
        "curves": rows,
    }

    def picture() -> str:
        return panel_chart(
            range(len(panels)),
            lambda panel, k: _draw(panel, [c for c in curves if c.panel == k], panels[k], log),
            file,
            alt,
            columns=columns,
            width=size[0],
            height=size[1],
            xlabel=xlabel,
        )

    return View(json_markup(content), [Figure(picture, caption)], kind="chart")


def _draw(axes, curves: Sequence[Curve], label: str, log: tuple[bool, bool]) -> None:
    for c in curves:
        style = (0, tuple(c.dash)) if c.dash else "-"
        line = {"color": c.colour, "lw": c.width, "ls": style if c.width else "none"}
        axes.plot(c.x, c.y, marker=c.mark or None, ms=4, label=c.name, **line)
    if log[0]:
        axes.set_xscale("log")
    if log[1]:
        axes.set_yscale("log")
        axes.yaxis.set_minor_formatter(NullFormatter())
    else:
        axes.ticklabel_format(axis="y", useOffset=False)
    axes.set_title(label, loc="left")


def _base64(values: np.ndarray) -> str:
    """Numbers as 64 bit, so that a reader saves what was computed."""
    numbers = np.ascontiguousarray(np.asarray(values, dtype=float).astype("<f8"))
    return base64.b64encode(numbers.tobytes()).decode("ascii")
