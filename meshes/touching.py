"""Where the parts of a whole mesh touch, facet by facet, and the round holes in those faces."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from fenics_joints.meshes.skin import FACETS, row_numbers
from fenics_joints.meshes.tagged import MeshLists

#: Vertices of two parts nearer than this share of the shortest edge are one.
_ONE = 1e-3
#: Cosine of the angle between neighbouring facets of one contact: 31 degrees, a circle of twelve.
_SMOOTH = 0.855
#: Sine by which the normals of a flat contact may differ.
_FLAT = 1e-3
#: A loop is a circle if its corners miss it by less than this share of its radius.
_ROUND, _CORNERS = 0.02, 6


@dataclass(frozen=True)
class Touch:
    """Facets on which two parts touch.

    Attributes:
        parts: Names of the two, in the mesh's order.
        cells: Cell of each facet in either part, shape (n, 2).
        sides: Which of the cell's facets it is, shape (n, 2).
        facets: Vertices of the glued mesh as the first part's cell has them, shape (n, n_corners).
        middles: Middles, m, shape (n, gdim).
        normals: Unit normals from the first part to the second, shape (n, gdim).
        areas: m2 (m in the plane), shape (n,).
    """

    parts: tuple[str, str]
    cells: np.ndarray
    sides: np.ndarray
    facets: np.ndarray
    middles: np.ndarray
    normals: np.ndarray
    areas: np.ndarray

    def pick(self, rows: np.ndarray) -> Touch:
        """Some of its facets."""
        keys = ("cells", "sides", "facets", "middles", "normals", "areas")
        return replace(self, **{key: getattr(self, key)[rows] for key in keys})

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
    facets = lists.x[lists.cells[:, FACETS[lists.cell]]]
    ends = {2: [(0, 1)], 3: [(0, 1), (1, 2), (0, 2)], 4: [(0, 1), (0, 2), (1, 3), (2, 3)]}
    return min(
        float(np.linalg.norm(facets[:, :, a] - facets[:, :, b], axis=-1).min())
        for a, b in ends[facets.shape[2]]
    )


def glued(lists: MeshLists) -> MeshLists:
    """The same mesh with one vertex where vertices of different parts coincide."""
    tree = cKDTree(lists.x)
    pairs = tree.query_pairs(_ONE * shortest_edge(lists), output_type="ndarray")
    if not len(pairs):
        return lists
    values = np.unique(lists.cell_values, return_inverse=True)[1].ravel()
    rows = lists.cells.ravel()
    of = np.repeat(values, lists.cells.shape[1])
    has = coo_array((np.ones(len(rows), np.int32), (rows, of)), (len(lists.x), values.max() + 1))
    has = has.tocsr()
    common = np.asarray(has[pairs[:, 0]].multiply(has[pairs[:, 1]]).sum(axis=1)).ravel()
    pairs = pairs[common == 0]
    n = len(lists.x)
    graph = coo_array((np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    label = connected_components(graph, directed=False)[1]
    _, first, number = np.unique(label, return_index=True, return_inverse=True)
    order = np.argsort(first)
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    new = place[number.ravel()]
    return replace(lists, x=lists.x[first[order]], cells=new[lists.cells], facets=new[lists.facets])


def touches(lists: MeshLists, bonded: Iterable[tuple[str, str]] = ()) -> list[Touch]:
    """The contacts of a glued mesh: smooth faces on which two parts touch.

    Flat faces of one pair of parts in one plane are one contact, even with a gap between them.

    Args:
        lists: The mesh; parts that touch share their vertices.
        bonded: Pairs of parts that are left out.

    Returns:
        The contacts in the order of the parts, then of x, y and z.
    """
    corners = lists.cells[:, FACETS[lists.cell]]
    n, n_sides, n_corners = corners.shape
    numbers = row_numbers(corners.reshape(-1, n_corners))
    order = np.argsort(numbers, kind="stable")
    twice = np.flatnonzero(np.diff(numbers[order]) == 0)
    one, other = order[twice], order[twice + 1]
    tags = lists.cell_values[np.column_stack([one, other]) // n_sides]
    apart = tags[:, 0] != tags[:, 1]
    both, tags = np.column_stack([one, other])[apart], tags[apart]
    rank = {tag: i for i, tag in enumerate(lists.cell_names.values())}
    turned = np.array([rank[a] > rank[b] for a, b in tags], dtype=bool)
    both[turned], tags[turned] = both[turned][:, ::-1], tags[turned][:, ::-1]
    names = {tag: name for name, tag in lists.cell_names.items()}
    left_out = {frozenset(pair) for pair in bonded}
    found = []
    for a, b in sorted({(int(a), int(b)) for a, b in tags}, key=lambda t: (rank[t[0]], rank[t[1]])):
        if frozenset((names[a], names[b])) in left_out:
            continue
        rows = both[(tags[:, 0] == a) & (tags[:, 1] == b)]
        touch = _measured(lists, (names[a], names[b]), rows // n_sides, rows % n_sides)
        found += _contacts(touch)
    return found


def _measured(lists: MeshLists, parts, cells, sides) -> Touch:
    facets = lists.cells[cells[:, :1], FACETS[lists.cell][sides[:, 0]]]
    x = lists.x[facets]
    middles = x.mean(axis=1)
    if x.shape[2] == 2:
        along = x[:, 1] - x[:, 0]
        areas = np.column_stack([along[:, 1], -along[:, 0]])
    else:
        last = x.shape[1] - 1
        areas = np.cross(x[:, last] - x[:, 0], x[:, 2] - x[:, 1]) / 2
    inside = lists.x[lists.cells[cells[:, 0]]].mean(axis=1)
    areas = areas * np.sign(np.sum(areas * (middles - inside), axis=1))[:, None]
    size = np.linalg.norm(areas, axis=1)
    return Touch(parts, cells, sides, facets, middles, areas / size[:, None], size)


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
    keys = ("cells", "sides", "facets", "middles", "normals", "areas")
    merged = [
        replace(group[0], **{k: np.concatenate([getattr(p, k) for p in group]) for k in keys})
        for group in found
    ]
    return sorted(merged, key=lambda t: tuple(np.round(t.middles.min(axis=0), 9)))


def _one_plane(a: Touch, b: Touch) -> bool:
    away = b.middles - a.middles[0]
    size = np.linalg.norm(away, axis=1).max()
    return bool(a.normal @ b.normal > 1 - _FLAT**2 and np.abs(away @ a.normal).max() < _FLAT * size)


def _edges(facets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Ends of the facets' edges (of the facets in the plane: their ends), and each one's facet."""
    ends = {2: [(0,), (1,)], 3: [(0, 1), (1, 2), (0, 2)], 4: [(0, 1), (0, 2), (1, 3), (2, 3)]}
    ends = np.array(ends[facets.shape[1]])
    n, k = len(facets), len(ends)
    return facets[:, ends].reshape(n * k, -1), np.repeat(np.arange(n), k)


