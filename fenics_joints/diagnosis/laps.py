"""Laps of beams in zones along them, so that a diagnosis can say where."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fenics_joints.build_beams import ZonedLap
from fenics_joints.case import Case
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
        bolt: Number of the nearest bolt of each zone, from 0; of a lap without a bolt its own
            middle stands for one.
        distance: Mean distance of the zone's elements from it, m, (n,).
    """

    case: Case
    laps: tuple[ZonedLap, ...]
    names: tuple[str, ...]
    joint: tuple[str, ...]
    lap: tuple[str, ...]
    middle: np.ndarray
    bolt: tuple[int, ...]
    distance: np.ndarray

    @property
    def symmetric(self) -> dict[str, tuple[str, ...]]:
        """Zones by their distance from the bolts, the nearest first, by the group's name.

        Zones that are equally far, as on either side of a bolt, are in one group.
        """
        size = _SAME * max(float(np.ptp(self.middle)), 1e-12)
        groups: list[tuple[float, list[str]]] = []
        for i in np.argsort(self.distance, kind="stable"):
            if not groups or self.distance[i] > groups[-1][0] + size:
                groups.append((float(self.distance[i]), []))
            groups[-1][1].append(self.names[i])
        return {f"at {1e3 * d:.3g} mm": tuple(names) for d, names in groups}

    @property
    def by_lap(self) -> dict[str, tuple[str, ...]]:
        """Zones of each lap."""
        return _by(self.names, self.lap)

    @property
    def by_bolt(self) -> dict[str, tuple[str, ...]]:
        """Zones nearest to each bolt, by its name."""
        return _by(self.names, [f"bolt {b + 1}" for b in self.bolt])

    def shown(self) -> dict[str, str]:
        """What each zone, and each lap as a whole, is called where zones are shown as one."""
        return dict(zip(self.names, self.lap, strict=True)) | {p.name: p.name for p in self.laps}


def _by(names, labels) -> dict[str, tuple[str, ...]]:
    found: dict[str, tuple[str, ...]] = {}
    for name, label in zip(names, labels, strict=True):
        found[label] = (*found.get(label, ()), name)
    return found


def lap_zones(case: Case) -> LapZones | None:
    """Split the laps of a case with beams into zones of joint elements; None without laps.

    A lap of one joint section is split into five zones, or as many as it has elements, which are
    as good as equal and symmetric; one of several sections keeps these as its zones. Bolts are
    those of ``[joints.NAME] bolts``, else one in the middle of each lap.

    Raises:
        InputError: If a bolt is beside its lap, or a zone's name is taken.
    """
    mesh, starts = case.mesh, _starts(case)
    owners = {cell: name for name, joint in case.joints.items() for cell in joint.cells}
    laps, rows, sections = [], {}, {}
    bolts: list[float] = []
    for number, cells in enumerate(mesh.lap_cells()):
        length = mesh.of("laps")[number]
        joints = [owners[cell] for cell in cells]
        several = len(set(joints)) > 1
        alone = len(mesh.lap_cells()) == 1 or several
        label = _lap_name(cells, joints, several, len(case.joints[joints[0]].cells))
        zones = tuple(joints) if several else tuple(_split(label, len(cells)))
        places = starts[number] + length / len(cells) * (np.arange(len(cells)) + 0.5)
        own = _bolts(case, joints, starts[number], length, alone)
        for zone in dict.fromkeys(zones):
            there = np.array([z == zone for z in zones])
            x = places[there]
            away = np.abs(x[:, None] - np.array(own))
            nearest = int(np.argmin(away.mean(axis=0)))
            joint = joints[int(np.argmax(there))]
            sections[zone] = case.joints[joint].model_copy(
                update={"cells": [zone], "k_axial": None}
            )
            rows[zone] = (joint, label, x.mean(), len(bolts) + nearest, away[:, nearest].mean())
        bolts += own
        laps.append(ZonedLap(label, zones, case.joints[joints[0]].k_axial))
    if not laps:
        return None
    _check_names(case, sections)
    joint, lap, middle, bolt, distance = zip(*rows.values(), strict=True)
    return LapZones(
        case.model_copy(update={"joints": sections}), tuple(laps), tuple(rows), joint, lap,
        np.array(middle), bolt, np.array(distance),
    )  # fmt: skip


def _starts(case: Case) -> list[float]:
    """Where each lap starts, m."""
    mesh = case.mesh
    lengths, laps = np.array(mesh.lengths), np.array(mesh.of("laps"))
    return (np.cumsum(lengths[:-1]) - np.cumsum(laps)).tolist()


def _lap_name(cells, joints, several: bool, count: int) -> str:
    """The joint's name where it has no other lap; else the lap's."""
    if several:
        return "lap"
    return joints[0] if count == len(set(cells)) else cells[0]


def _split(label: str, n: int) -> list[str]:
    """Zone of each of n elements: as equal as can be, and the same from both ends."""
    count = min(n, _ZONES)
    edges = np.round(n / count * np.arange(count + 1)).astype(int)
    zone = np.repeat(np.arange(count), np.diff(edges))
    return [f"{label}_s{i + 1}" for i in zone]


def _bolts(case: Case, joints, start: float, length: float, alone: bool) -> list[float]:
    """Places of the bolts of a lap, m."""
    given = []
    for name in dict.fromkeys(joints):
        for i, point in enumerate(case.joints[name].bolts or ()):
            if start <= point[0] <= start + length:
                given.append(float(point[0]))
            elif alone:
                raise InputError(
                    f"{case.path}: joints.{name}.bolts[{i}] = {list(point)} m is beside the lap: "
                    f"expected x from {start:g} to {start + length:g} m"
                )
    return given or [start + length / 2]


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
