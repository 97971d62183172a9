"""Meshes of the second world: quadratic tetrahedra by gmsh, bodies apart where they touch."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from .rigs import RIGS, Rig, draw_bodies

CACHE = Path(__file__).resolve().parents[1] / "cache" / "calculix"
#: gmsh's order of a tetrahedron's ten nodes in CalculiX' own.
_TO_C3D10 = [0, 1, 2, 3, 4, 5, 6, 7, 9, 8]


@dataclass(frozen=True)
class Pairs:
    """Nodes of two bodies at the same places of an interface, those that carry area.

    Attributes:
        first, second: Nodes of the two, (k,).
        area: Of each pair, m2: a third of each triangle at each of its midside nodes, which
            integrates quadratics.
    """

    first: np.ndarray
    second: np.ndarray
    area: np.ndarray


@dataclass(frozen=True)
class Mesh:
    """A rig's mesh.

    Attributes:
        x: Nodes, (n, 3), m.
        cells: Of each body, (k, 10), in CalculiX' order.
        faces: Outer triangles of each body, (k, 6), those at interfaces left out.
        pairs: Of each interface.
        body: Of each node, (n,).
    """

    x: np.ndarray
    cells: list[np.ndarray]
    faces: list[np.ndarray]
    pairs: list[Pairs]
    body: np.ndarray


@cache
def mesh_of(name: str, scale: float = 1.0) -> Mesh:
    """The mesh of a rig, kept in a file beside the program.

    Args:
        name: Of the rig.
        scale: Factor on the size of cells.
    """
    rig = RIGS[name]
    key = f"{name}_{rig.size * scale:.4g}_{rig.fine * scale:.4g}_unfolded"
    path = CACHE / f"{key}.npz"
    if path.exists():
        with np.load(path) as kept:
            return _separate(rig, kept["x"], *_lists(rig, kept))
    found = _by_gmsh(rig, scale)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f"{key}.{np.random.default_rng().integers(2**31)}.part.npz")
    np.savez_compressed(part, **found)
    part.replace(path)
    return _separate(rig, found["x"], *_lists(rig, found))


def _lists(rig: Rig, kept):
    n, m = len(rig.bodies), len(rig.interfaces)
    return (
        [kept[f"cells_{i}"] for i in range(n)],
        [kept[f"faces_{i}"] for i in range(n)],
        [kept[f"touch_{i}"] for i in range(m)],
    )


def _by_gmsh(rig: Rig, scale: float) -> dict[str, np.ndarray]:
    """Nodes, and by body and interface the cells and triangles, in nodes that bodies share."""
    import gmsh

    ours = not gmsh.isInitialized()
    if ours:
        gmsh.initialize()
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.add(rig.name)
        occ = gmsh.model.occ
        tags = draw_bodies(occ, rig)
        # Cells follow the rim of each pad, so that the contact's area does not hang on them.
        pads = [(2, occ.addDisk(*bolt, rig.pad, rig.pad)) for bolt in rig.bolts]
        _, made = occ.fragment([(3, tags[0])], [(3, tag) for tag in tags[1:]] + pads)
        occ.synchronize()
        volumes = [[tag for dim, tag in one if dim == 3] for one in made[: len(tags)]]
        _sizes(gmsh, rig, scale)
        gmsh.model.mesh.generate(3)
        gmsh.model.mesh.setOrder(2)
        return _read(gmsh, rig, volumes)
    finally:
        gmsh.model.remove()
        if ours:
            gmsh.finalize()


def _sizes(gmsh, rig: Rig, scale: float) -> None:
    field = gmsh.model.mesh.field
    balls = []
    for x, y, z in rig.bolts:
        ball = field.add("Ball")
        for key, value in {
            "XCenter": x,
            "YCenter": y,
            "ZCenter": z,
            "Radius": 1.1 * rig.pad,
            "Thickness": rig.size,
            "VIn": scale * rig.fine,
            "VOut": scale * rig.size,
        }.items():
            field.setNumber(ball, key, value)
        balls.append(ball)
    least = field.add("Min")
    field.setNumbers(least, "FieldsList", balls)
    field.setAsBackgroundMesh(least)
    for key in ("MeshSizeExtendFromBoundary", "MeshSizeFromPoints", "MeshSizeFromCurvature"):
        gmsh.option.setNumber(f"Mesh.{key}", 0)
    gmsh.option.setNumber("Mesh.SecondOrderLinear", 0)


def _read(gmsh, rig: Rig, volumes) -> dict[str, np.ndarray]:
    tags, x, _ = gmsh.model.mesh.getNodes()
    place = np.zeros(int(tags.max()) + 1, dtype=int)
    place[tags] = np.arange(len(tags))

    def nodes(dim, kind, entities, width):
        found = [gmsh.model.mesh.getElementsByType(kind, entity)[1] for entity in entities]
        return place[np.concatenate(found).astype(int).reshape(-1, width)]

    sides = [
        {tag for _, tag in gmsh.model.getBoundary([(3, v) for v in one], oriented=False)}
        for one in volumes
    ]
    out = {"x": x.reshape(-1, 3)}
    touching = set()
    for i, face in enumerate(rig.interfaces):
        shared = sides[face.bodies[0]] & sides[face.bodies[1]]
        touching |= shared
        out[f"touch_{i}"] = nodes(2, 9, sorted(shared), 6)
    for i, one in enumerate(volumes):
        out[f"cells_{i}"] = nodes(3, 11, one, 10)[:, _TO_C3D10]
        out[f"faces_{i}"] = nodes(2, 9, sorted(sides[i] - touching), 6)
    cells = np.concatenate([out[f"cells_{i}"] for i in range(len(volumes))])
    out["x"] = unfolded(out["x"], cells)
    return out


def unfolded(x: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Nodes, (n, 3), with the edges of cells that a curved side folds made straight."""
    x = x.copy()
    for _ in range(20):
        bad = cells[_least_volume(x[cells]) <= _FOLDED]
        if not len(bad):
            return x
        for middle, (first, second) in enumerate(_EDGES, 4):
            x[bad[:, middle]] = (x[bad[:, first]] + x[bad[:, second]]) / 2
    raise ValueError(f"{len(bad)} cells stay folded though their edges are straight")


