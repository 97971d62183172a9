"""Values and gradients of a displacement space at arbitrary points, as rows over its DOFs.

Sensors, point masses and springs need not sit on nodes: a displacement there is a short row of
basis-function values times DOFs.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import permutations, product

import basix.ufl
import numpy as np
from dolfinx import fem, geometry
from mpi4py import MPI
from numpy.typing import ArrayLike
from petsc4py import PETSc
from scipy.spatial.distance import pdist

from fenics_joints._compat import coordinate_map, geometry_dofmap
from fenics_joints.errors import InputError, MeshError, items, reals
from fenics_joints.meshes import TaggedMesh
from fenics_joints.meshes.rings import measure_ring, ring_names

#: A point this near, m, or nearer than half a cell, is moved onto the surface.
NEAR = 1e-3
#: Distance, m, below which a point is on the mesh, up to round-off.
_ON = 1e-8
#: How many points a message names.
_NAMED = 12
#: Points that span less than this share of a structure are those of another unit.
_SMALL = 2e-3
#: Factors to metres of units that files leave out, had their numbers been read as metres.
_UNITS = {"mm": 1e-3, "inches": 0.0254, "cm": 1e-2, "feet": 0.3048, "µm": 1e-6}


@dataclass(frozen=True)
class Nearest:
    """The nearest places on a mesh, equal on all ranks but for the cells.

    Attributes:
        owner: Rank that owns the cell, shape (n,).
        cells: That cell on its owner, else -1, shape (n,).
        points: The place, m, shape (n, 3).
        distance: From the point to it, m, shape (n,); 0 inside the mesh.
        reach: Within which the point may be moved there: 1 mm, or half of the cell's shortest
            edge if that is more; m, shape (n,).
    """

    owner: np.ndarray
    cells: np.ndarray
    points: np.ndarray
    distance: np.ndarray
    reach: np.ndarray

    @property
    def is_near(self) -> np.ndarray:
        """Which points may be moved, shape (n,)."""
        return self.distance <= self.reach


def nearest(msh, points: np.ndarray, among: np.ndarray | None = None) -> Nearest:
    """The nearest places on a mesh with straight-sided cells. Collective.

    Args:
        msh: The mesh.
        points: m, shape (n, 3).
        among: Cells of this rank that count; None for all.
    """
    comm, tdim, n = msh.comm, msh.topology.dim, len(points)
    points = np.ascontiguousarray(points, dtype=msh.geometry.x.dtype)
    owned = _owned(msh, among)
    cells = np.full(n, -1, dtype=np.int32)
    if len(owned) and n:
        trees = (
            geometry.bb_tree(msh, tdim, entities=owned),
            geometry.create_midpoint_tree(msh, tdim, owned),
        )
        cells = geometry.compute_closest_entity(*trees, msh, points)
    places, reach, distance = points.copy(), np.zeros(n), np.full(n, np.inf)
    for i in np.flatnonzero(cells >= 0):
        corners = msh.geometry.x[geometry_dofmap(msh)[cells[i]]]
        gap = geometry.compute_distance_gjk(points[i : i + 1], corners)
        places[i], distance[i] = points[i] - gap, np.linalg.norm(gap)
        reach[i] = max(NEAR, 0.5 * float(pdist(corners).min()))
    least = all_min(comm, distance)
    owner = all_min(comm, np.where(distance <= least, comm.rank, comm.size))
    mine = owner == comm.rank
    places, reach = (
        comm.allreduce(np.where(there, a, 0.0))
        for a, there in ((places, mine[:, None]), (reach, mine))
    )
    return Nearest(owner, np.where(mine, cells, -1), places, least, reach)


def round_bolts(tagged: TaggedMesh, points: np.ndarray) -> list[np.ndarray | None]:
    """Places on the ring around the empty bolt hole in which a point lies. Collective.

    Args:
        tagged: A mesh.
        points: m, shape (n_points, 3).

    Returns:
        For each point the places, halfway through the ring, m, shape (8, 3), with their mean on
        the bolt's axis; None for a point in the mesh or outside of all bolt holes.
    """
    found: list[np.ndarray | None] = [None] * len(points)
    names = ring_names(list(tagged.cell_names)) if tagged.mesh.geometry.dim == 3 else []
    if not names or not np.any(empty := nearest(tagged.mesh, points).distance > _ON):
        return found
    for name in names:
        try:
            ring = measure_ring(tagged, name)
        except MeshError:  # no flat ring
            continue
        across = np.linalg.svd(ring.normal[None])[2][1:]
        turn = 2 * np.pi * (np.arange(8)[:, None] + 0.5) / 8
        way = np.cos(turn) * across[0] + np.sin(turn) * across[1]
        for i in np.flatnonzero(empty):
            along = (points[i] - ring.centre) @ ring.normal
            beside = np.linalg.norm(points[i] - ring.centre - along * ring.normal)
            if beside < ring.r_nei and abs(along) <= ring.r_wai:
                found[i] = ring.centre + 0.5 * (ring.r_nei + ring.r_wai) * way
    return found


def all_min(comm: MPI.Intracomm, array: np.ndarray) -> np.ndarray:
    """The least of all ranks, entry by entry. Collective."""
    result = np.ascontiguousarray(array).copy()
    comm.Allreduce(MPI.IN_PLACE, result, op=MPI.MIN)
    return result


def too_close_together(msh, points: np.ndarray, what: str) -> None:
    """Refuse points that are all at one place of a large structure, as in a wrong unit.

    Raises:
        InputError: If three or more places span less than 0.2 % of the structure. Collective.
    """
    places = np.unique(np.asarray(points, dtype=float), axis=0)
    if len(places) < 3:
        return
    low, high = _box(msh)
    span, size = float(np.ptp(places, axis=0).max()), float((high - low).max())
    if span < _SMALL * size:
        raise InputError(
            f"the {len(places)} places of {what}s span {1e3 * span:.3g} mm of a structure of "
            f"{1e3 * size:.3g} mm: expected places all over it; the unit of their coordinates, or "
            "that of the structure's file, may be wrong"
        )


def far_points(
    msh, points: np.ndarray, found: Nearest, what: str, names: Sequence[str], all_points: np.ndarray
) -> InputError:
    """The error of points that are too far from the mesh, all in one. Collective.

    Args:
        msh: The mesh.
        points: Those outside of it, m, shape (n, 3).
        found: Their nearest places.
        what: What stands there.
        names: Their names; empty strings for those without.
        all_points: These and those inside, m, shape (m, 3), for a guess at what is wrong.
    """
    gdim = msh.geometry.dim
    low, high = (corner[:gdim].tolist() for corner in _box(msh))
    far = np.flatnonzero(~found.is_near)
    said = [_said(points[i, :gdim], found.distance[i], found.reach[i], names[i]) for i in far]
    within = f"expected a point of the structure, which lies within {low} and {high} m"
    least = float(found.reach[far].min())
    reach = f"; one within {1e3 * least:.3g} mm would be moved onto it" if least else ""
    # Where most are on the mesh, the others have errors of their own.
    hint = _hint(msh, all_points) if 3 * len(said) >= len(all_points) else ""
    if len(said) == 1:
        one = said[0].removeprefix(f"{what} ")
        return InputError(f"{what} {one}: {within}{reach}{hint}.")
    more = f"\n  and {len(said) - _NAMED} more" if len(said) > _NAMED else ""
    lines = "\n  ".join(said[:_NAMED])
    all_of_them = f"{len(all_points)} {what}{'es' if what.endswith('s') else 's'}"
    return InputError(
        f"{len(said)} of {all_of_them} are outside the mesh: {within}{reach}{hint}:"
        f"\n  {lines}{more}"
    )


def _said(point: np.ndarray, distance: float, reach: float, name: str) -> str:
    of = f"{name} " if name else ""
    place = [float(f"{x:.9g}") for x in point]
    return f"{of}at {place} m is outside the mesh, by {1e3 * distance:.4g} mm"


def _box(msh) -> tuple[np.ndarray, np.ndarray]:
    x = msh.geometry.x
    low = all_min(msh.comm, x.min(axis=0, initial=np.inf))
    return low, -all_min(msh.comm, (-x).min(axis=0, initial=np.inf))


def _hint(msh, points: np.ndarray) -> str:
    """A change that would bring all points onto the mesh: turned axes, or another unit.

    Smaller numbers nearly always lie within a mesh about the origin: of several units it is the
    largest that fits.
    """
    if len(np.unique(points, axis=0)) < 3:
        return ""
    low, high = _box(msh)
    size = float((high - low).max())
    for changed, words in (*_turned(points), *_scaled(points)):
        inside = np.all((changed >= low - 0.05 * size) & (changed <= high + 0.05 * size))
        wide = np.ptp(changed, axis=0).max() > 0.2 * size
        if inside and wide and nearest(msh, changed).is_near.all():
            # As they are they lie near enough for this, so that nothing is turned or scaled.
            return "" if np.array_equal(changed, points) else f". All would lie on it {words}"
    return ""


def _turned(points: np.ndarray) -> Iterator[tuple[np.ndarray, str]]:
    ways = product(permutations(range(3)), product((1, -1), repeat=3))
    # As few turned axes as possible.
    for order, signs in sorted(ways, key=lambda way: (way[0] != (0, 1, 2), -sum(way[1]))):
        axes = ", ".join(f"{'-' * (s < 0)}{'xyz'[i]}" for i, s in zip(order, signs, strict=True))
        yield points[:, order] * signs, f"with ({axes}) in place of (x, y, z)"


def _scaled(points: np.ndarray) -> Iterator[tuple[np.ndarray, str]]:
    for unit, factor in sorted(_UNITS.items(), key=lambda item: -item[1]):
        yield points * factor, f"if their numbers were {unit} and not m"


@dataclass(frozen=True, init=False, repr=False)
class Sensors:
    """Points and directions in which a test measured.

    Args:
        points: Positions, m, shape (n, gdim) or (gdim,).
        directions: Directions of any length, shape (n, gdim), or (gdim,) for all.
        names: What they are called in the test, n of them; or none.

    Raises:
        InputError: If a number is not finite, a direction zero, or their shapes do not fit.

    Attributes:
        points: Positions, m, shape (n, gdim).
        directions: Unit directions, shape (n, gdim).
        names: Names, n of them, or none.
    """

    points: np.ndarray
    directions: np.ndarray
    names: tuple[str, ...]

    def __init__(self, points: ArrayLike, directions: ArrayLike, names: Sequence[str] = ()):
        points = np.atleast_2d(reals("sensors.points", points, unit="m"))
        if points.ndim != 2 or (points.size and points.shape[1] not in (2, 3)):
            raise InputError(f"sensors.points has shape {points.shape}: expected (n, 2) or (n, 3).")
        directions = reals("sensors.directions", directions)
        if directions.shape not in (points.shape, (1, *points.shape[1:]), points.shape[1:]):
            raise InputError(
                f"sensors.directions has shape {directions.shape}: expected one for each of the "
                f"points, {points.shape}, or one for all, {points.shape[1:]}."
            )
        directions = np.broadcast_to(directions, points.shape)
        norms = np.linalg.norm(directions, axis=1, keepdims=True)
        if np.any(norms == 0):
            raise InputError("sensors.direction: expected non-zero vectors.")
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "directions", directions / norms)
        object.__setattr__(self, "names", items("sensors.names", names, str, "names"))

    def __len__(self) -> int:
        return len(self.points)

    def __repr__(self) -> str:
        if not len(self):
            return "Sensors(0)"
        low, high = (f(self.points, axis=0).round(4).tolist() for f in (np.min, np.max))
        return f"Sensors({len(self)}, from {low} to {high} m)"


@dataclass(frozen=True)
class PointRows:
    """Rows that evaluate a blocked space at points; a point is on exactly one rank.

    Attributes:
        index: Which of the asked points are on this rank, shape (m,).
        nodes: Local blocks (nodes) of the space, shape (m, n_basis).
        values: Basis functions there, shape (m, n_basis).
        gradients: Their gradients, 1/m, shape (m, n_basis, gdim).
        moved: How far each of the asked points was moved onto the mesh, m, shape (n,), equal on
            all ranks; or None.
    """

    index: np.ndarray
    nodes: np.ndarray
    values: np.ndarray
    gradients: np.ndarray
    moved: np.ndarray | None = None


def _owned(msh, cells: np.ndarray | None) -> np.ndarray:
    """The cells that this rank owns, or those of some."""
    n = msh.topology.index_map(msh.topology.dim).size_local
    return np.arange(n, dtype=np.int32) if cells is None else cells[cells < n]


def _owned_candidates(msh, points: np.ndarray, cells: np.ndarray | None) -> np.ndarray:
    """A cell that this rank owns around each point, or -1; shape (n,)."""
    tdim = msh.topology.dim
    owned = _owned(msh, cells)
    found = np.full(len(points), -1, dtype=np.int32)
    if len(owned) == 0:
        return found
    tree = geometry.bb_tree(msh, tdim, entities=owned, padding=1e-9)
    near = geometry.compute_collisions_points(tree, points)
    around = geometry.compute_colliding_cells(msh, near, points)
    for i in range(len(points)):
        links = around.links(i)
        if len(links):
            found[i] = links[0]
    return found


def locate(
    V: fem.FunctionSpace,
    element,
    points,
    what: str = "point",
    *,
    names: Sequence[str] = (),
    snap: bool = False,
    cells: np.ndarray | None = None,
) -> PointRows:
    """Rows that evaluate ``V`` at points. Collective.

    Args:
        V: Blocked space of displacements on a mesh with straight-sided cells.
        element: The scalar element of a block, from ``basix.ufl.element``.
        points: Positions, m, shape (n, gdim).
        what: What stands there, for the message.
        names: What the points are called, for the message; n of them, or none.
        snap: Whether points beside the mesh are moved onto it if they are within 1 mm, or half of
            the nearest cell's shortest edge; those of a test, which are measured by hand.
        cells: Cells of this rank in which points may be; None for all.

    Returns:
        The rows of the points that this rank owns.

    Raises:
        InputError: If points are outside the mesh, all of them in one message; on every rank.
    """
    msh = V.mesh
    gdim = msh.geometry.dim
    points = np.atleast_2d(np.asarray(points, dtype=float))
    padded = np.zeros((len(points), 3))
    padded[:, :gdim] = points
    if snap:
        too_close_together(msh, padded, what)
    candidate = _owned_candidates(msh, padded, cells)
    rank = np.where(candidate >= 0, msh.comm.rank, msh.comm.size)
    owner, moved = all_min(msh.comm, rank), np.zeros(len(points))
    lost = np.flatnonzero(owner == msh.comm.size)
    if len(lost):
        found = nearest(msh, padded[lost], cells)
        if not (snap and found.is_near.all()):
            far = found if snap else replace(found, reach=np.zeros(len(lost)))
            called = [names[i] if len(names) else "" for i in lost]
            raise far_points(msh, padded[lost], far, what, called, padded)
        padded[lost], moved[lost] = found.points, found.distance
        owner[lost], candidate[lost] = found.owner, found.cells
    index = np.flatnonzero(owner == msh.comm.rank)
    rows = _tabulate(V, element, padded[index, :gdim], candidate[index], index)
    return replace(rows, moved=moved)


def _tabulate(V, element, points, cells, index) -> PointRows:
    msh = V.mesh
    gdim, tdim = msh.geometry.dim, msh.topology.dim
    cmap, vertices = coordinate_map(msh), geometry_dofmap(msh)
    linear = basix.ufl.element("Lagrange", msh.topology.cell_name(), 1)
    orient = _orientation(V, element)
    nodes, values, gradients = [], [], []
    for point, cell in zip(points, cells, strict=True):
        x = msh.geometry.x[vertices[cell], :gdim]
        reference = cmap.pull_back(point[None, :], x)
        jacobian = x.T @ linear.tabulate(1, reference)[1 : tdim + 1, 0, :].T
        table = orient(element.tabulate(1, reference)[:, 0, :], cell)
        nodes.append(V.dofmap.cell_dofs(cell))
        values.append(table[0])
        gradients.append(table[1 : tdim + 1].T @ np.linalg.inv(jacobian))
    n = element.dim
    return PointRows(
        index,
        np.array(nodes, dtype=np.int32).reshape(len(index), n),
        np.array(values).reshape(len(index), n),
        np.array(gradients).reshape(len(index), n, gdim),
    )


def _orientation(V, element):
    """A function that turns an element's values, (k, n), from the reference cell to a cell.

    Only functions of degree 3 on edges that two cells see from different ends differ.
    """
    if not V.element.needs_dof_transformations:
        return lambda table, cell: table
    V.mesh.topology.create_entity_permutations()
    seen = V.mesh.topology.get_cell_permutation_info()
    scalar = fem.functionspace(V.mesh, element).element

    def turned(table, cell):
        found = np.ascontiguousarray(table)
        for row in found:
            scalar.T_apply(row, seen[cell : cell + 1], 1)
        return found

    return turned


def node_positions(V: fem.FunctionSpace) -> np.ndarray:
    """Positions of all local blocks, m, (n, gdim): vertices, and the middles of edges and so on.

    For elements whose DOFs are moments the middle of an edge is where a linear function takes the
    moment's value.
    """
    msh = V.mesh
    gdim, layout = msh.geometry.dim, V.dofmap.dof_layout
    topology = basix.topology(getattr(basix.CellType, msh.topology.cell_name()))
    imap, cells = V.dofmap.index_map, V.dofmap.list
    corners = msh.geometry.x[geometry_dofmap(msh)][:, :, :gdim]
    x = np.zeros((imap.size_local + imap.num_ghosts, gdim))
    for dim, entities in enumerate(topology):
        for number, vertices in enumerate(entities):
            for dof in layout.entity_dofs(dim, number):
                x[cells[:, dof]] = corners[: len(cells), vertices].mean(axis=1)
    return x


def observe(rows: PointRows, directions: np.ndarray, vectors: list[PETSc.Vec], V) -> np.ndarray:
    """Components of displacement vectors at points. Collective.

    Args:
        rows: From `locate`.
        directions: Unit directions, shape (n, gdim).
        vectors: Vectors over ``V``, owned entries.
        V: The space.

    Returns:
        Shape (n, len(vectors)), equal on all ranks.
    """
    bs = V.dofmap.index_map_bs
    u = fem.Function(V)
    result = np.zeros((len(directions), len(vectors)))
    owned = V.dofmap.index_map.size_local * bs
    for column, vector in enumerate(vectors):
        u.x.array[:owned] = vector.array_r
        u.x.scatter_forward()
        block = u.x.array.reshape(-1, bs)[rows.nodes]
        at_points = np.einsum("pn,pni->pi", rows.values, block)
        result[rows.index, column] = np.einsum("pi,pi->p", at_points, directions[rows.index])
    V.mesh.comm.Allreduce(MPI.IN_PLACE, result)
    return result


#: Points nearer than this share of the extent of all are one.
_SAME = 1e-9


@dataclass(frozen=True)
class PlaceRows:
    """The whole displacement at points, so that any direction there can be read or loaded.

    Attributes:
        points: Positions, m, (k, gdim).
        rows: Displacement of every vector of the basis there, (k, gdim, n).
    """

    points: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    rows: np.ndarray = field(default_factory=lambda: np.zeros((0, 3, 0)))

    def has(self, sensors: Sensors) -> bool:
        """Whether all these sensors stand at the points."""
        return not np.any(self._index(sensors) < 0)

    def at(self, sensors: Sensors, what: str = "sensor") -> np.ndarray:
        """Components along the sensors' directions, (n_sensors, n).

        Raises:
            InputError: If a sensor stands at none of the points; ``what`` is its name there.
        """
        index = self._index(sensors)
        if np.any(index < 0):
            lost = sensors.points[int(np.argmax(index < 0))]
            raise InputError(
                f"{what} at {lost.tolist()} m: expected one of the {len(self.points)} places that "
                "the reduced model was made with, see ReducedStructure.arrays."
            )
        gdim = self.points.shape[1]
        return np.einsum("kgn,kg->kn", self.rows[index], sensors.directions[:, :gdim])

    def _index(self, sensors: Sensors) -> np.ndarray:
        """The point of each sensor, or -1, (n_sensors,)."""
        known = self.points
        if not len(known):
            return np.full(len(sensors), -1)
        apart = np.abs(sensors.points[:, None, : known.shape[1]] - known).max(axis=2)
        near = np.argmin(apart, axis=1)
        found = apart[np.arange(len(near)), near] <= _SAME * (1e-3 + np.ptp(known, axis=0).max())
        return np.where(found, near, -1)
