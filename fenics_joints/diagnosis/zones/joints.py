"""Thin layers of a case in zones around their bolts, so that a diagnosis can say where.

Every cell of a joint belongs to its nearest bolt, and to a ring of distances from that bolt's axis.
The rings of a joint share its area equally; their radii are the same at all of its bolts, so that
ring 2 means the same everywhere. Bolts share the cells that are half-way between them. Of bolts in
line, such as screws into both ends of a wall, each has what is nearest along their axis. A joint
that holds several pairs of parts is several faces, which can give way each by itself.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import dolfinx.mesh
import numpy as np
import ufl
from dolfinx import fem
from scipy.cluster.hierarchy import DisjointSet
from scipy.spatial import cKDTree

from fenics_joints._compat import geometry_dofmap
from fenics_joints.case import Case
from fenics_joints.case.build import measured_joints
from fenics_joints.case.sections import JointSection
from fenics_joints.diagnosis.zones.zone import SAME, Grading, Zone, Zones, check_names
from fenics_joints.errors import InputError
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
    """Zones of each distinct location, grouped by kind."""
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

    def distances(self, middles: np.ndarray, bolts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance of middles, (n, 3), from the bolts' axes and, along them, from their points, m,
        each (n, n_bolts)."""
        normal = _unit(self.section.normal)
        off = middles[:, None] - bolts
        along = off @ normal
        return np.linalg.norm(off - along[..., None] * normal, axis=2), np.abs(along)


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
        bolt; ``JOINT`` where there is none.

    Raises:
        InputError: If a bolt is outside its joint, or a zone's name is taken.
    """
    volumes = _cell_volumes(tagged)
    case = _as_layers(measured_joints(case, tagged))
    layers = {name: _layer(tagged, joint, volumes) for name, joint in case.joints.items()}
    bolts = {name: _bolts(case, tagged, name, layer) for name, layer in layers.items()}
    per_bolt = {n: layers[n].areas.sum() / len(b) for n, b in bolts.items() if len(b)}
    largest = max(per_bolt.values(), default=0.0)
    values = tagged.cell_tags.values.copy()
    sections, rows = {}, []
    names, first = dict(tagged.cell_names), max(tagged.cell_names.values())
    for name, layer in layers.items():
        if not len(bolts[name]):
            sections[name] = layer.section
            rows.append(LayerZone(name, name, area=float(layer.areas.sum())))
            continue
        count = min(
            max(1, round(_RINGS * per_bolt[name] / largest)),
            max(1, len(layer.areas) // (_CELLS * len(bolts[name]))),
            max(2, _MOST // len(bolts[name])),
        )
        split = _split(case, tagged, name, layer, bolts[name], count)
        for cells in layer.section.cells:
            del names[cells]
        for row, local in split:
            first += 1
            names[row.name] = first
            values[np.searchsorted(tagged.cell_tags.indices, local)] = first
            update = {"cells": [row.name], "bolts": None}
            sections[row.name] = layer.section.model_copy(update=update)
            rows.append(row)
    check_names(case, [row.name for row in rows], "a joint")
    tags = tagged.cell_tags
    new = dolfinx.mesh.meshtags(tagged.mesh, tags.dim, tags.indices, values)
    return placed(
        case.model_copy(update={"joints": sections}),
        rows,
        replace(tagged, cell_tags=new, cell_names=names),
    )


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


def _cell_volumes(tagged: TaggedMesh) -> np.ndarray:
    """Volumes of the cells that this rank owns, m3."""
    mesh = tagged.mesh
    space = fem.functionspace(mesh, ("DG", 0))
    vector = fem.assemble_vector(fem.form(ufl.TestFunction(space) * ufl.dx))
    owned = mesh.topology.index_map(mesh.topology.dim).size_local
    return vector.array[space.dofmap.list[:owned, 0]]


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


def _bolts(case: Case, tagged: TaggedMesh, name: str, layer: _JointLayer) -> np.ndarray:
    """Points on the axes of a joint's bolts, m, (n, 3)."""
    if layer.section.bolts is None:
        points = bolt_points(tagged)
        return points[[layer.inside(point, along=True) for point in points]]
    points = np.array(layer.section.bolts)
    for i, point in enumerate(points):
        if not layer.inside(point, along=False):
            raise InputError(
                f"{case.path}: joints.{name}.bolts[{i}] = {point.tolist()} m is outside the joint: "
                f"expected a point within {layer.low.tolist()} and {layer.high.tolist()}"
            )
    return points


def _split(
    case: Case, tagged: TaggedMesh, name: str, layer: _JointLayer, bolts: np.ndarray, count: int
) -> list[tuple[LayerZone, np.ndarray]]:
    """The zones of a joint, each with its local cells."""
    nearest, distance = _nearest(layer, bolts)
    edges = _radii(distance, layer.areas, count)
    ring = np.searchsorted(edges, distance)
    # This rank's cells, ghosts included, among those of all.
    place = cKDTree(layer.middles).query(layer.local)[1] if len(layer.cells) else np.array([], int)
    faces = _faces(case, tagged, layer.cells, nearest[place], len(bolts))
    rows = []
    for b in range(len(bolts)):
        for r in range(len(edges) + 1):
            mask = (nearest == b) & (ring == r)
            if not mask.any():
                continue
            zone = f"{name}_r{r + 1}" if len(bolts) == 1 else f"{name}_b{b + 1}_r{r + 1}"
            span = float(distance[mask].min()), float(distance[mask].max())
            row = LayerZone(
                zone,
                name,
                float(layer.areas[mask].sum()),
                b + 1,
                r + 1,
                span,
                bolts[b],
                layer.section.bolts is None,
                faces[b],
            )
            rows.append((row, layer.cells[mask[place]]))
    return rows


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
    distances, along = layer.distances(layer.middles, bolts)
    least = distances.min(axis=1)
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


def _radii(distance: np.ndarray, area: np.ndarray, count: int) -> np.ndarray:
    """Radii between the rings, m: equal shares of the area, equal distances staying together."""
    order = np.argsort(distance, kind="stable")
    d, a = distance[order], area[order]
    level = np.concatenate([[0], np.cumsum(np.diff(d) > SAME * d[-1])])
    weight = np.bincount(level, a)
    share = (np.cumsum(weight) - 0.5 * weight) / weight.sum()
    bins = np.minimum((count * share).astype(int), count - 1)
    last = np.flatnonzero(np.diff(bins) > 0)
    ends = np.searchsorted(level, last, side="right")
    return 0.5 * (d[ends - 1] + d[ends])
