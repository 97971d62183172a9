"""Where the bolts of an assembly are: holes in two faces that touch, or given centres.

All lengths are in millimetres; see `fenics_joints.meshes.cad_shapes`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fenics_joints.errors import MeshError
from fenics_joints.meshes.cad_shapes import (
    TOUCH,
    Contact,
    Hole,
    Outline,
    Solids,
    circle_points,
    holes,
)

#: Axes of two holes may be apart by this share of the smaller one's radius.
_COAXIAL = 0.1
#: Holes that differ by less than this share of their radius are one size.
_SAME = 1e-6


@dataclass(frozen=True)
class BoltPlace:
    """A bolt's ring on a contact.

    Attributes:
        centre: On the first solid's face, in the file's coordinates; shape (3,).
        contact: The contact.
        r_nei: Inner radius.
        r_wai: Outer radius.
        imprinted: Whether the inner circle is no hole's edge, and so has to be drawn.
    """

    centre: np.ndarray
    contact: Contact
    r_nei: float
    r_wai: float
    imprinted: bool

    def said(self, number: int, solids: Solids) -> str:
        """The bolt for a message."""
        at = ", ".join(f"{x:.6g}" for x in self.centre)
        a, b = (solids.names[i] for i in (self.contact.lower, self.contact.upper))
        return f"bolt {number} at ({at}) mm between {a!r} and {b!r}"


class _Holes:
    """The holes of each contact, looked for once."""

    def __init__(self, model, solids: Solids, contacts: Sequence[Contact]):
        self.model, self.solids, self.contacts = model, solids, contacts
        self._found: dict[int, list[Hole]] = {}

    def of(self, face: int) -> list[Hole]:
        if face not in self._found:
            self._found[face] = holes(Outline.of(self.model, face))
        return self._found[face]

    def near(self, face: int, place: np.ndarray) -> list[tuple[float, Hole]]:
        """Holes of a face around a place, and the distances of their centres from it."""
        found = self.of(face)
        if not found:
            return []
        apart = np.linalg.norm([h.centre for h in found] - place, axis=1)
        own = np.flatnonzero(apart < [_COAXIAL * h.radius for h in found])
        return [(float(apart[i]), found[i]) for i in own]

    def pairs(self, contact: Contact) -> list[tuple[Hole, Hole, float]]:
        """Holes of the two faces that contain each other's axis, and how far apart these are."""
        lower, upper = (self.of(face) for face in contact.faces)
        shift = contact.gap * contact.normal
        return [
            (a, b, apart)
            for a in lower
            for b in upper
            if (apart := float(np.linalg.norm(b.centre - shift - a.centre)))
            < min(a.radius, b.radius)
        ]

    def listing(self) -> str:
        """All holes, for messages."""
        sides = [((c.faces[0], c.lower), (c.faces[1], c.upper)) for c in self.contacts]
        said = []
        for face, solid in dict.fromkeys(side for pair in sides for side in pair):
            for hole in self.of(face):
                at = ", ".join(f"{x:.6g}" for x in hole.centre)
                said.append(f"{self.solids.names[solid]!r}: {2 * hole.radius:g} mm at ({at}) mm")
        return "; ".join(sorted(said)) or "none"


