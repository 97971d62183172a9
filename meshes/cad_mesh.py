"""The solids of an assembly closed up, glued and meshed, the bolts' rings drawn on their contacts.

Where two solids touch, one face is meshed for both, so that their meshes match vertex by vertex
whatever the shapes of the faces; `fenics_joints.meshes.grow` then parts them and fills layers.
All lengths are in millimetres; see `fenics_joints.meshes.cad_faces`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components

from fenics_joints.errors import MeshError
from fenics_joints.meshes.cad_bolts import BoltPlace
from fenics_joints.meshes.cad_faces import TOUCH, FacePair, is_flat, surface_points
from fenics_joints.meshes.step_file import Solids
from fenics_joints.meshes.tagged import MeshLists

#: Most cells that gmsh is asked for. Chosen: more is a mistaken unit.
_MOST = 2e7
#: Share by which a ring's face may be smaller than the area between its circles: round-off of CAD.
_WHOLE = 1e-4


@dataclass(frozen=True)
class Sizes:
    """Sizes of the cells.

    Attributes:
        element: Largest.
        ring: In the rings.
        circle: Number of edges in a whole circle, at least.
    """

    element: float
    ring: float
    circle: int


def closing(solids: Solids, contacts: Sequence[FacePair]) -> np.ndarray:
    """Moves of the solids, shape (n_solids, 3), that bring the faces of contacts together.

    The first of the solids that hang together stays.

    Raises:
        MeshError: No moves close all of them.
    """
    steps = [(c.lower, c.upper, c.normal, -c.gap) for c in contacts]
    place = _placed(len(solids.names), steps)
    for c in contacts:
        left = (place[c.upper] - place[c.lower]) @ c.normal + c.gap
        if abs(left) > TOUCH:
            a, b = (solids.names[i] for i in (c.lower, c.upper))
            raise MeshError(
                f"{a!r} and {b!r} are {c.gap:.6g} mm apart and cannot be "
                "brought together without opening others; expected gaps that close, or none"
            )
    return place


def opening(
    solids: Solids, body: np.ndarray, contacts: Sequence[FacePair], layer: float
) -> np.ndarray:
    """Moves of the bodies, shape (n_bodies, 3), that open contacts by a layer's thickness.

    The body of the first solid stays.

    Raises:
        MeshError: A contact is within one body, or no moves open all of them along their normals.
    """
    for c in contacts:
        if body[c.lower] == body[c.upper]:
            a, b = (solids.names[i] for i in (c.lower, c.upper))
            raise MeshError(
                f"{a!r} and {b!r} are joined by a layer and bonded, by bonded = "
                "... or through other solids; expected one of the two"
            )
    steps = [(body[c.lower], body[c.upper], c.normal, layer) for c in contacts]
    place = _placed(int(body.max()) + 1, steps)
    for c in contacts:
        miss = place[body[c.upper]] - place[body[c.lower]] - layer * c.normal
        if np.linalg.norm(miss) > 1e-6 * layer:
            a, b = (solids.names[i] for i in (c.lower, c.upper))
            raise MeshError(
                f"{a!r} and {b!r} cannot be moved {layer:g} mm apart along "
                "the normal of each face that has a joint, as they or others are joined on faces "
                "of other directions too; expected joints that close no loop of such faces"
            )
    return place


def _placed(n: int, steps) -> np.ndarray:
    """Places, shape (n, 3), whose differences along normals are given, from 0 for each first.

    Args:
        n: Number of places.
        steps: For each step: from, to, unit normal, and length along it.
    """
    ways: dict[tuple[int, int], list] = {}
    for a, b, normal, length in steps:
        turn = 1 if a < b else -1
        ways.setdefault((min(a, b), max(a, b)), []).append((turn * normal, length))
    between = {}
    for (a, b), found in ways.items():
        normals, lengths = (np.array(each) for each in zip(*found, strict=True))
        between[a, b] = np.linalg.lstsq(normals, lengths, rcond=1e-9)[0]
        between[b, a] = -between[a, b]
    pairs = np.array([*between], dtype=np.int64).reshape(-1, 2)
    graph = coo_array((np.ones(len(pairs)), pairs.T), shape=(n, n))
    place = np.zeros((n, 3))
    for first in np.unique(connected_components(graph)[1], return_index=True)[1]:
        order, before = breadth_first_order(graph, first)
        for here in order[1:]:
            place[here] = place[before[here]] + between[before[here], here]
    return place


@dataclass(frozen=True)
class WasherPlace:
    """A round face under a head or nut, drawn on an outer face around a hole.

    Attributes:
        name: Of the face.
        centre: In the hole, in the face's plane, in the file's coordinates; shape (3,).
        normal: Unit normal of the face, shape (3,).
        radius: Its outer radius.
        hole: The hole's.
        solid: Index of its solid.
    """

    name: str
    centre: np.ndarray
    normal: np.ndarray
    radius: float
    hole: float
    solid: int


@dataclass(frozen=True)
class SharedFace:
    """Triangles that two solids share.

    Attributes:
        solids: Indices of the two, the lower one of a contact first.
        triangles: Vertices, shape (n, 3).
        contact: Index of the contact in whose plane they lie; None where they lie in none.
        ring: Index of the bolt in whose ring they are; None outside the rings.
    """

    solids: tuple[int, int]
    triangles: np.ndarray
    contact: int | None
    ring: int | None


@dataclass(frozen=True)
class Glued:
    """The mesh of the closed assembly.

    Attributes:
        lists: Tetrahedra of the solids, which share vertices; a part for each.
        shared: Where solids touch.
        faces: Named faces of the surface: the solid of each triangle, and its vertices.
    """

    lists: MeshLists
    shared: list[SharedFace]
    faces: dict[str, tuple[np.ndarray, np.ndarray]]


def glue(
    model,
    solids: Solids,
    shifts: np.ndarray,
    contacts: Sequence[FacePair],
    bolts: Sequence[BoltPlace],
    faces: Mapping[str, np.ndarray],
    washers: Sequence[WasherPlace],
    sizes: Sizes,
) -> Glued:
    """Close the gaps, glue the solids, draw the rings, and mesh.

    Args:
        model: gmsh's model, with the solids.
        solids: The solids.
        shifts: How far each moves to close the gaps, shape (n_solids, 3).
        contacts: The contacts.
        bolts: The bolts.
        faces: Points on each face that is to have a name, shape (n, 3), in the file's
            coordinates.
        washers: Faces under heads and nuts.
        sizes: Sizes of the cells.

    Raises:
        MeshError: Solids overlap, a ring leaves its contact, a face is not found, or gmsh fails.
    """
    for tag, shift in zip(solids.tags, shifts, strict=True):
        if np.any(shift):
            model.occ.translate([(3, tag)], *shift)
    pieces, discs, under = _fragments(model, solids, shifts, bolts, washers)
    sharing = _sharing(model, pieces)
    planes = [(c.normal, c.point + shifts[c.lower]) for c in contacts]
    rings = [
        _ring(model, solids, sharing, *item)
        for item in zip(range(1, len(bolts) + 1), bolts, discs, strict=True)
    ]
    ring_of = {face: i for i, found in enumerate(rings) for face in found}
    named = {
        name: _face(model, solids, pieces, sharing, shifts, name, points)
        for name, points in faces.items()
    }
    named |= {
        washer.name: _washer(model, solids, pieces, sharing, washer, disc)
        for washer, disc in zip(washers, under, strict=True)
    }
    _check_once(solids, named)
    fine = [*ring_of, *(face for washer in washers for face in named[washer.name])]
    _check_sizes(model, solids, pieces, fine, sizes)
    _set_sizes(model, fine, sizes)
    try:
        model.mesh.generate(3)
    except Exception as error:
        raise MeshError(
            f"gmsh cannot mesh it with cells of {sizes.element:g} mm: {error}"
        ) from error
    return _extract(model, solids, pieces, sharing, contacts, planes, ring_of, named)


def _fragments(model, solids: Solids, shifts, bolts: Sequence[BoltPlace], washers):
    """gmsh's volume of each solid, after gluing; and the faces in bolts' and washers' circles."""
    tools, owner = [], []
    for i, bolt in enumerate(bolts):
        centre = bolt.centre + shifts[bolt.contact.lower]
        for radius in (bolt.r_wai, bolt.r_nei)[: 1 + bolt.imprinted]:
            disc = model.occ.addDisk(*centre, radius, radius, zAxis=bolt.contact.normal.tolist())
            tools.append((2, disc))
            owner.append(i)
    for i, washer in enumerate(washers, start=len(bolts)):
        centre = washer.centre + shifts[washer.solid]
        disc = model.occ.addDisk(*centre, *2 * [washer.radius], zAxis=washer.normal.tolist())
        tools.append((2, disc))
        owner.append(i)
    volumes = [(3, tag) for tag in solids.tags]
    try:
        parts = [volumes]  # one solid, and nothing to glue
        if len(volumes) + len(tools) > 1:
            _, parts = model.occ.fragment(volumes, tools)
        model.occ.synchronize()
    except Exception as error:
        raise MeshError(f"gmsh cannot glue the solids: {error}") from error
    pieces = [[tag for dim, tag in part if dim == 3] for part in parts[: len(volumes)]]
    _check_apart(model, solids, pieces)
    discs = [[] for _ in (*bolts, *washers)]
    for i, part in zip(owner, parts[len(volumes) :], strict=True):
        discs[i].append({tag for dim, tag in part if dim == 2})
    _check_whole(model, solids, pieces, bolts, discs)
    _remove_loose(model, discs)
    n = len(bolts)
    return [tags[0] for tags in pieces], discs[:n], [disc for (disc,) in discs[n:]]


