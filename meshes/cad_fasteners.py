"""Bolts, nuts and washers that a drawing models as solids, by their shape and place.

All lengths are in millimetres; see `fenics_joints.meshes.cad_faces`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fenics_joints.meshes.cad_faces import TOUCH, FacePair, Hole
from fenics_joints.meshes.step_file import Solids

#: Share of a radius by which a bolt's centre of mass may be off the hole's axis. Chosen: a bolt
#: lies loosely in its hole in no drawing; the clearance itself is 5 to 10 %.
_OFF = 0.15
#: Relative difference of moments of inertia of what is the same all around. Chosen: hexagons have
#: none, and round-off and lettering on heads are less.
_ROUND = 0.03
#: Largest radius (of the disc with its inertia) of a bolt or ring, and largest length of a bolt, as
#: multiples of the hole's radius. Chosen: heads have 1.6, large washers (ISO 7093) 2.8; a rod of
#: more than twenty diameters is a part.
_WIDE, _LONG = 4.0, 40.0
#: Relative difference of volumes, inertias and places of one solid drawn twice: round-off.
_TWIN = 1e-6


@dataclass(frozen=True)
class Fastener:
    """A solid that is a bolt, or a nut or washer on one.

    Attributes:
        solid: Its index.
        kind: ``"bolt"`` or ``"ring"``.
        centre: On its axis, in the hole's plane; shape (3,).
        axis: Unit vector, shape (3,).
        radius: The hole's.
    """

    solid: int
    kind: str
    centre: np.ndarray
    axis: np.ndarray
    radius: float


class _Solid:
    """Volume, centre of mass and inertia of a solid."""

    def __init__(self, model, tag: int):
        self.tag = tag
        self.volume = model.occ.getMass(3, tag)
        self.centre = np.array(model.occ.getCenterOfMass(3, tag))
        self.inertia = np.array(model.occ.getMatrixOfInertia(3, tag)).reshape(3, 3)

    def is_round(self, centre: np.ndarray, axis: np.ndarray, radius: float) -> bool:
        """Whether it is the same all around an axis, and no wider than what is on bolts."""
        between = self.centre - centre
        off = np.linalg.norm(between - (between @ axis) * axis)
        along = float(axis @ self.inertia @ axis)
        if off > _OFF * radius or np.sqrt(2 * along / self.volume) > _WIDE * radius:
            return False
        rest = self.inertia - along * np.outer(axis, axis)
        tilt = np.linalg.norm(self.inertia @ axis - along * axis)
        low, high = np.linalg.eigvalsh(rest)[-2:]
        return high - low < _ROUND * high and tilt < _ROUND * max(along, high)

    def length(self, axis: np.ndarray) -> float:
        """Of the round rod of its inertia."""
        along = float(axis @ self.inertia @ axis)
        across = (np.trace(self.inertia) - along) / 2
        return float(np.sqrt(max(12 * (across - along / 2) / self.volume, 0.0)))

    def is_twin(self, other: _Solid) -> bool:
        """Whether it is the other once more, at the same place."""
        size = self.volume ** (1 / 3)
        return (
            abs(self.volume - other.volume) < _TWIN * self.volume
            and np.linalg.norm(self.centre - other.centre) < _TWIN * size
            and np.abs(self.inertia - other.inertia).max() < _TWIN * self.volume * size**2
        )


def find_twins(model, solids: Solids) -> list[tuple[int, int]]:
    """Solids that stand in the file before, at the same place: their index, and the first's."""
    bodies = [_Solid(model, tag) for tag in solids.tags]
    first = {}
    for j, body in enumerate(bodies):
        for i in range(j):
            if i not in first and body.is_twin(bodies[i]):
                first[j] = i
                break
    return list(first.items())


def find_fasteners(
    model, solids: Solids, contacts: Sequence[FacePair], holes: Sequence[tuple[FacePair, Hole]]
) -> list[Fastener]:
    """Bolts through holes, and nuts and washers on them that lie between no two other solids.

    Args:
        model: gmsh's model.
        solids: The solids.
        contacts: Faces that touch.
        holes: For each pair of holes with one axis, the contact and the wider hole.
    """
    bodies = [_Solid(model, tag) for tag in solids.tags]
    found: dict[int, Fastener] = {}
    for contact, hole in holes:
        for i, body in enumerate(bodies):
            if i in found or i in (contact.lower, contact.upper):
                continue
            place = (hole.centre, contact.normal, hole.radius)
            if not body.is_round(*place) or body.length(contact.normal) > _LONG * hole.radius:
                continue
            if model.isInside(3, body.tag, (hole.centre + 2 * TOUCH * contact.normal).tolist()):
                found[i] = Fastener(i, "bolt", *place)
    rings: dict[int, Fastener] = {}
    for contact, hole in holes:
        on = [f for f in found.values() if _coaxial(f, hole, contact.normal)]
        for i in (contact.lower, contact.upper) if on else ():
            place = (hole.centre, contact.normal, hole.radius)
            if i not in found and bodies[i].is_round(*place):
                rings.setdefault(i, Fastener(i, "ring", *place))
    touching = {frozenset((c.lower, c.upper)) for c in contacts}
    # From the ends of a bolt inwards: what then lies between two solids is a spacer, and a part.
    while ends := [i for i in rings if _neighbours(i, touching, found) <= 1]:
        found |= {i: rings.pop(i) for i in ends}
    return [found[i] for i in sorted(found)]


def _coaxial(fastener: Fastener, hole: Hole, normal: np.ndarray) -> bool:
    between = hole.centre - fastener.centre
    beside = between - (between @ fastener.axis) * fastener.axis
    return bool(np.linalg.norm(beside) < _OFF * hole.radius and abs(normal @ fastener.axis) > 0.999)


def _neighbours(i: int, touching, found) -> int:
    return sum(1 for pair in touching if i in pair and not any(j in found for j in pair - {i}))
