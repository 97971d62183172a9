"""Reading an assembly from a STEP file, its parts joined by rings of a layer around the bolts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, ClassVar, Concatenate, Literal, ParamSpec

import numpy as np
from mpi4py import MPI

from fenics_joints.errors import MeshError, located
from fenics_joints.files import path_of
from fenics_joints.meshes.arguments import (
    Arguments,
    Demand,
    Size,
    described,
    holds,
    is_count,
    is_positive,
)
from fenics_joints.meshes.cad_bolts import BoltPlace, check_rings, given_bolts, hole_bolts
from fenics_joints.meshes.cad_glue import Glued, Sizes, glue
from fenics_joints.meshes.cad_layer import Opened, open_thin
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

P = ParamSpec("P")
#: Widest gap, m, that counts as touching where no thickness of a layer is given.
_REACH = 0.7e-3
#: Of gmsh, while a file is read: millimetres whatever the file's unit, which are
#: OpenCASCADE's default (any other would stay for whatever the caller reads or writes next), and
#: straight-sided cells.
_MM = 1e3
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


def _is_range(hole) -> bool:
    return np.shape(hole) == (2,) and all(map(is_positive, hole)) and hole[0] <= hole[1]


def _is_few(cells) -> bool:
    return is_count(cells) and cells <= 1000


def _is_polygon(edges) -> bool:
    return is_count(edges) and 6 <= edges <= 10_000


@dataclass(frozen=True, kw_only=True)
class StepAssembly(Arguments):
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
        bonded: Pairs of parts that are one body where they touch, as if welded.
        between: Pairs of parts that are joined by bolts or layers; None: any.
        faces: Names of outer faces, each with a point on it, m, or several, as in the file.
        ring_size: Size of the cells in the rings, m; None: half of R_wai - R_nei.
        circle: Edges of a whole circle, at least.

    Raises:
        MeshError: The file is no STEP file or has one solid; solids overlap, no faces touch, a
            bolt has no contact or no hole, its ring leaves the faces or overlaps another, the
            parts do not hang together, gmsh fails, or cells are flat; the message names the solid,
            the bolt, or the argument.
    """

    function: ClassVar[str] = "read_step"

    element_size: Size
    joint: Literal["rings", "layer", "contact"] = "rings"
    r_wai: float | Sequence[float] | None = None
    r_nei: Size | None = None
    bolts: Sequence[Sequence[float]] | None = None
    hole: (
        Annotated[
            tuple[float, float], Demand(_is_range, "the least and the largest diameter, in metres")
        ]
        | None
    ) = None
    layer: Size | None = None
    n_layer: Annotated[int, Demand(_is_few, "a whole number from 1 to 1,000")] = 1
    parts: Mapping[str, Place] | None = None
    bonded: Sequence[tuple[str, str]] = ()
    between: Sequence[tuple[str, str]] | None = None
    faces: Mapping[str, Sequence[float] | Sequence[Sequence[float]]] | None = None
    ring_size: Size | None = None
    circle: Annotated[int, Demand(_is_polygon, "a whole number from 6 to 10,000")] = 16

    def check(self) -> None:
        """Refuse arguments that do not fit each other, with MeshError."""
        for key in ("parts", "faces"):
            value = getattr(self, key)
            named = value is None or isinstance(value, Mapping)
            self.require(named, key, value, "places by their names")
        for key in ("bolts", "between", "bonded"):
            value = getattr(self, key)
            several = value is None or (np.iterable(value) and not isinstance(value, str))
            self.require(several, key, value, "a sequence")
        self.radii()
        self.points()

    def radii(self) -> np.ndarray:
        """Outer radius of the rings, m: one, or one for each bolt; none without rings."""
        r_wai, bolts = self.r_wai, self.bolts
        if self.joint != "rings":
            self.require(r_wai is None, "r_wai", r_wai, f"none with joint = {self.joint!r}")
            self.require(bolts is None, "bolts", bolts, f"none with joint = {self.joint!r}")
            return np.empty(0)
        radii = np.atleast_1d(np.array(r_wai, dtype=float))
        fits = r_wai is not None and radii.ndim == 1 and np.all(np.isfinite(radii) & (radii > 0))
        self.require(fits, "r_wai", r_wai, "the outer radius of the rings, above 0 m")
        if bolts is None:
            self.require(len(radii) == 1, "r_wai", r_wai, "one radius, or bolts: their centres")
            return radii
        fits = len(bolts) > 0 and all(np.shape(bolt) == (3,) for bolt in bolts)
        self.require(fits, "bolts", bolts, "a point (x, y, z) in metres for each bolt")
        fits = len(radii) in (1, len(bolts))
        self.require(fits, "r_wai", r_wai, f"one radius, or {len(bolts)}")
        return np.broadcast_to(radii, len(bolts))

    def points(self) -> dict[str, np.ndarray]:
        """Points on each named face, m, shape (n, 3)."""
        found = {}
        for name, points in (self.faces or {}).items():
            expected = "a point (x, y, z) in metres, or several"
            number = holds(lambda p: np.array(p, dtype=float).ndim, points)
            self.require(number, f"faces.{name}", points, expected)
            found[name] = np.atleast_2d(np.array(points, dtype=float))
            fits = found[name].ndim == 2 and found[name].shape[1] == 3
            self.require(fits, f"faces.{name}", points, expected)
        return found

    def read(self, path: str | Path, comm: MPI.Intracomm) -> TaggedMesh:
        """The mesh of a STEP file, in any unit. Collective; gmsh runs on rank 0 alone."""
        tagged = distribute(comm, on_root(comm, _Assembly(path_of(path), self).lists))
        with located(path):
            check_mesh(tagged)
        return tagged


