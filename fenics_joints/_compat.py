"""What differs between DOLFINx 0.9 and 0.11: features are asked for before versions."""

from __future__ import annotations

import basix.ufl
import dolfinx.graph
import dolfinx.io
import dolfinx.mesh
import numpy as np
import ufl
from mpi4py import MPI


def create_mesh(
    comm: MPI.Intracomm, cells: np.ndarray, x: np.ndarray, cell: str
) -> dolfinx.mesh.Mesh:
    """Mesh of straight-sided cells, ghosted over shared facets.

    Args:
        comm: Communicator; the call is collective.
        cells: This rank's cells in DOLFINx's order of vertices, shape (n_cells, n_corners).
        x: This rank's vertices, shape (n, gdim), in metres.
        cell: Name of the cell's shape, such as ``"hexahedron"``.

    Returns:
        The mesh.
    """
    domain = ufl.Mesh(basix.ufl.element("Lagrange", cell, 1, shape=(x.shape[1],)))
    cells = np.ascontiguousarray(cells, dtype=np.int64)
    # `e` and `x` changed places in 0.10, but kept their names.
    return dolfinx.mesh.create_mesh(
        comm, cells=cells, x=x, e=domain, partitioner=_shared_facet_partitioner()
    )


def _shared_facet_partitioner():
    mode = dolfinx.mesh.GhostMode.shared_facet
    try:
        return dolfinx.mesh.create_cell_partitioner(mode, 2)
    except TypeError:  # 0.9 takes the mode alone
        return dolfinx.mesh.create_cell_partitioner(mode)


def distribute_facet_tags(
    mesh: dolfinx.mesh.Mesh, facets: np.ndarray, values: np.ndarray
) -> dolfinx.mesh.MeshTags:
    """Tags of facets that are given by their vertices on any rank.

    Args:
        mesh: The mesh; the call is collective.
        facets: Vertices in the numbering that ``create_mesh`` was given, shape (n, n_corners).
        values: Tag of each facet, shape (n,).

    Returns:
        The tags of this rank's facets, ghosts included.
    """
    fdim = mesh.topology.dim - 1
    mesh.topology.create_entities(fdim)
    mesh.topology.create_connectivity(fdim, 0)
    mesh.topology.create_connectivity(fdim, mesh.topology.dim)
    facets = np.ascontiguousarray(facets, dtype=np.int64)
    values = np.ascontiguousarray(values, dtype=np.int32)
    entities, values = dolfinx.io.distribute_entity_data(mesh, fdim, facets, values)
    entities = dolfinx.graph.adjacencylist(entities.astype(np.int32, copy=False))
    values = values.astype(np.int32, copy=False)
    tags = dolfinx.mesh.meshtags_from_entities(mesh, fdim, entities, values)
    tags.name = "facet_tags"
    return tags


def coordinate_map(mesh: dolfinx.mesh.Mesh):
    """The geometry's coordinate element, for push-forward and pull-back of points."""
    geometry = mesh.geometry
    # 0.11 deprecates the singular in favour of one element for each cell type.
    return geometry.cmaps[0] if hasattr(geometry, "cmaps") else geometry.cmap


def geometry_dofmap(mesh: dolfinx.mesh.Mesh) -> np.ndarray:
    """Rows of ``mesh.geometry.x`` of each local cell, shape (n_cells, n_nodes)."""
    geometry = mesh.geometry
    return geometry.dofmaps[0] if hasattr(geometry, "cmaps") else geometry.dofmap


def facet_nodes(mesh: dolfinx.mesh.Mesh, facets: np.ndarray) -> np.ndarray:
    """Geometry nodes at the corners of local facets, shape (n_facets, n_corners)."""
    return entity_nodes(mesh, mesh.topology.dim - 1, facets)


def entity_nodes(mesh: dolfinx.mesh.Mesh, dim: int, entities: np.ndarray) -> np.ndarray:
    """Geometry nodes at the corners of local entities, shape (n, n_corners).

    Without entities, as a rank may be, shape (0, 0): DOLFINx 0.9 divides by their number.
    """
    if not len(entities):
        return np.empty((0, 0), dtype=np.int32)
    return dolfinx.mesh.entities_to_geometry(mesh, dim, entities)
