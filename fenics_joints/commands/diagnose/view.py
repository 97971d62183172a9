"""The view of a diagnosis: the map of where the error lies, on the structure taken apart."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup

from fenics_joints.commands.diagnose.words import zone_words
from fenics_joints.diagnosis.where.patches import PatchMap
from fenics_joints.formatting import percent
from fenics_joints.report import geometry
from fenics_joints.report.mesh_pictures import diverging
from fenics_joints.report.surface import Surface, surface
from fenics_joints.report.view import Colours, SurfaceView, scene


def diagnosis_view(patches: PatchMap | None) -> Markup | None:
    """The map of patches, to be looked at from all sides; None without their cells."""
    if patches is None:
        return None
    x = np.asarray(patches.vertices, dtype=float)
    region = np.unique(np.array(patches.region), return_inverse=True)[1][patches.patch]
    turn = np.eye(3) if patches.side_view else geometry.upright(x)
    pieces = geometry.pieces_of(geometry.vertex_ids(x), region)
    level = geometry.stacked(x @ turn[2], pieces)
    name = "The structure taken apart, coloured by the share that a change in each place explains."
    return scene(
        surface(x, patches.patch, level),
        lambda s: [_explained(s, patches)],
        name,
        turn=turn,
        apart=True,
    )


def _explained(s: Surface, patches: PatchMap) -> SurfaceView:
    """Signed shares of chi-square, patch by patch."""
    most = max(float(patches.share.max(initial=0.0)), 1e-9)
    value = np.where(patches.seen, 0.5 + 0.5 * patches.signed_share / most, np.nan)
    end = percent(most, 0)
    colours = Colours(
        diverging,
        f"{end}, stiffer or lighter",
        f"{end}, softer or heavier",
        "of chi-square, by a change in this patch alone",
        "" if patches.seen.all() else "not visible to this test",
    )
    return SurfaceView(
        "where the error lies",
        colours,
        values=value[s.group],
        texts=[_said(patches, i) for i in range(len(patches.tests))],
        note="Lines bound the patches.",
    )


def _said(patches: PatchMap, i: int) -> str:
    test = patches.tests[i]
    name = zone_words(test.zone)
    if not patches.seen[i]:
        return f"{name}: not visible to this test"
    chance = "no more than chance"
    if patches.significant[i]:
        chance = "more than chance"
        chance += ", and could be the only place" if patches.sufficient[i] else ""
    return f"{name}: {test.way}, {percent(test.share, 0)} of chi-square, {chance}"
