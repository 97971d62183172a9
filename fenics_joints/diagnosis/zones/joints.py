"""Thin layers of a case in zones around their bolts, so that a diagnosis can say where.

Every cell of a joint belongs to its nearest bolt, and to a ring of distances from that bolt's axis.
The rings of a joint share its area equally; their radii are the same at all of its bolts, so that
ring 2 means the same everywhere. Bolts share the cells that are half-way between them. Of bolts in
line, such as screws into both ends of a wall, each has what is nearest along their axis. A joint
that holds several pairs of parts has several faces, which can be compliant independently.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import dolfinx.mesh
import numpy as np
from scipy.cluster.hierarchy import DisjointSet
from scipy.spatial import cKDTree

from fenics_joints._compat import geometry_dofmap
from fenics_joints.case import Case
from fenics_joints.case.build import measured_joints
from fenics_joints.case.build_matrices import LAYER, MatrixMesh, as_layers, with_zones
from fenics_joints.case.sections import JointSection
from fenics_joints.diagnosis.zones.zone import (
    SAME,
    Zone,
    Zones,
    check_names,
    distinct_places,
    equal_shares,
)
from fenics_joints.errors import InputError
from fenics_joints.meshes import TaggedMesh
from fenics_joints.structure.grids import cell_volumes

#: Points of a builder that are axes of bolts.
_BOLT_POINTS = ("bolts", "bolt")

#: Groups of rings at most: each has its own stiffnesses. [decision: chosen]
_GROUPS = 4
#: Bolts closer than this, relative to the largest distance of a zone from its bolt, are one.
#: [numerical: chosen]
_SAME = 1e-3


def bolt_points(tagged: TaggedMesh) -> np.ndarray:
    """Points on the axes of a mesh's bolts, m, (n, 3)."""
    there = [np.atleast_2d(tagged.points[key]) for key in _BOLT_POINTS if key in tagged.points]
    points = np.vstack(there) if there else np.zeros((0, 3))
    return np.pad(points, [(0, 0), (0, 3 - points.shape[1])])


def bolt_labels(case: Case, bolts: Mapping[str, np.ndarray], scale: float) -> dict[str, list[str]]:
    """Names of each joint's bolts: bolts of several joints are one if they are in line.

    Those that the mesh knows are one only if they are at one place: screws into both ends of a wall
    are in line.

    Args:
        case: The case.
        bolts: Points on the axes of each joint's bolts, m, (n, 3).
        scale: Distance within which two are the same, m.
    """
    found: dict[str, list[str]] = {}
    known: list[tuple[str, np.ndarray, str]] = []

    def is_one(joint: str, point: np.ndarray, other: str, at: np.ndarray) -> bool:
        off, normal = point - at, _unit(case.joints[joint].normal)
        if any(case.joints[name].bolts is not None for name in (joint, other)):
            off = off - (off @ normal) * normal
        return joint != other and float(np.linalg.norm(off)) <= scale

    for joint, points in bolts.items():
        found[joint] = []
        for number, point in enumerate(np.asarray(points, dtype=float), start=1):
            same = next((label for *bolt, label in known if is_one(joint, point, *bolt)), None)
            if same is None:
                same = f"bolt {number}"
                if same in (label for *_, label in known):
                    same = f"{joint} {same}"
                known.append((joint, point, same))
            found[joint].append(same)
    return found


def with_places(case: Case, zones: Sequence[Zone], tagged: TaggedMesh | None = None) -> Zones:
    """The zones of a case's layers with the places in which an effect can act.

    Args:
        case: The case, with a joint section for each zone.
        zones: The zones, joint by joint; ``held`` is the joint of each, or the face of it.
        tagged: Its mesh.
    """
    faces = list(dict.fromkeys(zone.held for zone in zones))
    one, first = DisjointSet(faces), {}
    for zone in zones:
        if zone.bolt:
            one.merge(zone.held, first.setdefault(zone.bolt, zone.held))
    together = {f: ", ".join(each for each in faces if one.connected(each, f)) for f in faces}
    zones = tuple(replace(zone, held=together[zone.held]) for zone in zones)
    # Zones away from bolts: of joints that are not ``bolted`` if any is, else all outer rings.
    bolted = {zone.name for zone in zones if case.joints[zone.name].bolted}
    away = tuple(z.name for z in zones if (z.name not in bolted if bolted else z.ring > 1))
    groups = _groups(zones)
    gradings = {"from zone to zone": groups} if len(groups) > 1 else {}
    found = Zones(case, zones, tagged, away=away, gradings=gradings)
    kinds = {"joint": found.by("held"), "bolt": found.by("bolt")}
    return replace(found, places=distinct_places(kinds, away))


