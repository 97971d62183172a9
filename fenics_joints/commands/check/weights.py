"""The cells of a case's mesh, what its parts weigh, and whether the real ones weigh that."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import dolfinx.mesh
import numpy as np

from fenics_joints._compat import geometry_dofmap
from fenics_joints.case import Case
from fenics_joints.case.check_structure import matching
from fenics_joints.case.preload import BeamBoltSection
from fenics_joints.case.sections import MassSection
from fenics_joints.formatting import percent, quantity
from fenics_joints.meshes import TaggedMesh
from fenics_joints.preload.threads import thread

#: Relative difference of a mass from which a note is made: castings and paint are within it, a
#: wrong material is not.
_OFF = 0.05
#: Range of the masses of structures in a lab, kg.
USUAL_KG = (1e-3, 1e4)
#: Ratios of units, and of numbers that are easily mixed up, with what they mean.
_RATIOS = {
    1000.0: "g read as kg, or mm as m in one place",
    1e9: "lengths in mm read as m",
    10.0: "a factor of ten",
    25.4**3: "inches read as mm",
    2.8: "steel and aluminium mixed up",
}


#: Simplices that a cell is cut into, by its number of corners in DOLFINx's order and dimension.
_SIMPLICES = {
    (3, 2): [(0, 1, 2)],
    (4, 2): [(0, 1, 3), (0, 2, 3)],
    (4, 3): [(0, 1, 2, 3)],
    (8, 3): [(0, 1, 3, 7), (0, 1, 5, 7), (0, 2, 3, 7), (0, 2, 6, 7), (0, 4, 5, 7), (0, 4, 6, 7)],
}


@dataclass(frozen=True, eq=False)
class Body:
    """All cells of a mesh.

    Attributes:
        vertices: Corners, m, shape (n, n_corners, 3).
        names: Names of the groups of cells.
        group: Which of them each cell is of, shape (n,).
        volumes: Of each cell, m3; in the plane of one metre of depth; shape (n,).
    """

    vertices: np.ndarray
    names: tuple[str, ...]
    group: np.ndarray
    volumes: np.ndarray

    def volume(self, names) -> float:
        """Volume of groups, m3."""
        wanted = [i for i, name in enumerate(self.names) if name in set(names)]
        return float(self.volumes[np.isin(self.group, wanted)].sum())


def body_of(tagged: TaggedMesh) -> Body | None:
    """The cells of a mesh, on rank 0; None on others. Collective."""
    mesh, gdim = tagged.mesh, tagged.mesh.geometry.dim
    owned = mesh.topology.index_map(mesh.topology.dim).size_local
    corners = mesh.geometry.x[geometry_dofmap(mesh)[:owned]]
    tags = np.full(owned, -1, dtype=np.int32)
    here = tagged.cell_tags.indices < owned
    tags[tagged.cell_tags.indices[here]] = tagged.cell_tags.values[here]
    found = mesh.comm.gather((corners, tags))
    if found is None:
        return None
    vertices, tags = (np.concatenate(parts) for parts in zip(*found, strict=True))
    names = tuple(tagged.cell_names)
    group = np.full(len(tags), -1)
    for i, name in enumerate(names):
        group[tags == tagged.cell_names[name]] = i
    return Body(vertices, names, group, _volumes(vertices[..., :gdim]))


def _volumes(vertices: np.ndarray) -> np.ndarray:
    """Volumes (areas in the plane) of straight-sided cells, shape (n,)."""
    gdim = vertices.shape[2]
    total = np.zeros(len(vertices))
    for corners in _SIMPLICES[vertices.shape[1], gdim]:
        x = vertices[:, list(corners)]
        total += np.abs(np.linalg.det(x[:, 1:] - x[:, :1]))
    return total / (6.0 if gdim == 3 else 2.0)


def face_centres(tagged: TaggedMesh) -> dict[str, np.ndarray]:
    """Mean place of each named face, m, shape (3,), the same on every rank. Collective."""
    mesh = tagged.mesh
    dim = mesh.topology.dim - 1
    owned = mesh.topology.index_map(dim).size_local
    found = {}
    for name, tag in tagged.facet_names.items():
        facets = tagged.facet_tags.find(tag)
        own = facets[facets < owned]
        middles = dolfinx.mesh.compute_midpoints(mesh, dim, own).reshape(-1, 3)
        total = mesh.comm.allreduce(np.array([*middles.sum(axis=0), len(own)]))
        if total[3]:
            found[name] = total[:3] / total[3]
    return found


#: Tables of attached masses, by kind.
_TABLES = {"mass": "masses", "attached": "attached"}


@dataclass(frozen=True)
class Weight:
    """The mass of something in a case.

    Attributes:
        name: Its name.
        kind: ``part``, ``joint``, ``mass``, ``bolt`` or ``attached``, which is not in the model.
        mass: kg.
        weighed: What the case says that it weighs, kg; or None.
    """

    name: str
    kind: str
    mass: float
    weighed: float | None = None

    def to_json(self) -> dict[str, object]:
        """Keys: name, kind, kg, weighed_kg."""
        return {"name": self.name, "kind": self.kind, "kg": self.mass, "weighed_kg": self.weighed}


def weights_of(
    case: Case, body: Body | None, centres: Mapping[str, np.ndarray]
) -> tuple[Weight, ...]:
    """Masses of the parts, the joints that have any, and what is put on.

    Args:
        case: The case.
        body: Its mesh, or its parts by matrices; None for beams.
        centres: Of the mesh's named faces, m.
    """
    found = []
    for name, part in case.parts.items():
        mass = part.rho * _volume(case, body, part.cells)
        found.append(Weight(name, "part", mass, part.mass))
    for name, joint in case.joints.items():
        if joint.rho is not None:
            found.append(Weight(name, "joint", joint.rho * _volume(case, body, joint.cells)))
    found += [Weight(name, "mass", section.mass) for name, section in case.masses.items()]
    for name, bolt in case.bolts.items():
        ends = centres.get(bolt.lower), centres.get(bolt.upper)
        if isinstance(bolt, BeamBoltSection) and all(end is not None for end in ends):
            d = thread(bolt.thread).diameter if bolt.diameter is None else bolt.diameter
            shank = bolt.rho * math.pi / 4 * d**2 * math.dist(*ends)
            found.append(Weight(name, "bolt", shank + 2 * bolt.head_mass))
    found += [
        Weight(name, "attached", section.mass)
        for name, section in case.attached.items()
        if isinstance(section, MassSection)
    ]
    return tuple(found)


def _volume(case: Case, body: Body | None, cells) -> float:
    if case.mesh.origin == "beams":
        return case.mesh.volume(cells)
    named = [name for pattern in cells for name in matching(pattern, body.names)]
    return body.volume(named)


def doubtful(case: Case, weights: tuple[Weight, ...]) -> list[str]:
    """A sentence for each mass that differs from its weighing or is unusual for a lab."""
    notes = [_said(f"parts.{w.name}", w.mass, w.weighed) for w in weights if w.weighed is not None]
    if case.test is not None and case.test.mass is not None:
        notes.append(_said("the whole structure", sum(w.mass for w in weights), case.test.mass))
    total = sum(w.mass for w in weights if w.kind != "attached")
    if total > 0 and not USUAL_KG[0] <= total <= USUAL_KG[1]:
        notes.append(f"the structure weighs {quantity(total, 'kg')}: is the unit of lengths right?")
    of_parts = sum(w.mass for w in weights if w.kind == "part")
    notes += [
        f"{table}.{w.name} is {quantity(w.mass, 'kg')}, more than all parts together, "
        f"{quantity(of_parts, 'kg')}; expected less: grams given as kg?"
        for w in weights
        for table in [_TABLES.get(w.kind)]
        if table and 0 < of_parts < w.mass
    ]
    return [note for note in notes if note]


def _said(what: str, mass: float, weighed: float) -> str:
    ratio = mass / weighed
    if abs(ratio - 1) <= _OFF:
        return ""
    near = [
        words
        for factor, words in _RATIOS.items()
        if any(abs(ratio / f - 1) < 0.08 for f in (factor, 1 / factor))
    ]
    hint = f"; {near[0]}?" if near else ""
    times = percent(ratio - 1, 0, sign=True) if 0.5 < ratio < 2 else f"{ratio:.3g} times as much"
    return (
        f"{what} is {quantity(mass, 'kg')} in the model and {quantity(weighed, 'kg')} on the "
        f"scales ({times}){hint}"
    )
