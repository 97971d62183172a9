"""The map of where the gap lies, of lapped beams from the side."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.patches import Rectangle

from fenics_joints.report.patch_pictures import (
    OUTLINES,
    colours_of,
    patch_bar,
    patch_legend,
    patches_alt,
)
from fenics_joints.report.style import drawing, to_svg

if TYPE_CHECKING:
    from fenics_joints.diagnosis.where.patches import PatchMap


#: Rows of the picture, from below: beams under the interface, joint elements, beams above. Where
#: each starts, and the height of the highest there.
_BELOW, _JOINT, _ABOVE = (0.0, 1.0), (1.35, 0.5), (2.2, 1.0)
#: Size of the picture, inches.
_SIZE = (7.6, 2.5)
_NAMES = "#14181d"
#: Share of the whole length that a patch needs for its number.
_ROOM = 0.022


def _boxes(vertices: np.ndarray) -> np.ndarray:
    """Corners (n, 4, 2) of the cells in the picture: x in mm, and their row."""
    x, z = vertices[:, :, 0], vertices[:, :, 2]
    low, high = z.min(axis=1), z.max(axis=1)
    size = np.max(high - low)
    joint = (low < 0) & (high > 0)
    rows = np.where(joint, 1, np.where(low + high > 0, 2, 0))
    start = np.array([_BELOW[0], _JOINT[0], _ABOVE[0]])[rows]
    tall = np.where(joint, _JOINT[1], (high - low) / size)
    # Beams below hang from the line where their row ends.
    start = np.where(rows == 0, _BELOW[0] + _BELOW[1] - tall, start)
    a, b = 1e3 * x.min(axis=1), 1e3 * x.max(axis=1)
    corners = [(a, start), (b, start), (b, start + tall), (a, start + tall)]
    return np.stack([np.stack(c, axis=-1) for c in corners], axis=1)


def _frame(axes, boxes: np.ndarray) -> None:
    span = np.ptp(boxes[:, :, 0])
    axes.set_xlim(boxes[:, :, 0].min() - 0.01 * span, boxes[:, :, 0].max() + 0.01 * span)
    axes.set_ylim(-0.12, _ABOVE[0] + _ABOVE[1] + 0.12)
    axes.spines[["left", "right", "top"]].set_visible(False)
    axes.set_xlabel("x, mm (heights not to scale, beams and laps apart)")
    axes.tick_params(length=2)
    rows = ((_ABOVE, "above"), (_JOINT, "lap"), (_BELOW, "below"))
    shown = [
        (low + high / 2, name)
        for (low, high), name in rows
        if np.any(np.isclose(boxes[:, :, 1], low + high))
    ]
    axes.set_yticks([y for y, _ in shown], [name for _, name in shown])
    axes.tick_params(axis="y", length=0)


def beam_patches(cells: PatchMap, name: str = "patches") -> str:
    """Beams and laps apart, patches coloured by what they explain; see `patch_pictures.patch_map`.

    Args:
        cells: The patches; on rank 0, where they have their cells.
        name: Unique in the page.
    """
    boxes = _boxes(np.asarray(cells.vertices, dtype=float))
    norm, by_patch = colours_of(cells)
    colours = by_patch[cells.patch]
    bolts = 1e3 * cells.bolts[:, 0]
    with drawing(*_SIZE) as figure:
        axes = figure.subplots()
        axes.add_collection(PolyCollection(boxes, facecolors=colours, edgecolors=colours, lw=0.3))
        for p, test in enumerate(cells.tests):
            own = boxes[cells.patch == p]
            (x0, y0), (x1, y1) = own.min(axis=(0, 1)), own.max(axis=(0, 1))
            rank = int(cells.significant[p]) + int(cells.sufficient[p])
            line = {"ec": OUTLINES[rank]["colors"], "lw": OUTLINES[rank]["lw"], "fill": False}
            axes.add_patch(Rectangle((x0, y0), x1 - x0, y1 - y0, zorder=3 + rank, **line))
            if x1 - x0 > _ROOM * np.ptp(boxes[:, :, 0]) or y0 == _JOINT[0]:
                dark = cells.share[p] > 0.6 * norm.vmax
                look = {"ha": "center", "va": "center", "fontsize": 6.5, "zorder": 7}
                number, ink = test.zone.rpartition(" ")[2], "#ffffff" if dark else _NAMES
                axes.text((x0 + x1) / 2, (y0 + y1) / 2, number, color=ink, **look)
        _frame(axes, boxes)
        gaps = [(_BELOW[1], _JOINT[0]), (sum(_JOINT), _ABOVE[0])]
        for x in bolts:
            for ends in [(-0.1, 0.15), *gaps, (sum(_ABOVE) - 0.15, sum(_ABOVE) + 0.1)]:
                axes.plot([x, x], ends, ls=(0, (3, 2)), lw=1.1, color=_NAMES, zorder=6)
        patch_bar(figure, axes, norm)
        patch_legend(figure, cells, bolt={"ls": (0, (4, 3))})
        return to_svg(figure, name, patches_alt(cells))
