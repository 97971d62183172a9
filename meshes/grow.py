"""Joint layers for a mesh that has none: one cell thick, grown where its parts touch.

The faces of the two parts stay where they are but for half the layer's thickness, a ten-thousandth
of the smallest part: nothing is moved that anyone would measure. With a law that is a stiffness
per area (`fenics_joints.structure.laws.SPRINGS`) such a layer is a spring of zero thickness, see
`fenics_joints.forms.thin_layer`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from typing import Annotated, ClassVar, Literal

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from fenics_joints.errors import MeshError
from fenics_joints.meshes.arguments import Arguments, Demand, Size, is_positive, lengths
from fenics_joints.meshes.facets import (
    FACETS,
    Bodies,
    add_faces,
    by_part,
    exterior_facets,
    interfaces,
    layer_cells,
    oriented,
    row_numbers,
)
from fenics_joints.meshes.mortar import TIED, overlap
from fenics_joints.meshes.tagged import MeshLists, Tie

#: Thickness of a layer that is not given, as a share of the smallest extent of the parts. Chosen:
#: frequencies change by less than a mesh's own error; `forms.thin_layer` is exact for any.
_THIN = 1e-4
#: Most thickness of any layer as a share of the shortest edge of a cell: none is turned inside out.
_OF_EDGE = 0.1
#: Most thickness of a layer that is given, as a share of the smallest extent of the parts. Chosen:
#: the parts lose half of it each.
_MOST = 5e-2
#: Distance as a share of the shortest edge up to which vertices of two parts are one: round-off of
#: mesh files.
_ONE = 1e-3
#: Cosine of the angle between neighbouring facets of one contact: 31 degrees, so that the facets of
#: a circle of twelve edges are one.
_SMOOTH = 0.855
#: Sine by which normals of a flat contact may differ, and height as a share of its size by which it
#: may be uneven: round-off of mesh files.
_FLAT = 1e-3
#: Share of its radius by which corners may miss a circle, and least number of them. Chosen: a hole
#: of six edges is round, a square one is not.
_ROUND, _CORNERS = 0.02, 6
#: Most distance of two faces that touch though their meshes differ, as a share of the size of their
#: facets: of flat ones, and of curved ones, where chords are apart. Chosen.
_APART, _CHORDS = 0.02, 0.1
#: Share of the area that matches above which what does not match counts: round-off of areas.
_REST = 1e-2
#: Ends of the edges of an edge (its two points), a triangle and a quadrilateral.
_ENDS = {2: [(0,), (1,)], 3: [(0, 1), (1, 2), (0, 2)], 4: [(0, 1), (0, 2), (1, 3), (2, 3)]}


def groups_of(n: int, pairs: Iterable[tuple[int, int]]) -> np.ndarray:
    """Number of the group of each of n things, of which pairs are connected; the first is 0."""
    if not isinstance(pairs, np.ndarray):
        pairs = np.array(list(pairs), dtype=np.int64).reshape(-1, 2)
    graph = coo_array((np.ones(len(pairs), np.int8), pairs.T), shape=(n, n))
    return connected_components(graph, directed=False)[1]


@dataclass(frozen=True)
class Touch:
    """Facets on which two parts touch.

    Attributes:
        parts: Names of the two, in the mesh's order; of meshes that differ, that with the larger
            facets first.
        facets: Vertices of the glued mesh as the first part's cell has them, shape (n, n_corners).
        middles: Middles, m, shape (n, gdim).
        normals: Unit normals from the first part to the second, shape (n, gdim).
        areas: m2 (m in the plane), shape (n,).
        opposite: Of faces whose meshes differ the facets of the first part, with its vertices,
            shape (m, n_corners); the others are then those of the second.
        hidden: Which of these are covered by more than half, (m,).
        reach: Farthest distance of the two faces, m.
        covered: Area that both have in common, m2, by facet: also that of facets of which too
            little is covered, shared out over the others; shape (n,).
    """

    parts: tuple[str, str]
    facets: np.ndarray
    middles: np.ndarray
    normals: np.ndarray
    areas: np.ndarray
    opposite: np.ndarray | None = None
    hidden: np.ndarray | None = None
    reach: float = 0.0
    covered: np.ndarray | None = None

    def pick(self, rows: np.ndarray) -> Touch:
        """Some of its facets."""
        return replace(self, **{key: getattr(self, key)[rows] for key in self.by_facet})

    @property
    def by_facet(self) -> tuple[str, ...]:
        """Names of the attributes that have an entry for each facet."""
        own = ("facets", "middles", "normals", "areas")
        return own if self.covered is None else (*own, "covered")

    @property
    def normal(self) -> np.ndarray:
        """Mean unit normal."""
        mean = self.areas @ self.normals
        return mean / np.linalg.norm(mean) + 0.0

    @property
    def is_flat(self) -> bool:
        """Whether all facets have one normal and lie in one plane."""
        off = self.normals - np.outer(self.normals @ self.normal, self.normal)
        height = self.middles @ self.normal
        size = np.linalg.norm(np.ptp(self.middles, axis=0)) + np.sqrt(self.areas.max())
        return bool(np.linalg.norm(off, axis=1).max() < _FLAT and np.ptp(height) < _FLAT * size)


def shortest_edge(lists: MeshLists) -> float:
    """Length of the shortest edge of the mesh's facets, m."""
    facets = lists.cells[:, FACETS[lists.cell]].reshape(-1, FACETS[lists.cell].shape[1])
    ends = [(0, 1)] if facets.shape[1] == 2 else _ENDS[facets.shape[1]]
    x = lists.x[facets]
    return min(float(np.linalg.norm(x[:, a] - x[:, b], axis=1).min()) for a, b in ends)


