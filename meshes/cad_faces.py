"""Flat faces of solids that touch, and the round holes in them.

CAD programs write mirrored, imported and healed bodies with splines in the place of planes and
circles. All lengths here are in millimetres, OpenCASCADE's own unit whatever the file's.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from fenics_joints.meshes.grow import groups_of
from fenics_joints.meshes.step_file import Solids

#: Millimetres in a metre.
MM = 1e3
#: Distance, mm, below which points are one: round-off of CAD (OpenCASCADE's is 1e-4 mm).
TOUCH = 1e-3
_SPLINES = ("BSpline surface", "Bezier surface", "BSpline", "Bezier")
#: Parameters, of 0 to 1, at which a spline is compared with a plane or a circle. Chosen: nothing
#: depends on their number within a factor of two.
_LOOK = (np.arange(7) + 0.5) / 7
#: One less the cosine by which the normals of facing faces may be off: round-off, 0.08 degrees.
_PARALLEL = 1e-6
#: Overlap, mm, up to which faces touch. Chosen: drawings are rounded, at worst to thousandths of an
#: inch (0.025 mm); a press fit overlaps by more.
OVERLAP = 0.02
#: Share of a face below which an area that it has in common with another is round-off.
_NO_AREA = 1e-6
#: Distance, mm, of a point from a face at which the solid's side is looked for. Chosen: ten times
#: `TOUCH`, and less than the thickness of any sheet.
_PROBE = 1e-2

#: Progress callback: the task, its finished parts, and their total number.
Report = Callable[[str, int, int], None]


def no_report(words: str, done: int, of: int) -> None:
    """Say nothing."""


def is_flat(model, face: int) -> bool:
    """Whether a face is a plane, or a spline that is one within `TOUCH`."""
    kind = model.getType(2, face)
    if kind not in _SPLINES:
        return kind == "Plane"
    points = surface_points(model, face)
    least = np.linalg.svd(points - points.mean(axis=0))[2][2]
    return float(np.ptp(points @ least)) < TOUCH


def surface_points(model, face: int) -> np.ndarray:
    """Points of a face's surface over the rectangle of its parameters, (n, 3)."""
    low, high = (np.array(ends) for ends in model.getParametrizationBounds(2, face))
    uv = [(low + (high - low) * [s, t]).tolist() for s in _LOOK for t in _LOOK]
    return np.reshape(model.getValue(2, face, np.ravel(uv).tolist()), (-1, 3))


def circle_of(model, curve: int) -> tuple[np.ndarray, float] | None:
    """Centre, (3,), and radius of the circle on which a curve lies within `TOUCH`, or None."""
    kind = model.getType(1, curve)
    if kind != "Circle" and kind not in _SPLINES:
        return None
    (low,), (high,) = model.getParametrizationBounds(1, curve)
    at = (low + (high - low) * np.array([0.1, 0.4, 0.7])).tolist()
    a, b, c = np.array(model.getValue(1, curve, at)).reshape(3, 3)
    u, v = b - a, c - a
    w = np.cross(u, v)
    if np.linalg.norm(w) <= 1e-9 * max(u @ u, v @ v):
        return None  # straight
    centre = a + np.cross((u @ u) * v - (v @ v) * u, w) / (2 * (w @ w))
    radius = float(np.linalg.norm(a - centre))
    if kind != "Circle":
        along = (low + (high - low) * _LOOK).tolist()
        points = np.reshape(model.getValue(1, curve, along), (-1, 3)) - centre
        off = np.abs(np.linalg.norm(points, axis=1) - radius)
        if max(off.max(), np.abs(points @ w).max() / np.sqrt(w @ w)) > TOUCH:
            return None
    return centre, radius


@dataclass(frozen=True)
class FacePair:
    """Two flat faces of two solids, one upon the other.

    Attributes:
        lower: Index of the first solid.
        upper: Index of the second.
        normal: Unit normal from the first to the second, shape (3,).
        point: A point of the first's face, shape (3,).
        gap: Distance between the faces in the file; below 0 where they overlap.
        faces: gmsh's numbers of the two faces.
        area: Area that they have in common.
    """

    lower: int
    upper: int
    normal: np.ndarray
    point: np.ndarray
    gap: float
    faces: tuple[int, int]
    area: float


@dataclass(frozen=True)
class _Flat:
    """A flat face: gmsh's number, its unit normal out of the solid, a point of it, its box."""

    tag: int
    normal: np.ndarray
    point: np.ndarray
    box: np.ndarray


