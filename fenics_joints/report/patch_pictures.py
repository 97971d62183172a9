"""The map of where the gap lies: patches coloured by what a change in each would explain."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import Normalize, to_rgba
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from fenics_joints.errors import InputError
from fenics_joints.report import geometry
from fenics_joints.report.mesh_pictures import bare, diverging
from fenics_joints.report.style import drawing, to_svg

if TYPE_CHECKING:
    from fenics_joints.diagnosis.where.patches import PatchMap


#: Colour of a patch that the test does not see, off the scale of those that it sees.
UNSEEN = "#b9c6d6"
#: Outlines of a patch: of no note, more than chance, and that alone enough.
OUTLINES = (
    {"colors": "#9aa0a8", "lw": 0.5},
    {"colors": "#14181d", "lw": 0.9},
    {"colors": "#14181d", "lw": 2.6},
)
#: Mark of a bolt: a broken line with a ring.
_BOLT = {"marker": "o", "mfc": "#ffffff", "mec": "#14181d", "ls": (0, (4, 3))}


def patch_map(cells: PatchMap) -> str:
    """The structure taken apart, seen at an angle, its patches coloured by what they explain.

    Patches that explain more than chance are outlined, heavily where no more than chance is left;
    bolts are marked where they go through.

    Args:
        cells: The patches; on rank 0, where they have their cells.

    Raises:
        InputError: If cells have a shape that the suite does not use, or are on another rank.
    """
    if cells.vertices is None:
        raise InputError("cells.vertices is None: expected the map of rank 0.")
    turn = geometry.upright(np.asarray(cells.vertices, dtype=float)).T
    x = 1e3 * np.asarray(cells.vertices, dtype=float) @ turn
    _, region = np.unique(np.array(cells.region), return_inverse=True)
    pieces = geometry.pieces_of(geometry.vertex_ids(x), region[cells.patch])
    levels = geometry.levels_of(x[:, :, 2], pieces)[::-1]
    width = np.ptp(x[:, :, 1])
    gap = 0.0 if len(levels) == 1 else 1.25 * width * np.tan(geometry.TILT) / np.cos(geometry.TURN)
    norm, colours = colours_of(cells)
    with drawing(7.6, 1.0) as figure:
        axes = figure.subplots()
        for k, members in enumerate(levels):
            shifted = x[members] + np.array([0.0, 0.0, k * gap])
            _patch_level(axes, shifted, cells, members, colours)
        _bolt_marks(
            axes, 1e3 * np.asarray(cells.bolts) @ turn, [x[m][:, :, 2] for m in levels], gap
        )
        bare(axes)
        low, high = axes.get_ylim()
        tall = 6.6 * (high - low) / np.ptp(axes.get_xlim())
        figure.set_size_inches(7.6, min(max(tall, 1.2), 6.0) + 1.3)
        patch_bar(figure, axes, norm)
        patch_legend(figure, cells)
        return to_svg(figure, "patches", patches_alt(cells))


def _patch_level(axes, x: np.ndarray, cells: PatchMap, members: np.ndarray, colour_of) -> None:
    """One level: its faces towards the viewer, far ones first, and the patches' outlines."""
    faces = geometry.face_corners(x)
    corners, ids = x[:, faces], geometry.vertex_ids(x)[:, faces]
    patch = np.repeat(cells.patch[members], len(faces))
    middle = np.repeat(x.mean(axis=1), len(faces), axis=0)
    corners, ids = (a.reshape(-1, faces.shape[1], *a.shape[3:]) for a in (corners, ids))
    outer = geometry.bounding(ids)
    flat, depth = geometry.oblique(corners[outer])
    # Outwards from its cell is towards the viewer: of a flat cell, either way.
    _, behind = geometry.oblique(middle[outer][:, None])
    shown = np.flatnonzero(depth >= behind - 1e-9 * np.ptp(x))
    shown = shown[np.argsort(depth[shown])]
    colours = colour_of[patch[outer][shown]]
    axes.add_collection(
        PolyCollection(flat[shown], facecolors=colours, edgecolors=colours, lw=0.3, rasterized=True)
    )
    own, ids, flat = patch[outer][shown], ids[outer][shown], flat[shown]
    for p in np.unique(own):
        rank = int(cells.significant[p]) + int(cells.sufficient[p])
        lines = geometry.outline(ids[own == p], flat[own == p])
        axes.add_collection(LineCollection(lines, zorder=3 + rank, **OUTLINES[rank]))


def _bolt_marks(axes, bolts: np.ndarray, heights: list[np.ndarray], gap: float) -> None:
    """A broken line along each bolt's axis, and a mark where it enters each level."""
    for bolt in bolts:
        z = np.array([h.max() + k * gap for k, h in enumerate(heights)])
        along = np.column_stack([np.tile(bolt[:2], (len(z), 1)), z])
        flat, _ = geometry.oblique(along[:, None])
        u, v = flat[:, 0].T
        axes.plot(u, v, ls=(0, (4, 3)), lw=0.9, color="#14181d", zorder=5)
        axes.plot(u, v, "o", ms=6.5, mfc="#ffffff", mec="#14181d", mew=1.0, zorder=6)
        axes.plot(u, v, "+", ms=5.5, mec="#14181d", mew=1.0, zorder=7)


def colours_of(cells: PatchMap) -> tuple[Normalize, np.ndarray]:
    """The scale of the signed shares, and the colour of each patch, (P, 4)."""
    most = max(float(cells.share.max(initial=0.0)), 1e-9)
    norm = Normalize(-most, most)
    colours = diverging(norm(cells.signed_share))
    colours[~cells.seen] = to_rgba(UNSEEN)
    return norm, colours


def patch_bar(figure, axes, norm: Normalize) -> None:
    """The colour bar of the patches."""
    bar = figure.colorbar(
        ScalarMappable(norm, diverging),
        ax=axes,
        location="bottom",
        aspect=45,
        shrink=0.8,
        format=lambda value, _: f"{100 * abs(value):.3g} %",
    )
    bar.set_label(
        "share of chi-square that a change here alone explains\n"
        "blue: stiffer or lighter than in the model   |   red: softer or heavier"
    )
    bar.outline.set_visible(False)


def patch_legend(figure, cells: PatchMap, bolt: Mapping = _BOLT) -> None:
    """The legend of the patches' outlines and marks."""
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
        handles.append(Patch(fc=UNSEEN, ec="#9aa0a8", label="not visible to this test"))
    if len(cells.bolts):
        handles.append(Line2D([], [], color="#14181d", lw=0.9, label="bolt", **bolt))
    figure.legend(
        handles=handles, loc="outside upper left", ncols=2 if len(handles) > 2 else len(handles)
    )


def patches_alt(cells: PatchMap) -> str:
    """A map of patches in words."""
    best = sorted(cells.tests, key=lambda t: -t.share)[:3]
    words = "; ".join(f"{t.zone} {100 * t.share:.0f} % ({t.way})" for t in best)
    return (
        f"Structure taken apart, in {len(cells.tests)} patches coloured by the share of chi-square "
        f"that a change there alone explains. Largest: {words}. "
        f"More than chance: {int(cells.significant.sum())}; could be the only one: "
        f"{', '.join(np.array([t.zone for t in cells.tests])[cells.sufficient]) or 'none'}."
    )
