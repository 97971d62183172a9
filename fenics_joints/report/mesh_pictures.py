"""Pictures of a mesh: how a mode moves it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib import colormaps
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize

from fenics_joints.report import geometry
from fenics_joints.report.style import drawing, to_svg

#: Red to blue through near white, which all kinds of colour vision tell apart.
diverging = colormaps["RdBu_r"]


def mode_shape(
    vertices: np.ndarray, motion: np.ndarray, direction: Sequence[float], name: str, alt: str
) -> str:
    """A mode shape in an oblique view, coloured by the motion along a direction.

    Args:
        vertices: Corner coordinates of every cell, m, shape (n_cells, n_corners, 3).
        motion: Displacement of the corners, any scale, same shape.
        direction: Direction that is coloured; the test's.
        name: Unique in the page.
        alt: What it shows, in words.

    Raises:
        InputError: If cells have a shape that the suite does not use.
    """
    surface, moved = geometry.outer_faces(
        np.asarray(vertices, dtype=float), np.asarray(motion, dtype=float)
    )
    size = np.ptp(surface.reshape(-1, 3), axis=0).max()
    largest = np.linalg.norm(moved, axis=-1).max() or 1.0
    shown = surface + 0.07 * size / largest * moved
    flat, depth = geometry.oblique(shown)
    unit = np.asarray(direction, dtype=float)
    value = (moved @ (unit / np.linalg.norm(unit))).mean(axis=1)
    scale = np.abs(value).max() or 1.0
    order = np.argsort(depth)
    colours = diverging(Normalize(-1, 1)(value[order] / scale))
    with drawing(3.7, 1.75) as figure:
        axes = figure.subplots()
        axes.add_collection(
            PolyCollection(
                flat[order], facecolors=colours, edgecolors="#4a4f57", lw=0.2, rasterized=True
            )
        )
        axes.autoscale_view()
        axes.set_aspect("equal")
        axes.set_axis_off()
        return to_svg(figure, name, alt, dpi=130)
