"""Where sensors, forces, masses and bolts are, and how far from the structure."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from fenics_joints.case import Case
from fenics_joints.case.harmonic import HarmonicSection
from fenics_joints.case.mesh import BoltsSection
from fenics_joints.case.sections import MassSection
from fenics_joints.case.test import Test
from fenics_joints.errors import InputError
from fenics_joints.measurements import MeasuredFRFs
from fenics_joints.meshes import TaggedMesh
from fenics_joints.meshes.arguments import ONE_BOLT
from fenics_joints.structure import Sensors
from fenics_joints.structure.points import (
    Nearest,
    far_points,
    nearest,
    round_bolts,
    too_close_together,
)

#: Nearer than this, m, a point is on the mesh but for round-off.
_ON = 1e-8
#: Sensors that span a smaller share of the structure are unlikely.
_SPAN = 0.1


@dataclass(frozen=True)
class CasePoint:
    """A point of a case.

    Attributes:
        kind: ``sensor``, ``force``, ``mass``, ``spring``, ``attached`` or ``bolt``; of what acts
            on a face ``obstacle``, ``displacement`` or ``load``.
        name: Its name.
        point: m, shape (3,).
        direction: Unit vector; None for what has none.
        off: Distance from the mesh, m; nan where it was not measured.
        spread: Whether it is put on the ring of a bolt whose hole it is in, see
            `fenics_joints.case.build`.
    """

    kind: str
    name: str
    point: tuple[float, ...]
    direction: tuple[float, ...] | None = None
    off: float = math.nan
    spread: bool = False

    def to_json(self) -> dict[str, object]:
        """Keys: kind, name, at_m, direction, off_mm."""
        return {
            "kind": self.kind,
            "name": self.name,
            "at_m": list(self.point),
            "direction": None if self.direction is None else list(self.direction),
            "off_mm": 1e3 * self.off if math.isfinite(self.off) else None,
        }


def places_of(case: Case) -> list[CasePoint]:
    """All points of a case but its bolts and the places of faces."""
    return list(_places(case))


def _places(case: Case) -> Iterator[CasePoint]:
    sensors, frfs = case.sensors(), case.frfs()
    if sensors is not None:
        names = sensors.names or [f"sensor {i + 1}" for i in range(len(sensors))]
        for name, point, way in zip(names, sensors.points, sensors.directions, strict=True):
            yield CasePoint("sensor", name, _three(point), _three(way))
    if frfs is not None:
        if case.test.sees is not None:
            yield from _responses(frfs, sensors)
        for i, (point, way) in enumerate(
            zip(frfs.reference_points, frfs.reference_directions, strict=True)
        ):
            yield CasePoint("force", f"force {i + 1}", _three(point), _three(way))
    if case.test is not None:
        yield from _besides(case.test)
    if case.harmonic is not None:
        yield from _harmonic(case.harmonic)
    tables = {"mass": case.masses, "spring": case.springs, "attached": case.attached}
    for kind, table in tables.items():
        for name, section in table.items():
            way = getattr(section, "direction", None)
            for label, point in section.labelled(name):
                spread = isinstance(section, MassSection) and section.travel is None
                yield CasePoint(kind, label, tuple(point), way, spread=spread)


def _responses(frfs: MeasuredFRFs, sensors: Sensors) -> Iterator[CasePoint]:
    """Responses of functions that are not among the test's sensors."""
    known = sensors.points
    rows = zip(frfs.response_names, frfs.response_points, frfs.response_directions, strict=True)
    for name, point, way in rows:
        if np.min(np.linalg.norm(known - point[: known.shape[1]], axis=1)) > _ON:
            yield CasePoint("sensor", name, _three(point), _three(way))


def _besides(test: Test) -> Iterator[CasePoint]:
    """Where single numbers were measured, and what was put on for a second test."""
    for key, table in (("stiffness", test.stiffness), ("antiresonances", test.antiresonances)):
        for name, at in table.items():
            yield CasePoint("force", f"test.{key}.{name}", _three(at.point), _three(at.direction))
    for name, changed in test.changed.items():
        for point in changed.points:
            yield CasePoint("mass", f"test.changed.{name}", _three(point))


def _harmonic(section: HarmonicSection) -> Iterator[CasePoint]:
    """Its forces, those that are at a place, and its sensor."""
    found = [(kind, f"harmonic.{kind}", getattr(section, kind)) for kind in ("force", "sensor")]
    found += [("force", f"harmonic.loads[{i}]", load) for i, load in enumerate(section.loads)]
    for kind, label, at in found:
        if at is not None:
            yield CasePoint(kind, label, tuple(at.point), tuple(at.direction))


def _three(vector: Sequence[float]) -> tuple[float, ...]:
    return (*map(float, vector), 0.0)[:3]