def _check_apart(model, solids: Solids, pieces) -> None:
    for (i, one), (j, other) in combinations(enumerate(pieces), 2):
        if common := set(one) & set(other):
            volume = sum(model.occ.getMass(3, tag) for tag in common)
            raise MeshError(
                f"{solids.names[i]!r} and {solids.names[j]!r} overlap by {volume:.6g} mm3, "
                "expected solids that touch or are apart"
            )


def _check_whole(model, solids: Solids, pieces, bolts: Sequence[BoltPlace], discs) -> None:
    """Refuse solids that bolts' circles cut in two."""
    for name, tags in zip(solids.names, pieces, strict=True):
        if len(tags) == 1:
            continue
        cut = {
            i
            for i, parts in enumerate(discs)
            for face in set().union(*parts)
            if len(set(model.getAdjacencies(2, face)[0].tolist()) & set(tags)) == 2
        }
        where = "; ".join(bolts[i].label(i + 1, solids) for i in sorted(cut)) or "a ring"
        raise MeshError(
            f"{name!r} passes through the middle of {where}; expected an empty "
            "hole there (leave bolts and pins out of the file)"
        )


def _remove_loose(model, discs) -> None:
    """Remove what the circles have inside holes, which no solid needs."""
    found = {face for parts in discs for part in parts for face in part}
    loose = [(2, face) for face in found if not len(model.getAdjacencies(2, face)[0])]
    if loose:
        model.occ.remove(loose, recursive=True)
        model.occ.synchronize()


