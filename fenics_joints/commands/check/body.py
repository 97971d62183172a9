"""The cells of a mesh on one rank: for volumes, and for a picture."""

from __future__ import annotations

from dataclasses import dataclass

import dolfinx.mesh
import numpy as np

from fenics_joints._compat import geometry_dofmap
from fenics_joints.meshes import TaggedMesh

#: Simplices that a cell is cut into, by its number of corners in DOLFINx's order and dimension.
_SIMPLICES = {
    (3, 2): [(0, 1, 2)],
    (4, 2): [(0, 1, 3), (0, 2, 3)],
    (4, 3): [(0, 1, 2, 3)],
    (8, 3): [(0, 1, 3, 7), (0, 1, 5, 7), (0, 2, 3, 7), (0, 2, 6, 7), (0, 4, 5, 7), (0, 4, 6, 7)],
}


@dataclass(frozen=True, eq=False)
class Body:
    """All cells of a mesh.

    Attributes:
        vertices: Corners, m, shape (n, n_corners, 3).
        names: Names of the groups of cells.
        group: Which of them each cell is of, shape (n,).
        volumes: Of each cell, m3; in the plane of one metre of depth; shape (n,).
    """

    vertices: np.ndarray
    names: tuple[str, ...]
    group: np.ndarray
    volumes: np.ndarray

    def volume(self, names) -> float:
        """Volume of groups, m3."""
        wanted = [i for i, name in enumerate(self.names) if name in set(names)]
        return float(self.volumes[np.isin(self.group, wanted)].sum())


def body_of(tagged: TaggedMesh) -> Body | None:
    """The cells of a mesh, on rank 0; None on others. Collective."""
    mesh, gdim = tagged.mesh, tagged.mesh.geometry.dim
    owned = mesh.topology.index_map(mesh.topology.dim).size_local
    corners = mesh.geometry.x[geometry_dofmap(mesh)[:owned]]
    tags = np.full(owned, -1, dtype=np.int32)
    here = tagged.cell_tags.indices < owned
    tags[tagged.cell_tags.indices[here]] = tagged.cell_tags.values[here]
    found = mesh.comm.gather((corners, tags))
    if found is None:
        return None
    vertices, tags = (np.concatenate(parts) for parts in zip(*found, strict=True))
    names = tuple(tagged.cell_names)
    group = np.full(len(tags), -1)
    for i, name in enumerate(names):
        group[tags == tagged.cell_names[name]] = i
    return Body(vertices, names, group, _volumes(vertices[..., :gdim]))


def _volumes(vertices: np.ndarray) -> np.ndarray:
    """Volumes (areas in the plane) of straight-sided cells, shape (n,)."""
    gdim = vertices.shape[2]
    total = np.zeros(len(vertices))
    for corners in _SIMPLICES[vertices.shape[1], gdim]:
        x = vertices[:, list(corners)]
        total += np.abs(np.linalg.det(x[:, 1:] - x[:, :1]))
    return total / (6.0 if gdim == 3 else 2.0)


def face_centres(tagged: TaggedMesh) -> dict[str, np.ndarray]:
    """Mean place of each named face, m, shape (3,), the same on every rank. Collective."""
    mesh = tagged.mesh
    dim = mesh.topology.dim - 1
    owned = mesh.topology.index_map(dim).size_local
    found = {}
    for name, tag in tagged.facet_names.items():
        facets = tagged.facet_tags.find(tag)
        own = facets[facets < owned]
        middles = dolfinx.mesh.compute_midpoints(mesh, dim, own).reshape(-1, 3)
        total = mesh.comm.allreduce(np.array([*middles.sum(axis=0), len(own)]))
        if total[3]:
            found[name] = total[:3] / total[3]
    return found