def glued(lists: MeshLists, apart: Iterable[tuple[str, str]] = ()) -> MeshLists:
    """The same mesh with one vertex where vertices of different parts coincide.

    Args:
        lists: The mesh.
        apart: Pairs of parts whose vertices stay two.
    """
    n, tree = len(lists.x), KDTree(lists.x)
    pairs = tree.query_pairs(_ONE * shortest_edge(lists), output_type="ndarray")
    if not len(pairs):
        return lists
    values = np.unique(lists.cell_values, return_inverse=True)[1].ravel()
    rows, of = lists.cells.ravel(), np.repeat(values, lists.cells.shape[1])
    has = coo_array((np.ones(len(rows), np.int32), (rows, of)), (n, values.max() + 1)).tocsr()
    common = np.asarray(has[pairs[:, 0]].multiply(has[pairs[:, 1]]).sum(axis=1)).ravel()
    tags = np.unique(lists.cell_values).tolist()
    for a, b in apart:
        one, other = (
            has[:, [tags.index(lists.cell_names[name])]].toarray()[:, 0] for name in (a, b)
        )
        one, other = one[pairs] > 0, other[pairs] > 0
        common[(one[:, 0] & other[:, 1]) | (other[:, 0] & one[:, 1])] = 1
    _, first, new = np.unique(
        groups_of(n, pairs[common == 0]), return_index=True, return_inverse=True
    )
    return replace(lists, x=lists.x[first], cells=new[lists.cells], facets=new[lists.facets])


def touches(
    lists: MeshLists,
    bonded: Sequence[tuple[str, str]] = (),
    between: Iterable[tuple[str, str]] = (),
) -> list[Touch]:
    """The contacts of a glued mesh: smooth faces on which two parts touch.

    Flat faces of one pair of parts in one plane are one contact, even with a gap between them.
    Parts whose meshes do not match touch too if nothing else connects them, or if ``between`` names
    them; the second part of such a contact is the one with the smaller facets.

    Args:
        lists: The mesh; vertices of parts at one place are one.
        bonded: Pairs of parts that are left out.
        between: Pairs of parts that may touch though their meshes do not match.

    Returns:
        The contacts in the order of the parts, then of x, y and z; those of meshes that do not
        match last.
    """
    names, left_out = list(lists.cell_names), {frozenset(pair) for pair in bonded}
    facets, cells = interfaces(lists, part_numbers(lists))
    parts = part_numbers(lists)[cells]
    found = []
    for a, b in np.unique(parts, axis=0):
        own = (parts == (a, b)).all(axis=1)
        if {names[a], names[b]} not in left_out:
            touch = _measured(lists, (names[a], names[b]), facets[own], cells[own])
            found += _contacts(touch)
    connected = [*bonded, *(touch.parts for touch in found)]
    return found + _unlike_touches(lists, connected, between)


def _whole_contacts(lists: MeshLists, wanted: Grown) -> tuple[MeshLists, list[Touch]]:
    """The glued mesh and its contacts; parts of which some facets match and others do not are taken
    as parts whose meshes do not match.

    Raises:
        MeshError: If parts that are to be one body do not match.
    """
    whole, between = glued(lists), wanted.between or ()
    names, sides, found = list(whole.cell_names), _sides_of(whole), touches(whole, between=between)
    matched, apart = dict.fromkeys(map(frozenset, wanted.bonded), 0.0), []
    for touch in found:
        if touch.opposite is None:
            pair = frozenset(touch.parts)
            matched[pair] = matched.get(pair, 0.0) + touch.areas.sum()
    for pair, area in matched.items():
        a, b = sorted(pair, key=names.index)
        one, other = sides[names.index(a)], sides[names.index(b)]
        rest = sum(t.covered[:, 1].sum() for t in _unlike((a, b), one, other, exact=True))
        if rest <= _REST * area:
            continue
        if pair in map(frozenset, wanted.bonded):
            raise MeshError(
                f"bonded has {[a, b]}, whose meshes do not match; expected common vertices "
                "(in gmsh: fragment the solids before meshing), or a joint"
            )
        apart.append((a, b))
    if apart:
        whole = glued(lists, apart)
    if apart or wanted.bonded:
        found = touches(whole, wanted.bonded, [*between, *apart])
    return whole, found


