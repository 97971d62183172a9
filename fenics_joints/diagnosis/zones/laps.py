"""Laps of beams in zones along them, so that a diagnosis can say where."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from fenics_joints.case import Case
from fenics_joints.case.build_beams import ZonedLap, lap_axial, lap_name
from fenics_joints.diagnosis.zones.zone import (
    GIVEN_LAP,
    LAP,
    SAME,
    Zone,
    Zones,
    check_names,
    distinct_places,
)
from fenics_joints.errors import InputError

#: Zones of a lap at most. [decision: chosen]
_ZONES = 5


def lap_zones(case: Case) -> Zones:
    """Split the laps of a case with beams into zones of joint elements.

    A lap of one joint section is split into five zones, or as many as it has elements, which are
    as good as equal and symmetric; one of several sections keeps these as its zones. Bolts are
    those of ``[joints.NAME] bolts``, else one in the middle of each lap that is ``bolted``.

    Raises:
        InputError: If a bolt is beside its lap, a zone's name is taken, or a lap of several
            sections has an axial stiffness.
    """
    owners = {cell: name for name, joint in case.joints.items() for cell in joint.cells}
    laps, found, sections = [], {}, {}
    bolts: list[float] = []
    middles: list[float] = []
    interface = LAP if case.diagnose.joints == "bonded" else GIVEN_LAP
    _check_bolts(case)
    for cells, start, length in _laps(case):
        joints = [owners[cell] for cell in cells]
        label = lap_name(case, cells, joints)
        zones = tuple(joints) if len(set(joints)) > 1 else tuple(_split(label, len(cells)))
        places = start + length / len(cells) * (np.arange(len(cells)) + 0.5)
        own = _bolts(case, joints, start, length)
        for number, zone in enumerate(dict.fromkeys(zones)):
            there = np.array([z == zone for z in zones])
            joint = joints[int(np.argmax(there))]
            away = np.abs(places[there, None] - np.array(own or [start + length / 2]))
            i = int(np.argmin(away.mean(axis=0)))
            # On average: a zone's elements on both sides of a bolt are as far as the mean of them.
            distance = float(away[:, i].mean())
            found[zone] = Zone(
                zone,
                interface,
                joint=joint,
                shown=label,
                distance=(distance, distance),
                bolt=f"bolt {len(bolts) + i + 1}" if own else "",
                label=f"{label} stretch {number + 1}" if zone == _zone(label, number) else zone,
            )
            middles.append(places[there].mean())
            update = {"cells": [zone], "k_axial": None}
            sections[zone] = case.joints[joint].model_copy(update=update)
        bolts += own
        laps.append(ZonedLap(label, zones, _axial(case, joints)))
    if not laps:
        return Zones(case, laps=())
    check_names(case, sections, "a lap")
    origin = "bolt" if bolts else "middle of the lap"
    zoned = Zones(
        case.model_copy(update={"joints": sections}),
        tuple(found.values()),
        laps=tuple(laps),
        gradings=_gradings(found.values(), float(np.ptp(middles)), origin),
        bolts=np.column_stack([bolts, np.zeros((len(bolts), 2))]),
    )
    return replace(zoned, places=distinct_places({"lap": zoned.by("shown")}))


def _gradings(zones: Collection[Zone], size: float, origin: str) -> dict[str, dict]:
    """By the distance from the bolts, those equally far on either side together; and each alone."""
    groups: list[tuple[float, list[str]]] = []
    for zone in sorted(zones, key=lambda zone: zone.distance[0]):
        if not groups or zone.distance[0] > groups[-1][0] + SAME * max(size, 1e-12):
            groups.append((zone.distance[0], []))
        groups[-1][1].append(zone.name)
    symmetric = {f"at {1e3 * d:.4g} mm": tuple(names) for d, names in groups}
    found = {f"by the distance from the {origin}": symmetric} if len(symmetric) > 1 else {}
    if len(zones) > len(symmetric):
        found["zone by zone"] = {zone.label: (zone.name,) for zone in zones}
    return found


def _laps(case: Case) -> list[tuple[Sequence[str], float, float]]:
    """Cells of each lap, where it starts, and its length, m."""
    lengths, laps = np.array(case.mesh.lengths), case.mesh.of("laps")
    starts = np.cumsum(lengths[:-1]) - np.cumsum(laps)
    return list(zip(case.mesh.lap_cells(), starts.tolist(), laps, strict=True))


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


def _check_bolts(case: Case) -> None:
    """Every bolt has to be in a lap of its joint."""
    for name, section in case.joints.items():
        own = set(section.cells)
        laps = [(start, start + length) for cells, start, length in _laps(case) if own & set(cells)]
        for i, point in enumerate(section.bolts or ()):
            if not any(start <= point[0] <= end for start, end in laps):
                where = " or ".join(f"{start:g} to {end:g}" for start, end in laps)
                raise InputError(
                    f"{case.path}: joints.{name}.bolts[{i}] = {list(point)} m is beside the lap: "
                    f"expected x from {where} m"
                )


def lap_as_one(case: Case, zones: Zones, values: Mapping[str, float]) -> dict[str, float]:
    """k1 and k2, N m, of the joint elements of each zone if its two beams were one piece.

    The bending and shear stiffness of both sections about their common neutral axis, in eq. 2 of
    Jalali et al. 2019 (see `fenics_joints.beams.element`).

    Args:
        case: The case.
        zones: Its laps in zones.
        values: Values of the parts' parameters; or many of each, (b,).
    """
    mesh, found = case.mesh, {}
    owners = {cell: name for name, part in case.parts.items() for cell in part.cells}
    sizes = list(zip(mesh.of("width"), mesh.of("thickness"), strict=True))
    for i, (lap, length) in enumerate(zip(zones.laps, mesh.of("laps"), strict=True)):
        L = length / len(lap.zones)
        sections = []
        for j in (i, i + 1):
            part = owners[f"beam_{j + 1}"]
            b, h = sizes[j]
            b, h = b * values.get(f"{part}.width", 1.0), h * values[f"{part}.thickness"]
            side = h / 2 if j == i else -h / 2
            E, nu = values[f"{part}.E"], values[f"{part}.nu"]
            sections.append((E * b * h, E * b * h**3 / 12, side, E / (2 * (1 + nu)) * b * h))
        EA, EI, q, GA = (np.array(np.broadcast_arrays(*of)) for of in zip(*sections, strict=True))
        axis = (EA * q).sum(axis=0) / EA.sum(axis=0)
        whole = EI.sum(axis=0) + (EA * (q - axis) ** 2).sum(axis=0)
        phi = 12 * whole * mesh.shear / (GA.sum(axis=0) * L**2)
        for zone in dict.fromkeys(lap.zones):
            found[f"{zone}.k1"] = 3 * whole / ((1 + phi) * L)
            found[f"{zone}.k2"] = whole / L
    return found
