"""A mesh with named parts and faces, and its distribution from one rank to all of them."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from textwrap import shorten
from typing import NamedTuple

import dolfinx.mesh
import numpy as np
from mpi4py import MPI

from fenics_joints import _compat
from fenics_joints.errors import MeshError


class Tie(NamedTuple):
    """A face of a layer that follows a part whose mesh differs.

    Attributes:
        face: Name of the face.
        to: Names of faces of the part that cover it, of which they may be larger.
        part: Name of the part.
        reach: Farthest distance of the two faces, m.
    """

    face: str
    to: tuple[str, ...]
    part: str
    reach: float


@dataclass(frozen=True)
class TaggedMesh:
    """A mesh whose parts and faces have names.

    A cell or facet has one tag. Names without any cell or facet are left out of ``cell_names`` and
    ``facet_names``, so that asking for one is an error and never an empty integral.

    Attributes:
        mesh: The mesh, geometry in metres, ghosted over shared facets so that ``dS`` works.
        cell_tags: Tags of the cells, those of ghosts included.
        facet_tags: Tags of the named facets.
        cell_names: Tag of each named part.
        facet_names: Tag of each named face.
        points: Named points, each of shape (n, 3) in metres, such as the centres of the bolts, or
            the vertices of a line.
        notes: Remarks for the user on how the mesh was made.
        ties: Faces that follow others whose mesh differs.
        shares: Share of each cell of this rank, ghosts included, that counts, (n_cells,), where the
            cells of a layer are not covered whole; None if all are.
    """

    mesh: dolfinx.mesh.Mesh
    cell_tags: dolfinx.mesh.MeshTags
    facet_tags: dolfinx.mesh.MeshTags
    cell_names: dict[str, int]
    facet_names: dict[str, int]
    points: dict[str, np.ndarray] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    ties: tuple[Tie, ...] = ()
    shares: np.ndarray | None = None

    def __repr__(self) -> str:
        parts, faces = ", ".join(self.cell_names), len(self.facet_names)
        return f"TaggedMesh({shorten(parts, 60)}; {faces} named faces)"

    @cached_property
    def digest(self) -> str:
        """Digest of coordinates, cells, tags, names and points, 64 digits, which does not depend on
        the distribution over ranks. Collective, and made once."""
        mesh, nodes = self.mesh, np.uint64(0)
        for column in np.asarray(mesh.geometry.x, dtype=float).T + 0.0:  # without -0.0
            nodes = mixed(nodes ^ np.ascontiguousarray(column).view(np.uint64))
        digest = hashlib.sha256()
        for tags, names in ((self.cell_tags, self.cell_names), (self.facet_tags, self.facet_names)):
            own = tags.indices < mesh.topology.index_map(tags.dim).size_local
            entities, cells = tags.indices[own], tags.dim == mesh.topology.dim
            at = (
                _compat.geometry_dofmap(mesh)[entities]
                if cells
                else (_compat.entity_nodes(mesh, tags.dim, entities))
            )
            sums = nodes[at].sum(axis=1, dtype=np.uint64)
            found = mixed(sums ^ mixed(tags.values[own].astype(np.uint64)))
            digest.update(np.sort(np.concatenate(mesh.comm.allgather(found))).tobytes())
            digest.update(repr(sorted(names.items())).encode())
        for name in sorted(self.points):
            digest.update(repr((name, np.asarray(self.points[name]).tolist())).encode())
        if self.ties:
            digest.update(repr([tuple(tie) for tie in self.ties]).encode())
        if self.shares is not None:
            own = self.shares[: mesh.topology.index_map(mesh.topology.dim).size_local]
            digest.update(np.sort(np.concatenate(mesh.comm.allgather(own))).tobytes())
        return digest.hexdigest()

    def cell_tag(self, name: str) -> int:
        """Tag of the part ``name``; raises MeshError when the mesh has no such part."""
        return _lookup(self.cell_names, name, "part")

    def facet_tag(self, name: str) -> int:
        """Tag of the face ``name``; raises MeshError when the mesh has no such face."""
        return _lookup(self.facet_names, name, "face")

    def named_points(self, name: str) -> np.ndarray:
        """The points of that name, m, (n, 3); raises MeshError when the mesh has none such."""
        return _lookup(self.points, name, "point or line")


def extent(tagged: TaggedMesh, cells: Sequence[str], normal: Sequence[float]) -> float:
    """Extent, m, of parts together along a direction: the thickness of a flat layer. Collective.

    Args:
        tagged: The mesh.
        cells: Names of the parts.
        normal: The direction; of any length.

    Raises:
        MeshError: The mesh has no part of one of the names.
    """
    found = [tagged.cell_tags.find(tagged.cell_tag(name)) for name in cells]
    corners = tagged.mesh.geometry.x[_compat.geometry_dofmap(tagged.mesh)[np.concatenate(found)]]
    gdim = tagged.mesh.geometry.dim
    n = np.asarray(normal, dtype=float)[:gdim]
    along = corners[..., :gdim] @ (n / np.linalg.norm(n))
    comm = tagged.mesh.comm
    low = comm.allreduce(float(along.min(initial=np.inf)), op=MPI.MIN)
    return comm.allreduce(float(along.max(initial=-np.inf)), op=MPI.MAX) - low


def in_patches(
    tagged: TaggedMesh, name: str, label: Callable[[np.ndarray], np.ndarray]
) -> tuple[TaggedMesh, tuple[str, ...]]:
    """A mesh with a part's cells in patches, by where their middles are. Collective.

    Each patch can be a part of its own, with a parameter of its own.

    Args:
        tagged: The mesh.
        name: Name of the part.
        label: Middles of cells, m, (n, 3), to a whole number for each, (n,): cells of one number
            are a patch.

    Returns:
        The mesh, in which the part's name is gone, and the names of the patches, the part's with
        their numbers, ascending: ``plate_0``, ``plate_1``, ...

    Raises:
        MeshError: The mesh has no such part, a label is no whole number, or a name is taken.
    """
    mesh, tag = tagged.mesh, tagged.cell_tag(name)
    cells, values = tagged.cell_tags.find(tag), tagged.cell_tags.values.copy()
    labels = np.asarray(
        label(dolfinx.mesh.compute_midpoints(mesh, mesh.topology.dim, cells)) if len(cells) else []
    )
    good = labels.shape == cells.shape and (labels.dtype.kind in "iu" or not len(cells))
    if not mesh.comm.allreduce(good, op=MPI.LAND):
        raise MeshError(f"label: expected a whole number for each cell of {name!r}")
    numbers = np.unique(np.concatenate(mesh.comm.allgather(labels.astype(np.int64))))
    first = max(tagged.cell_names.values()) + 1
    # Cells are in order: tags are of all cells, at their numbers.
    values[cells] = first + np.searchsorted(numbers, labels)
    names = {f"{name}_{number}": first + i for i, number in enumerate(numbers.tolist())}
    others = {other: at for other, at in tagged.cell_names.items() if other != name}
    if taken := set(names) & set(others):
        raise MeshError(f"{name!r} in patches: the mesh has a part {min(taken)!r} already")
    return replace(tagged, cell_tags=_cell_tags(mesh, values), cell_names=others | names), tuple(
        names
    )


def limits(tagged: TaggedMesh) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest coordinates of the mesh, m, each of shape (gdim,). Collective."""
    x = tagged.mesh.geometry.x[:, : tagged.mesh.geometry.dim]
    low, high = x.min(axis=0, initial=np.inf), x.max(axis=0, initial=-np.inf)
    tagged.mesh.comm.Allreduce(MPI.IN_PLACE, low, op=MPI.MIN)
    tagged.mesh.comm.Allreduce(MPI.IN_PLACE, high, op=MPI.MAX)
    return low, high


