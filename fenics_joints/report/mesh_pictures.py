"""Pictures of a mesh: what its cells say in an exploded view, and how a mode moves it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize, to_rgba
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from scipy.sparse.csgraph import connected_components

from fenics_joints.errors import InputError
from fenics_joints.report.style import new_figure, style, to_svg

if TYPE_CHECKING:
    from fenics_joints.diagnosis.where.localise import CellMap
    from fenics_joints.diagnosis.where.patches import PatchMap

__all__ = [
    "OUTLINES", "UNSEEN", "cell_bar", "cell_map", "cells_alt", "diverging", "mode_shape",
    "patch_bar", "patch_legend", "patch_map", "patches_alt", "rising",
]  # fmt: skip

#: Red to blue through near white, which all kinds of colour vision tell apart.
diverging = colormaps["RdBu_r"]

#: Near white to dark red, ever darker: it reads in grey as well.
rising = LinearSegmentedColormap.from_list(
    "rising", ["#f4f2ee", "#f6c79b", "#dd6b4a", "#7d1128"]
)

#: Corners of each face in DOLFINx's (tensor-product) order.
_FACES = {
    "hexahedron": [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4),
                   (1, 3, 7, 5)],
    "tetrahedron": [(0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)],
    "quadrilateral": [(0, 1, 3, 2)],
    "triangle": [(0, 1, 2)],
}  # fmt: skip
#: Colour of a patch that the test does not see, off the scale of those that it sees.
UNSEEN = "#b9c6d6"
#: Outlines of a patch: of no note, more than chance, and that alone enough.
OUTLINES = (
    {"colors": "#9aa0a8", "lw": 0.5}, {"colors": "#14181d", "lw": 0.9},
    {"colors": "#14181d", "lw": 2.6},
)  # fmt: skip
#: How far the oblique view is turned to the right, and seen from above.
_TURN, _TILT = np.radians(-28.0), np.radians(28.0)
#: More levels than this are no exploded view any more.
_MOST_LEVELS = 6


def _cell_name(vertices: np.ndarray) -> str:
    n = vertices.shape[1]
    if n == 4:
        edges = vertices[:, 1:] - vertices[:, :1]
        volume = np.abs(np.linalg.det(edges)).max()
        return "tetrahedron" if volume > 1e-9 * np.abs(edges).max() ** 3 else "quadrilateral"
    names = {8: "hexahedron", 3: "triangle"}
    if n not in names:
        raise InputError(f"cells with {n} corners: expected 3, 4 or 8.")
    return names[n]


def _faces(vertices: np.ndarray) -> np.ndarray:
    """Corners of all faces of all cells, shape (n_cells, n_faces, n_face_corners), as indices."""
    return np.array(_FACES[_cell_name(vertices)])


def _vertex_ids(vertices: np.ndarray) -> np.ndarray:
    """Number of each corner, equal where corners coincide, shape (n_cells, n_corners)."""
    flat = vertices.reshape(-1, 3)
    size = np.ptp(flat, axis=0).max() or 1.0
    _, ids = np.unique(np.round(flat / size * 1e7).astype(np.int64), axis=0, return_inverse=True)
    return ids.reshape(vertices.shape[:2])


def _pieces(ids: np.ndarray, region: np.ndarray) -> np.ndarray:
    """Number of the connected piece of one region that each cell belongs to, shape (n_cells,)."""
    piece = np.empty(len(ids), dtype=np.int64)
    n = 0
    for r in np.unique(region):
        cells = np.flatnonzero(region == r)
        rows = np.repeat(np.arange(len(cells)), ids.shape[1])
        graph = scipy.sparse.coo_matrix(
            (np.ones(len(rows)), (rows, len(cells) + ids[cells].ravel())),
            shape=(len(cells) + ids.max() + 1,) * 2,
        )
        _, label = connected_components(graph, directed=False)
        _, label = np.unique(label[: len(cells)], return_inverse=True)
        piece[cells] = n + label
        n += label.max() + 1
    return piece


def _levels(height: np.ndarray, piece: np.ndarray) -> list[np.ndarray]:
    """Cells by level, highest first: pieces whose heights overlap by half are on one level."""
    spans = []
    for p in range(piece.max() + 1):
        h = height[piece == p]
        spans.append((h.min(), h.max(), p))
    levels: list[list] = []
    for low, high, p in sorted(spans, key=lambda s: (s[0] + s[1]) / 2):
        if levels:
            l0, h0, members = levels[-1]
            overlap = min(high, h0) - max(low, l0)
            if overlap >= 0.5 * min(high - low, h0 - l0) - 1e-12:
                levels[-1] = [min(low, l0), max(high, h0), [*members, p]]
                continue
        levels.append([low, high, [p]])
    if len(levels) > _MOST_LEVELS:
        return [np.arange(len(piece))]
    return [np.flatnonzero(np.isin(piece, members)) for _, _, members in reversed(levels)]


def _flat_polygons(corners: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Polygons (n, k, 2) of the faces that do not vanish in the projection, and their cells."""
    polygons = corners[:, faces]
    x, y = polygons[..., 0], polygons[..., 1]
    area = 0.5 * np.abs(np.sum(x * np.roll(y, -1, axis=-1) - y * np.roll(x, -1, axis=-1), axis=-1))
    cell, face = np.nonzero(area > 1e-3 * area.max(axis=1, keepdims=True))
    return polygons[cell, face], cell