@dataclass(frozen=True)
class _Side:
    """Outer facets of a part: vertices, m, those of each facet, outward normals and areas, m2."""

    points: np.ndarray
    facets: np.ndarray
    normals: np.ndarray
    areas: np.ndarray

    def near(self, other: _Side) -> _Side:
        """The facets in the box around another's."""
        x, y = self.points[self.facets], other.points[other.facets]
        slack = np.ptp(x, axis=1).max()
        low, high = x.min(axis=1), x.max(axis=1)
        inside = (high >= y.min(axis=(0, 1)) - slack) & (low <= y.max(axis=(0, 1)) + slack)
        rows = inside.all(axis=1)
        return _Side(self.points, self.facets[rows], self.normals[rows], self.areas[rows])


def _unlike_touches(lists: MeshLists, connected, between) -> list[Touch]:
    """Contacts of parts whose meshes do not match, see `touches`."""
    names, sides = list(lists.cell_names), _sides_of(lists)
    body = groups_of(len(names), [[names.index(name) for name in pair] for pair in connected])
    asked = {frozenset(pair) for pair in between} - {frozenset(pair) for pair in connected}
    found = []
    for a, b in combinations(range(len(names)), 2):
        pair = names[a], names[b]
        if body[a] != body[b] or frozenset(pair) in asked:
            found += _unlike(pair, sides[a], sides[b])
    return found


def _sides_of(lists: MeshLists) -> list[_Side]:
    """Each part's outer facets, in the order of the mesh's names."""
    facets, cells = exterior_facets(lists)
    part = part_numbers(lists)[cells]
    areas = outward_areas(lists.x[facets], lists.x[lists.cells[cells]].mean(axis=1))
    size = np.linalg.norm(areas, axis=1)
    normals = areas / size[:, None]
    own = [part == i for i in range(len(lists.cell_names))]
    return [_Side(lists.x, facets[i], normals[i], size[i]) for i in own]


def _unlike(parts: tuple[str, str], a: _Side, b: _Side, exact: bool = False) -> list[Touch]:
    """Contacts of two parts by their outer facets; ``exact`` where the faces coincide."""
    if not len(a.facets) or not len(b.facets):  # inside others
        return []
    a, b = a.near(b), b.near(a)
    if not len(a.facets) or not len(b.facets):
        return []
    edge = (lambda s: s.mean()) if a.points.shape[1] == 2 else (lambda s: np.sqrt(s.mean()))
    if edge(a.areas) < edge(b.areas):
        parts, a, b = parts[::-1], b, a
    covered = np.empty((len(b.facets), 2))
    for i, share in enumerate((_ONE, _ONE) if exact else (_CHORDS, _APART)):
        common = overlap(b, a, share * edge(b.areas))
        covered[:, i] = np.bincount(common.upper, common.weight, len(b.facets))
        if not i:
            lower, reach = np.unique(common.lower), share * edge(b.areas)
            hidden = np.bincount(common.lower, common.weight, len(a.facets)) > 0.5 * a.areas
    rows = np.flatnonzero(covered[:, 0] > TIED * b.areas)
    if not len(rows):
        return []
    # What is covered of facets that are left out is shared out over the others.
    covered = covered[rows] * covered.sum(axis=0) / np.maximum(covered[rows].sum(axis=0), 1e-300)
    x = b.points[b.facets[rows]].mean(axis=1)
    face = b.facets[rows], x, -b.normals[rows], b.areas[rows]
    whole = Touch(parts, *face, a.facets[lower], hidden[lower], reach, covered)
    if exact:
        return [whole]
    found = []
    for touch in _contacts(whole):
        near = touch.covered[:, 1 if touch.is_flat else 0]
        kept = np.flatnonzero(near > TIED * touch.areas)
        if len(kept):
            found.append(replace(touch.pick(kept), covered=near[kept]))
    return found


def part_numbers(lists: MeshLists) -> np.ndarray:
    """Number of each cell's part in the order of the mesh's names, shape (n_cells,)."""
    return by_part(lists, {name: i for i, name in enumerate(lists.cell_names)})


def _measured(lists: MeshLists, parts, facets: np.ndarray, cells: np.ndarray) -> Touch:
    x = lists.x[facets]
    areas = outward_areas(x, lists.x[lists.cells[cells[:, 0]]].mean(axis=1))
    size = np.linalg.norm(areas, axis=1)
    return Touch(parts, facets, x.mean(axis=1), areas / size[:, None], size)


def area_vectors(x: np.ndarray) -> np.ndarray:
    """Area times normal, m2, (n, gdim), of facets by their corners, m, (n, k, gdim).

    Edges in the plane have their length, m. The corners of quadrilaterals are in DOLFINx's order:
    their diagonals are 0-3 and 1-2.
    """
    if x.shape[2] == 2:
        along = x[:, 1] - x[:, 0]
        return np.column_stack([along[:, 1], -along[:, 0]])
    return np.cross(x[:, -1] - x[:, 0], x[:, 2] - x[:, 1]) / 2


