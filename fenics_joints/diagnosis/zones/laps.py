"""Laps of beams in zones along them, so that a diagnosis can say where."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fenics_joints.case import Case
from fenics_joints.case.build_beams import ZonedLap, lap_axial, lap_name
from fenics_joints.errors import InputError

__all__ = ["LapZones", "lap_as_one", "lap_zones"]

#: Zones of a lap at most.
_ZONES = 5
#: Distances from the bolt closer than this, relative to the lap, are equal by symmetry.
_SAME = 1e-3


@dataclass(frozen=True)
class LapZones:
    """A case with the joint elements of its laps in zones.

    Attributes:
        case: The case with a joint section for each zone.
        laps: Its laps, by which zone each of their elements is in.
        names: Names of the zones: ``JOINT_s2`` is the second from the left.
        joint: Name of the original joint of each zone.
        lap: Name of the lap of each zone.
        middle: Places of the middles of the zones' elements, m, on average, (n,).
        bolts: Places of the bolts, m, ascending, (n_bolts,).
        bolt: Number of the nearest bolt of the same lap of each zone, from 0; -1 without one.
        distance: Mean distance of the zone's elements from it, m, (n,); from the middle of a lap
            that has no bolt.
    """

    case: Case
    laps: tuple[ZonedLap, ...]
    names: tuple[str, ...]
    joint: tuple[str, ...]
    lap: tuple[str, ...]
    middle: np.ndarray
    bolts: np.ndarray
    bolt: tuple[int, ...]
    distance: np.ndarray

    @property
    def symmetric(self) -> dict[str, tuple[str, ...]]:
        """Zones by their `distance`, the nearest first, by the group's name.

        Zones that are equally far, as on either side of a bolt, are in one group.
        """
        size = _SAME * max(float(np.ptp(self.middle)), 1e-12)
        groups: list[tuple[float, list[str]]] = []
        for i in np.argsort(self.distance, kind="stable"):
            if not groups or self.distance[i] > groups[-1][0] + size:
                groups.append((float(self.distance[i]), []))
            groups[-1][1].append(self.names[i])
        return {f"at {1e3 * d:.4g} mm": tuple(names) for d, names in groups}

    @property
    def by_lap(self) -> dict[str, tuple[str, ...]]:
        """Zones of each lap."""
        return _by(self.names, self.lap)

    @property
    def by_bolt(self) -> dict[str, tuple[str, ...]]:
        """Zones nearest to each bolt, by its name."""
        near = [(n, f"bolt {b + 1}") for n, b in zip(self.names, self.bolt, strict=True) if b >= 0]
        return _by(*zip(*near, strict=True)) if near else {}

    @property
    def words(self) -> dict[str, str]:
        """What each zone is called in the names of parameters: ``lap stretch 2``."""
        found = {}
        for lap in self.laps:
            for i, zone in enumerate(dict.fromkeys(lap.zones)):
                split = zone == _zone(lap.name, i)
                found[zone] = f"{lap.name} stretch {i + 1}" if split else zone
        return found

    def shown(self) -> dict[str, str]:
        """What each zone, and each lap along the beams, is called where zones are shown as one."""
        return dict(zip(self.names, self.lap, strict=True)) | {p.along: p.name for p in self.laps}


def _by(names, labels) -> dict[str, tuple[str, ...]]:
    found: dict[str, tuple[str, ...]] = {}
    for name, label in zip(names, labels, strict=True):
        found[label] = (*found.get(label, ()), name)
    return found


def lap_zones(case: Case) -> LapZones | None:
    """Split the laps of a case with beams into zones of joint elements; None without laps.

    A lap of one joint section is split into five zones, or as many as it has elements, which are
    as good as equal and symmetric; one of several sections keeps these as its zones. Bolts are
    those of ``[joints.NAME] bolts``, else one in the middle of each lap that is ``bolted``.

    Raises:
        InputError: If a bolt is beside its lap, a zone's name is taken, or a lap of several
            sections has an axial stiffness.
    """
    owners = {cell: name for name, joint in case.joints.items() for cell in joint.cells}
    laps, rows, sections = [], {}, {}
    bolts: list[float] = []
    _check_bolts(case, owners)
    for cells, (start, length) in zip(case.mesh.lap_cells(), _laps(case), strict=True):
        joints = [owners[cell] for cell in cells]
        label = lap_name(case, cells, joints)
        zones = tuple(joints) if len(set(joints)) > 1 else tuple(_split(label, len(cells)))
        places = start + length / len(cells) * (np.arange(len(cells)) + 0.5)
        own = _bolts(case, joints, start, length)
        for zone in dict.fromkeys(zones):
            there = np.array([z == zone for z in zones])
            joint = joints[int(np.argmax(there))]
            away = np.abs(places[there, None] - np.array(own or [start + length / 2]))
            i = int(np.argmin(away.mean(axis=0)))
            number = len(bolts) + i if own else -1
            rows[zone] = (joint, label, places[there].mean(), number, away[:, i].mean())
            update = {"cells": [zone], "k_axial": None}
            sections[zone] = case.joints[joint].model_copy(update=update)
        bolts += own
        laps.append(ZonedLap(label, zones, _axial(case, joints)))
    if not laps:
        return None
    _check_names(case, sections)
    joint, lap, middle, bolt, distance = zip(*rows.values(), strict=True)
    return LapZones(
        case.model_copy(update={"joints": sections}), tuple(laps), tuple(rows), joint, lap,
        np.array(middle), np.array(bolts), bolt, np.array(distance),
    )  # fmt: skip


def _laps(case: Case) -> list[tuple[float, float]]:
    """Where each lap starts, and its length, m."""
    lengths, laps = np.array(case.mesh.lengths), case.mesh.of("laps")
    starts = np.cumsum(lengths[:-1]) - np.cumsum(laps)
    return list(zip(starts.tolist(), laps, strict=True))


def _axial(case: Case, joints) -> float | None:
    try:
        return lap_axial(case, joints)
    except InputError as error:
        raise InputError(f"{case.path}: {error}") from error


def _zone(label: str, i: int) -> str:
    return f"{label}_s{i + 1}"


def _split(label: str, n: int) -> list[str]:
    """Zone of each of n elements: as equal as can be, and the same from both ends."""
    count = min(n, _ZONES)
    edges = np.round(n / count * np.arange(count + 1)).astype(int)
    zone = np.repeat(np.arange(count), np.diff(edges))
    return [_zone(label, i) for i in zone]


def _bolts(case: Case, joints, start: float, length: float) -> list[float]:
    """Places of the bolts of a lap, m; one in its middle if it is bolted and says no more."""
    own = [case.joints[name] for name in dict.fromkeys(joints)]
    given = {float(point[0]) for section in own for point in section.bolts or ()}
    found = sorted(x for x in given if start <= x <= start + length)
    return found or ([start + length / 2] if any(section.bolted for section in own) else [])


def _check_bolts(case: Case, owners: Mapping[str, str]) -> None:
    """Every bolt has to be in a lap of its joint."""
    for name, section in case.joints.items():
        laps = [
            lap for cells, lap in zip(case.mesh.lap_cells(), _laps(case), strict=True)
            if name in {owners[cell] for cell in cells}
        ]  # fmt: skip
        for i, point in enumerate(section.bolts or ()):
            if not any(start <= point[0] <= start + length for start, length in laps):
                where = " or ".join(f"{start:g} to {start + length:g}" for start, length in laps)
                raise InputError(
                    f"{case.path}: joints.{name}.bolts[{i}] = {list(point)} m is beside the lap: "
                    f"expected x from {where} m"
                )


def _check_names(case: Case, zones) -> None:
    tables = ("parts", "masses", "springs", "attached", "supports")
    taken = {name for table in tables for name in getattr(case, table)}
    for zone in zones:
        if zone in taken:
            raise InputError(
                f"{case.path}: the name {zone!r} is needed for a zone of a lap; expected no other "
                "section of that name"
            )


def lap_as_one(case: Case, laps: LapZones, values: Mapping[str, float]) -> dict[str, float]:
    """k1 and k2, N m, of the joint elements of each zone if its two beams were one piece.

    The bending and shear stiffness of both sections about their common neutral axis, in eq. 2 of
    seed 002 (see `fenics_joints.beams.element`).

    Args:
        case: The case.
        laps: Its laps.
        values: Values of the parts' parameters.
    """
    mesh, found = case.mesh, {}
    owners = {cell: name for name, part in case.parts.items() for cell in part.cells}
    sizes = list(zip(mesh.of("width"), mesh.of("thickness"), strict=True))
    for i, (lap, length) in enumerate(zip(laps.laps, mesh.of("laps"), strict=True)):
        L = length / len(lap.zones)
        sections = []
        for j in (i, i + 1):
            part = owners[f"beam_{j + 1}"]
            b, h = sizes[j]
            b, h = b * values.get(f"{part}.width", 1.0), h * values[f"{part}.thickness"]
            side = h / 2 if j == i else -h / 2
            E, nu = values[f"{part}.E"], values[f"{part}.nu"]
            sections.append((E * b * h, E * b * h**3 / 12, side, E / (2 * (1 + nu)) * b * h))
        EA, EI, q, GA = np.array(sections).T
        axis = EA @ q / EA.sum()
        whole = EI.sum() + EA @ (q - axis) ** 2
        phi = 12 * whole * mesh.shear / (GA.sum() * L**2)
        for zone in dict.fromkeys(lap.zones):
            found[f"{zone}.k1"] = float(3 * whole / ((1 + phi) * L))
            found[f"{zone}.k2"] = float(whole / L)
    return found
