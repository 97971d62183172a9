"""Whether parts can be stretched where they are: a stretched structure must move as a rigid body.

A part's thickness and width are maps of its cells, y = F x, with displacements in the same
components. It then turns by u = W F x, and its neighbours by W x. Both are equal on a face at one
height along the stretched direction, but for a translation, which costs nothing. On a face along
that direction they are not, and a model with such a face resists rotation: it is no longer free.

So motions without strain are counted: displacements linear in x in every connected body, without
energy by its law, equal where bodies share vertices. A body that moves so can be stretched if and
only if there are as many as before. The count is exact for parts and layers with flat faces.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from fenics_joints._compat import geometry_dofmap
from fenics_joints.structure.assembly import held_nodes
from fenics_joints.structure.components import Region, Support, number
from fenics_joints.structure.laws import LAYER_LAWS, SPRINGS
from fenics_joints.structure.structure import Structure

#: Stretch at which motions are counted: chosen; any that is not 1 would do.
#: Singular value below which a motion has no misfit; others are of the order of the stretch.
_TRIED, _NONE = 1.2, 1e-4
#: Extents of a face and of a layer, over the structure's, below which they count as zero: chosen.
_POINT, _THIN = 1e-4, 1e-3


@dataclass(frozen=True)
class _Body:
    """A connected body: its region, or one of several that are alike, and its nodes."""

    region: int
    nodes: np.ndarray


@dataclass(frozen=True)
class _Face:
    """Face that two bodies share, or a body and a support: its middle and its directions.

    Attributes:
        bodies: Indices of the bodies; one with a support.
        middle: Mean of its points, in units of the structure's size, shape (gdim,).
        ways: Directions in which it extends, shape (n, gdim).
        held: Directions that a support holds.
    """

    bodies: tuple[int, ...]
    middle: np.ndarray
    ways: np.ndarray
    held: tuple[int, ...] = ()


class Stretching:
    """The bodies of a structure and their contacts. Collective; the same on every rank.

    Args:
        structure: The structure.
    """

    def __init__(self, structure: Structure):
        self.structure = structure
        self._counts: dict[tuple, int] = {}
        found = _gathered(structure)
        self._bodies, self._faces, self._thin = structure.comm.bcast(found)

    def keeps(self, names: Iterable[str]) -> bool:
        """Whether the structure moves as freely when parameters of thickness or width change.

        Args:
            names: The parameters, which change by one factor.
        """
        changed = dict.fromkeys(names, _TRIED)
        if self.structure.axisymmetric:
            return True
        return all(
            self._count(changed, held) == self._count({}, held)
            for held in ((False, True) if self._is_held else (False,))
        )

    def spanned(self, name: str) -> list[str]:
        """Names of the regions that touch a part along the direction that a parameter stretches."""
        regions, found = self.structure.regions, []
        for face in self._faces:
            owners = [self._bodies[b].region for b in face.bodies]
            for at, way in self._ways(name):
                if len(owners) < 2 or at not in owners or not len(face.ways):
                    continue
                if np.abs(face.ways @ way).max() > _POINT:
                    found += [regions[i].name for i in owners if i != at]
        return list(dict.fromkeys(found))

    def _ways(self, name: str) -> list[tuple[int, np.ndarray]]:
        """Regions that a parameter stretches, and the direction."""
        gdim, found = self.structure.gdim, []
        for i, region in enumerate(self.structure.regions):
            for key, way in (("stretch", region.normal), ("width", region.across)):
                if region.properties.get(key) == name and way is not None:
                    found.append((i, np.array(way[:gdim])))
        return found

    @cached_property
    def _is_held(self) -> bool:
        return any(face.held for face in self._faces)

    def _count(self, given: Mapping[str, float], held: bool) -> int:
        """Number of motions without strain."""
        key = tuple(sorted(given)), held
        if key not in self._counts:
            self._counts[key] = self._free(self.structure.values(given), held)
        return self._counts[key]

    def _free(self, values: Mapping[str, float], held: bool) -> int:
        gdim, regions = self.structure.gdim, self.structure.regions
        own = [
            _strainless(regions[body.region], values, gdim, thin)
            for body, thin in zip(self._bodies, self._thin, strict=True)
        ]
        ends = np.cumsum([0, *(basis.shape[1] for basis in own)])
        rows = []
        for face in self._faces:
            if face.held and not held:
                continue
            reads = _reads(face, gdim)
            row = np.zeros((len(reads), ends[-1]))
            for body, sign in zip(face.bodies, (1.0, -1.0), strict=False):
                row[:, ends[body] : ends[body + 1]] = sign * reads @ own[body]
            rows.append(row)
        if not rows:
            return int(ends[-1])
        A = np.concatenate(rows)
        return int(np.sum(np.linalg.eigvalsh(A.T @ A) < _NONE**2))


def _strainless(region: Region, values, gdim: int, thin: bool) -> np.ndarray:
    """Displacements a + B x without energy in a region: columns of (a, B), orthonormal."""
    n, F = np.zeros(gdim), np.eye(gdim)
    n[:] = region.normal[:gdim]
    for key, way in (("stretch", region.normal), ("width", region.across)):
        value = region.properties.get(key, 1.0)
        if way is not None and not callable(value):
            a = np.array(way[:gdim])
            F += (1 / number(value, values) - 1) * np.outer(a, a)
    conditions = []
    for unit in np.eye(gdim * gdim):
        B = unit.reshape(gdim, gdim)
        G = B @ F
        strain = G + G.T
        if region.is_joint and thin:
            conditions.append(B @ n)
        elif region.law.name in (SPRINGS.name, LAYER_LAWS["uncoupled"].name):
            conditions.append(strain @ n)
        else:
            conditions.append(strain.ravel())
    s, right = np.linalg.svd(np.array(conditions).T)[1:]
    free = right[int(np.sum(s > 1e-9)) :].T
    basis = np.zeros((gdim + gdim**2, gdim + free.shape[1]))
    basis[:gdim, :gdim], basis[gdim:, gdim:] = np.eye(gdim), free
    return basis


def _reads(face: _Face, gdim: int) -> np.ndarray:
    """Rows that read a displacement (a, B) at a face: at its middle, and its slopes along it."""
    reads = []
    for value, way in ((1.0, face.middle), *((0.0, way) for way in face.ways)):
        for i in face.held or range(gdim):
            row = np.zeros(gdim + gdim**2)
            row[i], row[gdim + i * gdim : gdim + (i + 1) * gdim] = value, way
            reads.append(row)
    return np.array(reads)


# -- from the mesh ---------------------------------------------------------------------------------


def _gathered(structure: Structure):
    """Bodies, the faces that they share, and which are thin layers, on rank 0; None elsewhere."""
    mesh, tdim = structure.mesh, structure.mesh.topology.dim
    owned = mesh.topology.index_map(tdim).size_local
    number_of = mesh.geometry.index_map().local_to_global
    dofmap = geometry_dofmap(mesh)[:owned]
    region = np.zeros(owned, dtype=np.int32)
    for i, (_, cells) in enumerate(structure.field.regions):
        region[cells[cells < owned]] = i
    local = np.arange(len(mesh.geometry.x), dtype=np.int32)
    cells = number_of(dofmap.ravel().astype(np.int32)).reshape(dofmap.shape)
    held = [(ways, number_of(nodes)) for ways, nodes in _supports(structure)]
    found = mesh.comm.gather((cells, region, number_of(local), mesh.geometry.x, held))
    if found is None:
        return None
    cells, region = (np.concatenate([f[i] for f in found]) for i in (0, 1))
    x = np.zeros((1 + max(f[2].max(initial=-1) for f in found), structure.gdim))
    for f in found:
        x[f[2]] = f[3][:, : structure.gdim]
    size = float(np.ptp(x, axis=0).max())
    x = (x - x.mean(axis=0)) / size
    bodies = [
        body
        for alike in _alike(structure)
        for body in _connected(region[np.isin(region, alike)], cells[np.isin(region, alike)])
    ]
    supports = [
        (ways, np.unique(np.concatenate([f[4][i][1] for f in found])))
        for i, (ways, _) in enumerate(held)
    ]
    normals = [np.array(structure.regions[b.region].normal[: structure.gdim]) for b in bodies]
    thin = [
        structure.regions[b.region].is_joint and np.ptp(x[b.nodes] @ n) < _THIN
        for b, n in zip(bodies, normals, strict=True)
    ]
    return bodies, _faces(bodies, x) + _held(bodies, supports, x), thin


def _alike(structure: Structure) -> list[list[int]]:
    """Regions that move alike without strain: parts stretched alike, and zones of joints."""
    values, found = structure.values(), {}
    for i, region in enumerate(structure.regions):
        stretch = region.properties.get("stretch", 1.0)
        if region.is_joint and not callable(stretch):
            stretch = number(stretch, values)
        width = region.properties.get("width", 1.0)
        key = region.law, region.normal, region.across, stretch, width
        found.setdefault(key, []).append(i)
    return list(found.values())


def _supports(structure: Structure):
    """Held directions and geometry nodes of each support on this rank."""
    all_ways = tuple(range(structure.gdim))
    for support in structure.supports:
        ways = tuple(d for d in support.directions if d < structure.gdim)
        yield ways, held_nodes(structure.tagged, support)
    for support in structure.elastic_supports:
        yield all_ways, held_nodes(structure.tagged, Support(support.facets))


def _connected(region: np.ndarray, cells: np.ndarray) -> list[_Body]:
    """The connected bodies of cells that are alike."""
    if not len(cells):
        return []
    nodes, inverse = np.unique(cells, return_inverse=True)
    inverse = inverse.reshape(cells.shape)
    first = np.repeat(inverse[:, 0], cells.shape[1])
    links = coo_array((np.ones(first.size), (first, inverse.ravel())), (len(nodes),) * 2)
    count, label = connected_components(links, directed=False)
    owner = region[np.unique(label[inverse[:, 0]], return_index=True)[1]]
    return [_Body(int(owner[i]), nodes[label == i]) for i in range(count)]


def _faces(bodies: list[_Body], x: np.ndarray) -> list[_Face]:
    """Faces that two bodies share."""
    owners: list[list[int]] = [[] for _ in range(len(x))]
    for i, body in enumerate(bodies):
        for node in body.nodes.tolist():
            owners[node].append(i)
    shared: dict[tuple[int, int], list[int]] = {}
    for node, its in enumerate(owners):
        for a in range(len(its)):
            for b in range(a):
                shared.setdefault((its[b], its[a]), []).append(node)
    return [_face(pair, x[nodes]) for pair, nodes in shared.items()]


def _held(bodies: list[_Body], supports, x: np.ndarray) -> list[_Face]:
    found = []
    for ways, nodes in supports:
        for i, body in enumerate(bodies):
            here = np.intersect1d(nodes, body.nodes)
            if len(here) and ways:
                found.append(_face((i,), x[here], ways))
    return found


def _face(bodies: tuple[int, ...], points: np.ndarray, held: tuple[int, ...] = ()) -> _Face:
    middle = points.mean(axis=0)
    ways = np.linalg.svd(points - middle, full_matrices=False)[2]
    extents = np.ptp(points @ ways.T, axis=0)
    return _Face(bodies, middle, ways[extents > _POINT], held)