def hole_bolts(
    model,
    solids: Solids,
    contacts: Sequence[Contact],
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
        for a, b, apart in seen.pairs(contact):
            sizes = 2 * a.radius, 2 * b.radius
            if low * (1 - _SAME) <= min(sizes) and max(sizes) <= high * (1 + _SAME):
                found.append(_place(a, b, apart, contact, r_nei, r_wai))
                if apart > TOUCH:
                    raise MeshError(
                        f"{solids.path}: {found[-1].said(len(found), solids)}: the axes of its two "
                        f"holes are {apart:.3g} mm apart, expected one axis (or bolts' centres "
                        "and r_nei)"
                    )
                _check_nei(r_nei, max(a.radius, b.radius + apart), found[-1], len(found), solids)
    if not found:
        raise MeshError(
            f"{solids.path}: no bolt: expected holes of {low:g} to {high:g} mm with "
            f"one axis in two faces that touch; the holes in such faces are: {seen.listing()}"
        )
    order = sorted(found, key=lambda b: (b.contact.lower, b.contact.upper, *np.round(b.centre, 3)))
    _check_inner(order, solids)
    return order


def _place(a: Hole, b: Hole, apart: float, contact, r_nei, r_wai) -> BoltPlace:
    widest = max(a.radius, b.radius + apart)
    edge = r_nei is None or abs(r_nei / widest - 1) < _SAME
    inner = widest if r_nei is None else r_nei
    return BoltPlace(a.centre, contact, inner, r_wai, not edge)


def _check_nei(r_nei: float | None, widest: float, bolt, number: int, solids: Solids) -> None:
    if r_nei is not None and r_nei < widest * (1 - _SAME):
        raise MeshError(
            f"{solids.path}: {bolt.said(number, solids)}: r_nei is {r_nei:g} mm, expected at least "
            f"the hole's radius, {widest:g} mm"
        )


def _check_inner(bolts: Sequence[BoltPlace], solids: Solids) -> None:
    for number, bolt in enumerate(bolts, start=1):
        if not bolt.r_nei < bolt.r_wai:
            raise MeshError(
                f"{solids.path}: {bolt.said(number, solids)}: r_wai is {bolt.r_wai:g} mm, expected "
                f"more than the inner radius, {bolt.r_nei:g} mm"
            )


def given_bolts(
    model,
    solids: Solids,
    contacts: Sequence[Contact],
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
        at = f"{solids.path}: bolt {number} at ({', '.join(f'{x:.6g}' for x in centre)}) mm"
        contact = _contact_at(seen, centre, outer, reach)
        if contact is None:
            touching = {(solids.names[c.lower], solids.names[c.upper]) for c in contacts}
            pairs = ", ".join(f"{a!r} and {b!r}" for a, b in sorted(touching))
            raise MeshError(f"{at} is on no two faces that touch, expected those of: {pairs}")
        centre = centre - ((centre - contact.point) @ contact.normal) * contact.normal
        found.append(_at_centre(seen, contact, centre, outer, r_nei, number, at))
    _check_inner(found, solids)
    return found


def _contact_at(seen: _Holes, centre, radius: float, reach: float) -> Contact | None:
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
            around = centre + 0.99 * radius * circle_points(contact.normal, 16)
            faces = contact.faces
            n = sum(_on_face(seen.model, face, contact.normal, p) for face in faces for p in around)
        if n and (n, -abs(off)) > most:
            best, most = contact, (n, -abs(off))
    return best


def _on_face(model, face: int, normal, point) -> bool:
    """Whether a plane face has a point, or what of it is in the plane.

    gmsh's ``isInside`` alone asks it of the nearest place of the face's rectangle.
    """
    apart = np.asarray(model.getClosestPoint(2, face, point.tolist())[0]) - point
    apart -= (apart @ normal) * normal
    return np.linalg.norm(apart) < 10 * TOUCH and bool(model.isInside(2, face, point.tolist()))


def _at_centre(seen: _Holes, contact, centre, r_wai, r_nei, number: int, at: str):
    near = []
    for face, lift, solid in zip(
        contact.faces, (0.0, contact.gap), (contact.lower, contact.upper), strict=True
    ):
        place = centre + lift * contact.normal
        own = seen.near(face, place)
        if not own and r_nei is None:
            raise MeshError(
                f"{at}: {seen.solids.names[solid]!r} has no hole there, expected one, or r_nei; "
                f"the holes are: {seen.listing()}"
            )
        near += own
    widest = max((h.radius + d for d, h in near), default=0.0)
    inner = widest if r_nei is None else r_nei
    edge = bool(near) and abs(inner / widest - 1) < _SAME and all(d < TOUCH for d, _ in near)
    bolt = BoltPlace(centre, contact, inner, r_wai, inner > 0 and not edge)
    _check_nei(r_nei, widest, bolt, number, seen.solids)
    return bolt


def check_rings(bolts: Sequence[BoltPlace], solids: Solids) -> None:
    """Refuse rings that overlap; raises MeshError with both bolts."""
    for j, b in enumerate(bolts):
        for i, a in enumerate(bolts[:j]):
            between = b.centre - a.centre
            n = a.contact.normal
            if abs(n @ b.contact.normal) < 1 - 1e-6 or abs(n @ between) > TOUCH:
                continue
            distance, least = float(np.linalg.norm(between)), a.r_wai + b.r_wai
            if distance < least:
                raise MeshError(
                    f"{solids.path}: the rings of {a.said(i + 1, solids)} and "
                    f"{b.said(j + 1, solids)} overlap: {distance:.6g} mm apart, expected at "
                    f"least the sum of their r_wai, {least:.6g} mm"
                )
