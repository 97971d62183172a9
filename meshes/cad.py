"""Reading an assembly from a STEP file, its parts joined by rings of a layer around the bolts."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, ClassVar, Concatenate, ParamSpec

import numpy as np
from mpi4py import MPI

from fenics_joints.errors import MeshError, located
from fenics_joints.files import path_of
from fenics_joints.meshes.arguments import Count, Demand, Size, described, holds
from fenics_joints.meshes.cad_bolts import (
    BoltPlace,
    check_rings,
    given_bolts,
    hole_bolts,
    washer_face,
)
from fenics_joints.meshes.cad_faces import MM, OVERLAP, TOUCH, FacePair, find_contacts, nearest
from fenics_joints.meshes.cad_mesh import (
    Glued,
    SharedFace,
    Sizes,
    WasherPlace,
    closing,
    glue,
    opening,
)
from fenics_joints.meshes.check import check_mesh
from fenics_joints.meshes.facets import Bodies, add_faces
from fenics_joints.meshes.gmsh_apart import gmsh_model
from fenics_joints.meshes.grow import Grown, fill, groups_of, layer_faces, spread, thin_layer
from fenics_joints.meshes.step_file import Place, Solids, import_solids
from fenics_joints.meshes.tagged import MeshLists, TaggedMesh, distribute
from fenics_joints.parallel import on_root

P = ParamSpec("P")
#: Widest gap, m, that counts as touching where no thickness of a layer is given: about the layers
#: of Machines 2022 (0.657 and 0.72 mm).
_REACH = 0.7e-3
#: Options of gmsh while a file is read: millimetres whatever the file's unit, which are
#: OpenCASCADE's default (any other would stay for whatever the caller reads or writes next);
#: straight-sided cells; and gmsh's defaults, whatever the caller has set.
_OPTIONS = {
    "Geometry.OCCTargetUnit": "MM",
    "Mesh.ElementOrder": 1,
    "Mesh.MeshSizeMax": 1e22,
    "Mesh.MeshSizeMin": 0,
    "Mesh.MeshSizeFromCurvature": 0,
    "Mesh.MeshSizeFromPoints": 0,
    "Mesh.MeshSizeExtendFromBoundary": 1,
    "Mesh.MeshSizeFactor": 1,
    "Mesh.Algorithm": 6,
    "Mesh.Algorithm3D": 1,
    "Mesh.Optimize": 1,
    "Mesh.RecombineAll": 0,
    "Mesh.SubdivisionAlgorithm": 0,
    "Mesh.SaveAll": 0,
}


@dataclass(frozen=True, kw_only=True)
class StepAssembly(Grown):
    """Mesh an assembly from CAD, whose parts are bolted, and touch on flat faces.

    The faces may touch in the file, or be apart by up to ``layer``; they are closed first. Then the
    parts are moved apart by ``layer`` along the faces' normal, each with its exact shape; the part
    that comes first in the file keeps its place. Without ``layer`` no part moves: the layers are as
    thick as the gap, 0.7 mm at most, or where there is none as one that
    `fenics_joints.meshes.grow` grows. The parts' meshes match on the contacts, where they share no
    vertex. With ``joint="rings"`` they hang together by the rings alone: around each
    bolt the layer between R_nei and R_wai (Machines 2022, section 2), one triangle of the contact
    below and above, cut into three tetrahedra. Its circles are polygons whose corners lie on them,
    as all curved faces have straight-sided cells: with ``circle`` edges to a circle, a ring's area
    is short by a share of about 6.6 / circle^2.

    Parts: the solids, and ``ring_1``, ``ring_2``, ... or with ``joint="layer"`` ``joint`` (numbered
    if there are several contacts). Faces: ``joint_lower`` and ``joint_upper``, between all rings
    or layers and the parts; ``A_to_B`` and ``B_to_A``, what else of the faces of parts A and B
    touches; and ``faces``. Points: ``bolts``, the rings' centres at mid-height.

    Attributes:
        element_size: Largest size of a cell, m.
        joint: ``"rings"``; ``"layer"`` for a layer on all that touches; ``"contact"`` for no layer
            and no opening: separate parts whose faces match vertex by vertex.
        r_wai: Outer radius of the rings, m; or of each, with ``bolts``.
        r_nei: Inner radius, m; None: that of the wider of the two holes.
        bolts: Centres of the bolts on the contacts, m, as in the file; None: at all round holes
            with one axis in two faces that touch, in the order of the solids, then of x, y and z.
        hole: Least and largest diameter of the holes that are a bolt's, m; None: below 2 R_wai.
        layer: Thickness of the layer in the mesh, m; None: as thin as can be, and no part moves.
        n_layer: Cells through the layer.
        parts: Our name of each solid, and its label in the file, its number there from 1, or a
            point inside it, m. A solid without one is called by its label.
        without: Solids that are left out, such as bolts and nuts: by label, number or point.
        bonded: Pairs of parts that are one body where they touch, as if welded.
        between: Pairs of parts that are joined by bolts or layers; None: any.
        faces: Names of outer faces, each with a point on it, m, or several, as in the file.
        washers: Faces under heads and nuts, by name: the centre, m, in a round hole of an outer
            flat face, and the outer radius, m.
        ring_size: Size of the cells in rings and under washers, m; None: half of R_wai - R_nei.
        circle: Edges of a whole circle, at least.

    Raises:
        MeshError: The file is no STEP file; solids overlap, no faces touch, a
            bolt has no contact or no hole, its ring leaves the faces or overlaps another, the
            parts do not hang together, gmsh fails, or cells are flat; the message names the solid,
            the bolt, or the argument.
    """

    function: ClassVar[str] = "read_step"

    element_size: Size
    n_layer: Annotated[Count, Demand(lambda n: n <= 1000, "at most 1,000 cells")] = 1
    parts: Mapping[str, Place] | None = None
    without: Sequence[Place] | None = None
    faces: Mapping[str, Sequence[float] | Sequence[Sequence[float]]] | None = None
    washers: Mapping[str, tuple[Sequence[float], float]] | None = None
    ring_size: Size | None = None
    circle: Annotated[Count, Demand(lambda n: 6 <= n <= 10_000, "6 to 10,000 edges")] = 16

    def check(self) -> None:
        """Refuse arguments that do not fit each other, with MeshError."""
        super().check()
        for key in ("parts", "faces", "washers"):
            named = isinstance(getattr(self, key) or {}, Mapping)
            self.require(named, key, "places by their names")
        self.points()

    def points(self) -> dict[str, np.ndarray]:
        """Points on each named face, m, shape (n, 3)."""
        found = {}
        for name, points in (self.faces or {}).items():
            expected = "a point (x, y, z) in metres, or several"
            number = holds(lambda p: np.array(p, dtype=float).ndim, points)
            self.require(number, f"faces.{name}", expected, points)
            found[name] = np.atleast_2d(np.array(points, dtype=float))
            fits = found[name].ndim == 2 and found[name].shape[1] == 3
            self.require(fits, f"faces.{name}", expected, points)
        return found

    def read(self, path: str | Path, comm: MPI.Intracomm) -> TaggedMesh:
        """The mesh of a STEP file, in any unit. Collective; gmsh runs on rank 0 alone."""
        path = path_of(path)
        with located(path):
            tagged = distribute(comm, on_root(comm, lambda: self._lists(path)))
            check_mesh(tagged)
        return tagged

    # Lengths from here on are in millimetres.

    @property
    def _gap(self) -> float:
        """Thickness of the layer, or else the gap that one may fill."""
        return (self.layer or _REACH) * MM

    @property
    def _stays(self) -> bool:
        """Whether no part moves."""
        return self.layer is None and self.joint != "contact"

    def _lists(self, path: Path) -> MeshLists:
        """The whole mesh, in metres."""
        with gmsh_model(_OPTIONS) as model:
            parts = {name: _solid_at(place) for name, place in (self.parts or {}).items()}
            without = [_solid_at(place) for place in self.without or ()]
            solids = import_solids(path, model, parts, without)
            bonded = self._pairs(solids, "bonded", self.bonded)
            contacts = self._contacts(model, solids, bonded)
            bolts = self._bolts(model, solids, contacts)
            if self.joint == "rings":
                contacts = [c for c in contacts if any(b.contact is c for b in bolts)]
            self._check_names(solids, len(bolts), len(contacts))
            body, shifts = groups_of(len(solids.names), bonded), closing(solids, contacts)
            moves = np.zeros((int(body.max()) + 1, 3))
            if self._stays:
                moves[body] = -shifts
            elif self.joint != "contact":
                moves = opening(solids, body, contacts, self._gap)
            faces = {name: _in_mm(points) for name, points in self.points().items()}
            washers = [
                self._washer(model, solids, contacts, name, *given)
                for name, given in (self.washers or {}).items()
            ]
            sizes = self._sizes(bolts)
            glued = glue(model, solids, shifts, contacts, bolts, faces, washers, sizes)
        self._check_bonds(solids, bonded, glued)
        if self.joint != "contact":
            self._check_one(solids, body, contacts)
        lists = self._with_layers(glued, body, moves, contacts)
        if not bolts:
            return lists
        half = [(b.contact.gap if self._stays else self._gap) / 2 * b.contact.normal for b in bolts]
        lower = [b.contact.lower for b in bolts]
        centres = np.array([b.centre for b in bolts]) + shifts[lower] + moves[body[lower]] + half
        return replace(lists, points={"bolts": 1 / MM * centres})

    def _with_layers(self, glued: Glued, body, moves, contacts: Sequence[FacePair]) -> MeshLists:
        """The mesh opened by moves of the bodies, and filled, in metres."""
        names = list(glued.lists.cell_names)
        parted = Bodies(glued.lists, body[glued.lists.cell_values - 1])
        parted.x += moves[parted.body]

        def sides(shared: Iterable[SharedFace]) -> list[np.ndarray]:
            found = [[parted.own(body[s], face.triangles) for s in face.solids] for face in shared]
            return [np.vstack(side) for side in zip(*found, strict=True)]

        layers, notes = self._layers(glued), ()
        filled = [face for found in layers.values() for face in found]
        if self._stays and filled:
            touching = {names[solid] for face in filled for solid in face.solids}
            thin = thin_layer(parted.lists(), touching)
            for number, contact in enumerate(contacts):
                here = [face for face in filled if face.contact == number]
                if here and contact.gap < thin:
                    both = sides(here)
                    normals = np.broadcast_to(contact.normal, (len(both[0]), 3))
                    spread(parted.x, both, normals, thin - contact.gap)
            notes = (
                f"no part was moved for a layer: the layers are {1e3 * thin:.3g} um thick, half of "
                "that taken from each part, or as thick as the gap in the file",
            )
        layer_sides = {name: sides(found) for name, found in layers.items()}
        lists = fill(parted.lists(), layer_sides, self.n_layer)
        bare = [
            (tuple(names[solid] for solid in face.solids), sides([face]))
            for face in glued.shared
            if not any(face is other for other in filled) and np.ptp(body[list(face.solids)])
        ]
        faces = layer_faces(layer_sides, bare)
        for name, (solid, triangles) in glued.faces.items():
            _check_new(name, faces, "face")
            faces[name] = parted.own(body[solid], triangles)
        return replace(add_faces(lists, faces), x=lists.x / MM, notes=notes)

    def _pairs(self, solids: Solids, key: str, pairs) -> list[tuple[int, int]]:
        found = []
        for pair in pairs:
            fits = len(pair) == 2 and pair[0] != pair[1] and set(pair) <= set(solids.names)
            if not fits:
                there = ", ".join(solids.names)
                raise MeshError(f"{key} has {pair!r}, expected two of the parts: {there}")
            found.append(tuple(sorted(solids.names.index(name) for name in pair)))
        return found

    def _contacts(self, model, solids: Solids, bonded) -> list[FacePair]:
        reach = OVERLAP if self.joint == "contact" else self._gap * (1 + 1e-6) + TOUCH
        contacts = [
            c for c in find_contacts(model, solids, reach) if (c.lower, c.upper) not in bonded
        ]
        if self.between is not None:
            wanted = self._pairs(solids, "between", self.between)
            contacts = [c for c in contacts if (c.lower, c.upper) in wanted]
            for pair in set(wanted) - {(c.lower, c.upper) for c in contacts}:
                a, b = (solids.names[i] for i in pair)
                raise MeshError(
                    f"{a!r} and {b!r} have no flat faces that touch, or are apart by "
                    f"at most {reach:.6g} mm; expected some, as between names them"
                    f"{nearest(model, solids, reach, [(a, b)])}"
                )
        if not contacts and len(solids.names) > 1:
            raise MeshError(
                f"no two of {', '.join(map(repr, solids.names))} have flat faces that "
                f"touch, or are apart by at most {reach:.6g} mm; expected some"
                f"{nearest(model, solids, reach)}"
            )
        return contacts

    def _bolts(self, model, solids: Solids, contacts) -> list[BoltPlace]:
        if self.joint != "rings":
            return []
        if not contacts:
            raise MeshError(
                f"it has one solid, {solids.names[0]!r}; expected at least two for bolts to join"
            )
        r_wai, r_nei = _in_mm(self.radii()).tolist(), _in_mm(self.r_nei)
        if self.bolts is None:
            hole = None if self.hole is None else tuple(_in_mm(self.hole).tolist())
            bolts = hole_bolts(model, solids, contacts, r_wai=r_wai[0], r_nei=r_nei, hole=hole)
        else:
            bolts = given_bolts(
                model,
                solids,
                contacts,
                _in_mm(self.bolts),
                r_wai=r_wai,
                r_nei=r_nei,
                reach=self._gap,
            )
        check_rings(bolts, solids)
        return bolts

    def _washer(self, model, solids: Solids, contacts, name: str, at, radius) -> WasherPlace:
        _check_new(name, self.faces or {}, "face")
        solid, hole, normal = washer_face(model, solids, contacts, name, _in_mm(at))
        outer = float(_in_mm(radius))
        if outer <= hole.radius:
            raise MeshError(
                f"washers.{name}: the radius is {outer:g} mm, expected more than the hole's, "
                f"{hole.radius:g} mm"
            )
        return WasherPlace(name, hole.centre, normal, outer, hole.radius, solid)

    def _sizes(self, bolts) -> Sizes:
        widths = [bolt.r_wai - bolt.r_nei for bolt in bolts]
        size = self.element_size * MM
        ring = _in_mm(self.ring_size) or min(widths, default=2 * size) / 2
        return Sizes(size, min(ring, size), self.circle)

    def _check_bonds(self, solids: Solids, bonded, glued: Glued) -> None:
        touching = {i.solids for i in glued.shared}
        for pair in bonded:
            if pair not in touching:
                a, b = (solids.names[i] for i in pair)
                raise MeshError(f"{a!r} and {b!r} do not touch, expected it of bonded parts")

    def _check_one(self, solids: Solids, body: np.ndarray, contacts) -> None:
        links = [(c.lower, c.upper) for c in contacts]
        links += [(int(np.argmax(body == b)), i) for i, b in enumerate(body)]
        apart = groups_of(len(solids.names), links)
        if apart.max() == 0:
            return
        groups = [
            ", ".join(repr(solids.names[i]) for i in np.flatnonzero(apart == g))
            for g in range(apart.max() + 1)
        ]
        what = "bolt" if self.joint == "rings" else "layer"
        raise MeshError(
            f"no {what} joins {' with '.join(groups)}; expected one body "
            "(bonded = pairs of parts that are welded)"
        )

    def _check_names(self, solids: Solids, n_bolts: int, n_contacts: int) -> None:
        """Refuse solids named like the layers, before the mesh is made."""
        joints = [f"joint_{n + 1}" for n in range(n_contacts)] if n_contacts > 1 else ["joint"]
        taken = {"rings": [f"ring_{n + 1}" for n in range(n_bolts)], "layer": joints}
        for name in taken.get(self.joint, ()):
            _check_new(name, solids.names, "part")

    def _layers(self, glued: Glued) -> dict[str, list[SharedFace]]:
        """The faces that are filled, by the name of their layer."""
        key, word = {"rings": ("ring", "ring"), "layer": ("contact", "joint")}.get(
            self.joint, (None, "")
        )
        found: dict[int, list[SharedFace]] = {}
        for face in glued.shared if key else ():
            if getattr(face, key) is not None:
                found.setdefault(getattr(face, key), []).append(face)
        if self.joint == "layer" and len(found) == 1:
            return {"joint": next(iter(found.values()))}
        return {f"{word}_{n}": found[own] for n, own in enumerate(sorted(found), start=1)}


def _check_new(name: str, there, kind: str) -> None:
    if name in there:
        raise MeshError(
            f"{kind}s has the name {name!r}, which is that of a {kind} of the joints; expected "
            "another"
        )


def _solid_at(place: Place) -> Place:
    return place if isinstance(place, str | int) else _in_mm(place)


def _in_mm(length):
    return None if length is None else np.array(length, dtype=float) * MM


def _reader(
    assembly: Callable[P, StepAssembly],
) -> Callable[Concatenate[str | Path, MPI.Intracomm, P], TaggedMesh]:
    """The function of a file, a communicator and the other arguments."""

    def read(path, comm, **arguments):
        return assembly(**arguments).read(path, comm)

    return described(read, assembly)


read_step = _reader(StepAssembly)