def _pieces(touch: Touch) -> np.ndarray:
    """Number of the smooth piece that each facet is in."""
    ends, facet = _edges(touch.facets)
    number = row_numbers(ends)
    order = np.argsort(number, kind="stable")
    same = np.flatnonzero(np.diff(number[order]) == 0)
    a, b = facet[order[same]], facet[order[same + 1]]
    smooth = np.sum(touch.normals[a] * touch.normals[b], axis=1) > _SMOOTH
    n = len(touch.facets)
    graph = coo_array((np.ones(smooth.sum(), np.int8), (a[smooth], b[smooth])), shape=(n, n))
    return connected_components(graph, directed=False)[1]


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
    a, b = local.reshape(ends.shape).T
    graph = coo_array((np.ones(len(a), np.int8), (a, b)), shape=(len(nodes), len(nodes)))
    label = connected_components(graph, directed=False)[1]
    basis = np.linalg.svd(touch.normal[None])[2][1:]
    found = []
    for loop in range(label.max(initial=-1) + 1):
        corners = x[nodes[label == loop]]
        hole = _circle(corners, basis)
        if hole is None:
            continue
        rows = label[a] == loop
        edge = x[ends[rows]].mean(axis=1)
        beyond = touch.middles[facet[rows]]
        far = np.linalg.norm(beyond - hole.centre, axis=1)
        if np.all(far > np.linalg.norm(edge - hole.centre, axis=1)):
            found.append(hole)
    return sorted(found, key=lambda h: tuple(np.round(h.centre, 6)))


def _circle(corners: np.ndarray, basis: np.ndarray) -> RoundHole | None:
    """The circle on which corners lie, if they do."""
    if len(corners) < _CORNERS:
        return None
    middle = corners.mean(axis=0)
    flat = (corners - middle) @ basis.T
    # |x - c|^2 = r^2 is linear in c and r^2 - |c|^2.
    system = np.column_stack([2 * flat, np.ones(len(flat))])
    (*c, _), *_ = np.linalg.lstsq(system, (flat**2).sum(axis=1), rcond=None)
    radii = np.linalg.norm(flat - c, axis=1)
    radius = float(radii.mean())
    if np.abs(radii - radius).max() > _ROUND * radius:
        return None
    return RoundHole(middle + np.asarray(c) @ basis, radius)


def said_pairs(found: Sequence[Touch]) -> str:
    """The contacts for a message."""
    return ", ".join(f"{a!r} and {b!r}" for a, b in dict.fromkeys(t.parts for t in found))
