"""Faces that touch as pairs of nodes, or vertices and what is opposite, with normals and areas.

Faces with the same vertices are paired vertex by vertex; others by `fenics_joints.meshes.mortar`;
and one face alone with an obstacle that does not give way. An interface is small beside its bodies,
so every rank holds all of it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import basix
import numpy as np
from dolfinx import fem
from scipy.spatial import cKDTree

from fenics_joints._compat import geometry_dofmap
from fenics_joints.errors import MeshError
from fenics_joints.meshes import TaggedMesh
from fenics_joints.meshes.facets import row_numbers
from fenics_joints.meshes.grow import outward_areas
from fenics_joints.meshes.mortar import OPPOSED, Coupling, Mortar, couple, hat_integrals

#: Distance of the vertices of a pair as a share of the shortest edge: round-off of mesh files.
_TOLERANCE = 1e-3
_OTHER_EDGES = (
    "the faces have the same vertices but other edges between them; expected matching facets (on "
    "tetrahedra, the same diagonals)."
)


@dataclass(frozen=True, repr=False)
class Interface:
    """Pairs of vertices of two faces; or vertices of one and averages of the other, or an obstacle.

    Attributes:
        name: The contact's name.
        lower: Global block numbers of the lower vertices, (n,); of faces that do not match the
            nearest ones, of an obstacle none, (0,).
        upper: Those of their partners, (n,).
        points: Positions, m, of the lower vertices, (n, gdim); with a coupling or an obstacle of
            the upper ones.
        frames: Unit normal, from lower to upper, and tangents, as rows, (n, gdim, gdim).
        gap: Initial gap, m, along the normal, (n,); negative where the bodies overlap.
        facets: Pairs at the facets' vertices, (n_facets, k).
        shares: Integral of each vertex's hat function over each facet, m2, (n_facets, k).
        where: Rank and local number of the upper body's facets, (n_facets, 2).
        edges: Pairs at the ends of edges with midsides, (n_edges, 2).
        lower_midsides: Global block numbers there, (n_edges,).
        upper_midsides: Those of their partners, (n_edges,).
        coupling: What the lower face does at each upper vertex, if the faces do not match.
    """

    name: str
    lower: np.ndarray
    upper: np.ndarray
    points: np.ndarray
    frames: np.ndarray
    gap: np.ndarray
    facets: np.ndarray
    shares: np.ndarray
    where: np.ndarray
    edges: np.ndarray = field(default_factory=lambda: np.empty((0, 2), np.int64))
    lower_midsides: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))
    upper_midsides: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))
    coupling: Coupling | None = None

    def __len__(self) -> int:
        return len(self.upper)

    def __repr__(self) -> str:
        return f"Interface({self.name!r}, {len(self)} pairs, {len(self.facets)} facets)"

    @cached_property
    def areas(self) -> np.ndarray:
        """Area of the surface that belongs to each vertex, m2 (in plane strain m2 per metre of
        depth), (n,): the integral of its hat function."""
        areas = np.zeros(len(self))
        np.add.at(areas, self.facets, self.shares)
        return areas

    @property
    def normals(self) -> np.ndarray:
        """Unit normals from lower to upper, (n, gdim)."""
        return self.frames[:, 0]

    @property
    def masters(self) -> np.ndarray:
        """Global block numbers that the upper vertices refer to, (m,)."""
        return self.lower if self.coupling is None else self.coupling.nodes

    @property
    def opposite(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower vertices in contact, as global block numbers, and the pair of each, (k,) both."""
        if self.coupling is None:
            return self.lower, np.arange(len(self.lower))
        return self.coupling.nodes[self.coupling.facing], self.coupling.opposite

    def jumps_of(self, motion: Callable, upper: np.ndarray, lower: np.ndarray) -> np.ndarray:
        """Jumps, m, (n, gdim), in space, of a motion of one side or both.

        Args:
            motion: Displacement as a function of positions, (k, gdim).
            upper: Which of the upper vertices move, (n,).
            lower: Which of `masters` do, (m,).
        """
        jump = upper[:, None] * motion(self.points)
        if self.coupling is not None:
            return jump - self.coupling.partner(lower[:, None] * motion(self.coupling.points))
        return jump - lower[:, None] * motion(self.points) if len(self.lower) else jump