def find_contacts(
    model, solids: Solids, reach: float, report: Report = no_report, *, tidy: bool = True
) -> list[FacePair]:
    """Pairs of flat faces that touch, or are apart by at most ``reach``; see `FacePair`.

    Faces that overlap by at most `OVERLAP` touch, too. Faces with a gap do not touch if another
    solid lies in the gap, such as a sheet or a washer.

    Args:
        model: gmsh's model.
        solids: The solids.
        reach: How far apart faces may be.
        report: Progress callback.
        tidy: Whether to remove temporary shapes, which takes as long as the rest.
    """
    flats = [(i, flat) for i, tag in enumerate(solids.tags) for flat in _flats(model, tag)]
    pairs = _facing(flats, reach)
    found: list[tuple[FacePair, list]] = []
    for n, (k, m, gap) in enumerate(pairs):
        if n % 20 == 0:
            report("pairs of faces", n, len(pairs))
        (i, a), (j, b) = flats[k], flats[m]
        common, area = _overlap(model, [(2, a.tag)], [(2, b.tag)], -gap * a.normal)
        if area > _NO_AREA * model.occ.getMass(2, a.tag):
            contact = FacePair(i, j, a.normal, a.point, gap, (a.tag, b.tag), area)
            found.append((contact, common))
        elif common:
            model.occ.remove(common, recursive=True)
    free = [not _kept_apart(model, item, found) for item in found]
    if tidy:
        for _, common in found:
            model.occ.remove(common, recursive=True)
    return [contact for (contact, _), keep in zip(found, free, strict=True) if keep]


def _facing(flats: Sequence[tuple[int, _Flat]], reach: float) -> list[tuple[int, int, float]]:
    """Facing faces of two solids, within reach: the faces' numbers, and the gap."""
    if not flats:
        return []
    solid = np.array([i for i, _ in flats])
    normals, points = (np.array([getattr(f, k) for _, f in flats]) for k in ("normal", "point"))
    boxes = np.array([f.box for _, f in flats])
    found = []
    for k, (i, a) in enumerate(flats):
        gap = points @ a.normal - a.point @ a.normal
        near = (solid > i) & (normals @ a.normal <= _PARALLEL - 1)
        near &= (gap >= -OVERLAP) & (gap <= reach)
        moved = boxes - gap[:, None, None] * a.normal
        near &= np.all(moved[:, 1] >= a.box[0] - TOUCH, axis=1)
        near &= np.all(a.box[1] >= moved[:, 0] - TOUCH, axis=1)
        found += [(i, int(solid[m]), k, int(m), float(gap[m])) for m in np.flatnonzero(near)]
    return [(k, m, gap) for _, _, k, m, gap in sorted(found)]


def _kept_apart(model, item: tuple[FacePair, list], found) -> bool:
    """Whether a third solid lies between two faces, on a part of the area that they share."""
    contact, common = item
    if contact.gap <= TOUCH:
        return False
    for other, nearer in found:
        if other.gap < contact.gap and set(other.faces) & set(contact.faces):
            apart = (contact.point - other.point) @ contact.normal
            both, area = _overlap(model, common, nearer, apart * contact.normal)
            model.occ.remove(both, recursive=True)
            if area > _NO_AREA * contact.area:
                return True
    return False


def nearest(
    model, solids: Solids, reach: float, pairs: Sequence[tuple[str, str]] | None = None
) -> str:
    """Why there are no contacts, for a message: solids that overlap, or how far faces are apart.

    Args:
        model: gmsh's model.
        solids: The solids.
        reach: How far faces that touch may be apart.
        pairs: Names of the pairs that are looked at; None: all.
    """
    names = solids.names
    if pairs is None:
        pairs = [(a, b) for i, a in enumerate(names) for b in names[i + 1 :]]
    for a, b in pairs:
        both = [model.occ.copy([(3, solids.tags[names.index(name)])]) for name in (a, b)]
        common, _ = model.occ.intersect(*both)
        if volume := sum(model.occ.getMass(3, tag) for dim, tag in common if dim == 3):
            return f"; {a!r} and {b!r} overlap by {volume:.6g} mm3"
    wanted = {frozenset(pair) for pair in pairs}
    apart = [
        (c.gap, names[c.lower], names[c.upper])
        for c in find_contacts(model, solids, np.inf)
        if frozenset((names[c.lower], names[c.upper])) in wanted and c.gap > reach
    ]
    if not apart:
        return ""
    gap, a, b = min(apart)
    return f"; those of {a!r} and {b!r} are {gap:.6g} mm apart (layer says how far they may be)"


def _overlap(model, first, second, move) -> tuple[list[tuple[int, int]], float]:
    """Common part of two shapes of gmsh's when the second has been moved, and its area."""
    one, two = model.occ.copy(first), model.occ.copy(second)
    model.occ.translate(two, *move)
    common, _ = model.occ.intersect(one, two)
    return common, sum(model.occ.getMass(2, tag) for dim, tag in common if dim == 2)


