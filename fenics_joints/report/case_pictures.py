"""A structure before anything is solved: its parts in colours, and what stands on it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np
from matplotlib import colormaps
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke

from fenics_joints.report import geometry
from fenics_joints.report.mesh_pictures import bare, draw_arrows, draw_faces
from fenics_joints.report.style import INK, PAPER, drawing, to_svg

#: Marker, colour and words of each kind of place.
MARKS = {
    "sensor": ("o", "#1f4e9c", "sensor"),
    "force": ("v", "#b3261e", "force"),
    "mass": ("s", "#4a4f57", "mass"),
    "spring": ("d", "#3f7d4e", "spring"),
    "attached": ("s", "#b8860b", "attached"),
    "bolt": ("+", "#14181d", "bolt"),
    "obstacle": ("^", "#7b3f9d", "obstacle"),
    "displacement": (">", "#00798c", "displacement"),
    "load": ("P", "#d2601a", "load"),
}
_PALE = colormaps["Pastel1"]
#: Length of an arrow relative to the structure, most names in a legend, most that are numbered.
_ARROW, _NAMED, _NUMBERED = 0.07, 12, 40


class Placed(Protocol):
    """Something at a point, m, that may look in a direction."""

    name: str
    point: tuple[float, ...]
    direction: tuple[float, ...] | None


def structure_picture(
    vertices: np.ndarray,
    group: np.ndarray,
    names: Sequence[str],
    places: Mapping[str, Sequence[Placed]],
    *,
    below: bool = False,
) -> str:
    """The parts of a structure in an oblique view, with sensors, forces, masses and bolts.

    What is behind the structure shows through, paler.

    Args:
        vertices: Corner coordinates of every cell, m, shape (n_cells, n_corners, 3).
        group: Which part each cell is of, shape (n_cells,).
        names: Names of the parts.
        places: What stands where, by its kind, a key of the legend.
        below: Whether it is seen from below and behind instead.
    """
    turned = np.array([1.0, -1.0, -1.0]) if below else np.ones(3)
    number = np.broadcast_to(group[:, None, None], vertices.shape).astype(float)
    faces, own = geometry.outer_faces(np.asarray(vertices, dtype=float) * turned, number)
    flat, depth = geometry.oblique(faces)
    order = np.argsort(depth)
    colours = _PALE(own[order, 0, 0].astype(int) % _PALE.N)
    size = float(np.ptp(vertices.reshape(-1, 3), axis=0).max())
    with drawing(7.6, 3.9) as figure:
        axes = figure.subplots()
        draw_faces(axes, flat[order], colours, "#7a808a")
        for kind, found in places.items():
            _draw(axes, kind, found, turned, size)
        bare(axes, 0.05)
        _legend(figure, names, [kind for kind, found in places.items() if found])
        side = "below" if below else "above"
        return to_svg(figure, f"structure-{side}", _alt(names, places, side), dpi=130)


def _draw(axes, kind: str, found: Sequence[Placed], turned: np.ndarray, size: float) -> None:
    if not found:
        return
    marker, colour, _ = MARKS[kind]
    points = np.array([place.point for place in found]) * turned
    start = geometry.oblique_points(points)
    axes.plot(*start.T, marker, color=colour, ms=7 if kind == "bolt" else 3.5, ls="", zorder=5)
    ways = [(i, np.array(p.direction) * turned) for i, p in enumerate(found) if p.direction]
    if ways:
        at = np.array([i for i, _ in ways])
        units = np.array([way / np.linalg.norm(way) for _, way in ways])
        along = geometry.oblique_points(points[at] + _ARROW * size * units) - start[at]
        draw_arrows(axes, start[at], along, colour, 0.0025, 4)
    if kind in ("sensor", "bolt") and len(found) <= _NUMBERED:
        halo = [withStroke(linewidth=2.2, foreground=PAPER)]
        look = {"textcoords": "offset points", "fontsize": 6.5, "color": INK, "zorder": 6}
        for place, at in zip(found, start, strict=True):
            name = place.name.removeprefix(f"{kind} ")
            axes.annotate(name, at, (3, 3), path_effects=halo, **look)


def _legend(figure, names: Sequence[str], kinds: Sequence[str]) -> None:
    shown = [Patch(color=_PALE(i % _PALE.N), label=n) for i, n in enumerate(names[:_NAMED])]
    if len(names) > _NAMED:
        shown.append(Patch(color="none", label=f"and {len(names) - _NAMED} more"))
    for kind in kinds:
        marker, colour, words = MARKS[kind]
        shown.append(Line2D([], [], marker=marker, color=colour, ls="", label=words))
    figure.legend(handles=shown, loc="outside right upper", fontsize=8)


def _alt(names, places, side: str) -> str:
    counts = ", ".join(f"{len(found)} of kind {kind}" for kind, found in places.items() if found)
    return f"The structure from {side}: parts {', '.join(names)}; {counts or 'nothing on it'}."
