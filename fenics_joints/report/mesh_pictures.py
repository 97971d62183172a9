"""Pictures of a mesh: what its cells say in an exploded view, and how a mode moves it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import Normalize

from fenics_joints.report import geometry
from fenics_joints.report.style import drawing, to_svg

if TYPE_CHECKING:
    from fenics_joints.diagnosis.where.localise import CellMap

__all__ = ["cell_bar", "cell_map", "cells_alt", "diverging", "mode_shape"]

#: Red to blue through near white, which all kinds of colour vision tell apart.
diverging = colormaps["RdBu_r"]


def cell_map(cells: CellMap) -> str:
    """The structure taken apart, seen along its thinnest direction, cells coloured by density.

    Pieces that lie above one another (a plate, a layer, a plate) get a panel each, the highest
    first. Within a column of cells the strongest is on top.

    Raises:
        InputError: If cells have a shape that the suite does not use.
    """
    x = 1e3 * np.asarray(cells.vertices, dtype=float)
    extent = np.ptp(x.reshape(-1, 3), axis=0)
    up = int(np.argmin(extent))
    across, along = sorted((a for a in range(3) if a != up), key=lambda a: extent[a])
    plane = x[:, :, [along, across]]
    pieces = geometry.pieces_of(geometry.vertex_ids(x), cells.region)
    levels = geometry.levels_of(x[:, :, up], pieces)
    norm = Normalize(-1, 1)
    width = 7.6
    height = (width - 1.2) * max(extent[across] / max(extent[along], 1e-9), 0.06)
    with drawing(width, min((height + 0.3) * len(levels), 8.0) + 0.95) as figure:
        panels = figure.subplots(len(levels), 1, sharex=True, sharey=True, squeeze=False).ravel()
        for panel, members in zip(panels, levels, strict=True):
            _level(panel, plane[members], cells, members, norm)
            heights = x[members][:, :, up]
            title = ", ".join(cells.regions[r] for r in np.unique(cells.region[members]))
            span = f"{'xyz'[up]} = {heights.min():.3g} to {heights.max():.3g} mm"
            panel.set_title(f"{title} ({span})", loc="left")
            panel.set_aspect("equal")
            panel.autoscale_view()
            panel.spines[:].set_visible(False)
            panel.tick_params(length=2)
            panel.set_ylabel(f"{'xyz'[across]}, mm")
        panels[-1].set_xlabel(f"{'xyz'[along]}, mm")
        cell_bar(figure, panels, norm)
        return to_svg(figure, "cells", cells_alt(cells))


def _level(panel, plane, cells, members, norm) -> None:
    faces = geometry.face_corners(cells.vertices)
    order = np.argsort(np.abs(cells.density[members]), kind="stable")
    polygons, owner = geometry.flat_polygons(plane[order], faces)
    colours = diverging(norm(cells.density[members][order][owner]))
    panel.add_collection(
        PolyCollection(polygons, facecolors=colours, edgecolors=colours, lw=0.4, rasterized=True)
    )
    if faces.shape[1] == 4:
        for r in np.unique(cells.region[members]):
            flat, _ = geometry.flat_polygons(plane[cells.region[members] == r], faces)
            flat, ids = geometry.flat_ids(flat)
            lines = geometry.outline(ids, flat)
            panel.add_collection(LineCollection(lines, colors="#20252b", lw=0.8))


def cell_bar(figure, axes, norm: Normalize) -> None:
    """What colours of cells mean."""
    bar = figure.colorbar(
        ScalarMappable(norm, diverging), ax=axes, location="bottom", aspect=45, shrink=0.85
    )
    bar.set_ticks([-1, -0.5, 0, 0.5, 1], labels=["-1", "-0.5", "0", "0.5", "1"])
    bar.set_label("blue: stiffer here closes the gap   |   red: softer here closes the gap")
    bar.outline.set_visible(False)


def cells_alt(cells: CellMap) -> str:
    """A map of cells in words."""
    words = []
    for r, name in enumerate(cells.regions):
        density = cells.density[cells.region == r]
        if len(density):
            words.append(f"{name} {density.min():.2f} to {density.max():.2f}")
    return (
        "Structure taken apart. Colour from -1, where stiffer closes the gap, "
        "to 1, where softer does. By region: " + "; ".join(words) + "."
    )


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