def pair_faces(
    name: str,
    lower: Face,
    upper: Face,
    *,
    gap: float | Callable = 0.0,
    tolerance: float | None = None,
    weight: Callable[[np.ndarray], np.ndarray] | None = None,
    held: Callable[[np.ndarray], np.ndarray] | None = None,
) -> Interface:
    """Pair the vertices of two faces.

    One face may be larger than the other; every vertex of the smaller needs a partner.

    Args:
        name: Name in messages.
        lower: The face whose outward normal is the interface's.
        upper: The other.
        gap: Initial gap beyond that of the mesh, see `Contact`.
        tolerance: Farthest distance of a pair, m.
        weight: Weight of the surface measure as a function of positions (2 pi r), or None.
        held: Directions in which supports hold blocks, from global numbers, (n,), to a mask,
            (n, gdim). In a direction in which both vertices of a pair are held they cannot part,
            so the normal has no component there: at the edge of a quarter model that of the
            facets, all on one side of it, leans.

    Raises:
        MeshError: The faces share vertices, do not match, or look the same way.
    """
    _check_apart(name, lower, upper)
    pairs = _match(name, lower, upper, tolerance)
    facets, rows = _common_facets(pairs[:, 1], upper)
    normals = -_vertex_normals(len(pairs), facets, upper.normals[rows])
    opposed = _vertex_normals(len(lower.nodes), lower.facets, lower.normals)[pairs[:, 0]]
    if np.any(np.einsum("ij,ij->i", opposed, -normals) > OPPOSED):
        raise MeshError(f"{name}: the two faces look the same way; expected opposed normals.")
    if held is not None:
        both = held(lower.nodes[pairs[:, 0]]) & held(upper.nodes[pairs[:, 1]])
        normals = _upright(normals, both)
    points = lower.points[pairs[:, 0]]
    meshed = np.einsum("ij,ij->i", upper.points[pairs[:, 1]] - points, normals)
    edges, low_mid, up_mid = _pair_edges(name, pairs, lower, upper)
    return Interface(
        name,
        lower.nodes[pairs[:, 0]],
        upper.nodes[pairs[:, 1]],
        points,
        frames(normals),
        meshed + _given_gap(gap, points),
        facets,
        hat_integrals(points, facets, weight),
        upper.where[rows],
        edges,
        low_mid,
        up_mid,
    )


def check_contact(
    tagged: TaggedMesh, lower: str, upper: str, tolerance: float | None = None
) -> Interface:
    """Refuse two faces whose contact cannot be computed vertex by vertex. Collective.

    Args:
        tagged: The mesh.
        lower: Name of the one face.
        upper: Name of the other face.
        tolerance: Farthest distance of a pair of vertices, m; by default a thousandth of the
            shortest edge.

    Returns:
        The pairs of vertices, with their gaps.

    Raises:
        MeshError: A face is unknown, or inside a body; the faces share vertices; a vertex of one
            has no partner on the other, or two have the same; the facets on matching vertices
            differ; or the faces look the same way.
    """
    V = fem.functionspace(tagged.mesh, ("Lagrange", 1, (tagged.mesh.geometry.dim,)))
    low, up = (read_face(V, tagged, face) for face in (lower, upper))
    name = f"{lower} and {upper}"
    found = pair_faces(name, low, up, tolerance=tolerance)
    if not len(low.nodes) == len(up.nodes) == len(found):
        raise MeshError(
            f"{name}: the faces have {len(low.nodes)} and {len(up.nodes)} vertices, of which "
            f"{len(found)} match; expected two faces that cover one another."
        )
    below, _ = _common_facets(np.searchsorted(low.nodes, found.lower), low)
    numbers = row_numbers(np.vstack([below, found.facets]))
    if np.setxor1d(*np.split(numbers, [len(below)])).size:
        raise MeshError(f"{name}: {_OTHER_EDGES}")
    return found


