"""Checks of a mesh from any source: inverted and flat cells, separate bodies, matching faces."""

from __future__ import annotations

from dataclasses import dataclass

import dolfinx.la
import numpy as np
from mpi4py import MPI
from scipy.spatial import KDTree

from fenics_joints import _compat
from fenics_joints.errors import MeshError
from fenics_joints.meshes.arguments import is_positive, requirement
from fenics_joints.meshes.facets import row_numbers
from fenics_joints.meshes.grow import groups_of
from fenics_joints.meshes.tagged import TaggedMesh
from fenics_joints.parallel import on_root

# Corners at which each shape is measured, and per corner the ends of its edges; DOLFINx's order.
_CORNERS = {
    "triangle": [(0, 1, 2), (1, 2, 0), (2, 0, 1)],
    "tetrahedron": [(0, 1, 2, 3), (1, 2, 0, 3), (2, 0, 1, 3), (3, 1, 0, 2)],
    "quadrilateral": [(0, 1, 2), (1, 3, 0), (3, 2, 1), (2, 0, 3)],
    "hexahedron": [
        (0, 1, 2, 4),
        (1, 3, 0, 5),
        (3, 2, 1, 7),
        (2, 0, 3, 6),
        (4, 6, 5, 0),
        (5, 4, 7, 1),
        (7, 5, 6, 3),
        (6, 7, 4, 2),
    ],
}

_PART = "part the bodies first, with fenics_joints.meshes.separate or in the mesh generator"
# Cells of thickness 1e-5 of their length still pass; round-off of a flat one lies far below.
_FLAT = 1e-7


@dataclass(frozen=True)
class MeshQuality:
    """What ``check_mesh`` measured.

    Attributes:
        scaled_jacobian: Smallest scaled Jacobian over all cells; 1 for right angles.
        bodies: Number of bodies that share no vertex; more than 1 where parts that look joined
            have each their own vertices.
    """

    scaled_jacobian: float
    bodies: int


def check_mesh(tagged: TaggedMesh) -> MeshQuality:
    """Refuse a mesh with inverted or flat cells.

    Args:
        tagged: The mesh; the call is collective, and raises on all ranks or on none.

    Returns:
        The measured quality.

    Raises:
        MeshError: A cell's Jacobian is negative at a corner (the cell is folded, or its vertices
            are numbered as its mirror image), or vanishes there; the message names the number of
            such cells, and the first one's centre and part.
    """
    mesh = tagged.mesh
    cell, gdim = mesh.topology.cell_name(), mesh.geometry.dim
    if cell not in _CORNERS or gdim != mesh.topology.dim:
        known = ", ".join(_CORNERS)
        raise MeshError(f"the mesh has {cell} cells in {gdim}-D, expected one of {known}, flat")
    n_owned = mesh.topology.index_map(mesh.topology.dim).size_local
    n_corners = len(_CORNERS[cell])
    vertices = mesh.geometry.x[_compat.geometry_dofmap(mesh)[:n_owned, :n_corners]]
    jacobian = scaled_jacobian(vertices[..., :gdim], cell)
    # Written so that a vertex that is not a number is bad too.
    bad = np.flatnonzero(~(jacobian > _FLAT))
    _refuse(tagged, bad, jacobian[bad] < -_FLAT, vertices[bad].mean(axis=1))
    smallest = mesh.comm.allreduce(float(jacobian.min(initial=np.inf)), op=MPI.MIN)
    return MeshQuality(smallest, count_bodies(tagged))


def scaled_jacobian(vertices: np.ndarray, cell: str) -> np.ndarray:
    """Smallest over a cell's corners of the Jacobian divided by the lengths of the edges there.

    P. Knupp, "Algebraic mesh quality metrics", SIAM J. Sci. Comput. 23 (2001) 193.

    Args:
        vertices: Corners of each cell in DOLFINx's order, shape (n_cells, n_corners, gdim).
        cell: Name of the cells' shape, of dimension gdim.

    Returns:
        Values from -1 to 1, not a number where an edge has no length; shape (n_cells,).
    """
    smallest = np.full(len(vertices), np.inf)
    for corner, *ends in _CORNERS[cell]:
        edges = vertices[:, ends] - vertices[:, [corner]]
        lengths = np.linalg.norm(edges, axis=2, keepdims=True)
        with np.errstate(invalid="ignore"):
            smallest = np.minimum(smallest, np.linalg.det(edges / lengths))
    return smallest