def _flats(model, solid: int) -> list[_Flat]:
    faces = [tag for _, tag in model.getBoundary([(3, solid)], oriented=False)]
    flats = (_flat(model, solid, tag) for tag in faces if is_flat(model, tag))
    return [flat for flat in flats if flat is not None]


def _flat(model, solid: int, tag: int) -> _Flat | None:
    uv = _inner_parameters(model, tag)
    if uv is None:
        return None
    point, normal = np.array(model.getValue(2, tag, uv)), np.array(model.getNormal(tag, uv))
    # Which way the normal points depends on who wrote the file.
    if model.isInside(3, solid, (point + _PROBE * normal).tolist()):
        normal = -normal
    box = np.array(model.getBoundingBox(2, tag)).reshape(2, 3)
    return _Flat(tag, normal, point, box)


def _inner_parameters(model, tag: int) -> list[float] | None:
    """Parameters of a point of the face that is in no hole of it."""
    low, high = (np.array(ends) for ends in model.getParametrizationBounds(2, tag))
    for n in (3, 8, 21, 55):
        steps = (np.arange(n) + 0.5) / n
        for s in steps:
            for t in steps:
                uv = (low + (high - low) * [s, t]).tolist()
                if model.isInside(2, tag, uv, parametric=True):
                    return uv
    return None


@dataclass(frozen=True)
class Hole:
    """A round hole in a flat face: its centre, shape (3,), radius, and gmsh's curves round it."""

    centre: np.ndarray
    radius: float
    curves: list[int]


@dataclass(frozen=True)
class Outline:
    """The edges of a flat face.

    Attributes:
        holes: Round holes: whole circles that are not the outer edge.
        pieces: All other edges as straight pieces, shape (n_pieces, 2, 3).
    """

    holes: list[Hole]
    pieces: np.ndarray

    @classmethod
    def of(cls, model, face: int) -> Outline:
        """The edges of a face of gmsh's."""
        curves = [curve for _, curve in model.getBoundary([(2, face)], oriented=False)]
        points = [_along(model, curve) for curve in curves]
        found = [circle_of(model, curve) for curve in curves]
        arcs = np.array([i for i, circle in enumerate(found) if circle is not None], dtype=int)
        circles = np.array([[*found[i][0], found[i][1]] for i in arcs]).reshape(-1, 4)
        group = groups_of(len(arcs), KDTree(circles).query_pairs(TOUCH))
        holes, edges = [], dict(enumerate(points))
        starts = np.array([x[0] for x in points])
        for number in range(group.max(initial=-1) + 1):
            own = arcs[group == number]
            centre, radius = found[own[0]]
            length = sum(model.occ.getMass(1, curves[i]) for i in own)
            others = np.delete(starts, own, axis=0)
            outside = np.any(np.linalg.norm(others - centre, axis=1) > radius)
            if outside and abs(length / (2 * np.pi * radius) - 1) < 1e-3:
                holes.append(Hole(centre, radius, [curves[i] for i in own]))
                for i in own:
                    del edges[i]
        pieces = [np.stack([x[:-1], x[1:]], axis=1) for x in edges.values()]
        return cls(holes, np.vstack([np.empty((0, 2, 3)), *pieces]))

    def clearance(self, point: np.ndarray, hole: Hole) -> float:
        """Distance of a point in the face's plane from the nearest edge, except those of a hole."""
        rims = [
            abs(float(np.linalg.norm(other.centre - point)) - other.radius)
            for other in self.holes
            if other is not hole
        ]
        start, along = self.pieces[:, 0], self.pieces[:, 1] - self.pieces[:, 0]
        length = np.maximum((along**2).sum(axis=1), 1e-300)
        share = np.clip(((point - start) * along).sum(axis=1) / length, 0, 1)
        beside = np.linalg.norm(start + share[:, None] * along - point, axis=1)
        return min([*rims, *beside], default=np.inf)


def _along(model, curve: int) -> np.ndarray:
    """Points along a curve, its ends included, shape (n, 3)."""
    (low,), (high,) = model.getParametrizationBounds(1, curve)
    n = 2 if model.getType(1, curve) == "Line" else 65
    at = np.linspace(low, high, n).tolist()
    return np.reshape(model.getValue(1, curve, at), (-1, 3))


def hole_pairs(lower: Outline, upper: Outline, pair: FacePair) -> list[tuple[Hole, Hole, float]]:
    """Holes of two faces that touch which hold each other's axis, and how far apart these are."""
    if not lower.holes or not upper.holes:
        return []
    below, above = (np.array([hole.centre for hole in each.holes]) for each in (lower, upper))
    apart = cdist(below, above - pair.gap * pair.normal)
    radii = np.minimum.outer([h.radius for h in lower.holes], [h.radius for h in upper.holes])
    found = np.argwhere(apart < radii)
    return [(lower.holes[i], upper.holes[j], float(apart[i, j])) for i, j in found]