def _reader(
    assembly: Callable[P, StepAssembly],
) -> Callable[Concatenate[str | Path, MPI.Intracomm, P], TaggedMesh]:
    """The function of a file, a communicator and the other arguments."""

    def read(path, comm, **arguments):
        return assembly(**arguments).read(path, comm)

    return described(read, assembly)


read_step = _reader(StepAssembly)


def _in_mm(length):
    return None if length is None else np.array(length, dtype=float) * _MM


@dataclass(frozen=True)
class _Assembly:
    """A file that is read with these arguments; lengths here are in millimetres."""

    path: Path
    given: StepAssembly

    @property
    def layer(self) -> float:
        """Thickness of the layer, or else the gap that one may fill."""
        return (self.given.layer or _REACH) * _MM

    @property
    def stays(self) -> bool:
        """Whether no part moves."""
        return self.given.layer is None and self.given.joint != "contact"

    def lists(self) -> MeshLists:
        """The whole mesh."""
        with gmsh_model(self.path, _OPTIONS) as model:
            parts = {
                name: place if isinstance(place, str | int) else _in_mm(place)
                for name, place in (self.given.parts or {}).items()
            }
            solids = import_solids(self.path, model, parts)
            bonded = self._pairs(solids, "bonded", self.given.bonded)
            contacts = self._contacts(model, solids, bonded)
            bolts = self._bolts(model, solids, contacts)
            if self.given.joint == "rings":
                contacts = [c for c in contacts if any(b.contact is c for b in bolts)]
            self._check_names(solids, len(bolts), len(contacts))
            shifts, body = closing(solids, contacts), bodies(solids, bonded)
            moves = np.zeros((int(body.max()) + 1, 3))
            if self.stays:
                for solid, own in enumerate(body):
                    moves[own] = -shifts[solid]
            elif self.given.joint != "contact":
                moves = opening(solids, body, contacts, self.layer)
            faces = {name: _in_mm(points) for name, points in self.given.points().items()}
            glued = glue(model, solids, shifts, contacts, bolts, faces, self._sizes(bolts))
        self._check_bonds(solids, bonded, glued)
        if self.given.joint != "contact":
            self._check_one(solids, body, contacts)
        opened = Opened(glued, body, moves)
        if not self.stays:
            return self._named(solids, glued, opened, body, moves, shifts, bolts)
        filled = [i for found in self._layers(glued).values() for i in found]
        of = [contacts[i.contact] if i.ring is None else bolts[i.ring].contact for i in filled]
        thin = open_thin(opened, glued.solid, filled, of)
        lists = self._named(solids, glued, opened, body, moves, shifts, bolts)
        return replace(
            lists,
            notes=(
                f"no part was moved for a layer: the layers are {1e3 * thin:.3g} um thick, half of "
                "that taken from each part, or as thick as the gap in the file",
            ),
        )

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
        reach = TOUCH if self.given.joint == "contact" else self.layer * (1 + 1e-6) + TOUCH
        contacts = [
            c for c in find_contacts(model, solids, reach) if (c.lower, c.upper) not in bonded
        ]
        if self.given.between is not None:
            wanted = self._pairs(solids, "between", self.given.between)
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
        if self.given.joint != "rings":
            return []
        r_wai, r_nei = _in_mm(self.given.radii()).tolist(), _in_mm(self.given.r_nei)
        if self.given.bolts is None:
            hole = None if self.given.hole is None else tuple(_in_mm(self.given.hole).tolist())
            bolts = hole_bolts(model, solids, contacts, r_wai=r_wai[0], r_nei=r_nei, hole=hole)
        else:
            bolts = given_bolts(
                model,
                solids,
                contacts,
                _in_mm(self.given.bolts),
                r_wai=r_wai,
                r_nei=r_nei,
                reach=self.layer,
            )
        check_rings(bolts, solids)
        return bolts

    def _sizes(self, bolts) -> Sizes:
        widths = [bolt.r_wai - bolt.r_nei for bolt in bolts]
        size = self.given.element_size * _MM
        ring = _in_mm(self.given.ring_size) or min(widths, default=2 * size) / 2
        return Sizes(size, min(ring, size), self.given.circle)

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
        what = "bolt" if self.given.joint == "rings" else "layer"
        raise MeshError(
            f"{self.path}: no {what} joins {' with '.join(groups)}; expected one body "
            "(bonded = pairs of parts that are welded)"
        )

    def _named(self, solids, glued: Glued, opened: Opened, body, moves, shifts, bolts) -> MeshLists:
        names = list(solids.names)
        cells, values = [opened.cells], [glued.solid + 1]
        facets: dict[str, list[np.ndarray]] = {}
        layers = self._layers(glued)
        for name, interfaces in layers.items():
            self._check_new(name, names, "part")
            names.append(name)
            cells.append(opened.layer(interfaces, self.given.n_layer))
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
            points["bolts"] = (
                1
                / _MM
                * np.array(
                    [
                        b.centre
                        + shifts[b.contact.lower]
                        + moves[body[b.contact.lower]]
                        + (b.contact.gap if self.stays else self.layer) / 2 * b.contact.normal
                        for b in bolts
                    ]
                )
            )
        return MeshLists(
            "tetrahedron",
            opened.x / _MM,
            opened.turned(np.vstack(cells)),
            np.concatenate(values),
            all_facets,
            tags,
            {name: i for i, name in enumerate(names, start=1)},
            {name: i for i, name in enumerate(facets, start=1)},
            points,
        )

    def _check_names(self, solids: Solids, n_bolts: int, n_contacts: int) -> None:
        """Refuse solids named like the layers, before the mesh is made."""
        joints = [f"joint_{n + 1}" for n in range(n_contacts)] if n_contacts > 1 else ["joint"]
        taken = {"rings": [f"ring_{n + 1}" for n in range(n_bolts)], "layer": joints}
        for name in taken.get(self.given.joint, ()):
            self._check_new(name, solids.names, "part")

    def _check_new(self, name: str, there, kind: str) -> None:
        if name in there:
            raise MeshError(
                f"{self.path}: {kind}s has the name {name!r}, which is that of a {kind} of the "
                "joints; expected another"
            )

    def _layers(self, glued: Glued) -> dict[str, list]:
        """The interfaces that are filled, by the name of their layer."""
        found: dict = {}
        if self.given.joint == "rings":
            for i in glued.interfaces:
                if i.ring is not None:
                    found.setdefault(i.ring, []).append(i)
            return {f"ring_{ring + 1}": found[ring] for ring in sorted(found)}
        if self.given.joint == "layer":
            for i in glued.interfaces:
                if i.contact is not None:
                    found.setdefault(i.contact, []).append(i)
            if len(found) == 1:
                return {"joint": next(iter(found.values()))}
            return {f"joint_{n}": found[c] for n, c in enumerate(sorted(found), start=1)}
        return {}
