"""What a STEP file holds, before anything is meshed: solids, what touches, and holes for bolts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fenics_joints.errors import MeshError, located
from fenics_joints.meshes.cad_faces import (
    MM,
    TOUCH,
    FacePair,
    Hole,
    Outline,
    Report,
    find_contacts,
    hole_pairs,
    is_flat,
    nearest,
    no_report,
    surface_points,
)
from fenics_joints.meshes.cad_fasteners import find_fasteners, find_twins
from fenics_joints.meshes.gmsh_apart import gmsh_model
from fenics_joints.meshes.step_file import Place, Solids, import_solids

#: Distance, mm, up to which faces may belong together. Chosen: gaskets, paint and gaps of drawings
#: are thinner.
_REACH = 1.0
#: Ratio of the radii that are tried for a ring. Chosen: a radius is known to a tenth at best.
_STEP = 0.93
#: Least radius of a ring over its hole's. Chosen: heads of screws have 1.35 and more.
_LEAST = 1.15
#: Radius of a round face over its hole's up to which a head covers all of it. Chosen: heads and
#: washers have 1.35 to 2.8 (ISO 7093), and bosses are turned to fit them.
_COVERED = 3.0
#: Vertices of surfaces up to which they are meshed to be counted, in a second or two. Chosen.
_COUNTED = 1e5
_Z = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Solid:
    """A solid of a file; lengths in m.

    Attributes:
        label: What the file calls it; empty if nothing a person wrote.
        name: A name for a case.
        volume: m3.
        area: Of its surface, m2.
        box: Lowest and highest corner, m, shape (2, 3).
    """

    label: str
    name: str
    volume: float
    area: float
    box: np.ndarray


@dataclass(frozen=True)
class TouchingFaces:
    """Two flat faces, one upon the other; lengths in m.

    Attributes:
        solids: Indices of the two solids.
        normal: Unit normal from the first to the second, shape (3,).
        gap: Distance of the faces.
        area: That they have in common, m2.
    """

    solids: tuple[int, int]
    normal: np.ndarray
    gap: float
    area: float


@dataclass(frozen=True)
class Seat:
    """Where a bolt ends: under its head or nut, or its thread in a part; lengths in m.

    Attributes:
        kind: ``"flat"``; ``"cone"``, of a countersunk head; or ``"thread"``, the hole's wall.
        centre: On the axis, in the face's plane; shape (3,).
        point: On the face, in no hole of it; shape (3,).
        room: Radius of the largest circle in the face; 0 if the face itself is one that a head
            covers, or is no flat one.
    """

    kind: str
    centre: np.ndarray
    point: np.ndarray
    room: float = 0.0


@dataclass(frozen=True)
class ThroughHole:
    """Two round holes with one axis in two faces that touch: a bolt's; lengths in m.

    Attributes:
        touch: Index of the faces that touch.
        centre: On the first solid's face, shape (3,).
        diameters: Of the hole in the first solid and in the second.
        depths: How deep the two holes are.
        room: Largest radius of a ring around the hole that stays on both faces and meets no other
            hole, nor half way to the next bolt; 0 if there is none.
        seats: Where the bolt ends in the first solid and in the second; None where it goes on.
    """

    touch: int
    centre: np.ndarray
    diameters: tuple[float, float]
    depths: tuple[float, float]
    room: float
    seats: tuple[Seat | None, Seat | None]


@dataclass(frozen=True)
class LeftOut:
    """A solid that is no part of a model; lengths in m.

    Attributes:
        solid: Its index.
        kind: ``"bolt"``, ``"ring"`` (a nut or washer on one), or ``"twin"`` of another solid.
        centre: On the bolt's axis, shape (3,); of a twin, its middle.
        axis: The bolt's axis, shape (3,).
        radius: Of its hole.
    """

    solid: int
    kind: str
    centre: np.ndarray
    axis: np.ndarray
    radius: float = 0.0


@dataclass(frozen=True)
class StepSurvey:
    """A STEP file.

    Attributes:
        solids: In the order of the file.
        touching: Flat faces that touch, or nearly.
        holes: Those that a bolt may go through.
        left_out: Solids that neither touch nor have holes here: bolts, nuts, washers, twins.
    """

    solids: tuple[Solid, ...]
    touching: tuple[TouchingFaces, ...]
    holes: tuple[ThroughHole, ...]
    left_out: tuple[LeftOut, ...] = ()


def survey_step(path: str | Path, report: Report = no_report) -> StepSurvey:
    """Look into a STEP file. Needs gmsh, and no MPI.

    Args:
        path: The file.
        report: Progress callback.

    Raises:
        MeshError: As `read_step` for a file that it cannot read; or solids overlap.
    """
    path = Path(path)
    with located(path), gmsh_model({"Geometry.OCCTargetUnit": "MM"}) as model:
        found = import_solids(path, model, {})
        solids = tuple(
            _solid(model, tag, i, name)
            for i, (tag, name) in enumerate(zip(found.tags, found.names, strict=True), start=1)
        )
        twins = [LeftOut(i, "twin", solids[i].box.mean(0), _Z) for i, _ in find_twins(model, found)]
        own, kept = _without(found, twins)
        contacts = find_contacts(model, own, _REACH, report, tidy=False)
        if not contacts and len(kept) > 1:
            why = nearest(model, own, _REACH)
            if "overlap" in why:
                raise MeshError(why.removeprefix("; "))
        outlines = {face: Outline.of(model, face) for c in contacts for face in c.faces}
        pairs = _pairs(contacts, outlines)
        wider = [(contacts[i], max(a, b, key=lambda hole: hole.radius)) for i, a, b in pairs]
        fasteners = find_fasteners(model, own, contacts, wider)
        out = {fastener.solid for fastener in fasteners}
        contacts = [c for c in contacts if not out & {c.lower, c.upper}]
        through = _through(model, contacts, outlines, report)
    left_out = [
        *(LeftOut(kept[f.solid], f.kind, f.centre / MM, f.axis, f.radius / MM) for f in fasteners),
        *twins,
    ]
    touching = tuple(
        TouchingFaces((kept[c.lower], kept[c.upper]), c.normal, c.gap / MM, c.area / MM**2)
        for c in contacts
    )
    return StepSurvey(solids, touching, tuple(through), tuple(left_out))


def _without(found: Solids, out: list[LeftOut]) -> tuple[Solids, list[int]]:
    """The solids that are not left out, and their indices."""
    kept = [i for i in range(len(found.tags)) if i not in {o.solid for o in out}]
    return Solids([found.names[i] for i in kept], [found.tags[i] for i in kept]), kept


def count_vertices(
    path: str | Path, *, size: float, circle: int = 16, without: Sequence[Place] = ()
) -> float:
    """About how many vertices the mesh of a STEP file has, also where its solids cannot be joined.

    Surfaces are meshed, each solid's on its own; vertices inside come from the volume.

    Args:
        path: The file.
        size: Largest size of a cell, m.
        circle: Edges of a circle.
        without: Solids that are left out; points in m.

    Raises:
        MeshError: As `read_step` for a file that it cannot read.
    """
    path = Path(path)
    options = {
        "Geometry.OCCTargetUnit": "MM",
        "Mesh.MeshSizeMax": size * MM,
        "Mesh.MeshSizeFromCurvature": circle,
    }
    with located(path), gmsh_model(options) as model:
        places = [p if isinstance(p, str | int) else np.array(p) * MM for p in without]
        tags = import_solids(path, model, {}, places).tags
        volume = sum(model.occ.getMass(3, tag) for tag in tags)
        area = sum(model.occ.getMass(2, face) for _, face in model.getEntities(2))
        inside, around = 1.41 * volume / (size * MM) ** 3, 0.58 * area / (size * MM) ** 2
        if around > _COUNTED:
            return inside + around
        try:
            model.mesh.generate(2)
        except Exception as error:
            raise MeshError(f"gmsh cannot mesh its faces: {error}") from error
        return max(inside - around, 0.0) + len(model.mesh.getNodes()[0])


def _solid(model, tag: int, number: int, name: str) -> Solid:
    label = model.getEntityName(3, tag).rpartition("/")[2].strip()
    plain = "" if "CASCADE" in label or not any(c.isalpha() for c in label) else label
    faces = model.getBoundary([(3, tag)], oriented=False)
    area = sum(model.occ.getMass(2, face) for _, face in faces)
    box = np.array(model.getBoundingBox(3, tag)).reshape(2, 3) / MM
    name = name if plain else f"solid_{number}"
    return Solid(plain, name, model.occ.getMass(3, tag) / MM**3, area / MM**2, box)


def _pairs(contacts: list[FacePair], outlines) -> list[tuple[int, Hole, Hole]]:
    """Index of a contact, and two holes with one axis in its faces."""
    return [
        (i, a, b)
        for i, contact in enumerate(contacts)
        for a, b, apart in hole_pairs(*map(outlines.get, contact.faces), contact)
        if apart <= TOUCH
    ]


def _through(model, contacts: list[FacePair], outlines, report: Report) -> list[ThroughHole]:
    """Pairs of holes with one axis, and how large rings around them may be."""
    pairs = _pairs(contacts, outlines)
    taken = {face for i, _, _ in pairs for face in contacts[i].faces}
    places, found = np.array([a.centre for _, a, _ in pairs]).reshape(-1, 3), []
    for n, (i, a, b) in enumerate(pairs):
        if n % 20 == 0:
            report("pairs of holes", n, len(pairs))
        contact = contacts[i]
        between = places - a.centre
        distance = np.linalg.norm(between, axis=1)
        others = distance[(np.abs(between @ contact.normal) < TOUCH) & (distance > TOUCH)]
        most = 0.98 * min(others / 2, default=np.inf)
        room = _room(contact, [outlines[face] for face in contact.faces], (a, b), most)
        sides = list(zip(contact.faces, (a, b), strict=True))
        depths = tuple(_depth(model, face, hole.curves, contact.normal) for face, hole in sides)
        seats = tuple(_seat(model, face, hole, contact.normal, taken) for face, hole in sides)
        diameters = 2 * a.radius / MM, 2 * b.radius / MM
        found.append(
            ThroughHole(
                i, a.centre / MM, diameters, tuple(d / MM for d in depths), room / MM, seats
            )
        )
    return found


def _room(
    contact: FacePair, outlines: list[Outline], pair: tuple[Hole, Hole], most: float
) -> float:
    """Largest radius of a ring on both faces, mm; it meets no edge and no other hole."""
    inner = max(hole.radius for hole in pair)
    clear = min(
        outline.clearance(pair[0].centre + lift * contact.normal, hole)
        for outline, hole, lift in zip(outlines, pair, (0.0, contact.gap), strict=True)
    )
    least, most = _LEAST * inner, min(most, 6 * inner)
    radius, best = inner * 1.05, 0.0
    while radius < most:
        if 1.02 * radius > clear:
            return best if best >= least else 0.0
        best, radius = radius, radius / _STEP
    best = max(best, most * _STEP) if best else 0.0
    return best if best >= least else 0.0


def _seat(model, face: int, hole: Hole, normal: np.ndarray, taken: set[int]) -> Seat | None:
    """Where a bolt ends in a solid, seen from one of its faces; not on faces that are taken."""
    walls = _walls(model, face, hole.curves)
    edges = {abs(c) for w in walls for _, c in model.getBoundary([(2, w)], oriented=False)}
    beyond = {int(f) for c in edges for f in model.getAdjacencies(1, c)[0]} - walls - {face}
    for other in sorted(beyond):
        if not is_flat(model, other):
            points = surface_points(model, other)
            away = np.linalg.norm(np.cross(points - hole.centre, normal), axis=1)
            if away.min() > 0.9 * hole.radius and away.max() > _LEAST * hole.radius:
                return Seat("cone", hole.centre / MM, points[len(points) // 2] / MM)
            continue
        outline = Outline.of(model, other)
        for end in outline.holes:
            beside = np.cross(end.centre - hole.centre, normal)
            if np.linalg.norm(beside) > TOUCH:
                continue
            if other in taken:
                return None
            across = np.linalg.svd(normal[None])[2][1]
            room = outline.clearance(end.centre, end)
            rim = np.linalg.norm(outline.pieces.reshape(-1, 3) - end.centre, axis=1)
            covered = np.ptp(rim) < TOUCH and room < _COVERED * end.radius
            place = end.centre + 0.5 * (end.radius + room) * across
            return Seat("flat", end.centre / MM, place / MM, 0.0 if covered else room / MM)
    wall = min(walls, default=None)
    if wall is None:
        return None
    points = surface_points(model, wall)
    return Seat("thread", hole.centre / MM, points[len(points) // 2] / MM)


def _walls(model, face: int, edge: list[int]) -> set[int]:
    """The round walls of a hole, that meet its edge in a face."""
    walls = {int(wall) for curve in edge for wall in model.getAdjacencies(1, curve)[0]} - {face}
    return {wall for wall in walls if not is_flat(model, wall)}


def _depth(model, face: int, edge: list[int], normal: np.ndarray) -> float:
    """How deep a hole is: the extent along the normal of the walls that meet its edge, mm."""
    walls = _walls(model, face, edge)
    return max((_extent(model, wall, normal) for wall in walls), default=0.0)


def _extent(model, wall: int, normal: np.ndarray) -> float:
    heights = []
    for _, curve in model.getBoundary([(2, wall)], oriented=False):
        (low,), (high,) = model.getParametrizationBounds(1, curve)
        for t in (low, (low + high) / 2, high):
            heights.append(np.array(model.getValue(1, curve, [t])) @ normal)
    return float(max(heights) - min(heights)) if heights else 0.0
