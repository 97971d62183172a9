"""Checks of a mesh from any source: inverted and flat cells, separate bodies."""

from __future__ import annotations

from dataclasses import dataclass

import dolfinx.la
import numpy as np
from dolfinx.common import IndexMap
from mpi4py import MPI

from fenics_joints import _compat
from fenics_joints.errors import MeshError
from fenics_joints.meshes.grow import groups_of
from fenics_joints.meshes.tagged import TaggedMesh

#: Corners at which each shape is measured, and per corner the ends of its edges; DOLFINx's order.
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

#: Scaled Jacobian below which a cell is flat. Cells of a thickness of 1e-5 of their length still
#: pass; the round-off of a flat one lies far below.
_FLAT = 1e-7


@dataclass(frozen=True)
class MeshQuality:
    """Quality of a mesh by `check_mesh`.

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
    """Number of bodies that neither share a vertex nor are tied; the call is collective."""
    topology = tagged.mesh.topology
    vertices = topology.connectivity(topology.dim, 0).array
    cells = vertices.reshape(-1, len(_CORNERS[topology.cell_name()]))
    body, n = body_numbers(topology.index_map(0), cells, tagged.mesh.comm)
    facet = topology.dim - 1

    def body_of(face: str) -> int:
        topology.create_connectivity(facet, 0)
        facets = tagged.facet_tags.find(tagged.facet_tag(face))
        here = [body[topology.connectivity(facet, 0).links(f)[0]] for f in facets[:1]]
        return tagged.mesh.comm.allreduce(max(here, default=-1), op=MPI.MAX)

    pairs = [(body_of(tie.face), body_of(tie.to[0])) for tie in tagged.ties]
    return int(groups_of(n, pairs).max()) + 1


def body_numbers(imap: IndexMap, cells: np.ndarray, comm: MPI.Intracomm) -> tuple[np.ndarray, int]:
    """Number of the body of each local node, ghosts included, and of bodies. Collective.

    A body is a set of cells that are connected through shared nodes.

    Args:
        imap: Index map of the nodes.
        cells: Local nodes of this rank's cells, ghosts included, shape (n_cells, k).
        comm: Communicator of the mesh.
    """
    links = np.column_stack([cells[:, 0].repeat(cells.shape[1]), cells.ravel()])
    piece = groups_of(imap.size_local + imap.num_ghosts, links)
    n_pieces = int(piece.max(initial=-1)) + 1
    # A ghost ties the piece that it is in here to the piece that it is in on its owner.
    number = dolfinx.la.vector(imap, dtype=np.int64)
    number.array[:] = piece + (comm.exscan(n_pieces) or 0)
    here = number.array.copy()
    number.scatter_forward()
    ties = np.column_stack([here, number.array])[imap.size_local :]
    ties = np.vstack(comm.allgather(np.unique(ties, axis=0)))
    body = groups_of(comm.allreduce(n_pieces), ties)
    return body[here], int(body.max()) + 1
