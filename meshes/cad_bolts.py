"""Where the bolts of an assembly are: holes in two faces that touch, or given centres.

All lengths are in millimetres; see `fenics_joints.meshes.cad_faces`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from fenics_joints.errors import MeshError
from fenics_joints.meshes.cad_faces import TOUCH, FacePair, Hole, Outline, hole_pairs, is_flat
from fenics_joints.meshes.step_file import Solids

#: Distance of a given centre from a hole's axis, as a share of its radius, up to which it means the
#: hole. Chosen: coordinates read from a drawing are better, and other holes are farther.
_COAXIAL = 0.1
#: Radii that differ by less than this share are equal: round-off of CAD files.
_SAME = 1e-6


@dataclass(frozen=True)
class BoltPlace:
    """A bolt's ring on a contact.

    Attributes:
        centre: On the first solid's face, in the file's coordinates; shape (3,).
        contact: The contact.
        r_nei: Inner radius.
        r_wai: Outer radius.
        hole: Radius of the circle around the axis that the holes of both faces are in.
        imprinted: Whether the inner circle is no hole's edge, and so has to be drawn.
    """

    centre: np.ndarray
    contact: FacePair
    r_nei: float
    r_wai: float
    hole: float
    imprinted: bool

    def label(self, number: int, solids: Solids) -> str:
        """The bolt for a message."""
        at = ", ".join(f"{x:.6g}" for x in self.centre)
        a, b = (solids.names[i] for i in (self.contact.lower, self.contact.upper))
        return f"bolt {number} at ({at}) mm between {a!r} and {b!r}"


class _Holes:
    """The holes of each contact, looked for once."""

    def __init__(self, model, solids: Solids, contacts: Sequence[FacePair]):
        self.model, self.solids, self.contacts = model, solids, contacts
        self.outline = cache(lambda face: Outline.of(model, face))

    def of(self, face: int) -> list[Hole]:
        return self.outline(face).holes

    def near(self, face: int, place: np.ndarray) -> list[tuple[float, Hole]]:
        """Holes of a face around a place, and the distances of their centres from it."""
        found = self.of(face)
        if not found:
            return []
        apart = np.linalg.norm([h.centre for h in found] - place, axis=1)
        own = np.flatnonzero(apart < [_COAXIAL * h.radius for h in found])
        return [(float(apart[i]), found[i]) for i in own]

    def listing(self) -> str:
        """All holes, for messages."""
        sides = [((c.faces[0], c.lower), (c.faces[1], c.upper)) for c in self.contacts]
        found = []
        for face, solid in dict.fromkeys(side for pair in sides for side in pair):
            for hole in self.of(face):
                at = ", ".join(f"{x:.6g}" for x in hole.centre)
                found.append(f"{self.solids.names[solid]!r}: {2 * hole.radius:g} mm at ({at}) mm")
        return "; ".join(sorted(found)) or "none"


def hole_bolts(
    model,
    solids: Solids,
    contacts: Sequence[FacePair],
    *,
    r_wai: float,
    r_nei: float | None,
    hole: tuple[float, float] | None,
) -> list[BoltPlace]:
    """A bolt for each pair of holes with one axis; sorted by solids, then x, y and z.

    Args:
        model: gmsh's model.
        solids: The solids.
        contacts: Their contacts.
        r_wai: Outer radius of the rings.
        r_nei: Inner radius; None: that of the wider hole.
        hole: Least and largest diameter of a bolt's hole; None: any below 2 ``r_wai``.

    Raises:
        MeshError: There is no such pair; the message lists the holes.
    """
    low, high = hole or (0.0, 2 * r_wai)
    seen = _Holes(model, solids, contacts)
    found = []
    for contact in contacts:
        for a, b, apart in hole_pairs(*map(seen.outline, contact.faces), contact):
            sizes = 2 * a.radius, 2 * b.radius
            if low * (1 - _SAME) <= min(sizes) and max(sizes) <= high * (1 + _SAME):
                found.append(_bolt(contact, a.centre, [(0.0, a), (apart, b)], r_nei, r_wai))
                if apart > TOUCH:
                    raise MeshError(
                        f"{found[-1].label(len(found), solids)}: the axes of its two "
                        f"holes are {apart:.3g} mm apart, expected one axis (or bolts' centres "
                        "and r_nei)"
                    )
    if not found:
        raise MeshError(
            f"no bolt: expected holes of {low:g} to {high:g} mm with "
            f"one axis in two faces that touch; the holes in such faces are: {seen.listing()}"
        )
    return sorted(found, key=lambda b: (b.contact.lower, b.contact.upper, *np.round(b.centre, 3)))


def _bolt(contact, centre, near: Sequence[tuple[float, Hole]], r_nei, r_wai) -> BoltPlace:
    """A bolt at a centre, from the holes there and how far their axes are off it."""
    widest = max((hole.radius + off for off, hole in near), default=0.0)
    inner = widest if r_nei is None else r_nei
    edge = bool(near) and abs(inner / widest - 1) < _SAME and all(off < TOUCH for off, _ in near)
    return BoltPlace(centre, contact, inner, r_wai, widest, inner > 0 and not edge)


def given_bolts(
    model,
    solids: Solids,
    contacts: Sequence[FacePair],
    centres: Sequence[Sequence[float]],
    *,
    r_wai: Sequence[float],
    r_nei: float | None,
    reach: float,
) -> list[BoltPlace]:
    """Bolts at given centres, in their order.

    Args:
        model: gmsh's model.
        solids: The solids.
        contacts: Their contacts.
        centres: Points on the contacts, in the file's coordinates.
        r_wai: Outer radius of each ring.
        r_nei: Inner radius; None: that of the wider of the two holes there.
        reach: How far from the first solid's face a centre may be.

    Raises:
        MeshError: No contact is there, or no hole although ``r_nei`` is None.
    """
    seen = _Holes(model, solids, contacts)
    found = []
    for number, (centre, outer) in enumerate(zip(centres, r_wai, strict=True), start=1):
        centre = np.asarray(centre, dtype=float)
        at = f"bolt {number} at ({', '.join(f'{x:.6g}' for x in centre)}) mm"
        contact = _contact_at(seen, centre, outer, reach)
        if contact is None:
            touching = {(solids.names[c.lower], solids.names[c.upper]) for c in contacts}
            pairs = ", ".join(f"{a!r} and {b!r}" for a, b in sorted(touching))
            raise MeshError(f"{at} is on no two faces that touch, expected those of: {pairs}")
        centre = centre - ((centre - contact.point) @ contact.normal) * contact.normal
        near = []
        for face, lift, solid in zip(
            contact.faces, (0.0, contact.gap), (contact.lower, contact.upper), strict=True
        ):
            own = seen.near(face, centre + lift * contact.normal)
            if not own and r_nei is None:
                raise MeshError(
                    f"{at}: {solids.names[solid]!r} has no hole there, expected one, or r_nei; "
                    f"the holes are: {seen.listing()}"
                )
            near += own
        found.append(_bolt(contact, centre, near, r_nei, outer))
    return found


def washer_face(
    model, solids: Solids, contacts: Sequence[FacePair], name: str, place: np.ndarray
) -> tuple[int, Hole, np.ndarray]:
    """Solid, hole, and unit normal of the outer flat face that has a round hole about a place.

    Raises:
        MeshError: There is no such face, or several.
    """
    taken, found, there = {face for c in contacts for face in c.faces}, [], []
    for i, tag in enumerate(solids.tags):
        for _, face in model.getBoundary([(3, tag)], oriented=False):
            box = np.array(model.getBoundingBox(2, face)).reshape(2, 3)
            near = np.all(place > box[0] - TOUCH) and np.all(place < box[1] + TOUCH)
            if not near or face in taken or not is_flat(model, face):
                continue
            for hole in Outline.of(model, face).holes:
                there.append(f"({', '.join(f'{x:.6g}' for x in hole.centre)})")
                if np.linalg.norm(hole.centre - place) < _COAXIAL * hole.radius:
                    uv = np.mean(model.getParametrizationBounds(2, face), axis=0).tolist()
                    found.append((i, hole, np.array(model.getNormal(face, uv))))
    if len(found) != 1:
        at = ", ".join(f"{x:.6g}" for x in place)
        raise MeshError(
            f"washers.{name}: {len(found)} outer flat faces have a round hole about ({at}) mm, "
            f"expected one; the holes in such faces near it are at: {', '.join(there) or 'none'}"
        )
    return found[0]


def _contact_at(seen: _Holes, centre, radius: float, reach: float) -> FacePair | None:
    """The contact whose faces hold most of the circle around a centre; among equals the nearest."""
    best, most = None, (0, 0.0)
    for contact in seen.contacts:
        off = float((centre - contact.point) @ contact.normal)
        if abs(off) > reach + TOUCH:
            continue
        base = centre - off * contact.normal
        sides = zip(contact.faces, (base, base + contact.gap * contact.normal), strict=True)
        if all(seen.near(face, place) for face, place in sides):
            n = 32  # its two holes are there
        else:
            around = centre + 0.99 * radius * _circle_points(contact.normal, 16)
            faces = contact.faces
            n = sum(_on_face(seen.model, face, contact.normal, p) for face in faces for p in around)
        if n and (n, -abs(off)) > most:
            best, most = contact, (n, -abs(off))
    return best


def _circle_points(normal: np.ndarray, n: int) -> np.ndarray:
    """Unit vectors, shape (n, 3), evenly around a normal."""
    first = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    first /= np.linalg.norm(first)
    turn = 2 * np.pi * np.arange(n)[:, None] / n
    return np.cos(turn) * first + np.sin(turn) * np.cross(normal, first)


def _on_face(model, face: int, normal, point) -> bool:
    """Whether a plane face has a point, or what of it is in the plane.

    gmsh's ``isInside`` alone asks it of the nearest place of the face's rectangle.
    """
    apart = np.asarray(model.getClosestPoint(2, face, point.tolist())[0]) - point
    apart -= (apart @ normal) * normal
    return np.linalg.norm(apart) < 10 * TOUCH and bool(model.isInside(2, face, point.tolist()))


def check_rings(bolts: Sequence[BoltPlace], solids: Solids) -> None:
    """Refuse rings that are in their holes, have no width, or overlap; raises MeshError."""
    for j, b in enumerate(bolts):
        if b.r_nei < b.hole * (1 - _SAME):
            raise MeshError(
                f"{b.label(j + 1, solids)}: r_nei is {b.r_nei:g} mm, expected at least the hole's "
                f"radius, {b.hole:g} mm"
            )
        if not b.r_nei < b.r_wai:
            raise MeshError(
                f"{b.label(j + 1, solids)}: r_wai is {b.r_wai:g} mm, expected more than the inner "
                f"radius, {b.r_nei:g} mm"
            )
        for i, a in enumerate(bolts[:j]):
            between = b.centre - a.centre
            n = a.contact.normal
            if abs(n @ b.contact.normal) < 1 - 1e-6 or abs(n @ between) > TOUCH:
                continue
            distance, least = float(np.linalg.norm(between)), a.r_wai + b.r_wai
            if distance < least:
                raise MeshError(
                    f"the rings of {a.label(i + 1, solids)} and "
                    f"{b.label(j + 1, solids)} overlap: {distance:.6g} mm apart, expected at "
                    f"least the sum of their r_wai, {least:.6g} mm"
                )