def _refuse(tagged, bad, inverted, centres) -> None:
    """Raise on all ranks if any rank has bad cells, naming the first in the order of the input."""
    mesh = tagged.mesh
    first = (np.inf, None, None)
    if len(bad):
        original = np.asarray(mesh.topology.original_cell_index)[bad]
        here = original.argmin()
        tag = tagged.cell_tags.values[tagged.cell_tags.indices == bad[here]]
        first = (int(original[here]), centres[here], int(tag[0]) if len(tag) else None)
    found = mesh.comm.allgather((len(bad), int(inverted.sum()), first))
    n_bad, n_inverted = (sum(counts) for counts in list(zip(*found, strict=True))[:2])
    if n_bad == 0:
        return
    _, centre, tag = min((first for _, _, first in found), key=lambda entry: entry[0])
    names = {value: name for name, value in tagged.cell_names.items()}
    part = f"part {names[tag]!r}" if tag in names else "no part"
    at = ", ".join(f"{x:.6g}" for x in centre)
    most = 2 * n_inverted > mesh.topology.index_map(mesh.topology.dim).size_global
    hint = "; most are inverted: is the mesh mirrored?" if most else ""
    raise MeshError(
        f"the mesh has {n_inverted} inverted and {n_bad - n_inverted} flat cells; the first has "
        f"its centre at ({at}) m in {part}; expected a positive Jacobian at every corner{hint}"
    )


def count_bodies(tagged: TaggedMesh) -> int:
    """Number of bodies that share no vertex with each other; the call is collective."""
    mesh = tagged.mesh
    vertices = mesh.topology.index_map(0)
    links = mesh.topology.connectivity(mesh.topology.dim, 0)
    first = np.repeat(links.array[links.offsets[:-1]], np.diff(links.offsets))
    body = groups_of(
        vertices.size_local + vertices.num_ghosts, np.column_stack([first, links.array])
    )
    n_bodies = int(body.max(initial=-1)) + 1
    # A ghost vertex ties the body it has here to the body it has on its owner.
    of_vertex = dolfinx.la.vector(vertices, dtype=np.int64)
    of_vertex.array[:] = body + (mesh.comm.exscan(n_bodies) or 0)
    here = of_vertex.array[vertices.size_local :].copy()
    of_vertex.scatter_forward()
    ties = np.unique(np.column_stack([here, of_vertex.array[vertices.size_local :]]), axis=0)
    ties = np.vstack(mesh.comm.allgather(ties))
    return int(groups_of(mesh.comm.allreduce(n_bodies), ties).max()) + 1


@dataclass(frozen=True)
class ContactMatch:
    """What ``check_contact`` measured of two matching faces.

    Attributes:
        vertices: Number of pairs of vertices.
        facets: Number of pairs of facets.
        distance: Largest distance of a pair of vertices, in metres.
    """

    vertices: int
    facets: int
    distance: float


def check_contact(
    tagged: TaggedMesh, lower: str, upper: str, tolerance: float = 1e-6
) -> ContactMatch:
    """Refuse two faces whose contact cannot be computed vertex by vertex.

    Args:
        tagged: The mesh; the call is collective, and raises on all ranks or on none.
        lower: Name of the one face.
        upper: Name of the other face.
        tolerance: Largest distance of two matching vertices, relative to the shortest edge of the
            facets around them.

    Returns:
        The numbers of matching vertices and facets, and the largest distance.

    Raises:
        MeshError: A face is unknown, or has facets between two cells; the faces share vertices; a
            vertex of one has no partner on the other, or two have the same; the facets on matching
            vertices differ; or the bodies lie on the same side of the faces. The message says how
            many and where, and what to do.
    """
    require = requirement("check_contact")
    require(lower != upper, "upper", upper, "another face than lower")
    require(is_positive(tolerance), "tolerance", tolerance, "a share above 0 of an edge")
    gathered = [_gather(tagged, name) for name in (lower, upper)]
    match = on_root(tagged.mesh.comm, lambda: _check(*gathered, tolerance))
    return tagged.mesh.comm.bcast(match)


@dataclass(frozen=True)
class _OneFace:
    """One face, gathered on rank 0.

    Attributes:
        name: Its name.
        facets: Vertices of each facet, rows of ``x``, shape (n_facets, n_corners).
        n_cells: Number of cells at each facet, shape (n_facets,).
        inside: Middle of a cell at each facet, shape (n_facets, 3), in metres.
        numbers: Number of each vertex in the whole mesh, shape (n,).
        x: Vertices, shape (n, 3), in metres.
        edge: Shortest edge of the face's facets at each vertex, shape (n,), in metres.
    """

    name: str
    facets: np.ndarray
    n_cells: np.ndarray
    inside: np.ndarray
    numbers: np.ndarray
    x: np.ndarray
    edge: np.ndarray


