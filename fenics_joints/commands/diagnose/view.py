"""The view of a diagnosis: its patches, and what each cell says, on the structure taken apart."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup

from fenics_joints.commands.diagnose.words import zone_words
from fenics_joints.diagnosis.where.localise import CellMap
from fenics_joints.diagnosis.where.patches import PatchMap
from fenics_joints.formatting import percent, spaced
from fenics_joints.report import geometry
from fenics_joints.report.mesh_pictures import diverging
from fenics_joints.report.patch_pictures import rising
from fenics_joints.report.surface import Surface, surface
from fenics_joints.report.view import Colours, Look, scene

__all__ = ["diagnosis_view"]

_DENSITY = Colours(
    diverging, "stiffer here closes the gap", "softer here does", "by the model's sensitivities"
)


def diagnosis_view(patches: PatchMap | None, cells: CellMap | None) -> Markup | None:
    """What the patches explain, and what each cell says, to be looked at from all sides.

    Args:
        patches: The patches, where they have their cells; or None.
        cells: The map of cells, or None.
    """
    shown = cells if patches is None else patches
    if shown is None:
        return None
    x = np.asarray(shown.vertices, dtype=float)
    if patches is None:
        region = group = cells.region
    else:
        region = np.unique(np.array(patches.region), return_inverse=True)[1][patches.patch]
        group = patches.patch
    turn = np.eye(3) if shown.side_view else geometry.upright(x)
    pieces = geometry.pieces_of(geometry.vertex_ids(x), region)
    level = geometry.stacked(x @ turn[2], pieces)
    density = None
    if cells is not None and cells.vertices.shape == x.shape:
        density = _at_corners(x, region, cells.density)

    def looks(s: Surface) -> list[Look]:
        found = []
        if patches is not None:
            found.append(_explained(s, patches))
        if density is not None:
            texts = [spaced(name) for name in cells.regions] if patches is None else ()
            found.append(Look(
                "where stiffness would close the gap", _DENSITY, texts=texts,
                values=0.5 + 0.5 * np.clip(density[s.pick], -1, 1), shown=(-1.0, 1.0, ""),
                note="By the sensitivities of the nominal model; it says where, not how much.",
            ))  # fmt: skip
        return found

    name = "The structure taken apart, coloured by what a change in each place would explain."
    return scene(surface(x, group, level), looks, name, turn=turn, apart=True)


def _explained(s: Surface, patches: PatchMap) -> Look:
    """Shares of the misfit, patch by patch."""
    most = max(float(patches.share.max(initial=0.0)), 1e-9)
    value = np.where(patches.seen, patches.share / most, np.nan)
    colours = Colours(
        rising, "0 %", percent(most, 0), "of the misfit, by a change in this patch alone",
        "" if patches.seen.all() else "not seen by this test",
    )  # fmt: skip
    return Look(
        "what each patch would explain", colours, values=value[s.group],
        texts=[_said(patches, i) for i in range(len(patches.tests))],
        note="Lines bound the patches.",
    )


def _said(patches: PatchMap, i: int) -> str:
    test = patches.tests[i]
    name = zone_words(test.zone)
    if not patches.seen[i]:
        return f"{name}: not seen by this test"
    chance = "no more than chance"
    if patches.significant[i]:
        chance = "more than chance"
        chance += ", and could be the only one" if patches.sufficient[i] else ""
    return f"{name}: {percent(test.share, 0)}, {chance}"


def _at_corners(x: np.ndarray, region: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values of cells at all their corners: the mean of those of the region that meet there."""
    key = np.column_stack([geometry.vertex_ids(x).ravel(), np.repeat(region, x.shape[1])])
    _, where = np.unique(key, axis=0, return_inverse=True)
    where = where.ravel()
    total = np.bincount(where, weights=np.repeat(values, x.shape[1]))
    return (total / np.bincount(where))[where]