def _groups(zones: Sequence[Zone]) -> dict[str, tuple[str, ...]]:
    """Zones in a few groups by distance; each joint without bolts is a group."""
    bands: list[list[str]] = []  # of distances that do not overlap, from the bolts outwards
    end = -np.inf
    for zone in sorted((z for z in zones if z.bolt), key=lambda z: np.mean(z.distance)):
        if np.mean(zone.distance) > end:
            bands.append([])
            end = zone.distance[1]
        bands[-1].append(zone.name)
    found = {}
    for i, part in enumerate(np.array_split(np.arange(len(bands)), _GROUPS)):
        if len(part):
            found[f"ring {i + 1}"] = tuple(name for k in part for name in bands[k])
    return found | {zone.joint: (zone.name,) for zone in zones if not zone.bolt}


#: Rings of the joint with the largest area per bolt. [decision: chosen]
_RINGS = 4
#: Cells that a ring has at a bolt on average, at least. [numerical: chosen]
_CELLS = 2
#: Zones of a joint at most, as long as it has two rings: of many bolts each needs fewer.
#: [numerical: chosen for time]
_MOST = 64


@dataclass(frozen=True)
class _JointLayer:
    """Cells of a joint: local ones, and the middles and areas of all ranks' owned ones."""

    section: JointSection
    cells: np.ndarray
    local: np.ndarray
    middles: np.ndarray
    areas: np.ndarray
    low: np.ndarray
    high: np.ndarray

    def inside(self, point: np.ndarray, along: bool) -> bool:
        """Whether a point is in the joint's box in its plane, and if asked along its normal."""
        normal = np.abs(_unit(self.section.normal))
        room = self.high - self.low
        off = np.maximum(self.low - point, point - self.high)
        # Along the normal a layer is thin, and a bolt's point may lie on a face beside it.
        thin = float(normal @ room)
        good = (off <= SAME * room.max()) | (normal > 0.5)
        return bool(good.all() and (not along or np.all((off <= thin) | (normal <= 0.5))))


def joint_zones(case: Case, tagged: TaggedMesh) -> Zones:
    """Split the joints of a case by nearest bolt and by distance to it. Collective.

    Bolts are those of ``[joints.NAME] bolts``, else the mesh builder's that pass through the joint;
    a joint without any stays one zone. Of the joint with the largest area per bolt a bolt has
    `_RINGS` rings; others have fewer, so that all zones are about as large, and none has more than
    its cells allow.

    Args:
        case: The case; its joints are layers one cell thick.
        tagged: Its mesh.

    Returns:
        Zones named ``JOINT_b2_r1`` at bolt 2, ring 1 the innermost; ``JOINT_r1`` where there is one
        bolt; ``JOINT`` where there is none. A joint with a law of the user's own has no zones.

    Raises:
        InputError: If a bolt is outside its joint, or a zone's name is taken.
    """
    # Of layers the covered share.
    volumes = cell_volumes(tagged.mesh)
    if tagged.shares is not None:
        volumes = volumes * tagged.shares[: len(volumes)]
    case = _as_layers(measured_joints(case, tagged))
    own = {name: joint for name, joint in case.joints.items() if joint.own_law is not None}
    zoned = {name: joint for name, joint in case.joints.items() if name not in own}
    layers = {name: _layer(tagged, joint, volumes) for name, joint in zoned.items()}
    values = tagged.cell_tags.values.copy()
    sections, zones = {}, []
    names, first = dict(tagged.cell_names), max(tagged.cell_names.values())
    for zone, section, local in _all_zones(case, layers, bolt_points(tagged), tagged):
        zones.append(zone)
        sections[zone.name] = section
        if zone.bolt:
            for cells in layers[zone.joint].section.cells:
                names.pop(cells, None)
            first += 1
            names[zone.name] = first
            values[np.searchsorted(tagged.cell_tags.indices, local)] = first
    check_names(case, [zone.name for zone in zones], "a joint")
    tags = tagged.cell_tags
    new = dolfinx.mesh.meshtags(tagged.mesh, tags.dim, tags.indices, values)
    case = case.model_copy(update={"joints": sections | own})
    return with_places(case, zones, replace(tagged, cell_tags=new, cell_names=names))


