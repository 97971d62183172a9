"""Points beside a mesh: the nearest place on it, and what may be wrong with those that are far."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
from dolfinx import geometry
from mpi4py import MPI
from scipy.spatial.distance import pdist

from fenics_joints._compat import geometry_dofmap
from fenics_joints.errors import InputError, MeshError
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


def nearest(msh, points: np.ndarray) -> Nearest:
    """The nearest places on a mesh with straight-sided cells. Collective.

    Args:
        msh: The mesh.
        points: m, shape (n, 3).
    """
    comm, tdim, n = msh.comm, msh.topology.dim, len(points)
    points = np.ascontiguousarray(points, dtype=msh.geometry.x.dtype)
    owned = np.arange(msh.topology.index_map(tdim).size_local, dtype=np.int32)
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


def round_bolts(tagged: TaggedMesh, points: np.ndarray, n: int = 8) -> list[np.ndarray | None]:
    """Places on the ring around the empty bolt hole in which a point lies. Collective.

    Args:
        tagged: A mesh.
        points: m, shape (n_points, 3).
        n: Number of places.

    Returns:
        For each point the places, halfway through the ring, m, shape (n, 3), with their mean on
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
        turn = 2 * np.pi * (np.arange(n)[:, None] + 0.5) / n
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
        return InputError(f"{what} {said[0]}: {within}{reach}{hint}.")
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
    """What would bring all points onto the mesh: turned or exchanged axes, or another unit.

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