def couple_faces(
    name: str,
    lower: Face,
    upper: Face,
    *,
    bubble: float,
    gap: float | Callable = 0.0,
    tolerance: float | None = None,
    weight: Callable | None = None,
    held: Callable | None = None,
    bonded: bool = False,
    tied: bool = False,
) -> Interface:
    """Couple two faces whose vertices do not match, see `fenics_joints.meshes.mortar`.

    The upper face carries the pressure. It should be the smaller one: its facets that stick out by
    more than half are not in contact.

    Args:
        bubble: Value of a midside's shape function in the middle of its edge.
        tolerance: Farthest distance of facets, m; by default half the size of the upper one.
        bonded: Whether it is to be glued: supports of the upper face then go before the glue.
        tied: Whether facets that stick out by more than half are coupled too.
        name, lower, upper, gap, weight, held: See `pair_faces`.

    Raises:
        MeshError: The faces share vertices or do not lie on one another.
    """
    _check_apart(name, lower, upper)
    mortar = couple(lower, upper, bubble, tolerance, weight, tied)
    if mortar is None:
        raise MeshError(
            f"{name}: the two faces do not lie on one another, or look the same way; expected two "
            "faces opposite each other. Give the contact a tolerance if a gap is meshed between "
            "them."
        )
    coupling = mortar.coupling
    nodes, nearest = upper.nodes[mortar.rows], lower.nodes[mortar.nearest]
    normals = -_vertex_normals(len(nodes), mortar.corners, upper.normals[mortar.facets])
    if held is not None:
        at_upper = held(nodes)
        normals = _upright(normals, held(nearest) & at_upper)
        coupling = replace(coupling, free=at_upper & bonded)
    points = upper.points[mortar.rows]
    meshed = np.einsum("ij,ij->i", points - coupling.partner(coupling.points), normals)
    found = _one_sided(name, upper, mortar, frames(normals), meshed, gap)
    return replace(found, lower=nearest, coupling=coupling)


def face_obstacle(
    name: str,
    face: Face,
    shape: Callable,
    *,
    gap: float | Callable = 0.0,
    weight: Callable | None = None,
) -> Interface:
    """Vertices of a face and the nearest points of an obstacle that does not give way.

    Args:
        name: Name in messages.
        face: The face; it is the upper side.
        shape: From positions, (n, gdim), to distances from the obstacle, m, (n,), and its outward
            unit normals, (n, gdim).
        gap: Initial gap beyond that distance, see `Contact`.
        weight: See `pair_faces`.

    Raises:
        MeshError: No facet looks at the obstacle.
    """
    distance, normals = shape(face.points)
    mean = _vertex_normals(len(face.nodes), face.facets, face.normals)
    looks = np.einsum("ij,ij->i", mean, normals) < OPPOSED
    facets = np.flatnonzero(looks[face.facets].all(axis=1))
    if not len(facets):
        raise MeshError(
            f"{name}: no facet of the face looks at the obstacle; expected a face with "
            "the obstacle outside the body."
        )
    rows, corners = np.unique(face.facets[facets], return_inverse=True)
    corners = corners.reshape(len(facets), -1)
    shares = hat_integrals(face.points[rows], corners, weight)
    edges = np.flatnonzero(np.isin(face.edges, rows).all(axis=1)) if len(face.edges) else []
    mortar = Mortar(rows, facets, corners, shares, np.empty(0, int), None)
    found = _one_sided(name, face, mortar, frames(normals[rows]), distance[rows], gap)
    ends = np.searchsorted(rows, face.edges[edges]).reshape(-1, 2)
    return replace(found, edges=ends, upper_midsides=face.midsides[edges])


def _one_sided(name, upper: Face, mortar: Mortar, turned, meshed, gap) -> Interface:
    """The interface of vertices of one face, without partners."""
    points = upper.points[mortar.rows]
    return Interface(
        name,
        np.empty(0, np.int64),
        upper.nodes[mortar.rows],
        points,
        turned,
        meshed + _given_gap(gap, points),
        mortar.corners,
        mortar.shares,
        upper.where[mortar.facets],
    )


def _given_gap(gap: float | Callable, points: np.ndarray) -> np.ndarray:
    given = np.asarray(gap(points) if callable(gap) else gap, dtype=float)
    return np.broadcast_to(given, len(points))


def _check_apart(name: str, lower: Face, upper: Face) -> None:
    if np.intersect1d(lower.nodes, upper.nodes).size:
        raise MeshError(
            f"{name}: the two faces share vertices, so they are one body; expected two bodies that "
            "coincide there without sharing (fenics_joints.meshes.separate parts them)."
        )


def matching(lower: Face, upper: Face, tolerance: float | None = None) -> bool:
    """Whether every vertex of the face with fewer has a partner within the tolerance."""
    _, distance, _, tolerance = _nearest(lower, upper, tolerance)
    return bool(np.all(distance <= tolerance))


def _nearest(lower: Face, upper: Face, tolerance: float | None):
    """The smaller face, distances of its vertices to the other's, these, and the tolerance."""
    ends = lower.points[lower.facets]
    if tolerance is None:
        tolerance = _TOLERANCE * np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).min()
    small, large = (upper, lower) if len(upper.nodes) <= len(lower.nodes) else (lower, upper)
    distance, partner = cKDTree(large.points).query(small.points)
    return small, distance, partner, tolerance