def _gather(tagged: TaggedMesh, name: str) -> _OneFace | None:
    mesh = tagged.mesh
    tdim = mesh.topology.dim
    mesh.topology.create_connectivity(tdim - 1, tdim)
    facets = tagged.facet_tags.find(tagged.facet_tag(name))
    # Ghosts of shared facets: an owned facet has all its cells here.
    facets = facets[facets < mesh.topology.index_map(tdim - 1).size_local]
    found = None
    if len(facets):
        corners = _compat.facet_nodes(mesh, facets)
        links = mesh.topology.connectivity(tdim - 1, tdim)
        cells = links.array[links.offsets[facets]]
        inside = mesh.geometry.x[_compat.geometry_dofmap(mesh)[cells]].mean(axis=1)
        numbers = mesh.geometry.index_map().local_to_global(corners.ravel().astype(np.int32))
        n_cells = np.diff(links.offsets)[facets]
        found = mesh.geometry.x[corners], numbers.reshape(corners.shape), n_cells, inside
    parts = mesh.comm.gather(found)
    if mesh.comm.rank != 0:
        return None
    parts = [part for part in parts if part is not None]
    x, numbers, n_cells, inside = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    unique, first, facets = np.unique(numbers, return_index=True, return_inverse=True)
    facets = facets.reshape(numbers.shape)
    apart = np.linalg.norm(x[:, :, None] - x[:, None], axis=3)
    apart[:, np.eye(x.shape[1], dtype=bool)] = np.inf
    edge = np.full(len(unique), np.inf)
    np.minimum.at(edge, facets, apart.min(axis=2))
    return _OneFace(name, facets, n_cells, inside, unique, x.reshape(-1, 3)[first], edge)


def _check(lower: _OneFace, upper: _OneFace, tolerance: float) -> ContactMatch:
    names = f"faces {lower.name!r} and {upper.name!r}"
    for face in (lower, upper):
        between = int(np.sum(face.n_cells != 1))
        if between:
            raise MeshError(
                f"face {face.name!r} has {between} of {len(face.facets)} facets between two cells: "
                f"it is inside one body (bonded); {_PART}"
            )
    shared = np.isin(lower.numbers, upper.numbers)
    if shared.any():
        where = _at(lower.x[shared.argmax()])
        raise MeshError(
            f"{names} share {shared.sum()} vertices, the first at {where}: there they are one body "
            f"(bonded); {_PART}"
        )
    partner, distance = _partners(lower, upper, tolerance)
    _partners(upper, lower, tolerance)
    _check_facets(lower, upper, partner[lower.facets], names)
    return ContactMatch(len(partner), len(lower.facets), float(distance.max()))


def _partners(face: _OneFace, other: _OneFace, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    """The other face's vertex for each vertex of a face, and its distance."""
    distance, partner = KDTree(other.x).query(face.x)
    alone = distance > tolerance * face.edge
    if alone.any():
        worst = int(np.where(alone, distance / face.edge, 0).argmax())
        raise MeshError(
            f"face {face.name!r} has {alone.sum()} of {len(alone)} vertices without a partner on "
            f"{other.name!r}; the farthest off is at {_at(face.x[worst])}, its nearest neighbour "
            f"{distance[worst]:.3g} m away, which is {distance[worst] / face.edge[worst]:.3g} of "
            f"the shortest edge there, expected at most {tolerance:g}; mesh both faces from the "
            "same lines (contact needs matching vertices), name only the area where they touch, "
            "or raise the tolerance"
        )
    twice = np.bincount(partner, minlength=len(other.x)) > 1
    if twice.any():
        raise MeshError(
            f"{twice.sum()} vertices of face {other.name!r} have two partners on {face.name!r}, "
            f"the first at {_at(other.x[twice.argmax()])}: {face.name!r} has vertices that "
            "coincide, so it is cracked; merge them, for instance with the mesh generator's "
            "removal of duplicate nodes"
        )
    return partner, distance


def _check_facets(lower: _OneFace, upper: _OneFace, matched: np.ndarray, names: str) -> None:
    """Whether the facets match, and the bodies lie on their two sides, as opposed normals mean.

    ``matched`` are the lower facets by their partners on the upper face, shape (n, n_corners).
    """
    # A triangle beside a quadrilateral cannot be: a mesh has facets of one shape.
    numbers = row_numbers(np.vstack([matched, upper.facets]))
    n, x = len(matched), lower.x[lower.facets]
    odd = ~np.isin(numbers[:n], numbers[n:])
    n_odd = int(odd.sum() + np.sum(~np.isin(numbers[n:], numbers[:n])))
    middle = x.mean(axis=1)
    if n_odd:
        raise MeshError(
            f"{names} have matching vertices, but {n_odd} facets without a partner, near "
            f"{_at(middle[odd.argmax()])}; cut both faces along the same diagonals"
        )
    opposite = np.empty(n, dtype=np.int64)
    opposite[np.argsort(numbers[:n])] = np.argsort(numbers[n:])
    below, above = lower.inside - middle, upper.inside[opposite] - middle
    normal = _normals(x, below)
    same = np.sum(normal * below, axis=1) * np.sum(normal * above, axis=1) >= 0
    if same.any():
        raise MeshError(
            f"{names} have {same.sum()} of {n} facets whose bodies lie on the same side, the first "
            f"at {_at(middle[same.argmax()])}: the bodies overlap; check the faces' names, or move "
            "one body"
        )


def _normals(x: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Vectors normal to facets of corners ``x``, (n, n_corners, 3), of any length and sign."""
    if x.shape[1] > 2:
        return np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    along = x[:, 1] - x[:, 0]
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    return inside - along * np.sum(inside * along, axis=1, keepdims=True)


def _at(x: np.ndarray) -> str:
    return "(" + ", ".join(f"{value:.6g}" for value in x) + ") m"
