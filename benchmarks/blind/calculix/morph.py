"""Where the nodes of a specimen are: the drawing's mesh, stretched and bent."""

from __future__ import annotations

import numpy as np

from .build import Build
from .meshing import Mesh
from .rigs import Rig


def spans(mesh: Mesh) -> list[tuple[np.ndarray, np.ndarray]]:
    """Least and largest coordinates of each body, (3,) each."""
    found = [mesh.x[mesh.body == i] for i in range(len(mesh.cells))]
    return [(own.min(axis=0), own.max(axis=0)) for own in found]


def moved(rig: Rig, mesh: Mesh, build: Build) -> np.ndarray:
    """Nodes of the specimen, (n, 3). Faces at which bodies touch stay where they are."""
    x = mesh.x.copy()
    boxes = spans(mesh)
    for number, body in enumerate(rig.bodies):
        own = mesh.body == number
        low, high = boxes[number]
        if body.normal is not None:
            x[own] = _thickened(rig, number, x[own], low, high, build)
        else:
            x[own] = _formed(rig, number, x[own], low, high, build)
    return x


def _still(rig: Rig, number: int, axis: int) -> float | None:
    """Where along an axis a body touches another."""
    own = [face for face in rig.interfaces if number in face.bodies and face.axis == axis]
    found = [face.bolts[0][axis] for face in own]
    return found[0] if found else None


def _thickened(rig, number, x, low, high, build: Build) -> np.ndarray:
    """Thickness, taper and bow of a plate, each along its normal."""
    axis, along = rig.bodies[number].normal, rig.bodies[number].axis
    base = _still(rig, number, axis)
    middle = (low + high) / 2
    base = middle[axis] if base is None else base
    s = (x[:, along] - middle[along]) / (high[along] - low[along])
    factor = build.thickness.get(number, 1.0) * (1 + build.taper.get(number, 0.0) * s)
    out = x.copy()
    out[:, axis] = base + (x[:, axis] - base) * factor
    across = 3 - axis - along
    t = 2 * (x[:, across] - middle[across]) / (high[across] - low[across])
    arch = (1 - 4 * s**2) * np.clip(1 - t**2, 0, None)
    out[:, axis] += build.bow.get(number, 0.0) * arch
    return out


def _formed(rig, number, x, low, high, build: Build) -> np.ndarray:
    """Extent, bow, lean and ovality of a tube, which fade in with the distance from the joint."""
    axis = rig.bodies[number].axis
    base = _still(rig, number, axis)
    middle, length = (low + high) / 2, high[axis] - low[axis]
    base = middle[axis] if base is None else base
    away = x[:, axis] - base
    out = x.copy()
    across = [i for i in range(3) if i != axis]
    # Ovality in front of a touching face, or between the joint and the ends.
    fade = np.clip((np.abs(away) - 0.08 * length) / (0.3 * length), 0, 1)
    oval = build.oval.get(number, 0.0) * fade**2 * (3 - 2 * fade)
    centre = _centre(rig, number, middle)
    for i, sign in zip(across, (1, -1), strict=True):
        if not (i == 2 and axis == 0):  # the chord's top face stays flat
            out[:, i] = centre[i] + (x[:, i] - centre[i]) * (1 + sign * oval)
    out[:, axis] = base + away * build.extent.get(number, 1.0)
    s = away / length
    out[:, across[0]] += build.bow.get(number, 0.0) * 4 * s**2
    out[:, across[0]] += build.lean.get(number, 0.0) * np.sign(away) * np.abs(away) * fade
    return out


def _centre(rig: Rig, number: int, middle: np.ndarray) -> np.ndarray:
    """A tube's own axis: that of its box, or the rig's where a fin is on one side."""
    return np.zeros(3) if rig.name == "flanged_pipe" else middle