def mixed(x: np.ndarray) -> np.ndarray:
    """A permutation of the 64-bit numbers that sends close numbers far apart (SplitMix64: Steele,
    Lea and Flood, OOPSLA 2014)."""
    x = x + np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


def _lookup(names: dict, name: str, kind: str):
    if name not in names:
        present = ", ".join(sorted(names)) or "none"
        raise MeshError(f"the mesh has no {kind} named {name!r}; it has: {present}")
    return names[name]


@dataclass(frozen=True)
class MeshLists:
    """The whole mesh as arrays on one rank, before it is distributed.

    Attributes:
        cell: ``"hexahedron"``, ``"tetrahedron"``, ``"quadrilateral"`` or ``"triangle"``.
        x: Vertices, shape (n_vertices, gdim), in metres.
        cells: Vertices of each cell in DOLFINx's order, shape (n_cells, n_corners).
        cell_values: Tag of each cell, shape (n_cells,).
        facets: Vertices of each tagged facet in DOLFINx's order, shape (n_facets, n_corners).
        facet_values: Tag of each tagged facet, shape (n_facets,).
        cell_names: Tag of each named part.
        facet_names: Tag of each named face.
        points: Named points, each of shape (n, 3), in metres.
        notes: Remarks for the user on how the mesh was made.
        ties: Faces that follow others whose mesh differs.
        shares: As `TaggedMesh.shares`, of all cells.
    """

    cell: str
    x: np.ndarray
    cells: np.ndarray
    cell_values: np.ndarray
    facets: np.ndarray
    facet_values: np.ndarray
    cell_names: dict[str, int]
    facet_names: dict[str, int]
    points: dict[str, np.ndarray] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    ties: tuple[Tie, ...] = ()
    shares: np.ndarray | None = None

    def __repr__(self) -> str:
        return f"MeshLists({len(self.cells)} {self.cell} cells, {len(self.x)} vertices)"


