"""Named faces of a mesh, gathered on every rank with their blocks of unknowns."""

from __future__ import annotations

from dataclasses import dataclass

import basix
import numpy as np
from dolfinx import fem

from fenics_joints._compat import geometry_dofmap
from fenics_joints.errors import MeshError
from fenics_joints.meshes import TaggedMesh
from fenics_joints.structure.structure import Structure


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


def read_face(V: fem.FunctionSpace, tagged: TaggedMesh, name: str) -> Face:
    """Gather a named exterior face with its blocks of ``V``. Collective.

    Raises:
        MeshError: If the mesh has no such face or a facet of it is inside a body.
    """
    local = _local_facets(V, tagged, name)
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


def _local_facets(V, tagged: TaggedMesh, name: str):
    """This rank's facets: vertex blocks, positions, normals, edge blocks, edge ends, where."""
    msh = V.mesh
    tdim, gdim = msh.topology.dim, msh.geometry.dim
    fdim = tdim - 1
    msh.topology.create_connectivity(fdim, tdim)
    msh.topology.create_connectivity(tdim, fdim)
    to_cell, to_facet = msh.topology.connectivity(fdim, tdim), msh.topology.connectivity(tdim, fdim)
    n_owned = msh.topology.index_map(tdim).size_local
    corners, layout = _facet_layout(V)
    geometry, imap = geometry_dofmap(msh), V.dofmap.index_map
    rows, inside = [], False
    for facet in tagged.facet_tags.find(tagged.facet_tag(name)):
        cells = to_cell.links(facet)
        inside |= len(cells) > 1
        if cells[0] >= n_owned or len(cells) > 1:
            continue
        cell = cells[0]
        local = int(np.flatnonzero(to_facet.links(cell) == facet)[0])
        vertices, edges, ends = corners[local]
        dofs = V.dofmap.cell_dofs(cell)
        x = msh.geometry.x[geometry[cell]][:, :gdim]
        normal = _outward(x[vertices], x.mean(axis=0))
        at = dofs[[layout[0][v] for v in vertices]]
        mid = dofs[[layout[1][e] for e in edges]] if edges else np.empty(0, np.int32)
        end = dofs[[[layout[0][v] for v in pair] for pair in ends]] if ends else np.empty((0, 2))
        rows.append((at, x[vertices], normal, mid, end, facet))
    if msh.comm.allreduce(inside):
        raise MeshError(
            f"face {name}: some of its facets lie inside a body; expected the surface of one body. "
            "Bodies in contact must not share vertices: see fenics_joints.meshes.separate."
        )
    k, m = len(corners[0][0]), len(corners[0][1])
    return (
        _global(imap, _column(rows, 0, (k,), np.int32)),
        _column(rows, 1, (k, gdim), float),
        _column(rows, 2, (gdim,), float),
        _global(imap, _column(rows, 3, (m,), np.int32)),
        _global(imap, _column(rows, 4, (m, 2), np.int32)),
        np.column_stack([np.full(len(rows), msh.comm.rank), _column(rows, 5, (), np.int64)]),
    )


def _column(rows: list, i: int, shape: tuple, kind) -> np.ndarray:
    return np.array([row[i] for row in rows], dtype=kind).reshape(len(rows), *shape)


def _global(imap, blocks: np.ndarray) -> np.ndarray:
    return imap.local_to_global(blocks.ravel()).reshape(blocks.shape)


def _facet_layout(V):
    """Of each facet of the reference cell: vertices, edges with a block, and their end vertices."""
    msh = V.mesh
    cell = getattr(basix.CellType, msh.topology.cell_name())
    topology, tdim = basix.topology(cell), msh.topology.dim
    layout = V.dofmap.dof_layout
    at_vertex = [layout.entity_dofs(0, v)[0] for v in range(len(topology[0]))]
    at_edge = [layout.entity_dofs(1, e) for e in range(len(topology[1]))]
    at_edge = [d[0] if len(d) else None for d in at_edge]
    facets = []
    for vertices in topology[tdim - 1]:
        edges = [
            e
            for e, ends in enumerate(topology[1])
            if set(ends) <= set(vertices) and at_edge[e] is not None
        ]
        facets.append((list(vertices), edges, [list(topology[1][e]) for e in edges]))
    return facets, (at_vertex, at_edge)


def _outward(x: np.ndarray, inside: np.ndarray) -> np.ndarray:
    if x.shape[1] == 2:
        along = x[1] - x[0]
        normal = np.array([along[1], -along[0]])
    else:
        normal = np.cross(x[1] - x[0], x[2] - x[0])
    normal /= np.linalg.norm(normal)
    return normal if (x.mean(axis=0) - inside) @ normal > 0 else -normal


def edge_middle(structure: Structure) -> float:
    """Value of a midside's shape function in the middle of its edge; 0 if there is none."""
    if structure.degree == 1:
        return 0.0
    V = structure.V
    cell = getattr(basix.CellType, V.mesh.topology.cell_name())
    middle = basix.geometry(cell)[basix.topology(cell)[1][0]].mean(axis=0, keepdims=True)
    dof = V.dofmap.dof_layout.entity_dofs(1, 0)[0]
    return float(structure.element.tabulate(0, middle)[0][0, dof])
