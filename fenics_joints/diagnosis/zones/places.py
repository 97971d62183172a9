"""Where in its joints an effect can act: all over, at one joint, at one bolt, at a distance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fenics_joints.case import Case
from fenics_joints.diagnosis.zones.joints import JointZones

__all__ = ["JointPlaces", "joint_places"]

#: Groups of rings at most, as each has stiffnesses of its own.
_GROUPS = 4
#: Bolts closer than this, relative to the largest distance of a zone from its bolt, are one.
_SAME = 1e-3


@dataclass(frozen=True)
class JointPlaces:
    """The zones of a case's joints, by place.

    Attributes:
        zones: Names of all of them.
        joints: Zones of each joint on its own: layers that no bolt holds together with another.
        bolts: Zones of each bolt, by its name, such as ``bolt 2``; empty where no zone has a bolt.
        distance: Least and largest distance of each zone from its bolt, m, (n, 2); nan without.
        away: Zones away from the bolts, and their joints' names.
        groups: Zones by their distance from the bolts, in a few groups.
    """

    zones: tuple[str, ...]
    joints: dict[str, tuple[str, ...]]
    bolts: dict[str, tuple[str, ...]]
    distance: np.ndarray
    away: tuple[tuple[str, ...], tuple[str, ...]]
    groups: dict[str, tuple[str, ...]]

    @property
    def around(self) -> tuple[tuple[str, ...], np.ndarray]:
        """The zones that have a bolt, and their distances from it, m, (k, 2)."""
        there = np.isfinite(self.distance[:, 0])
        return tuple(np.array(self.zones, dtype=object)[there]), self.distance[there]

    def single(self) -> Mapping[str, Mapping[str, tuple[str, ...]]]:
        """Zones of each single place by kind, ``joint`` or ``bolt``, where there are several."""
        kinds = {"joint": self.joints, "bolt": self.bolts}
        seen, found = {frozenset(self.away[0])}, {}
        for kind, places in kinds.items():
            new = {k: zones for k, zones in places.items() if frozenset(zones) not in seen}
            if len(places) > 1 and new:
                found[kind] = new
                seen |= {frozenset(zones) for zones in new.values()}
        return found


def joint_places(case: Case, zones: JointZones | None) -> JointPlaces:
    """The places of a case's joints.

    Args:
        case: The case, with a joint section for each zone.
        zones: How its joints were split; None if they were not.
    """
    names = tuple(case.joints)
    bolted = {name for name, section in case.joints.items() if section.bolted}
    if zones is None:
        alone = {name: (name,) for name in names}
        away = tuple(n for n in names if n not in bolted) if bolted else ()
        nowhere = np.full((len(names), 2), np.nan)
        return JointPlaces(names, alone, {}, nowhere, (away, away), alone)
    labels = _labels(zones)
    away = _away(zones, bolted)
    owner = dict(zip(zones.names, zones.joint, strict=True))
    where = tuple(dict.fromkeys(owner[name] for name in away))
    bolts = _by(names, labels)
    bolts.pop("", None)
    joints = _by(names, _held_together(zones.joint, labels))
    return JointPlaces(names, joints, bolts, zones.distance, (away, where), _groups(zones))


def _by(names, labels) -> dict[str, tuple[str, ...]]:
    found: dict[str, tuple[str, ...]] = {}
    for name, label in zip(names, labels, strict=True):
        found[label] = (*found.get(label, ()), name)
    return found


def _labels(zones: JointZones) -> list[str]:
    """The name of the bolt of each zone: bolts of several joints are one if they are in line."""
    scale = _SAME * np.nanmax(zones.distance, initial=0.0)
    known: list[tuple[np.ndarray, str]] = []
    labels = []
    for label, joint, axis, name in zip(
        zones.bolt, zones.joint, zones.axis, zones.names, strict=True
    ):
        if not label:
            labels.append("")
            continue
        normal = np.asarray(zones.case.joints[name].normal, dtype=float)
        normal = normal / np.linalg.norm(normal)
        there = (_off(axis - point, normal) for point, _ in known)
        same = next((k for k, off in enumerate(there) if off <= scale), None)
        if same is None:
            words = f"bolt {label.removeprefix('b')}"
            taken = words in (other for _, other in known)
            known.append((axis, f"{joint} {words}" if taken else words))
            same = -1
        labels.append(known[same][1])
    return labels


def _off(vector: np.ndarray, normal: np.ndarray) -> float:
    """Length of a vector's part across a normal."""
    return float(np.linalg.norm(vector - (vector @ normal) * normal))


def _held_together(joints, labels) -> list[str]:
    """For each zone the joints that it is one with: those that share a bolt."""
    parent = {joint: joint for joint in joints}

    def root(joint):
        while parent[joint] != joint:
            joint = parent[joint]
        return joint

    first: dict[str, str] = {}
    for joint, label in zip(joints, labels, strict=True):
        if label:
            parent[root(joint)] = root(first.setdefault(label, joint))
    members = {}
    for joint in parent:
        members.setdefault(root(joint), []).append(joint)
    return [", ".join(members[root(joint)]) for joint in joints]


def _away(zones: JointZones, bolted: set[str]) -> tuple[str, ...]:
    """Zones that are not under bolts: those of the joints that say so, else all but the innermost
    rings."""
    if bolted:
        return tuple(name for name in zones.names if name not in bolted)
    rings = zip(zones.names, zones.bolt, zones.ring, strict=True)
    return tuple(name for name, bolt, ring in rings if bolt and ring > 1)


def _groups(zones: JointZones) -> dict[str, tuple[str, ...]]:
    """Zones in a few groups by distance; a joint without bolts is a group of its own."""
    found = {
        joint: (name,)
        for name, joint, bolt in zip(zones.names, zones.joint, zones.bolt, strict=True)
        if not bolt
    }
    bands = _bands(zones)
    parts = np.array_split(np.arange(len(bands)), _GROUPS)
    parts = [[name for k in part for name in bands[k]] for part in parts if len(part)]
    return {f"ring {i + 1}": tuple(part) for i, part in enumerate(parts)} | found


def _bands(zones: JointZones) -> list[list[str]]:
    """Zones in bands of distances that do not overlap, from the bolts outwards."""
    bands, end = [], -np.inf
    for k in np.argsort(zones.distance.mean(axis=1), kind="stable"):
        if not zones.bolt[k]:
            continue
        if zones.distance[k].mean() > end:
            bands.append([])
            end = zones.distance[k, 1]
        bands[-1].append(zones.names[k])
    return bands