def _outline(ids: np.ndarray, flat: np.ndarray) -> np.ndarray:
    """Edges, shape (n, 2, 2), where a group of quadrilaterals ends; ``ids`` number the corners."""
    edges = np.stack([ids, np.roll(ids, -1, axis=1)], axis=2).reshape(-1, 2)
    ends = np.stack([flat, np.roll(flat, -1, axis=1)], axis=2).reshape(-1, 2, 2)
    return ends[_alone(edges)]


def _alone(ids: np.ndarray) -> np.ndarray:
    """Rows of vertices, in any order, that no other row has: what bounds cells or polygons."""
    _, first, count = np.unique(np.sort(ids, axis=1), axis=0, return_index=True, return_counts=True)
    return first[count == 1]


def _flat_ids(flat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Polygons without duplicates (columns of cells project onto one), and their corners' ids."""
    size = np.ptp(flat.reshape(-1, 2), axis=0).max() or 1.0
    whole = np.round(flat.reshape(-1, 2) / size * 1e6).astype(np.int64)
    _, ids = np.unique(whole, axis=0, return_inverse=True)
    ids = ids.reshape(flat.shape[:2])
    _, first = np.unique(np.sort(ids, axis=1), axis=0, return_index=True)
    return flat[first], ids[first]


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
    levels = _levels(x[:, :, up], _pieces(_vertex_ids(x), cells.region))
    norm = Normalize(-1, 1)
    width = 7.6
    height = (width - 1.2) * max(extent[across] / max(extent[along], 1e-9), 0.06)
    with style():
        figure = new_figure(width, min((height + 0.3) * len(levels), 8.0) + 0.95)
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
    faces = _faces(cells.vertices)
    order = np.argsort(np.abs(cells.density[members]), kind="stable")
    polygons, owner = _flat_polygons(plane[order], faces)
    colours = diverging(norm(cells.density[members][order][owner]))
    panel.add_collection(
        PolyCollection(polygons, facecolors=colours, edgecolors=colours, lw=0.4, rasterized=True)
    )
    if faces.shape[1] == 4:
        for r in np.unique(cells.region[members]):
            flat, _ = _flat_polygons(plane[cells.region[members] == r], faces)
            flat, ids = _flat_ids(flat)
            lines = _outline(ids, flat)
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
    surface, moved = _surface(np.asarray(vertices, dtype=float), np.asarray(motion, dtype=float))
    size = np.ptp(surface.reshape(-1, 3), axis=0).max()
    largest = np.linalg.norm(moved, axis=-1).max() or 1.0
    shown = surface + 0.07 * size / largest * moved
    flat, depth = _oblique(shown)
    unit = np.asarray(direction, dtype=float)
    value = (moved @ (unit / np.linalg.norm(unit))).mean(axis=1)
    scale = np.abs(value).max() or 1.0
    order = np.argsort(depth)
    colours = diverging(Normalize(-1, 1)(value[order] / scale))
    with style():
        figure = new_figure(3.7, 1.75)
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


def _surface(vertices, motion) -> tuple[np.ndarray, np.ndarray]:
    """Outer faces and their motion: those that belong to one cell only."""
    faces = _faces(vertices)
    ids = _vertex_ids(vertices)[:, faces].reshape(-1, faces.shape[1])
    outer = _alone(ids)
    shape = (-1, faces.shape[1], 3)
    return vertices[:, faces].reshape(shape)[outer], motion[:, faces].reshape(shape)[outer]


def _oblique(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Parallel projection from the front, the right and above; and how near each face is."""
    right = np.array([np.cos(_TURN), -np.sin(_TURN), 0.0])
    into = np.array([np.sin(_TURN), np.cos(_TURN), 0.0]) * np.cos(_TILT)
    into[2] = -np.sin(_TILT)
    upward = np.cross(right, into)
    return np.stack([x @ right, x @ upward], axis=-1), -(x @ into).mean(axis=1)


# -- patches ---------------------------------------------------------------------------------


def patch_map(cells: PatchMap, name: str = "patches") -> str:
    """The structure taken apart, seen at an angle, its patches coloured by what they explain.

    Patches that explain more than chance are outlined, heavily where no more than chance is left;
    bolts are marked where they go through.

    Args:
        cells: The patches; on rank 0, where they have their cells.
        name: Unique in the page.

    Raises:
        InputError: If cells have a shape that the suite does not use, or are on another rank.
    """
    if cells.vertices is None:
        raise InputError("cells.vertices is None: expected the map of rank 0.")
    x, turned = _upright(1e3 * np.asarray(cells.vertices, dtype=float))
    levels = _levels(x[:, :, 2], _pieces(_vertex_ids(x), _regions_of(cells)))[::-1]
    width = np.ptp(x[:, :, 1])
    gap = 0.0 if len(levels) == 1 else 1.25 * width * np.tan(_TILT) / np.cos(_TURN)
    norm = Normalize(0.0, max(float(cells.share.max(initial=0.0)), 1e-9))
    with style():
        figure = new_figure(7.6, 1.0)
        axes = figure.subplots()
        for k, members in enumerate(levels):
            shifted = x[members] + np.array([0.0, 0.0, k * gap])
            _patch_level(axes, shifted, cells, members, norm)
        _bolt_marks(axes, turned(1e3 * cells.bolts), [x[m][:, :, 2] for m in levels], gap)
        axes.autoscale_view()
        axes.set_aspect("equal")
        axes.set_axis_off()
        low, high = axes.get_ylim()
        tall = 6.6 * (high - low) / np.ptp(axes.get_xlim())
        figure.set_size_inches(7.6, min(max(tall, 1.2), 6.0) + 1.3)
        patch_bar(figure, axes, norm)
        patch_legend(figure, cells)
        return to_svg(figure, name, patches_alt(cells))


def _regions_of(cells: PatchMap) -> np.ndarray:
    """Number of the region of every cell."""
    _, number = np.unique(np.array(cells.region), return_inverse=True)
    return number[cells.patch]


def _upright(x: np.ndarray):
    """Corners with the longest direction along x and the thinnest along z; and what turns points.

    The hand is kept: a mirror image would have its bolts on the wrong side.
    """
    extent = np.ptp(x.reshape(-1, 3), axis=0)
    order = np.argsort(-extent, kind="stable")
    turn = np.eye(3)[order]
    if np.linalg.det(turn) < 0:
        turn[1] *= -1
    return x @ turn.T, lambda points: np.asarray(points) @ turn.T


def _patch_level(axes, x: np.ndarray, cells: PatchMap, members: np.ndarray, norm) -> None:
    """One level: its faces towards the viewer, far ones first, and the patches' outlines."""
    faces = _faces(x)
    corners, ids = x[:, faces], _vertex_ids(x)[:, faces]
    patch = np.repeat(cells.patch[members], len(faces))
    middle = np.repeat(x.mean(axis=1), len(faces), axis=0)
    corners, ids = (a.reshape(-1, faces.shape[1], *a.shape[3:]) for a in (corners, ids))
    outer = _alone(ids)
    flat, depth = _oblique(corners[outer])
    # Outwards from its cell is towards the viewer: of a flat cell, either way.
    _, behind = _oblique(middle[outer][:, None])
    shown = np.flatnonzero(depth >= behind - 1e-9 * np.ptp(x))
    shown = shown[np.argsort(depth[shown])]
    colours = rising(norm(cells.share[patch[outer][shown]]))
    colours[~cells.seen[patch[outer][shown]]] = to_rgba(UNSEEN)
    axes.add_collection(
        PolyCollection(flat[shown], facecolors=colours, edgecolors=colours, lw=0.3, rasterized=True)
    )
    own, ids, flat = patch[outer][shown], ids[outer][shown], flat[shown]
    for p in np.unique(own):
        rank = int(cells.significant[p]) + int(cells.sufficient[p])
        lines = _outline(ids[own == p], flat[own == p])
        axes.add_collection(LineCollection(lines, zorder=3 + rank, **OUTLINES[rank]))


def _bolt_marks(axes, bolts: np.ndarray, heights: list[np.ndarray], gap: float) -> None:
    """A broken line along each bolt's axis, and a mark where it enters each level."""
    for bolt in bolts:
        z = np.array([h.max() + k * gap for k, h in enumerate(heights)])
        along = np.column_stack([np.tile(bolt[:2], (len(z), 1)), z])
        flat, _ = _oblique(along[:, None])
        u, v = flat[:, 0].T
        axes.plot(u, v, ls=(0, (4, 3)), lw=0.9, color="#14181d", zorder=5)
        axes.plot(u, v, "o", ms=6.5, mfc="#ffffff", mec="#14181d", mew=1.0, zorder=6)
        axes.plot(u, v, "+", ms=5.5, mec="#14181d", mew=1.0, zorder=7)


#: Mark of a bolt: a broken line with a ring.
_BOLT = {"marker": "o", "mfc": "#ffffff", "mec": "#14181d", "ls": (0, (4, 3))}


def patch_bar(figure, axes, norm: Normalize) -> None:
    """What colours of patches mean."""
    bar = figure.colorbar(
        ScalarMappable(norm, rising), ax=axes, location="bottom", aspect=45, shrink=0.8,
        format=lambda value, _: f"{100 * value:.3g} %",
    )  # fmt: skip
    bar.set_label("share of the misfit that a change in this patch alone would explain")
    bar.outline.set_visible(False)


def patch_legend(figure, cells: PatchMap, bolt: Mapping = _BOLT) -> None:
    """What outlines and marks of patches mean."""
    words = [
        f"none explains more than chance (p < {cells.level:g}, all considered)",
        f"explains more than chance (p < {cells.level:g}, all considered)",
        "and could be the only one",
    ]
    there = [not cells.significant.any(), cells.significant.any(), cells.sufficient.any()]
    handles = [
        Line2D([], [], color=style["colors"], lw=style["lw"], label=label)
        for label, style, shown in zip(words, OUTLINES, there, strict=True)
        if shown
    ]
    if not cells.seen.all():
        handles.append(Patch(fc=UNSEEN, ec="#9aa0a8", label="not seen by this test"))
    if len(cells.bolts):
        handles.append(Line2D([], [], color="#14181d", lw=0.9, label="bolt", **bolt))
    figure.legend(
        handles=handles, loc="outside upper left", ncols=2 if len(handles) > 2 else len(handles)
    )


def patches_alt(cells: PatchMap) -> str:
    """A map of patches in words."""
    best = sorted(cells.tests, key=lambda t: -t.share)[:3]
    words = "; ".join(f"{t.zone} {100 * t.share:.0f} %" for t in best)
    return (
        f"Structure taken apart, in {len(cells.tests)} patches coloured by the share of the misfit "
        f"that a change there alone would explain. Largest: {words}. "
        f"More than chance: {int(cells.significant.sum())}; could be the only one: "
        f"{', '.join(np.array([t.zone for t in cells.tests])[cells.sufficient]) or 'none'}."
    )
