"""The view of a preload state: how the bodies move, and the pressure on their faces."""

from __future__ import annotations

import numpy as np
from dolfinx import fem
from markupsafe import Markup
from matplotlib import colormaps

from fenics_joints.formatting import quantity
from fenics_joints.preload import STICK, PreloadResult
from fenics_joints.preload.bodies import at_blocks, body_numbers
from fenics_joints.preload.fields import nodal_fields
from fenics_joints.report.surface import Surface, surface
from fenics_joints.report.view import Colours, Look, scene

#: Open, slipping, sticking: told apart by all kinds of colour vision.
_STATUS = colormaps["cividis"]


def preload_view(result: PreloadResult) -> Markup | None:
    """Pressure and status of the contacts on the bodies, taken apart. Collective.

    Returns:
        The view on rank 0; None on the others, and of bodies in the plane.
    """
    model = result.model
    if model.structure.gdim < 3 or not result.contacts:
        return None
    V, comm = model.V, model.comm
    named = {field.name: field for field in nodal_fields(result)}
    vertices, motions = model.structure.corner_motion([result.displacement.x.petsc_vec])
    body, levels = _levels(result)
    own = V.mesh.topology.index_map(3).size_local
    here = [
        body[V.dofmap.list[:own, 0]],
        _corners(named["pressure"], own),
        _corners(named["status"], own),
    ]
    parts = comm.gather(here)
    if parts is None:
        return None
    number, pressure, status = (np.concatenate(a) for a in zip(*parts, strict=True))
    motion = motions[0]

    def looks(s: Surface) -> list[Look]:
        return _looks(result, s, motion, pressure, status)

    whole = surface(vertices, number, levels[number], [motion])
    name = "Bodies under preload, taken apart, with the pressure on their faces."
    return scene(whole, looks, name, turn=_frame(result), apart=True)


def _corners(field: fem.Function, own: int) -> np.ndarray:
    """Values at the corners of this rank's cells, (own, n_corners)."""
    return field.x.array[field.function_space.dofmap.list[:own]]


def _looks(result, s: Surface, motion, pressure, status) -> list[Look]:
    shape, at = motion.reshape(-1, 3)[s.pick], status.ravel()[s.pick]
    touched = at >= 0
    value = pressure.ravel()[s.pick]
    most = max(float(pressure.max(initial=0.0)), 1e-12)
    peak = quantity(most, "Pa")
    factor = float(np.abs(shape).max(initial=0.0))
    note = f"Bodies as the preload deforms them, up to {quantity(factor, 'm')}, enlarged."
    return [
        Look(
            "contact pressure",
            Colours(colormaps["YlGnBu"], "0", peak, "pressure at the vertices", "no contact"),
            motion=shape,
            values=np.where(touched, value / most, np.nan),
            shown=(0.0, most / 1e6, "MPa"),
            note=note,
        ),
        Look(
            "open, slip, stick",
            Colours(_STATUS, "open", "stick", "slip between them", "no contact"),
            motion=shape,
            values=np.where(touched, at / STICK, np.nan),
            note=note,
        ),
    ]


def _levels(result: PreloadResult) -> tuple[np.ndarray, np.ndarray]:
    """Body of every local block, and the level of each body: above what it lies on. Collective."""
    V = result.model.V
    body, n = body_numbers(V)
    own = V.dofmap.index_map.size_local
    lies = []
    for state in result.contacts.values():
        i = state.interface
        if not len(i.lower):  # an obstacle
            continue
        both = [at_blocks(V, body[:own].astype(np.int64), nodes) for nodes in (i.lower, i.upper)]
        lies += sorted(set(zip(*(side.tolist() for side in both), strict=True)))
    level = np.zeros(n, dtype=np.int64)
    for _ in range(n):
        for lower, upper in lies:
            level[upper] = max(level[upper], level[lower] + 1)
        if level.max(initial=0) > n:  # bodies that lie on one another in a ring
            return body, np.zeros(n, dtype=np.int64)
    return body, level


def _frame(result: PreloadResult) -> np.ndarray:
    """Turns the contacts' mean normal upwards, and the longest way across it to the right."""
    normals = np.concatenate([s.interface.frames[:, 0] for s in result.contacts.values()])
    points = np.concatenate([s.interface.points for s in result.contacts.values()])
    up = normals.mean(axis=0)
    if np.linalg.norm(up) < 0.5:
        return np.eye(3)
    up /= np.linalg.norm(up)
    flat = points - points.mean(axis=0)
    flat -= np.outer(flat @ up, up)
    axes = np.eye(3) - np.outer(up, up)
    right = axes[int(np.argmax(np.ptp(flat, axis=0)))]
    right /= np.linalg.norm(right)
    return np.array([right, np.cross(up, right), up])