def distribute(comm: MPI.Intracomm, lists: MeshLists | None) -> TaggedMesh:
    """Distribute a mesh that rank 0 holds over all ranks.

    Args:
        comm: Communicator; the call is collective.
        lists: The whole mesh on rank 0; ignored on the other ranks.

    Returns:
        The tagged mesh, ghosted over shared facets.
    """
    shapes = None
    if comm.rank == 0:
        shapes = (
            lists.cell,
            lists.x.shape[1],
            lists.cells.shape[1],
            lists.facets.shape[1],
            _used(lists.cell_names, lists.cell_values),
            _used(lists.facet_names, lists.facet_values),
            (lists.points, lists.notes, lists.ties),
        )
    cell, gdim, cell_corners, facet_corners, cell_names, facet_names, more = comm.bcast(shapes)
    if comm.rank == 0:
        x, cells = lists.x, lists.cells
        facets, facet_values = lists.facets, lists.facet_values
        cell_values, shares = lists.cell_values.astype(np.int32), lists.shares
    else:
        x, cells = np.empty((0, gdim)), np.empty((0, cell_corners), np.int64)
        facets, facet_values = np.empty((0, facet_corners), np.int64), np.empty(0, np.int32)
        cell_values = shares = None
    mesh = _compat.create_mesh(comm, cells, x, cell)
    cell_values, shares = comm.bcast((cell_values, shares))
    # Rank 0 gave all cells, so the original index of any cell is its row in rank 0's list.
    original = np.asarray(mesh.topology.original_cell_index)
    return TaggedMesh(
        mesh,
        _cell_tags(mesh, cell_values[original]),
        _compat.distribute_facet_tags(mesh, facets, facet_values),
        cell_names,
        facet_names,
        *more,
        None if shares is None else shares[original],
    )


def _used(names: dict[str, int], values: np.ndarray) -> dict[str, int]:
    present = set(np.unique(values).tolist())
    return {name: tag for name, tag in names.items() if tag in present}


def _cell_tags(mesh: dolfinx.mesh.Mesh, values: np.ndarray) -> dolfinx.mesh.MeshTags:
    cells = np.arange(len(values), dtype=np.int32)
    tags = dolfinx.mesh.meshtags(mesh, mesh.topology.dim, cells, values)
    tags.name = "cell_tags"
    return tags