def interface_zones(case: Case, mesh: MatrixMesh) -> tuple[Zones, MatrixMesh]:
    """The same of joints between parts by matrices; and their interfaces split likewise.

    Args:
        case: The case.
        mesh: Its parts and interfaces.
    """
    case = _as_layers(as_layers(case, mesh))
    own = {name: joint for name, joint in case.joints.items() if joint.own_law is not None}
    layers = {}
    for name, section in case.joints.items():
        if name not in own:
            there = mesh.interfaces[section.cells[0]]
            box = there.points.min(axis=0), there.points.max(axis=0)
            at, cells = there.points, np.arange(len(there.points))
            layers[name] = _JointLayer(section, cells, at, at, there.areas, *box)
    sections, zones, split = {}, [], {}
    for zone, section, local in _all_zones(case, layers, np.zeros((0, 3))):
        zones.append(zone)
        sections[zone.name] = section.model_copy(update={"meshed": LAYER})
        if zone.bolt:
            whole = layers[zone.joint].section.cells[0]
            mask = np.isin(np.arange(len(mesh.interfaces[whole].points)), local)
            split[zone.name] = whole, mask
    check_names(case, [zone.name for zone in zones], "a joint")
    case = case.model_copy(update={"joints": sections | own})
    return with_places(case, zones), with_zones(mesh, split)