def _sharing(model, pieces: Sequence[int]) -> dict[int, tuple[int, int]]:
    """The two solids of each face that two have."""
    number = {tag: i for i, tag in enumerate(pieces)}
    found = {}
    for _, face in model.getEntities(2):
        up, _ = model.getAdjacencies(2, face)
        if len(up) == 2:
            found[face] = tuple(sorted(number[tag] for tag in up))
    return found


def _ring(model, solids: Solids, sharing, number: int, bolt: BoltPlace, disc) -> list[int]:
    outer, inner = disc[0], disc[1] if len(disc) > 1 else set()
    pair = bolt.contact.lower, bolt.contact.upper
    found = [face for face in outer - inner if sharing.get(face) == pair]
    area = sum(model.occ.getMass(2, face) for face in found)
    expected = np.pi * (bolt.r_wai**2 - bolt.r_nei**2)
    if area < expected * (1 - _WHOLE):
        raise MeshError(
            f"the ring of {bolt.label(number, solids)}, {bolt.r_nei:g} to "
            f"{bolt.r_wai:g} mm, leaves the faces that touch: {100 * area / expected:.3g} % "
            "of it is on both; expected all (a smaller r_wai, or another centre)"
        )
    return found


def _washer(model, solids: Solids, pieces, sharing, washer: WasherPlace, disc) -> dict[int, int]:
    """gmsh's faces under a washer, and the solid of each."""
    own = {face for _, face in model.getBoundary([(3, pieces[washer.solid])], oriented=False)}
    found = [face for face in disc if face in own and face not in sharing]
    area = sum(model.occ.getMass(2, face) for face in found)
    expected = np.pi * (washer.radius**2 - washer.hole**2)
    if area < expected * (1 - _WHOLE):
        at = ", ".join(f"{x:.6g}" for x in washer.centre)
        raise MeshError(
            f"washers.{washer.name}: {100 * area / expected:.3g} % of the face of "
            f"{washer.radius:g} mm around ({at}) mm is on the outside of "
            f"{solids.names[washer.solid]!r}; expected all (a smaller radius, or another centre)"
        )
    return dict.fromkeys(found, washer.solid)


def _face(model, solids: Solids, pieces, sharing, shifts, name: str, points) -> dict[int, int]:
    """gmsh's faces with a name, and the solid of each."""
    found = {}
    for point in points:
        near = []
        for i, volume in enumerate(pieces):
            place = (point + shifts[i]).tolist()
            for _, face in model.getBoundary([(3, volume)], oriented=False):
                if face in sharing:
                    continue
                box = np.array(model.getBoundingBox(2, face)).reshape(2, 3)
                if np.any(place < box[0] - TOUCH) or np.any(place > box[1] + TOUCH):
                    continue
                nearest, _ = model.getClosestPoint(2, face, place)
                distance = float(np.linalg.norm(nearest - np.array(place)))
                if distance <= 10 * TOUCH and model.isInside(2, face, place):
                    near.append((face, i))
        at = ", ".join(f"{x:.6g}" for x in point)
        if len(near) > 1:
            raise MeshError(
                f"faces.{name}: {len(near)} faces of solids meet at ({at}) mm, "
                "expected a point inside one"
            )
        if not near:
            raise MeshError(
                f"faces.{name}: no face of a solid is at ({at}) mm, expected a "
                "point on an outer face (where solids touch, the faces have names already)"
            )
        found[near[0][0]] = near[0][1]
    return found