def _least_volume(nodes: np.ndarray) -> np.ndarray:
    """Least over a cell of its Jacobian, over that with straight edges, (k,) of (k, 10, 3)."""
    straight = np.linalg.det(nodes[:, 1:4] - nodes[:, :1])
    jacobians = np.einsum("pia,kib->kpab", _SLOPES, nodes)
    return (np.linalg.det(jacobians) / straight[:, None]).min(axis=1)


def _slopes(point: np.ndarray) -> np.ndarray:
    """Derivatives of the ten shape functions by the last three barycentric coordinates, (10, 3)."""
    by = np.vstack([-np.ones(3), np.eye(3)])
    t = np.array([1 - point.sum(), *point])
    corners = (4 * t - 1)[:, None] * by
    middles = [4 * (t[i] * by[j] + t[j] * by[i]) for i, j in _EDGES]
    return np.vstack([corners, middles])


#: Corners at the ends of the middles 5 to 10 of a C3D10.
_EDGES = ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))
#: Jacobian, over that with straight edges, below which a cell counts as folded.
_FOLDED = 0.1
#: At the four points of its quadrature and at its corners.
_SLOPES = np.array(
    [
        _slopes(np.array(point))
        for point in [
            *np.full((1, 3), 0.1381966),
            *(0.1381966 + 0.4472136 * np.eye(3)),
            *np.zeros((1, 3)),
            *np.eye(3),
        ]
    ]
)


def _separate(rig: Rig, x, cells, faces, touch) -> Mesh:
    """Nodes of their own for the second body of each interface."""
    x, pairs = x.copy(), []
    for face, triangles in zip(rig.interfaces, touch, strict=True):
        second = face.bodies[1]
        shared = np.unique(triangles)
        copy = np.arange(len(x), len(x) + len(shared))
        to = np.arange(len(x))
        to[shared] = copy
        x = np.concatenate([x, x[shared]])
        cells[second], faces[second] = to[cells[second]], to[faces[second]]
        a, b, c = (x[triangles[:, i]] for i in range(3))
        third = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 6
        area = np.zeros(len(to))
        for i in (3, 4, 5):
            np.add.at(area, triangles[:, i], third)
        used = np.flatnonzero(area)
        pairs.append(Pairs(used, to[used], area[used]))
    body = np.full(len(x), -1)
    for number, own in enumerate(cells):
        body[own] = number
    return _dense(Mesh(x, list(cells), list(faces), pairs, body))


def _dense(mesh: Mesh) -> Mesh:
    """Without nodes that nothing uses, such as centres of balls."""
    used = mesh.body >= 0
    to = np.cumsum(used) - 1
    pairs = [Pairs(to[p.first], to[p.second], p.area) for p in mesh.pairs]
    return Mesh(
        mesh.x[used],
        [to[c] for c in mesh.cells],
        [to[f] for f in mesh.faces],
        pairs,
        mesh.body[used],
    )