def _match(name: str, lower: Face, upper: Face, tolerance: float | None) -> np.ndarray:
    """Rows of partners in both faces, (n, 2)."""
    small, distance, partner, tolerance = _nearest(lower, upper, tolerance)
    far = distance > tolerance
    if np.any(far):
        worst = int(np.argmax(distance))
        raise MeshError(
            f"{name}: {int(far.sum())} of {len(far)} vertices of the smaller face have no partner "
            f"within {tolerance:.3g} m; the worst, at {small.points[worst].tolist()} m, is "
            f"{distance[worst]:.3g} m from the nearest. Expected matching meshes: the same "
            "vertices on both faces; give the contact a tolerance if they match across a gap."
        )
    if len(np.unique(partner)) < len(partner):
        raise MeshError(
            f"{name}: two vertices have the same partner; expected a smaller tolerance."
        )
    pairs = np.column_stack([np.arange(len(partner)), partner])
    return pairs[:, ::-1] if small is upper else pairs


def _common_facets(upper_rows: np.ndarray, upper: Face):
    """Facets all of whose vertices have partners, by pair; and which facets those are."""
    number = np.full(len(upper.nodes), -1)
    number[upper_rows] = np.arange(len(upper_rows))
    facets = number[upper.facets]
    rows = np.flatnonzero((facets >= 0).all(axis=1))
    return facets[rows], rows


def _vertex_normals(n: int, facets: np.ndarray, normals: np.ndarray) -> np.ndarray:
    total = np.zeros((n, normals.shape[1]))
    np.add.at(total, facets, normals[:, None, :])
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return total / np.where(length > 0, length, 1.0)


def _upright(normals: np.ndarray, held: np.ndarray) -> np.ndarray:
    """Unit normals without their components in held directions, unless little else is left."""
    flat = np.where(held, 0.0, normals)
    length = np.linalg.norm(flat, axis=1, keepdims=True)
    return np.where(length > -OPPOSED, flat / np.where(length > 0, length, 1.0), normals)


def frames(normals: np.ndarray) -> np.ndarray:
    """Orthonormal frames as rows, (n, gdim, gdim): unit normals, (n, gdim), then tangents.

    The tangents are as near the axes as can be.
    """
    n, gdim = normals.shape
    if gdim == 2:
        return np.stack([normals, np.column_stack([normals[:, 1], -normals[:, 0]])], axis=1)
    axis = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
    first = axis - np.einsum("ij,ij->i", axis, normals)[:, None] * normals
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([normals, first, np.cross(normals, first)], axis=1)


def _pair_edges(name: str, pairs: np.ndarray, lower: Face, upper: Face):
    """Edges of both faces between the same pairs: ends by pair, and the midsides' blocks."""
    found = []
    for face, rows in zip((lower, upper), pairs.T, strict=True):
        number = np.full(len(face.nodes), -1)
        number[rows] = np.arange(len(pairs))
        ends = np.sort(number[face.edges], axis=1)
        key = np.where(ends[:, 0] >= 0, ends @ [len(pairs), 1], -1)
        order = np.argsort(key)[np.sum(key < 0) :]
        found.append((ends[order], face.midsides[order], key[order]))
    (_, low, low_key), (ends, up, key) = found
    if not np.isin(key, low_key).all():
        raise MeshError(f"{name}: {_OTHER_EDGES}")
    return ends, low[np.searchsorted(low_key, key)], up


# -- faces of a mesh -----------------------------------------------------------------------------


@dataclass(frozen=True, repr=False)
class Face:
    """A named face of a mesh, gathered on every rank.

    Attributes:
        nodes: Global numbers of the displacement's blocks at the vertices, ascending, (n,).
        points: Positions of the vertices, m, (n, gdim).
        facets: Vertices of the facets, as rows of ``nodes``, in DOLFINx's order, (n_facets, k).
        normals: Outward unit normals of the facets, (n_facets, gdim).
        edges: Vertices of the edges that carry a midside block, as rows of ``nodes``, (n_edges, 2).
        midsides: Global numbers of those blocks, (n_edges,); empty at degree 1.
        where: Rank and local number of each facet, (n_facets, 2).
    """

    nodes: np.ndarray
    points: np.ndarray
    facets: np.ndarray
    normals: np.ndarray
    edges: np.ndarray
    midsides: np.ndarray
    where: np.ndarray

    def __repr__(self) -> str:
        return f"Face({len(self.nodes)} vertices, {len(self.facets)} facets)"