def _all_zones(
    case: Case,
    layers: Mapping[str, _JointLayer],
    there: np.ndarray,
    tagged: TaggedMesh | None = None,
) -> Iterator[tuple[Zone, JointSection, np.ndarray]]:
    """Each zone with its section of the case and its local cells.

    Args:
        case: The case.
        layers: The joints.
        there: Points on the axes of bolts that the mesh knows, m, (n, 3).
        tagged: The mesh, by which a joint between several pairs of parts has several faces.
    """
    bolts = {name: _bolts(case, there, name, layer) for name, layer in layers.items()}
    bolts = {name: points for name, points in bolts.items() if len(points)}
    near = {name: _nearest(layers[name], points) for name, points in bolts.items()}
    farthest = max((float(distance.max()) for _, distance in near.values()), default=0.0)
    labels = bolt_labels(case, bolts, _SAME * farthest)
    per_bolt = {name: layers[name].areas.sum() / len(points) for name, points in bolts.items()}
    for name, layer in layers.items():
        if name not in bolts:
            area = float(layer.areas.sum())
            zone = Zone(name, joint=name, shown=name, held=name, area=area)
            yield zone, layer.section, layer.cells
            continue
        n = len(bolts[name])
        count = min(
            max(1, round(_RINGS * per_bolt[name] / max(per_bolt.values()))),
            max(1, len(layer.areas) // (_CELLS * n)),
            max(2, _MOST // n),
        )
        for zone, local in _split(case, tagged, name, layer, near[name], labels[name], count):
            update = {"cells": [zone.name], "bolts": None}
            yield zone, layer.section.model_copy(update=update), local


def _as_layers(case: Case) -> Case:
    """The case with its springs as layers that are as stiff: zones speak of moduli."""
    joints = {
        name: joint.model_copy(
            update={
                "law": "uncoupled",
                "E": joint.k_n * joint.meshed,
                "G": joint.k_t * joint.meshed,
                "k_n": None,
                "k_t": None,
                "meshed": None,
            }
        )
        if joint.law == "springs"
        else joint
        for name, joint in case.joints.items()
    }
    return case.model_copy(update={"joints": joints})


def _unit(normal) -> np.ndarray:
    return np.asarray(normal, dtype=float) / np.linalg.norm(normal)


def _layer(tagged: TaggedMesh, section: JointSection, volumes: np.ndarray) -> _JointLayer:
    mesh, comm = tagged.mesh, tagged.mesh.comm
    tags = [tagged.cell_tag(name) for name in section.cells]
    cells = np.sort(np.concatenate([tagged.cell_tags.find(t) for t in tags]))
    corners = mesh.geometry.x[geometry_dofmap(mesh)[cells]]
    middles = corners.mean(axis=1)
    thickness = np.ptp(corners @ _unit(section.normal), axis=1)
    own = cells < len(volumes)
    areas = volumes[cells[own]] / thickness[own]
    every = np.concatenate(comm.allgather(middles[own]))
    flat = corners.reshape(-1, 3)
    box = [flat.min(axis=0), flat.max(axis=0)] if len(cells) else []
    boxes = np.array([b for b in comm.allgather(box) if len(b)])
    return _JointLayer(
        section,
        cells,
        middles,
        every,
        np.concatenate(comm.allgather(areas)),
        boxes[:, 0].min(axis=0),
        boxes[:, 1].max(axis=0),
    )


def _bolts(case: Case, there: np.ndarray, name: str, layer: _JointLayer) -> np.ndarray:
    """Points on the axes of a joint's bolts, m, (n, 3), by default those that are there."""
    if layer.section.bolts is None:
        return there[[layer.inside(point, along=True) for point in there]]
    points = np.array(layer.section.bolts)
    for i, point in enumerate(points):
        if not layer.inside(point, along=False):
            raise InputError(
                f"{case.path}: joints.{name}.bolts[{i}] = {point.tolist()} m is outside the joint: "
                f"expected a point within {layer.low.tolist()} and {layer.high.tolist()}"
            )
    return points


def _split(
    case: Case,
    tagged: TaggedMesh | None,
    name: str,
    layer: _JointLayer,
    near: tuple[np.ndarray, np.ndarray],
    labels: Sequence[str],
    count: int,
) -> Iterator[tuple[Zone, np.ndarray]]:
    """The zones of a joint, each with its local cells.

    Args:
        case: The case.
        tagged: Its mesh.
        name: The joint.
        layer: Its cells.
        near: The nearest bolt of each, and its distance, m.
        labels: Names of its bolts.
        count: Rings at most.
    """
    nearest, distance = near
    ring = 1 + equal_shares(distance, layer.areas, count)
    # Places of this rank's cells, ghosts included, among the cells of all ranks.
    place = cKDTree(layer.middles).query(layer.local)[1] if len(layer.cells) else np.array([], int)
    faces = [""] * len(labels)
    if tagged is not None:
        faces = _faces(case, tagged, layer.cells, nearest[place], len(labels))
    for b, label in enumerate(labels):
        at = f"_b{b + 1}" if len(labels) > 1 else ""
        for r in range(1, ring.max() + 1):
            mask = (nearest == b) & (ring == r)
            if mask.any():
                zone = Zone(
                    f"{name}{at}_r{r}",
                    joint=name,
                    shown=name,
                    held=faces[b] or name,
                    bolt=label,
                    ring=r,
                    distance=(float(distance[mask].min()), float(distance[mask].max())),
                    area=float(layer.areas[mask].sum()),
                )
                yield zone, layer.cells[mask[place]]


def _faces(
    case: Case, tagged: TaggedMesh, cells: np.ndarray, bolt: np.ndarray, n_bolts: int
) -> list[str]:
    """The parts that a joint holds together at each of its bolts, in words; ``""`` where these are
    the same at all of them, or at none the same as at another. Collective.

    Args:
        case: The case.
        tagged: Its mesh.
        cells: This rank's cells of the joint.
        bolt: The nearest bolt of each.
        n_bolts: Number of bolts.
    """
    owner = {tagged.cell_tag(c): name for name, part in case.parts.items() for c in part.cells}
    topology, tags = tagged.mesh.topology, tagged.cell_tags
    facets, behind = topology.dim - 1, topology.dim
    topology.create_connectivity(behind, facets), topology.create_connectivity(facets, behind)
    to_facets = topology.connectivity(behind, facets)
    to_cells = topology.connectivity(facets, behind)
    cell_map = topology.index_map(behind)
    tag = np.full(cell_map.size_local + cell_map.num_ghosts, -1)
    tag[tags.indices] = tags.values
    touched: list[set[str]] = [set() for _ in range(n_bolts)]
    for cell, b in zip(cells, bolt, strict=True):
        beside = {int(c) for facet in to_facets.links(cell) for c in to_cells.links(facet)}
        touched[b] |= {owner[tag[c]] for c in beside if tag[c] in owner}
    every = tagged.mesh.comm.allgather(touched)
    held = [frozenset().union(*(part[b] for part in every)) for b in range(n_bolts)]
    if not 1 < len(set(held)) < n_bolts:
        return [""] * n_bolts
    return [" and ".join(name for name in case.parts if name in parts) for parts in held]


def _nearest(layer: _JointLayer, bolts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nearest bolt of all cells and its distance, m; of bolts in line that whose point is nearest,
    of equally near ones that with least area."""
    normal, off = _unit(layer.section.normal), layer.middles[:, None] - bolts
    along = off @ normal
    distances = np.linalg.norm(off - along[..., None] * normal, axis=2)
    least, along = distances.min(axis=1), np.abs(along)
    size = np.linalg.norm(layer.high - layer.low)
    near = distances <= least[:, None] + SAME * size
    along = np.where(near, along, np.inf)
    near = along <= along.min(axis=1)[:, None] + SAME * size
    nearest, tied = near.argmax(axis=1), near.sum(axis=1) > 1
    area = np.bincount(nearest[~tied], layer.areas[~tied], minlength=len(bolts)).astype(float)
    # By place, since their order depends on the number of ranks; the offset keeps off grid lines.
    cell = np.floor((layer.middles - layer.low) / (SAME * size) + 0.318)
    for i in np.lexsort(cell.T):
        if tied[i]:
            share = np.where(near[i], np.round(area / layer.areas.sum(), 9), np.inf)
            nearest[i] = share.argmin()
            area[nearest[i]] += layer.areas[i]
    return nearest, least
