"""Which entities of a mesh a support holds: facets of a group, or vertices and edges at points."""

from __future__ import annotations

import dolfinx.mesh
import numpy as np
from mpi4py import MPI
from scipy.spatial import cKDTree

from fenics_joints._compat import entity_nodes
from fenics_joints.errors import MeshError
from fenics_joints.meshes import TaggedMesh
from fenics_joints.structure.components import Support

#: Vertices as near to a point as the nearest one, up to this share of the mesh's extent, are at it:
#: bodies that touch without sharing vertices have one each.
_SAME = 1e-9


def held_entities(tagged: TaggedMesh, support: Support) -> list[tuple[int, np.ndarray]]:
    """Dimension and this rank's entities, of each dimension that the support holds. Collective.

    Raises:
        MeshError: If the mesh has no such group, or no vertex near a point.
    """
    mesh = tagged.mesh
    if support.facets:
        facets = tagged.facet_tags.find(tagged.facet_tag(support.facets))
        return [(mesh.topology.dim - 1, facets)]
    vertices = _vertices(mesh, *_points(tagged, support))
    if mesh.topology.dim == 1:
        return [(0, vertices)]
    mesh.topology.create_entities(1)
    mesh.topology.create_connectivity(0, 1)
    mesh.topology.create_connectivity(1, 0)
    mesh.topology.create_connectivity(1, mesh.topology.dim)
    ends = mesh.topology.connectivity(1, 0).array.reshape(-1, 2)
    edges = np.flatnonzero(np.isin(ends, vertices).all(axis=1)).astype(np.int32)
    return [(0, vertices), (1, edges)]


def held_nodes(tagged: TaggedMesh, support: Support) -> np.ndarray:
    """This rank's geometry nodes at what the support holds. Collective."""
    found = [
        entity_nodes(tagged.mesh, dim, entities).ravel()
        for dim, entities in held_entities(tagged, support)
    ]
    return np.unique(np.concatenate(found)).astype(np.int32)


def _points(tagged: TaggedMesh, support: Support) -> tuple[str, np.ndarray]:
    gdim = tagged.mesh.geometry.dim
    if isinstance(support.points, str):
        return f"points {support.points!r}", tagged.named_points(support.points)[:, :gdim]
    x = np.atleast_2d(np.asarray(support.points, dtype=float))
    if x.shape[1] < gdim:
        raise MeshError(f"support.points of {x.shape[1]} coordinates: expected {gdim}.")
    return "support.points", x[:, :gdim]


def _vertices(mesh: dolfinx.mesh.Mesh, name: str, points: np.ndarray) -> np.ndarray:
    """This rank's vertices nearest to each point."""
    gdim, comm = mesh.geometry.dim, mesh.comm
    mesh.topology.create_connectivity(0, mesh.topology.dim)
    count = mesh.topology.index_map(0)
    vertices = np.arange(count.size_local + count.num_ghosts, dtype=np.int32)
    x = mesh.geometry.x[entity_nodes(mesh, 0, vertices).ravel()][:, :gdim]
    tree = cKDTree(x) if len(x) else None
    near = np.full(len(points), np.inf) if tree is None else tree.query(points)[0]
    comm.Allreduce(MPI.IN_PLACE, near, op=MPI.MIN)
    cells = mesh.topology.index_map(mesh.topology.dim).size_local
    sizes = mesh.h(mesh.topology.dim, np.arange(cells, dtype=np.int32))
    reach = 0.5 * comm.allreduce(float(sizes.max(initial=0.0)), op=MPI.MAX)
    if near.max(initial=0.0) > reach:
        worst = int(np.argmax(near))
        raise MeshError(
            f"{name}: {points[worst].tolist()} m is {near[worst]:.3g} m from the nearest vertex; "
            f"expected one within half a cell, {reach:.3g} m."
        )
    if tree is None:
        return vertices
    slack = _SAME * comm.allreduce(float(np.abs(x).max(initial=0.0)), op=MPI.MAX)
    found = tree.query_ball_point(points, near + slack)
    return np.unique(np.concatenate([np.empty(0, int), *found])).astype(np.int32)