def outward_areas(x: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """`area_vectors` that point away from a point behind each facet, m, shape (n, gdim)."""
    areas = area_vectors(x)
    return areas * np.sign(np.sum(areas * (x.mean(axis=1) - inside), axis=1))[:, None]


def _contacts(touch: Touch) -> list[Touch]:
    """Its facets in smooth pieces; flat ones in one plane together."""
    label = _pieces(touch)
    pieces = [touch.pick(label == i) for i in range(label.max() + 1)]
    found: list[list[Touch]] = []
    for piece in pieces:
        for group in found:
            if piece.is_flat and group[0].is_flat and _one_plane(group[0], piece):
                group.append(piece)
                break
        else:
            found.append([piece])
    merged = [
        replace(
            group[0], **{k: np.concatenate([getattr(p, k) for p in group]) for k in touch.by_facet}
        )
        for group in found
    ]
    return sorted(merged, key=lambda t: tuple(np.round(t.middles.min(axis=0), 9)))


def _one_plane(a: Touch, b: Touch) -> bool:
    away = b.middles - a.middles[0]
    size = np.linalg.norm(away, axis=1).max()
    return bool(a.normal @ b.normal > 1 - _FLAT**2 and np.abs(away @ a.normal).max() < _FLAT * size)


def _edges(facets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Ends of the facets' edges (of the facets in the plane: their ends), and each one's facet."""
    ends = np.array(_ENDS[facets.shape[1]])
    n, k = len(facets), len(ends)
    return facets[:, ends].reshape(n * k, -1), np.repeat(np.arange(n), k)


def _pieces(touch: Touch) -> np.ndarray:
    """Number of the smooth piece that each facet is in."""
    ends, facet = _edges(touch.facets)
    number = row_numbers(ends)
    order = np.argsort(number, kind="stable")
    same = np.flatnonzero(np.diff(number[order]) == 0)
    pairs = facet[np.column_stack([order[same], order[same + 1]])]
    smooth = np.sum(np.prod(touch.normals[pairs], axis=1), axis=1) > _SMOOTH
    return groups_of(len(touch.facets), pairs[smooth])


@dataclass(frozen=True)
class RoundHole:
    """A round hole in a contact: its centre, m, shape (3,), and its radius, m."""

    centre: np.ndarray
    radius: float


def round_holes(x: np.ndarray, touch: Touch) -> list[RoundHole]:
    """The round holes of a flat contact in space, in the order of x, y and z.

    Args:
        x: Vertices, m, shape (n, 3).
        touch: The contact.
    """
    if x.shape[1] != 3 or not touch.is_flat:
        return []
    ends, facet = _edges(touch.facets)
    number = row_numbers(ends)
    alone = np.bincount(number)[number] == 1
    ends, facet = ends[alone], facet[alone]
    nodes, local = np.unique(ends, return_inverse=True)
    local = local.reshape(ends.shape)
    loop = groups_of(len(nodes), local)
    found = []
    for own in range(loop.max(initial=-1) + 1):
        hole = _circle(x[nodes[loop == own]], touch.normal)
        if hole is None:
            continue
        rows = loop[local[:, 0]] == own
        edge, beyond = x[ends[rows]].mean(axis=1), touch.middles[facet[rows]]
        far, near = (np.linalg.norm(at - hole.centre, axis=1) for at in (beyond, edge))
        if np.all(far > near):
            found.append(hole)
    return sorted(found, key=lambda h: tuple(np.round(h.centre, 6)))


def _circle(corners: np.ndarray, normal: np.ndarray) -> RoundHole | None:
    """The circle on which corners lie, if they do."""
    if len(corners) < _CORNERS:
        return None
    centre, radii = fit_circle(corners, normal)
    radius = float(radii.mean())
    is_round = np.abs(radii - radius).max() <= _ROUND * radius
    return RoundHole(centre, radius) if is_round else None


def fit_circle(corners: np.ndarray, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centre, (3,), of the circle through points in a plane, (n, 3); the points' distances, (n,).

    |x - c|^2 = r^2 is linear in c and r^2 - |c|^2.
    """
    basis, middle = np.linalg.svd(normal[None])[2][1:], corners.mean(axis=0)
    flat = (corners - middle) @ basis.T
    system = np.column_stack([2 * flat, np.ones(len(flat))])
    (*c, _), *_ = np.linalg.lstsq(system, (flat**2).sum(axis=1), rcond=None)
    return middle + np.array(c) @ basis, np.linalg.norm(flat - c, axis=1)


def pair_list(found: Sequence[Touch]) -> str:
    """The contacts for a message."""
    return ", ".join(f"{a!r} and {b!r}" for a, b in dict.fromkeys(t.parts for t in found))


def thin_layer(lists: MeshLists, parts: Iterable[str]) -> float:
    """Thickness of a layer between parts that moves nothing anyone would measure."""
    return min(_THIN * _smallest_extent(lists, parts), _OF_EDGE * shortest_edge(lists))


def _smallest_extent(lists: MeshLists, parts: Iterable[str]) -> float:
    cells = (lists.cells[lists.cell_values == lists.cell_names[name]] for name in parts)
    return min(float(np.ptp(lists.x[own], axis=(0, 1)).min()) for own in cells)


def spread(x: np.ndarray, sides: Sequence[np.ndarray], areas: np.ndarray, size: float) -> None:
    """Move the vertices of two faces that coincide apart, half of a distance each.

    Args:
        x: Vertices, shape (n, gdim), which are moved.
        sides: Vertices of the facets of either face, or of the first alone, each of shape
            (n_facets, n_corners).
        areas: Normals from the first to the second, as long as the facets' areas,
            shape (n_facets, gdim).
        size: The distance, in the unit of ``x``.
    """
    for corners, way in zip(sides, (-0.5, 0.5), strict=False):
        nodes, local = np.unique(corners, return_inverse=True)
        total = np.zeros((len(nodes), x.shape[1]))
        np.add.at(total, local.ravel(), areas.repeat(corners.shape[1], axis=0))
        x[nodes] += way * size * total / np.linalg.norm(total, axis=1)[:, None]


def fill(lists: MeshLists, layers: Mapping[str, Sequence[np.ndarray]], n_layer=1) -> MeshLists:
    """The mesh with layers of cells, which are parts of it, between faces.

    Args:
        lists: The mesh.
        layers: For the name of each layer, the vertices of the facets below and above it, each of
            shape (n_facets, n_corners).
        n_layer: Cells through a layer.

    Raises:
        MeshError: The mesh has a part of the name.
    """
    x, names, simplex = lists.x, dict(lists.cell_names), lists.cell in ("triangle", "tetrahedron")
    cells, values = [lists.cells], [lists.cell_values]
    for name, (lower, upper) in layers.items():
        if name in names:
            raise MeshError(
                f"the mesh has a part {name!r} already, which is the name of a new layer; expected "
                "another name, or no joint for [mesh]"
            )
        names[name] = max(names.values()) + 1
        flat, first = np.unique(lower, return_index=True)
        levels, low, high = [lower], x[flat], x[upper.ravel()[first]]
        for share in np.arange(1, n_layer) / n_layer:
            levels.append(len(x) + np.searchsorted(flat, lower))
            x = np.vstack([x, (1 - share) * low + share * high])
        levels.append(upper)
        new = np.vstack([layer_cells(*pair, simplex) for pair in pairwise(levels)])
        cells.append(oriented(lists.cell, x, new))
        values.append(np.full(len(new), names[name], dtype=lists.cell_values.dtype))
    return replace(
        lists, x=x, cells=np.vstack(cells), cell_values=np.concatenate(values), cell_names=names
    )


def _are_several(values) -> bool:
    return np.iterable(values) and not isinstance(values, str)


Range = Annotated[
    tuple[float, float],
    Demand(
        lambda v: lengths(v, 2) and v[0] <= v[1], "the least and the largest diameter, in metres"
    ),
]
Pairs = Annotated[Sequence[tuple[str, str]], Demand(_are_several, "a sequence of pairs of parts")]


@dataclass(frozen=True, kw_only=True)
class Grown(Arguments):
    """How parts are joined where they touch.

    Attributes:
        joint: ``"layer"`` on all that touches, ``"rings"`` round bolts, or ``"contact"``: none,
            but separate parts.
        r_wai: Outer radius of the rings, m, or of each, with ``bolts``.
        r_nei: Inner radius, m; None: that of the holes.
        bolts: Points on the bolts' axes, m, shape (n, 3); None: in all round holes.
        hole: Least and largest diameter of these, m; None: any below 2 ``r_wai``.
        layer: Thickness of the layers, m; None: a ten-thousandth of the smallest extent of a part.
        bonded: Pairs of parts that stay one body where they touch.
        between: Pairs of parts that are joined; None: all that touch.

    Raises:
        MeshError: A value makes no sense; the message names it.
    """

    function: ClassVar[str] = "grow"

    joint: Literal["rings", "layer", "contact"] = "rings"
    r_wai: float | Sequence[float] | None = None
    r_nei: Size | None = None
    bolts: Annotated[Sequence[Sequence[float]], Demand(_are_several, "a sequence")] | None = None
    hole: Range | None = None
    layer: Size | None = None
    bonded: Pairs = ()
    between: Pairs | None = None

    def check(self) -> None:
        """Refuse arguments that do not fit each other, with MeshError."""
        if self.joint != "rings":
            for key in ("r_wai", "bolts"):
                none = getattr(self, key) is None
                self.require(none, key, f"none with joint = {self.joint!r}")
            return
        radii = np.atleast_1d(np.array(self.r_wai, dtype=object))
        fits = radii.ndim == 1 and len(radii) > 0 and all(map(is_positive, radii))
        self.require(fits, "r_wai", "the outer radius of the rings, above 0 m")
        n = 1
        if self.bolts is not None:
            n = len(self.bolts)
            fits = n > 0 and all(np.shape(bolt) == (3,) for bolt in self.bolts)
            self.require(fits, "bolts", "a point (x, y, z) in metres for each bolt")
        self.require(len(radii) in (1, n), "r_wai", f"one radius, or {n} with the bolts' centres")

    def radii(self) -> np.ndarray:
        """Outer radius of the rings, m: one, or one for each of the bolts that are given."""
        n = 1 if self.bolts is None else len(self.bolts)
        return np.broadcast_to(np.array(self.r_wai, dtype=float), n)


def grow(lists: MeshLists, wanted: Grown) -> MeshLists:
    """Part a mesh where its parts touch, and grow layers of cells in between.

    Parts touch where they share vertices or have vertices at one place. New parts: ``joint``, or
    ``joint_1``, ... where there are several contacts, flat or smooth; or ``ring_1``, ..., the
    facets whose middle is within a ring. New faces, of facets that have no name: ``joint_lower``
    and ``joint_upper`` between layers and parts, and ``A_to_B`` and ``B_to_A`` where parts A and B
    touch with no layer. ``notes`` of the mesh say what was done.

    Where meshes do not match (`touches`) the layer stands on those facets of one part of which the
    other covers at least a tenth. Its free face, ``NAME_tied`` of the first layer of a contact,
    follows the other part (`MeshLists.ties`), whose facets there become ``A_to_B`` if more than
    half of them is covered. Faces of which only a part matches are taken so as a whole.

    Raises:
        MeshError: No parts touch, a part is unknown, a bolt is on no contact or
            has no facets, or the layer is too thick for the mesh.
    """
    if not len(lists.facets):  # of whatever shape, without any
        corners = FACETS[lists.cell].shape[1]
        lists = replace(lists, facets=np.empty((0, corners), np.int64))
    _check_pairs(lists, wanted)
    whole, found = _whole_contacts(lists, wanted)
    if not found:
        raise MeshError(
            f"no two of the parts {', '.join(map(repr, whole.cell_names))} touch, expected faces "
            "that lie on one another, with or without vertices at the same places"
        )
    names = list(whole.cell_names)
    bonds = [[names.index(name) for name in pair] for pair in wanted.bonded]
    body = groups_of(len(names), bonds)
    parted = Bodies(whole, body[part_numbers(whole)])
    layers, centres, notes = _layers(whole, found, wanted)

    def own(part: str, facets: np.ndarray) -> np.ndarray:
        return parted.own(body[names.index(part)], facets)

    #: Vertices of the second parts' faces, and the first of their copies, for unlike meshes.
    copies: dict[int, tuple[np.ndarray, int]] = {}

    def sides(touch: Touch, rows) -> list[np.ndarray]:
        upper = own(touch.parts[1], touch.facets[rows])
        if touch.opposite is None:
            return [own(touch.parts[0], touch.facets[rows]), upper]
        if id(touch) not in copies:
            nodes = np.unique(upper)
            copies[id(touch)] = nodes, len(parted.x)
            parted.x = np.vstack([parted.x, parted.x[nodes]])
        nodes, first = copies[id(touch)]
        return [first + np.searchsorted(nodes, upper), upper]

    size, bare = _thickness(whole, wanted, found) if layers else 0.0, []
    for touch in found:
        # All rings of a contact together, as they may share vertices.
        rows = np.unique([row for of, own in layers.values() if of is touch for row in own])
        rest = np.setdiff1d(np.arange(len(touch.areas)), rows)
        if len(rows):
            rows = rows.astype(int)
            normals = touch.normal if touch.is_flat else touch.normals[rows]
            faces = sides(touch, rows)  # may add vertices
            spread(parted.x, faces, normals * touch.areas[rows, None], size)
            if touch.opposite is not None:
                lower = own(touch.parts[0], touch.opposite)
                areas, near = area_vectors(parted.x[lower]), KDTree(touch.middles)
                ways = touch.normals[near.query(parted.x[lower].mean(axis=1))[1]]
                areas *= np.sign(np.sum(areas * ways, axis=1))[:, None]
                spread(parted.x, [lower], areas, size)
        if touch.opposite is not None and not len(rows):
            upper = own(touch.parts[1], touch.facets)
            bare.append((touch.parts, (own(touch.parts[0], touch.opposite), upper)))
        elif len(rest) and touch.opposite is None:
            bare.append((touch.parts, sides(touch, rest)))
    layer_sides = {name: sides(*layer) for name, layer in layers.items()}
    grown = fill(parted.lists(), layer_sides)
    grown = replace(grown, shares=_cell_shares(len(whole.cells), len(grown.cells), layers))
    like, tied = {}, {}
    for name, pair in layer_sides.items():
        touch = layers[name][0]
        if touch.opposite is None:
            like[name] = pair
        else:  # layers of one contact may share vertices
            tied.setdefault(id(touch), (touch, f"{name}_tied", []))[2].append(pair[0])
    faces = layer_faces(like, bare)
    for touch, face, facets in tied.values():
        faces[face] = np.vstack(facets)
        lower = own(touch.parts[0], touch.opposite)
        faces["{}_to_{}".format(*touch.parts)] = lower
        # As where meshes match, a named face is what the contact leaves of it.
        grown = _without_names(grown, lower[touch.hidden])
    grown = _with_free_facets(grown, faces)
    ties = []
    for touch, face, _ in tied.values():
        to = _face_names(grown, own(touch.parts[0], touch.opposite))
        ties.append(Tie(face, to, touch.parts[0], float(1.5 * touch.reach + size)))
    grown = replace(grown, ties=(*grown.ties, *ties))
    if centres is not None:
        grown = replace(grown, points={**grown.points, "bolts": centres})
    return replace(grown, notes=(*grown.notes, *_layer_notes(layers, size), *notes))


def _check_pairs(lists: MeshLists, wanted: Grown) -> None:
    for key in ("bonded", "between"):
        for pair in getattr(wanted, key) or ():
            known = set(pair) <= set(lists.cell_names)
            if len(pair) != 2 or pair[0] == pair[1] or not known:
                there = ", ".join(lists.cell_names)
                raise MeshError(f"{key} has {list(pair)}, expected two of the parts: {there}")


def _thickness(lists: MeshLists, wanted: Grown, found: Sequence[Touch]) -> float:
    parts = {part for touch in found for part in touch.parts}
    if wanted.layer is None:
        return thin_layer(lists, parts)
    most = min(_MOST * _smallest_extent(lists, parts), _OF_EDGE * shortest_edge(lists))
    if wanted.layer > most:
        raise MeshError(
            f"layer is {1e3 * wanted.layer:g} mm, which is grown into the parts, half into "
            f"each: expected at most {1e3 * most:.3g} mm in this mesh, or none given (the "
            "stiffness of a joint need not know the thickness: law = 'springs')"
        )
    return wanted.layer


def _layers(lists: MeshLists, found: list[Touch], wanted: Grown):
    """Facets to be filled: their contact and its rows, by the layer's name; centres and notes."""
    if wanted.between is not None:
        pairs = {frozenset(pair) for pair in wanted.between}
        for pair in wanted.between:
            if not any(set(t.parts) == set(pair) for t in found):
                raise MeshError(
                    f"between: {pair[0]!r} and {pair[1]!r} do not touch, expected two of: "
                    f"{pair_list(found)}"
                )
        found = [t for t in found if frozenset(t.parts) in pairs]
    if wanted.joint == "contact":
        return {}, None, []
    if wanted.joint == "layer":
        names = ["joint"] if len(found) == 1 else [f"joint_{i + 1}" for i in range(len(found))]
        rows = {n: (t, np.arange(len(t.areas))) for n, t in zip(names, found, strict=True)}
        return rows, None, []
    return _rings(lists, found, wanted)


def _rings(lists: MeshLists, found: list[Touch], wanted: Grown):
    if lists.x.shape[1] != 3:
        raise MeshError("joint = 'rings': the mesh is in the plane, expected one in space")
    bolts = (_seen if wanted.bolts is None else _given)(lists.x, found, wanted)
    layers, taken, notes = {}, {}, []
    for number, (touch, centre, r_nei, r_wai, hole) in enumerate(bolts, start=1):
        away = touch.middles - centre
        away = away - np.outer(away @ touch.normal, touch.normal)
        distance = np.linalg.norm(away, axis=1)
        rows = np.flatnonzero((distance < r_wai) & (distance > r_nei))
        at = f"bolt {number} at ({', '.join(f'{1e3 * c:.6g}' for c in centre)}) mm"
        if len(rows) < 3:
            raise MeshError(
                f"{at}: {len(rows)} facets of the mesh have their middle between {1e3 * r_nei:g} "
                f"and {1e3 * r_wai:g} mm from its axis, expected at least 3: a finer mesh there, "
                "or a larger r_wai"
            )
        for row in rows:
            if taken.setdefault((id(touch), row), number) != number:
                raise MeshError(
                    f"{at}: its ring of {1e3 * r_wai:g} mm overlaps that of bolt "
                    f"{taken[id(touch), row]}, expected a smaller r_wai"
                )
        area, circle = touch.areas[rows].sum(), np.pi * (r_wai**2 - max(r_nei, hole) ** 2)
        layers[f"ring_{number}"] = touch, rows
        notes.append(
            f"ring_{number} is {len(rows)} facets of the mesh whose middles are within "
            f"{1e3 * r_wai:.3g} mm of ({', '.join(f'{1e3 * c:.4g}' for c in centre)}) mm: their "
            f"area is {100 * area / circle:.0f} % of the round ring's"
        )
    return layers, np.array([bolt[1] for bolt in bolts]), notes


def _seen(x: np.ndarray, found: list[Touch], wanted: Grown):
    """Bolts in the round holes of the contacts."""
    (r_wai,), r_nei = wanted.radii(), wanted.r_nei or 0.0
    low, high = wanted.hole or (0.0, 2 * r_wai)
    holes = [(t, h) for t in found for h in round_holes(x, t)]
    bolts = [
        (t, h.centre, r_nei, r_wai, h.radius)
        for t, h in holes
        if low * 0.98 <= 2 * h.radius <= high * 1.02
    ]
    if not bolts:
        there = "; ".join(
            f"{2e3 * h.radius:.4g} mm at ({', '.join(f'{1e3 * c:.5g}' for c in h.centre)}) mm"
            for _, h in holes
        )
        raise MeshError(
            f"no bolt: expected round holes of {1e3 * low:g} to {1e3 * high:g} mm in flat faces "
            f"that touch; there are: {there or 'none'}"
        )
    return bolts


def _given(x: np.ndarray, found: list[Touch], wanted: Grown):
    """Bolts at given points, each on the contact with most area round it."""
    bolts, points = [], np.array(wanted.bolts, dtype=float)
    for number, (point, r_wai) in enumerate(zip(points, wanted.radii(), strict=True), start=1):
        best, most = None, 0.0
        for touch in (t for t in found if t.is_flat):
            away = touch.middles - point
            height = away @ touch.normal
            near = np.linalg.norm(away - np.outer(height, touch.normal), axis=1) < r_wai
            area = touch.areas[near & (np.abs(height) < r_wai)].sum()
            if area > most:
                best, most = touch, area
        if best is None:
            at = ", ".join(f"{1e3 * c:.6g}" for c in point)
            raise MeshError(
                f"bolt {number} at ({at}) mm: no two flat faces touch within {1e3 * r_wai:g} mm, "
                f"expected those of: {pair_list(found)} (in which unit is it given?)"
            )
        n = best.normal
        centre = point - ((point - best.middles[0]) @ n) * n
        near = [h.radius for h in round_holes(x, best) if math.dist(h.centre, centre) < h.radius]
        bolts.append((best, centre, wanted.r_nei or 0.0, r_wai, max(near, default=0.0)))
    return bolts


def layer_faces(layers: Mapping[str, Sequence[np.ndarray]], bare) -> dict[str, np.ndarray]:
    """Facets between layers and parts, and those of contacts with no layer, by their names.

    Args:
        layers: Vertices of the facets below and above each layer.
        bare: For each contact without one: the names of its two parts, and likewise the vertices.
    """
    faces: dict[str, list[np.ndarray]] = {}
    for lower, upper in layers.values():
        faces.setdefault("joint_lower", []).append(lower)
        faces.setdefault("joint_upper", []).append(upper)
    for (a, b), (lower, upper) in bare:
        faces.setdefault(f"{a}_to_{b}", []).append(lower)
        faces.setdefault(f"{b}_to_{a}", []).append(upper)
    return {name: np.vstack(facets) for name, facets in faces.items()}


def _with_free_facets(lists: MeshLists, faces: Mapping[str, np.ndarray]) -> MeshLists:
    """The mesh with more named faces, but for facets that have a name already."""
    new = {}
    for name, facets in faces.items():
        numbers = row_numbers(np.vstack([facets, lists.facets]))
        free = ~np.isin(numbers[: len(facets)], numbers[len(facets) :])
        if free.any():
            new[name] = facets[free]
    return add_faces(lists, new)


def _cell_shares(before: int, n: int, layers) -> np.ndarray | None:
    """Share of each cell that counts, with layers on facets that are not covered whole."""
    of_facet = [
        np.ones(len(rows)) if t.covered is None else t.covered[rows] / t.areas[rows]
        for t, rows in layers.values()
    ]
    if all(t.covered is None for t, _ in layers.values()):
        return None
    shares = np.concatenate(of_facet)
    return np.append(np.ones(before), shares.repeat((n - before) // len(shares)))


def _without_names(lists: MeshLists, facets: np.ndarray) -> MeshLists:
    """The mesh without names for some facets."""
    numbers = row_numbers(np.vstack([facets, lists.facets]))
    kept = ~np.isin(numbers[len(facets) :], numbers[: len(facets)])
    return replace(lists, facets=lists.facets[kept], facet_values=lists.facet_values[kept])


def _face_names(lists: MeshLists, facets: np.ndarray) -> tuple[str, ...]:
    """Names of the faces that facets are of."""
    numbers = row_numbers(np.vstack([facets, lists.facets]))
    tags = set(lists.facet_values[np.isin(numbers[len(facets) :], numbers[: len(facets)])].tolist())
    return tuple(name for name, tag in lists.facet_names.items() if tag in tags)


def _extent(area: float, touch: Touch) -> str:
    """An area, or in the plane a length, in words."""
    return f"{1e6 * area:.4g} mm2" if touch.middles.shape[1] == 3 else f"{1e3 * area:.4g} mm"


def _layer_notes(layers, size: float) -> list[str]:
    if not layers:
        return []
    names = list(layers)
    pairs = "; ".join(
        f"{name} between {t.parts[0]} and {t.parts[1]}, {_extent(t.areas[rows].sum(), t)}"
        for name, (t, rows) in list(layers.items())[:12]
    )
    more = f"; and {len(names) - 12} more" if len(names) > 12 else ""
    unlike = [
        f"{name}: the meshes of {t.parts[0]} and {t.parts[1]} do not match. The layer stands on "
        f"facets of {t.parts[1]}, {_extent(t.areas[rows].sum(), t)}, and counts as the "
        f"{_extent(t.covered[rows].sum(), t)} that the parts have in common"
        for name, (t, rows) in layers.items()
        if t.opposite is not None
    ]
    return [
        *unlike,
        f"the mesh had no layer where its parts touch: one of {1e6 * size:.3g} um was grown, half "
        f"into each part ({pairs}{more})",
    ]