def far_places(
    places: Sequence[CasePoint], tagged: TaggedMesh
) -> tuple[list[CasePoint], list[str]]:
    """The places with their distance from the mesh, and what is wrong with them. Collective.

    What a test measured by hand may be near the mesh, masses and springs must be on it.
    """
    if not places:
        return [], []
    points = np.array([place.point for place in places], dtype=float)
    found, errors = nearest(tagged.mesh, points), []
    off = np.where(found.distance > _ON, found.distance, 0.0)
    heavy = np.flatnonzero([place.spread for place in places])
    for i, around in zip(heavy, round_bolts(tagged, points[heavy]), strict=True):
        if around is not None:
            off[i] = 0.0  # the mass is put on the ring
    for kind in dict.fromkeys(place.kind for place in places):
        own = np.flatnonzero([place.kind == kind for place in places])
        if kind == "sensor":
            try:
                too_close_together(tagged.mesh, points[own], kind)
            except InputError as error:
                errors.append(str(error))
                continue
        reach = found.reach[own] if kind in ("sensor", "force") else np.zeros(len(own))
        bad = off[own] > np.maximum(reach, _ON)
        if bad.any():
            at, names = own[bad], [places[i].name for i in own[bad]]
            near = Nearest(
                found.owner[at], found.cells[at], found.points[at], found.distance[at], reach[bad]
            )
            far = far_points(tagged.mesh, points[at], near, kind, names, points[own])
            errors.append(str(far))
    return [replace(p, off=float(d)) for p, d in zip(places, off, strict=True)], errors


def twice(places: Sequence[CasePoint]) -> list[str]:
    """Sensors at one place that look the same way; forgotten commas and copied rows."""
    seen: dict[tuple, list[str]] = {}
    for place in places:
        if place.kind == "sensor" and not place.name.startswith("harmonic."):
            key = tuple((np.round([*place.point, *place.direction], 6) + 0.0).tolist())
            seen.setdefault(key, []).append(place.name)
    return [
        f"{' and '.join(names)} are at one place, {list(key[:3])} m, in the same direction"
        for key, names in seen.items()
        if len(names) > 1
    ]


def close_together(places: Sequence[CasePoint], size: float) -> list[str]:
    """A sentence where the sensors see a small part of a structure of this size, m, alone."""
    points = {place.point for place in places if place.kind == "sensor"}
    if len(points) < 3:
        return []
    span = float(np.ptp(np.array(list(points)), axis=0).max())
    if span >= _SPAN * size:
        return []
    return [
        f"the {len(points)} places of sensors span {1e3 * span:.3g} mm of a structure of "
        f"{1e3 * size:.3g} mm: is the unit of their coordinates right?"
    ]


def bolts_of(
    case: Case, points: np.ndarray | None = None, centres: Mapping[str, np.ndarray] | None = None
) -> list[CasePoint]:
    """The bolts of a case.

    Args:
        case: The case.
        points: Those that its mesh knows, m, shape (n, 3); they count without ``[bolts]``.
        centres: Of the mesh's named faces, m.
    """
    if not case.bolts:
        return [CasePoint("bolt", f"bolt {i + 1}", _three(p)) for i, p in enumerate(_rows(points))]
    found = []
    for name, bolt in case.bolts.items():
        ends = [(centres or {}).get(face) for face in (bolt.lower, bolt.upper)]
        if all(end is not None for end in ends):
            found.append(CasePoint("bolt", name, _three(0.5 * (ends[0] + ends[1]))))
    return found


def _rows(points) -> np.ndarray:
    return np.empty((0, 3)) if points is None else np.atleast_2d(points)


def same_bolts(case: Case, bolts: Sequence[CasePoint]) -> list[str]:
    """A line for each two bolts at one place, of the file and of the mesh."""
    key, asked = "mesh.bolts", getattr(case.mesh, "bolts", None)
    if isinstance(asked, BoltsSection):
        key, asked = "mesh.bolts.at", asked.at
    asked = asked if isinstance(asked, list | tuple) else []
    listed = [
        CasePoint("bolt", f"{key}[{i}]", _three(point))
        for i, point in enumerate(asked)
        if isinstance(point, list | tuple)  # a builder may want their number
    ]
    own, of_mesh = (
        [b for b in bolts if (b.name in case.bolts) == named] for named in (True, False)
    )
    return [
        f"{a.name} and {b.name} are at one place, {(np.round(b.point, 6) + 0.0).tolist()} m (by "
        f"{1e3 * math.dist(a.point, b.point):.3g} mm); expected each bolt once"
        for found in (listed or of_mesh, own)
        for a, b in combinations(found, 2)
        if math.dist(a.point, b.point) < ONE_BOLT
    ]


def applied_places(case: Case, centres: Mapping[str, np.ndarray], gdim: int) -> Iterator[CasePoint]:
    """The middle of each face; of an obstacle its point nearest to the middle.

    Args:
        case: The case.
        centres: Of the mesh's named faces, m, shape (3,).
        gdim: Dimensions of the mesh.
    """
    for name, obstacle in case.obstacles.items():
        if obstacle.facets in centres:
            yield from _nearest(name, obstacle, centres[obstacle.facets][:gdim], gdim)
    ways = [("displacement", case.displacements, "value"), ("load", case.loads, "force")]
    for kind, table, key in ways:
        for name, section in table.items():
            way = np.array([v or 0.0 for v in getattr(section, key) or ()])
            if section.facets in centres:
                at = _three(centres[section.facets])
                unit = _three(way / np.linalg.norm(way)) if way.any() else None
                yield CasePoint(kind, name, at, unit)


def _nearest(name: str, obstacle, centre: np.ndarray, gdim: int) -> Iterator[CasePoint]:
    try:
        shape = obstacle.shape(f"obstacles.{name}", gdim)
    except InputError:
        return  # said where the model is made
    distance, normal = shape(centre[None])
    yield CasePoint("obstacle", name, _three(centre - distance[0] * normal[0]), _three(normal[0]))