def _check_once(solids: Solids, named) -> None:
    used: dict[int, str] = {}
    for name, found in named.items():
        for face in found:
            if face in used:
                both = f"faces.{used[face]} and faces.{name}"
                raise MeshError(f"{both} are one face, expected one name for it")
            used[face] = name


def _check_sizes(model, solids: Solids, pieces, fine, sizes: Sizes) -> None:
    """Refuse sizes that would fill the memory; often a length in another unit than metres."""
    volume = sum(model.occ.getMass(3, tag) for tag in pieces)
    area = sum(model.occ.getMass(2, face) for face in fine)
    # A regular tetrahedron of size s has the volume s^3 / 8.5, a triangle the area 0.43 s^2.
    for key, size, n in (
        ("element_size", sizes.element, 8.5 * volume / sizes.element**3),
        ("ring_size", sizes.ring, area / (0.43 * sizes.ring**2)),
    ):
        if n > _MOST:
            raise MeshError(
                f"{key} is {size:.6g} mm, for which there would be about {n:.2g} "
                f"cells; expected at most {_MOST:.0e} (in what unit is it given?)"
            )


def _set_sizes(model, fine, sizes: Sizes) -> None:
    import gmsh

    gmsh.option.setNumber("Mesh.MeshSizeMax", sizes.element)
    gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", sizes.circle)
    if not fine:
        return
    curves = {abs(c) for f in fine for _, c in model.getBoundary([(2, f)], oriented=False)}
    distance, threshold = (model.mesh.field.add(kind) for kind in ("Distance", "Threshold"))
    model.mesh.field.setNumbers(distance, "CurvesList", sorted(curves))
    model.mesh.field.setNumbers(distance, "SurfacesList", sorted(fine))
    model.mesh.field.setNumber(distance, "Sampling", 40)
    reach = 2 * max(sizes.element - sizes.ring, sizes.ring)
    for key, value in {
        "InField": distance,
        "SizeMin": sizes.ring,
        "SizeMax": sizes.element,
        "DistMin": 0.5 * sizes.ring,
        "DistMax": reach,
    }.items():
        model.mesh.field.setNumber(threshold, key, value)
    model.mesh.field.setAsBackgroundMesh(threshold)


def _extract(model, solids, pieces, sharing, contacts, planes, ring_of, named) -> Glued:
    tags, x, _ = model.mesh.getNodes()
    cells = [_elements(model, 3, volume) for volume in pieces]
    values = np.repeat(np.arange(1, len(pieces) + 1), [len(c) for c in cells])
    nodes, cells = np.unique(np.vstack(cells), return_inverse=True)
    order = np.argsort(tags)
    x = x.reshape(-1, 3)[order[np.searchsorted(tags, nodes, sorter=order)]]
    shared = [
        SharedFace(
            pair,
            np.searchsorted(nodes, _elements(model, 2, face)),
            _contact_of(model, contacts, planes, face, pair),
            ring_of.get(face),
        )
        for face, pair in sharing.items()
    ]
    faces = {}
    for name, found in named.items():
        triangles = [np.searchsorted(nodes, _elements(model, 2, face)) for face in found]
        owner = np.repeat(list(found.values()), [len(t) for t in triangles])
        faces[name] = owner, np.vstack(triangles)
    none = np.empty((0, 3), np.int64), np.empty(0, np.int32)
    names = {name: tag for tag, name in enumerate(solids.names, start=1)}
    lists = MeshLists("tetrahedron", x, cells.reshape(-1, 4), values, *none, names, {})
    return Glued(lists, shared, faces)


def _elements(model, dim: int, entity: int) -> np.ndarray:
    """Corners of an entity's tetrahedra or triangles by gmsh's numbers, shape (n, dim + 1)."""
    found = [n.reshape(-1, dim + 1) for n in model.mesh.getElements(dim, entity)[2]]
    return np.vstack(found).astype(np.int64) if found else np.empty((0, dim + 1), np.int64)


def _contact_of(model, contacts, planes, face: int, pair) -> int | None:
    if not is_flat(model, face):
        return None
    points = surface_points(model, face)
    for i, (contact, (normal, point)) in enumerate(zip(contacts, planes, strict=True)):
        in_plane = np.abs((points - point) @ normal).max() < 10 * TOUCH
        if (contact.lower, contact.upper) == pair and in_plane:
            return i
    return None