def read_face(V: fem.FunctionSpace, tagged: TaggedMesh, *names: str, of: str | None = None) -> Face:
    """Gather a named exterior face, or several together, with blocks of ``V``. Collective.

    With the name of a part, ``of``, only its outer facets.

    Raises:
        MeshError: If the mesh has no such face or a facet of it is inside a body.
    """
    local = _local_facets(V, tagged, names, of)
    comm = V.mesh.comm
    gathered = [np.concatenate(parts) for parts in zip(*comm.allgather(local), strict=True)]
    vertex_ids, x, normals, edge_ids, ends, where = gathered
    nodes, first, facets = np.unique(vertex_ids.ravel(), return_index=True, return_inverse=True)
    points = x.reshape(-1, x.shape[-1])[first]
    if edge_ids.size:
        midsides, pick = np.unique(edge_ids.ravel(), return_index=True)
        edges = np.searchsorted(nodes, ends.reshape(-1, 2)[pick])
    else:
        midsides, edges = np.empty(0, np.int64), np.empty((0, 2), np.int64)
    return Face(nodes, points, facets.reshape(vertex_ids.shape), normals, edges, midsides, where)


def _local_facets(V, tagged: TaggedMesh, names: Sequence[str], of: str | None):
    """This rank's facets: vertex blocks, positions, normals, edge blocks, edge ends, where."""
    msh, topology = V.mesh, V.mesh.topology
    tdim, gdim = topology.dim, msh.geometry.dim
    topology.create_connectivity(tdim - 1, tdim)
    topology.create_connectivity(tdim, tdim - 1)
    to_cell = topology.connectivity(tdim - 1, tdim)
    found = [tagged.facet_tags.find(tagged.facet_tag(name)) for name in names]
    facets = np.sort(np.concatenate(found))
    if of is not None:
        facets = facets[np.diff(to_cell.offsets)[facets] == 1]
        tags = tagged.cell_tags
        inside = np.isin(to_cell.array[to_cell.offsets[facets]], tags.find(tagged.cell_tag(of)))
        facets = facets[inside]
    if msh.comm.allreduce(int(np.sum(np.diff(to_cell.offsets)[facets] > 1))):
        raise MeshError(
            f"face {', '.join(names)}: some of its facets lie inside a body; expected the surface "
            "of one body. Bodies in contact must not share vertices: see "
            "fenics_joints.meshes.separate."
        )
    cells = to_cell.array[to_cell.offsets[facets]]
    own = cells < topology.index_map(tdim).size_local
    facets, cells = facets[own], cells[own]
    vertices, *tables = _facet_layout(V)
    of_cell = topology.connectivity(tdim, tdim - 1).array.reshape(-1, len(vertices))[cells]
    local = np.argmax(of_cell == facets[:, None], axis=1)
    x = msh.geometry.x[geometry_dofmap(msh)[cells]][:, :, :gdim]
    corners = np.take_along_axis(x, vertices[local][:, :, None], axis=1)
    areas = outward_areas(corners, x.mean(axis=1))
    normals = areas / np.linalg.norm(areas, axis=1, keepdims=True)
    found = []
    for table in tables:
        at = table[local].reshape(len(cells), table[0].size)
        blocks = np.take_along_axis(V.dofmap.list[cells], at, axis=1)
        blocks = V.dofmap.index_map.local_to_global(blocks.ravel())
        found.append(blocks.reshape(len(cells), *table.shape[1:]))
    where = np.column_stack([np.full(len(facets), msh.comm.rank), facets])
    return found[0], corners, normals, *found[1:], where


def _facet_layout(V) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of each facet of the reference cell: its vertices, (f, k); and numbers of the cell's blocks:
    at these vertices, on the facet's edges, (f, m), and at these edges' ends, (f, m, 2)."""
    topology = basix.topology(getattr(basix.CellType, V.mesh.topology.cell_name()))
    facets, layout = topology[V.mesh.topology.dim - 1], V.dofmap.dof_layout
    at_vertex = np.array([layout.entity_dofs(0, v)[0] for v in range(len(topology[0]))])
    at_edge = [layout.entity_dofs(1, e)[:1] for e in range(len(topology[1]))]
    edges = [
        [e for e, ends in enumerate(topology[1]) if set(ends) <= set(corners) and len(at_edge[e])]
        for corners in facets
    ]
    middles = np.array([[at_edge[e][0] for e in own] for own in edges], dtype=int)
    ends = np.array([[topology[1][e] for e in own] for own in edges], dtype=int)
    ends = at_vertex[ends.reshape(*middles.shape, 2)]
    return np.array(facets), at_vertex[np.array(facets)], middles, ends
