"""Where in its layers an effect can act: all over, at one joint, at one bolt, at a distance."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.cluster.hierarchy import DisjointSet

from fenics_joints.case.case import Case
from fenics_joints.diagnosis.zones.zone import Grading, Zone, Zones
from fenics_joints.meshes import TaggedMesh

#: Points of a builder that are axes of bolts.
_BOLT_POINTS = ("bolts", "bolt")

#: Groups of rings at most, as each has stiffnesses of its own. [decision: chosen]
_GROUPS = 4
#: Bolts closer than this, relative to the largest distance of a zone from its bolt, are one.
#: [numerical: chosen]
_SAME = 1e-3


@dataclass(frozen=True)
class LayerZone:
    """A zone of a layer before it is known which bolts and joints are one.

    Attributes:
        name: Its name.
        joint: The joint's.
        area: m2.
        bolt: Number of its bolt in the joint, from 1; 0 for a joint without.
        ring: Number of its ring, 1 the innermost.
        distance: Least and largest distance of its cells' middles from the bolt's axis, m.
        axis: A point on that axis, m, (3,).
        there: Whether that point is in the joint: bolts in line with others are others then.
        face: The parts that it holds together, where its joint has several such; else ``""``.
    """

    name: str
    joint: str
    area: float = np.nan
    bolt: int = 0
    ring: int = 0
    distance: tuple[float, float] = (np.nan, np.nan)
    axis: Sequence[float] = (np.nan,) * 3
    there: bool = False
    face: str = ""

    @property
    def place(self) -> str:
        """What it is a part of: its joint, or of a joint with several faces one of these."""
        return self.face or self.joint


def bolt_points(tagged: TaggedMesh) -> np.ndarray:
    """Points on the axes of a mesh's bolts, m, (n, 3)."""
    there = [np.atleast_2d(tagged.points[key]) for key in _BOLT_POINTS if key in tagged.points]
    points = np.vstack(there) if there else np.zeros((0, 3))
    return np.pad(points, [(0, 0), (0, 3 - points.shape[1])])


def placed(case: Case, rows: Sequence[LayerZone], tagged: TaggedMesh | None = None) -> Zones:
    """The zones of a case's layers with the places in which an effect can act.

    Args:
        case: The case, with a joint section for each zone.
        rows: The zones, joint by joint.
        tagged: Its mesh.
    """
    labels = _labels(case, rows)
    bolted = {row.name for row in rows if case.joints[row.name].bolted}
    groups = _groups(rows)
    zones = tuple(
        Zone(r.name, joint=r.joint, shown=r.joint, bolt=label, distance=r.distance, area=r.area)
        for r, label in zip(rows, labels, strict=True)
    )
    # Zones that are not under bolts: those of the joints that say so, else all but the innermost.
    away = tuple(
        r.name for r in rows if (r.name not in bolted if bolted else r.bolt and r.ring > 1)
    )
    gradings = (Grading("from zone to zone", groups),) if len(groups) > 1 else ()
    joints = _by(zip(rows, _held_together(rows, labels), strict=True))
    bolts = _by((row, label) for row, label in zip(rows, labels, strict=True) if label)
    places = _single({"joint": joints, "bolt": bolts}, away)
    return Zones(case, zones, tagged, None, places, away, gradings)


def _single(kinds: Mapping[str, Mapping[str, tuple[str, ...]]], away: tuple[str, ...]):
    """Zones of each single place by kind, where there are several, and no place twice."""
    seen, found = {frozenset(away)}, {}
    for kind, places in kinds.items():
        new = {k: zones for k, zones in places.items() if frozenset(zones) not in seen}
        if len(places) > 1 and new:
            found[kind] = new
            seen |= {frozenset(zones) for zones in new.values()}
    return found


def _by(pairs: Iterable[tuple[LayerZone, str]]) -> dict[str, tuple[str, ...]]:
    found: dict[str, tuple[str, ...]] = {}
    for row, label in pairs:
        found[label] = (*found.get(label, ()), row.name)
    return found


def _labels(case: Case, rows: Sequence[LayerZone]) -> list[str]:
    """The name of the bolt of each zone: bolts of several joints are one if they are in line."""
    scale = _SAME * max((r.distance[1] for r in rows if r.bolt), default=0.0)
    known: list[tuple[LayerZone, str]] = []
    labels = []
    for row in rows:
        if not row.bolt:
            labels.append("")
            continue
        normal = np.asarray(case.joints[row.name].normal, dtype=float)
        same = next((label for other, label in known if _is_one(row, other, normal, scale)), None)
        if same is None:
            same = f"bolt {row.bolt}"
            if same in (label for _, label in known):
                same = f"{row.joint} {same}"
            known.append((row, same))
        labels.append(same)
    return labels


def _is_one(a: LayerZone, b: LayerZone, normal: np.ndarray, scale: float) -> bool:
    """Whether two zones have the same bolt."""
    if a.joint == b.joint:
        return a.bolt == b.bolt
    off = np.asarray(a.axis, dtype=float) - np.asarray(b.axis, dtype=float)
    if a.there and b.there:
        return float(np.linalg.norm(off)) <= scale
    return _off(off, normal / np.linalg.norm(normal)) <= scale


def _off(vector: np.ndarray, normal: np.ndarray) -> float:
    """Length of a vector's part across a normal."""
    return float(np.linalg.norm(vector - (vector @ normal) * normal))


def _held_together(rows: Sequence[LayerZone], labels: Sequence[str]) -> list[str]:
    """For each zone the joints, or faces of one, that it is one with: those that share a bolt."""
    joints = list(dict.fromkeys(row.place for row in rows))
    one, first = DisjointSet(joints), {}
    for row, label in zip(rows, labels, strict=True):
        if label:
            one.merge(row.place, first.setdefault(label, row.place))
    return [", ".join(j for j in joints if one.connected(j, row.place)) for row in rows]


def _groups(rows: Sequence[LayerZone]) -> dict[str, tuple[str, ...]]:
    """Zones in a few groups by distance; a joint without bolts is a group of its own."""
    found = {row.joint: (row.name,) for row in rows if not row.bolt}
    bands = _bands(rows)
    parts = np.array_split(np.arange(len(bands)), _GROUPS)
    parts = [[name for k in part for name in bands[k]] for part in parts if len(part)]
    return {f"ring {i + 1}": tuple(part) for i, part in enumerate(parts)} | found


def _bands(rows: Sequence[LayerZone]) -> list[list[str]]:
    """Zones in bands of distances that do not overlap, from the bolts outwards."""
    bands, end = [], -np.inf
    for row in sorted((r for r in rows if r.bolt), key=lambda r: np.mean(r.distance)):
        if np.mean(row.distance) > end:
            bands.append([])
            end = row.distance[1]
        bands[-1].append(row.name)
    return bands
