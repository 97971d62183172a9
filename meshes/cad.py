"""Reading an assembly from a STEP file, its parts joined by rings of a layer around the bolts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mpi4py import MPI

from fenics_joints.errors import MeshError
from fenics_joints.meshes.arguments import is_count, is_positive, requirement
from fenics_joints.meshes.cad_bolts import BoltPlace, check_rings, given_bolts, hole_bolts
from fenics_joints.meshes.cad_glue import Glued, Sizes, glue
from fenics_joints.meshes.cad_layer import Opened
from fenics_joints.meshes.cad_moves import bodies, closing, opening
from fenics_joints.meshes.cad_shapes import (
    TOUCH,
    Contact,
    Place,
    Solids,
    find_contacts,
    import_solids,
    nearest,
)
from fenics_joints.meshes.check import check_mesh
from fenics_joints.meshes.gmsh_model import gmsh_model
from fenics_joints.meshes.tagged import MeshLists, TaggedMesh, distribute
from fenics_joints.parallel import on_root

__all__ = ["read_step"]

JOINTS = ("rings", "layer", "contact")
_require = requirement("read_step")
#: Of gmsh, while a file is read: millimetres whatever the file's unit, which are
#: OpenCASCADE's default (any other would stay for whatever the caller reads or writes next), and
#: straight-sided cells.
_MM = 1e3
_OPTIONS = {
    "Geometry.OCCTargetUnit": "MM", "Mesh.ElementOrder": 1, "Mesh.MeshSizeMax": 1e22,
    "Mesh.MeshSizeMin": 0, "Mesh.MeshSizeFromCurvature": 0, "Mesh.MeshSizeFromPoints": 0,
    "Mesh.MeshSizeExtendFromBoundary": 1, "Mesh.MeshSizeFactor": 1, "Mesh.Algorithm": 6,
    "Mesh.Algorithm3D": 1, "Mesh.Optimize": 1, "Mesh.RecombineAll": 0,
    "Mesh.SubdivisionAlgorithm": 0, "Mesh.SaveAll": 0,
}  # fmt: skip


def read_step(
    path: str | Path,
    comm: MPI.Intracomm,
    *,
    element_size: float,
    joint: str = "rings",
    r_wai: float | Sequence[float] | None = None,
    r_nei: float | None = None,
    bolts: Sequence[Sequence[float]] | None = None,
    hole: tuple[float, float] | None = None,
    layer: float = 0.7e-3,
    n_layer: int = 1,
    parts: Mapping[str, Place] | None = None,
    bonded: Sequence[tuple[str, str]] = (),
    between: Sequence[tuple[str, str]] | None = None,
    faces: Mapping[str, Sequence[float] | Sequence[Sequence[float]]] | None = None,
    ring_size: float | None = None,
    circle: int = 16,
) -> TaggedMesh:
    """Mesh an assembly from CAD, whose parts are bolted, and touch on flat faces.

    The faces may touch in the file, or be apart by up to ``layer``; they are closed first. Then the
    parts are moved apart by ``layer`` along the faces' normal, each with its exact shape; the part
    that comes first in the file keeps its place. The parts' meshes match on the contacts, where
    they share no vertex. With ``joint="rings"`` they hang together by the rings alone: around each
    bolt the layer between R_nei and R_wai (seed 000, section 2), one triangle of the contact below
    and above, cut into three tetrahedra. Its circles are polygons whose corners lie on them, as
    all curved faces have straight-sided cells: with ``circle`` edges to a circle, a ring's area is
    short by a share of about 6.6 / circle^2.

    Parts: the solids, and ``ring_1``, ``ring_2``, ... or with ``joint="layer"`` ``joint`` (numbered
    if there are several contacts). Faces: ``joint_lower`` and ``joint_upper``, between all rings
    or layers and the parts; ``A_to_B`` and ``B_to_A``, what else of the faces of parts A and B
    touches; and ``faces``. Points: ``bolts``, the rings' centres at mid-height.

    Args:
        path: The STEP file, in any unit.
        comm: Communicator; the call is collective, gmsh runs on rank 0 alone.
        element_size: Largest size of a cell, m.
        joint: ``"rings"``; ``"layer"`` for a layer on all that touches; ``"contact"`` for no layer
            and no opening: separate parts whose faces match vertex by vertex.
        r_wai: Outer radius of the rings, m; or of each, with ``bolts``.
        r_nei: Inner radius, m; None: that of the wider of the two holes.
        bolts: Centres of the bolts on the contacts, m, as in the file; None: at all round holes
            with one axis in two faces that touch, in the order of the solids, then of x, y and z.
        hole: Least and largest diameter of the holes that are a bolt's, m; None: below 2 R_wai.
        layer: Thickness of the layer in the mesh, m.
        n_layer: Cells through the layer.
        parts: Our name of each solid, and its label in the file, its number there from 1, or a
            point inside it, m. A solid without one is called by its label.
        bonded: Pairs of parts that are one body where they touch, as if welded.
        between: Pairs of parts that are joined by bolts or layers; None: any.
        faces: Names of outer faces, each with a point on it, m, or several, as in the file.
        ring_size: Size of the cells in the rings, m; None: half of R_wai - R_nei.
        circle: Edges of a whole circle, at least.

    Returns:
        The tagged mesh.

    Raises:
        MeshError: The file is no STEP file or has one solid; solids overlap, no faces touch, a
            bolt has no contact or no hole, its ring leaves the faces or overlaps another, the
            parts do not hang together, gmsh fails, or cells are flat; the message names the solid,
            the bolt, or the argument.
    """
    for name, size in (("element_size", element_size), ("layer", layer)):
        _require(is_positive(size), name, size, "a length above 0 m")
    for name, size in (("r_nei", r_nei), ("ring_size", ring_size)):
        _require(size is None or is_positive(size), name, size, "a length above 0 m")
    _require(joint in JOINTS, "joint", joint, " or ".join(map(repr, JOINTS)))
    _require(is_count(n_layer), "n_layer", n_layer, "a whole number of at least 1")
    _require(is_count(circle) and circle >= 6, "circle", circle, "a whole number of at least 6")
    radii = _outer_radii(joint, r_wai, bolts)
    if hole is not None:
        fits = np.shape(hole) == (2,) and all(map(is_positive, hole)) and hole[0] <= hole[1]
        _require(fits, "hole", hole, "the least and the largest diameter, in metres")
    assembly = _Assembly(
        Path(path), _places(parts or {}), tuple(map(tuple, bonded)), between, joint, radii * _MM,
        _in_mm(r_nei), _in_mm(bolts), _pair_in_mm(hole), layer * _MM, n_layer, _points(faces or {}),
        element_size * _MM, _in_mm(ring_size), circle,
    )  # fmt: skip
    tagged = distribute(comm, on_root(comm, assembly.lists))
    try:
        check_mesh(tagged)
    except MeshError as error:
        raise MeshError(f"{path}: {error}") from None
    return tagged


def _outer_radii(joint: str, r_wai, bolts) -> np.ndarray:
    """Outer radius of the rings, m: one, or one for each bolt; none without rings."""
    if joint != "rings":
        _require(r_wai is None, "r_wai", r_wai, f"none with joint = {joint!r}")
        _require(bolts is None, "bolts", bolts, f"none with joint = {joint!r}")
        return np.empty(0)
    radii = np.atleast_1d(np.array(r_wai, dtype=float))
    fits = r_wai is not None and radii.ndim == 1 and np.all(np.isfinite(radii) & (radii > 0))
    _require(fits, "r_wai", r_wai, "the outer radius of the rings, above 0 m")
    if bolts is None:
        _require(len(radii) == 1, "r_wai", r_wai, "one radius, or bolts: their centres")
        return radii
    fits = len(bolts) > 0 and all(np.shape(bolt) == (3,) for bolt in bolts)
    _require(fits, "bolts", bolts, "a point (x, y, z) in metres for each bolt")
    _require(len(radii) in (1, len(bolts)), "r_wai", r_wai, f"one radius, or {len(bolts)}")
    return np.broadcast_to(radii, len(bolts))


def _in_mm(length):
    return None if length is None else np.array(length, dtype=float) * _MM


def _pair_in_mm(pair):
    return None if pair is None else (float(pair[0]) * _MM, float(pair[1]) * _MM)


def _places(parts: Mapping[str, Place]) -> dict[str, Place]:
    return {
        name: place if isinstance(place, str | int) else _in_mm(place)
        for name, place in parts.items()
    }


def _points(faces) -> dict[str, np.ndarray]:
    found = {}
    for name, points in faces.items():
        found[name] = np.atleast_2d(np.array(points, dtype=float)) * _MM
        fits = found[name].ndim == 2 and found[name].shape[1] == 3
        _require(fits, f"faces.{name}", points, "a point (x, y, z) in metres, or several")
    return found


@dataclass(frozen=True)
class _Assembly:
    """Checked arguments of ``read_step``, lengths in millimetres."""

    path: Path
    parts: Mapping[str, Place]
    bonded: tuple[tuple[str, str], ...]
    between: Sequence[tuple[str, str]] | None
    joint: str
    r_wai: np.ndarray
    r_nei: float | None
    bolts: Sequence[Sequence[float]] | None
    hole: tuple[float, float] | None
    layer: float
    n_layer: int
    faces: Mapping[str, np.ndarray]
    size: float
    ring_size: float | None
    circle: int

    def lists(self) -> MeshLists:
        """The whole mesh."""
        with gmsh_model(self.path, _OPTIONS) as model:
            solids = import_solids(self.path, model, self.parts)
            bonded = self._pairs(solids, "bonded", self.bonded)
            contacts = self._contacts(model, solids, bonded)
            bolts = self._bolts(model, solids, contacts)
            if self.joint == "rings":
                contacts = [c for c in contacts if any(b.contact is c for b in bolts)]
            shifts, body = closing(solids, contacts), bodies(solids, bonded)
            moves = np.zeros((int(body.max()) + 1, 3))
            if self.joint != "contact":
                moves = opening(solids, body, contacts, self.layer)
            glued = glue(model, solids, shifts, contacts, bolts, self.faces, self._sizes(bolts))
        self._check_bonds(solids, bonded, glued)
        if self.joint != "contact":
            self._check_one(solids, body, contacts)
        return self._named(solids, glued, Opened(glued, body, moves), body, moves, shifts, bolts)

    def _pairs(self, solids: Solids, key: str, pairs) -> list[tuple[int, int]]:
        found = []
        for pair in pairs:
            fits = len(pair) == 2 and pair[0] != pair[1] and set(pair) <= set(solids.names)
            if not fits:
                there = ", ".join(solids.names)
                raise MeshError(
                    f"{self.path}: {key} has {pair!r}, expected two of the parts: {there}"
                )
            found.append(tuple(sorted(solids.names.index(name) for name in pair)))
        return found

    def _contacts(self, model, solids: Solids, bonded) -> list[Contact]:
        reach = TOUCH if self.joint == "contact" else self.layer * (1 + 1e-6) + TOUCH
        contacts = [
            c for c in find_contacts(model, solids, reach) if (c.lower, c.upper) not in bonded
        ]
        if self.between is not None:
            wanted = self._pairs(solids, "between", self.between)
            contacts = [c for c in contacts if (c.lower, c.upper) in wanted]
            for pair in set(wanted) - {(c.lower, c.upper) for c in contacts}:
                a, b = (solids.names[i] for i in pair)
                raise MeshError(
                    f"{self.path}: {a!r} and {b!r} have no flat faces that touch, or are apart by "
                    f"at most {reach:.6g} mm; expected some, as between names them"
                    f"{nearest(model, solids, reach, [(a, b)])}"
                )
        if not contacts:
            raise MeshError(
                f"{self.path}: no two of {', '.join(map(repr, solids.names))} have flat faces that "
                f"touch, or are apart by at most {reach:.6g} mm; expected some"
                f"{nearest(model, solids, reach)}"
            )
        return contacts

    def _bolts(self, model, solids: Solids, contacts) -> list[BoltPlace]:
        if self.joint != "rings":
            return []
        if self.bolts is None:
            bolts = hole_bolts(
                model, solids, contacts, r_wai=float(self.r_wai[0]), r_nei=self.r_nei,
                hole=self.hole,
            )  # fmt: skip
        else:
            bolts = given_bolts(
                model, solids, contacts, self.bolts, r_wai=self.r_wai.tolist(), r_nei=self.r_nei,
                reach=self.layer,
            )  # fmt: skip
        check_rings(bolts, solids)
        return bolts

    def _sizes(self, bolts) -> Sizes:
        widths = [bolt.r_wai - bolt.r_nei for bolt in bolts]
        ring = self.ring_size or min(widths, default=2 * self.size) / 2
        return Sizes(self.size, min(ring, self.size), self.circle)

    def _check_bonds(self, solids: Solids, bonded, glued: Glued) -> None:
        touching = {i.solids for i in glued.interfaces}
        for pair in bonded:
            if pair not in touching:
                a, b = (solids.names[i] for i in pair)
                raise MeshError(
                    f"{self.path}: {a!r} and {b!r} do not touch, expected it of bonded parts"
                )

    def _check_one(self, solids: Solids, body: np.ndarray, contacts) -> None:
        links = [(c.lower, c.upper) for c in contacts]
        links += [(int(np.argmax(body == b)), i) for i, b in enumerate(body)]
        apart = bodies(solids, links)
        if apart.max() == 0:
            return
        groups = [
            ", ".join(repr(solids.names[i]) for i in np.flatnonzero(apart == g))
            for g in range(apart.max() + 1)
        ]
        what = "bolt" if self.joint == "rings" else "layer"
        raise MeshError(
            f"{self.path}: no {what} joins {' with '.join(groups)}; expected one body "
            "(bonded = pairs of parts that are welded)"
        )

    def _named(
        self, solids, glued: Glued, opened: Opened, body, moves, shifts, bolts
    ) -> MeshLists:
        names = list(solids.names)
        cells, values = [opened.cells], [glued.solid + 1]
        facets: dict[str, list[np.ndarray]] = {}
        layers = self._layers(glued)
        for name, interfaces in layers.items():
            self._check_new(name, names, "part")
            names.append(name)
            cells.append(opened.layer(interfaces, self.n_layer))
            values.append(np.full(len(cells[-1]), len(names)))
            for upper, face in enumerate(("joint_lower", "joint_upper")):
                facets.setdefault(face, []).extend(opened.side(i, upper) for i in interfaces)
        filled = {id(i) for found in layers.values() for i in found}
        for i in glued.interfaces:
            a, b = i.solids
            if id(i) not in filled and body[a] != body[b]:
                for upper, (one, other) in enumerate(((a, b), (b, a))):
                    face = f"{solids.names[one]}_to_{solids.names[other]}"
                    facets.setdefault(face, []).append(opened.side(i, upper))
        for name, (solid, triangles) in glued.faces.items():
            self._check_new(name, facets, "face")
            facets.setdefault(name, []).append(opened.of(solid, triangles))
        found = [np.vstack(f) for f in facets.values()]
        tags = np.repeat(np.arange(1, len(found) + 1), [len(f) for f in found])
        all_facets = np.vstack(found) if found else np.empty((0, 3), np.int64)
        points = {}
        if bolts:
            points["bolts"] = 1 / _MM * np.array([
                b.centre + shifts[b.contact.lower] + moves[body[b.contact.lower]]
                + self.layer / 2 * b.contact.normal for b in bolts
            ])  # fmt: skip
        return MeshLists(
            "tetrahedron", opened.x / _MM, opened.turned(np.vstack(cells)), np.concatenate(values),
            all_facets, tags, {name: i for i, name in enumerate(names, start=1)},
            {name: i for i, name in enumerate(facets, start=1)}, points,
        )  # fmt: skip

    def _check_new(self, name: str, there, kind: str) -> None:
        if name in there:
            raise MeshError(
                f"{self.path}: {kind}s has the name {name!r}, which is that of a {kind} of the "
                "joints; expected another"
            )

    def _layers(self, glued: Glued) -> dict[str, list]:
        """The interfaces that are filled, by the name of their layer."""
        found: dict = {}
        if self.joint == "rings":
            for i in glued.interfaces:
                if i.ring is not None:
                    found.setdefault(i.ring, []).append(i)
            return {f"ring_{ring + 1}": found[ring] for ring in sorted(found)}
        if self.joint == "layer":
            for i in glued.interfaces:
                if i.contact is not None:
                    found.setdefault(i.contact, []).append(i)
            if len(found) == 1:
                return {"joint": next(iter(found.values()))}
            return {f"joint_{n}": found[c] for n, c in enumerate(sorted(found), start=1)}
        return {}
