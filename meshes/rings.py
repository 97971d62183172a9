"""Bolts' rings in a mesh, measured: where they are, how thick, and between which parts."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import ufl
from dolfinx import fem

from fenics_joints._compat import facet_nodes, geometry_dofmap
from fenics_joints.errors import MeshError
from fenics_joints.meshes.tagged import TaggedMesh

#: Cosine by which the direction of a flat face may miss its normal, and a wall a right angle.
_FLAT = 1e-3
#: Share of a layer's faces towards parts that may be walls.
_WALLS = 0.02
#: By how much of its thickness a layer may be uneven, and rings of one joint may differ.
_EVEN = 1e-2


@dataclass(frozen=True)
class Ring:
    """A flat layer of cells between parts, such as a bolt's ring.

    Attributes:
        name: Name of its cells.
        centre: At mid-height, m, shape (3,): of the circle on which its outer corners lie, or
            else of its faces.
        normal: Unit normal, shape (3,).
        thickness: m.
        r_nei: Least distance of its walls from the axis, m; 0 if they are all at r_wai.
        r_wai: Largest, m.
        area: Of a face towards a part, m2.
        lower: Parts at its foot, against the normal.
        upper: Parts at its head.
    """

    name: str
    centre: np.ndarray
    normal: np.ndarray
    thickness: float
    r_nei: float
    r_wai: float
    area: float
    lower: tuple[str, ...]
    upper: tuple[str, ...]


def ring_names(names: Sequence[str]) -> list[str]:
    """Those of the names that are ``ring_1``, ``ring_2``, ..., by their number."""
    found = (re.fullmatch(r"ring_(\d+)", name) for name in names)
    numbers = {match[0]: int(match[1]) for match in found if match}
    return sorted(numbers, key=numbers.get)


def measure_ring(tagged: TaggedMesh, name: str, normal: Sequence[float] | None = None) -> Ring:
    """Measure a ring by its faces towards other parts. Collective.

    Args:
        tagged: A mesh in space.
        name: Name of the ring's cells.
        normal: The layer's normal, of any length; None: that of most of its faces.

    Raises:
        MeshError: There are no such cells; the ring touches no part, or on one side only; a face
            towards a part is not flat along the normal; or the thickness is uneven.
    """
    sides, areas, parts, walls = _skin(tagged, name)
    if not len(sides):
        raise MeshError(
            f"{name}: it touches no other part, expected one on each side "
            "(do the meshes share their vertices?)"
        )
    n = _normal(areas) if normal is None else np.asarray(normal, dtype=float)
    n = n / np.linalg.norm(n) + 0.0  # no negative zeros in messages
    cosine = np.abs(areas @ n) / np.linalg.norm(areas, axis=1)
    flat = cosine > 1 - _FLAT
    slanted = ~flat & (cosine > _FLAT)
    if slanted.any() or not flat.any():
        worst = np.degrees(np.arccos(np.clip(cosine[slanted if slanted.any() else ~flat][0], 0, 1)))
        raise MeshError(
            f"{name}: its face towards {parts[np.flatnonzero(~flat)[0]]!r} is {worst:.3g} degrees "
            f"off the normal ({', '.join(f'{c:.3g}' for c in n)}), expected a ring that is flat "
            "along its normal"
        )
    walls = np.concatenate([walls, sides[~flat].reshape(-1, 3)])
    sides, areas = sides[flat], areas[flat]
    parts = [part for part, is_flat in zip(parts, flat, strict=True) if is_flat]
    height = sides @ n
    low, high = float(height.min()), float(height.max())
    upper = height.mean(axis=1) > (low + high) / 2
    _check_sides(name, parts, upper, height, low, high, np.sqrt(np.abs(areas @ n).sum()))
    weights = np.abs(areas @ n)
    middle = _middle(sides, weights, upper, n)
    centre, distance = _axis(middle, n, np.concatenate([walls, sides.reshape(-1, 3)]))
    inner = _distances(walls, centre, n)
    r_wai = float(distance.max())
    r_nei = float(inner.min(initial=r_wai))
    here = {
        side: tuple(sorted({p for p, u in zip(parts, upper, strict=True) if u == side}))
        for side in (False, True)
    }
    return Ring(
        name,
        centre,
        n,
        high - low,
        r_nei if r_nei < 0.98 * r_wai else 0.0,
        r_wai,
        float(weights.sum() / 2),
        here[False],
        here[True],
    )


def layer_thickness(tagged: TaggedMesh, cells: Sequence[str], normal: Sequence[float]) -> float:
    """Thickness, m, that all rings of a joint have, along its normal. Collective.

    Args:
        tagged: A mesh in space.
        cells: Names of the rings' cells.
        normal: The layer's normal, of any length.

    Raises:
        MeshError: As `measure_ring`, or the rings differ by more than a hundredth.
    """
    rings = [measure_ring(tagged, name, normal) for name in cells]
    first = rings[0]
    for ring in rings:
        if set(ring.lower + ring.upper) & set(cells):
            raise MeshError(
                f"{ring.name}: it lies on {', '.join((set(ring.lower + ring.upper)) & set(cells))} "
                "of the same joint, expected rings side by side; or give the thickness as meshed"
            )
        if abs(ring.thickness / first.thickness - 1) > _EVEN:
            raise MeshError(
                f"{ring.name} is {1e3 * ring.thickness:.6g} mm thick, {first.name} "
                f"{1e3 * first.thickness:.6g} mm; expected one thickness, or a joint for each"
            )
    return first.thickness


def measure_layer(
    tagged: TaggedMesh, cells: Sequence[str], normal: Sequence[float] | None = None
) -> tuple[float, np.ndarray]:
    """Mean thickness of flat layers of cells, m, and their normal, shape (3,). Collective.

    Layers may lie in several planes; the thickness is their volume over their area.

    Args:
        tagged: A mesh in space.
        cells: Names of the layers' cells.
        normal: Their normal, of any length; None: that of most of their faces.

    Raises:
        MeshError: They touch no part, or are not flat along one normal.
    """
    found = [_skin(tagged, name) for name in cells]
    sides = [
        (area, cells_of)
        for _, areas, parts, _ in found
        for area, cells_of in zip(areas, parts, strict=True)
        if cells_of not in cells
    ]
    names = ", ".join(cells)
    if not sides:
        raise MeshError(f"{names}: it touches no other part, expected one on each side")
    areas = np.array([area for area, _ in sides])
    n = _normal(areas) if normal is None else np.asarray(normal, dtype=float)
    n = n / np.linalg.norm(n) + 0.0
    along = np.abs(areas @ n)
    cosine = along / np.linalg.norm(areas, axis=1)
    # Walls of a layer touch parts too, but a thin one's have hardly any area.
    off = ~(cosine > 1 - _FLAT)
    if np.linalg.norm(areas[off], axis=1).sum() > _WALLS * np.linalg.norm(areas, axis=1).sum():
        worst = np.degrees(np.arccos(np.clip(cosine.min(), 0, 1)))
        raise MeshError(
            f"{names}: its faces are up to {worst:.3g} degrees off the normal "
            f"({', '.join(f'{c:.3g}' for c in n)}), expected flat layers along one normal (a "
            "joint for each direction)"
        )
    own = tagged.mesh.topology.index_map(3).size_local
    here = np.sort(np.concatenate([tagged.cell_tags.find(tagged.cell_tag(n)) for n in cells]))
    # The cells as data of the form: one code for all layers.
    dx = ufl.Measure("dx", tagged.mesh, subdomain_data=[(1, here[here < own])])(1)
    volume = fem.assemble_scalar(fem.form(fem.Constant(tagged.mesh, 1.0) * dx))
    return float(2 * tagged.mesh.comm.allreduce(volume) / along[~off].sum()), n


def layer_normal(tagged: TaggedMesh, cells: Sequence[str]) -> tuple[float, ...]:
    """Normal of a straight layer of cells in the plane, shape (3,): across its corners' best line.

    Collective.
    """
    mesh = tagged.mesh
    found = np.concatenate([tagged.cell_tags.find(tagged.cell_tag(name)) for name in cells])
    corners = mesh.geometry.x[geometry_dofmap(mesh)[found]].reshape(-1, 3)[:, :2]
    # Each once: below each stands one above, so that the line is not tilted by a layer's thickness.
    corners = np.unique(np.concatenate(mesh.comm.allgather(corners)), axis=0)
    nx, ny = np.linalg.svd(corners - corners.mean(axis=0), full_matrices=False)[2][1]
    sign = np.sign(nx if abs(nx) > abs(ny) else ny)
    return float(sign * nx), float(sign * ny), 0.0


def check_normal(tagged: TaggedMesh, cells: Sequence[str], normal: Sequence[float]) -> None:
    """Refuse a normal that is not that of the parts ``ring_1``, ... among cells. Collective.

    Rings that are no flat layers have none.

    Raises:
        MeshError: A ring is flat along another direction.
    """
    n = np.asarray(normal, dtype=float)
    for name in ring_names(cells):
        try:
            ring = measure_ring(tagged, name)
        except MeshError:
            continue
        if abs(ring.normal @ n) < (1 - _FLAT) * np.linalg.norm(n):
            there, given = (", ".join(f"{c:.3g}" for c in v) for v in (ring.normal, n))
            raise MeshError(
                f"{name}: it is flat along ({there}), expected that as the normal, not ({given})"
            )


def ring_centres(tagged: TaggedMesh) -> np.ndarray | None:
    """Centres, m, shape (n, 3), of the parts ``ring_1``, ...; None if there are none. Collective.

    Rings that are no flat layers have the mean of their faces there.
    """
    found = []
    for name in ring_names(list(tagged.cell_names)):
        try:
            found.append(measure_ring(tagged, name).centre)
        except MeshError:
            sides, areas, _, walls = _skin(tagged, name)
            corners = np.concatenate([sides.reshape(-1, 3), walls])
            found.append(corners.mean(axis=0))
    return np.array(found) if found else None


def _check_sides(name, parts, upper, height, low, high, size) -> None:
    thickness = high - low
    if upper.all() or not upper.any() or thickness < 1e-9 * size:
        raise MeshError(
            f"{name}: it touches {', '.join(sorted(set(parts)))} on one side only, expected a part "
            "on each side (do the two meshes share their vertices?)"
        )
    uneven = np.abs(height - np.where(upper, high, low)[:, None]).max()
    if uneven > _EVEN * thickness:
        raise MeshError(
            f"{name}: its faces are {1e3 * uneven:.3g} mm uneven at a thickness of "
            f"{1e3 * thickness:.6g} mm, expected a flat layer of one thickness"
        )


def _normal(areas: np.ndarray) -> np.ndarray:
    """Direction of most of the area; the first of its components that counts is positive."""
    weighted = areas / np.sqrt(np.linalg.norm(areas, axis=1))[:, None]
    n = np.linalg.svd(weighted, full_matrices=False)[2][0]
    return n * np.sign(n[np.abs(n) > 0.5][0])


def _middle(sides, weights, upper, n) -> np.ndarray:
    """Mean of the centroids of the two faces."""
    middles = sides.mean(axis=1)
    return np.mean(
        [np.average(middles[side], axis=0, weights=weights[side]) for side in (upper, ~upper)],
        axis=0,
    )


def _distances(x: np.ndarray, centre: np.ndarray, n: np.ndarray) -> np.ndarray:
    away = x - centre
    return np.linalg.norm(away - np.outer(away @ n, n), axis=1)


def _axis(middle, n, corners) -> tuple[np.ndarray, np.ndarray]:
    """Centre of the circle of the outermost corners, or else ``middle``; distances from there."""
    basis = np.linalg.svd(n[None])[2][1:]
    away = _distances(corners, middle, n)
    flat = (corners - middle) @ basis.T
    outer = flat[away > 0.9 * away.max()]
    # |x - c|^2 = r^2 is linear in c and r^2 - |c|^2.
    system = np.column_stack([2 * outer, np.ones(len(outer))])
    (*c, _), *_ = np.linalg.lstsq(system, (outer**2).sum(axis=1), rcond=None)
    radii = np.linalg.norm(outer - c, axis=1)
    if np.ptp(radii) < 1e-3 * radii.max():
        middle = middle + np.array(c) @ basis
        away = _distances(corners, middle, n)
    return middle, away


def _skin(tagged: TaggedMesh, name: str):
    """Facets towards other parts, their area vectors and those parts' names; and other corners.

    Returns:
        Corners of the facets, shape (n, 3 or 4, 3); area vectors, shape (n, 3); names, one for
        each; corners of facets on the surface, shape (m, 3). The same on all ranks.
    """
    mesh, tdim = tagged.mesh, tagged.mesh.topology.dim
    if mesh.geometry.dim != 3 or tdim != 3:
        raise MeshError(f"{name}: the mesh is {mesh.geometry.dim}-D, expected rings in space")
    tag, fdim = tagged.cell_tag(name), tdim - 1
    mesh.topology.create_connectivity(tdim, fdim)
    mesh.topology.create_connectivity(fdim, tdim)
    facets_of = mesh.topology.connectivity(tdim, fdim)
    cells_of = mesh.topology.connectivity(fdim, tdim)
    imap = mesh.topology.index_map(tdim)
    of_cell = np.full(imap.size_local + imap.num_ghosts, -1)
    of_cell[tagged.cell_tags.indices] = tagged.cell_tags.values
    facets, neighbours = [], []
    for cell in np.flatnonzero(of_cell[: imap.size_local] == tag):
        for facet in facets_of.links(cell):
            other = [of_cell[c] for c in cells_of.links(facet) if c != cell]
            if not other or other[0] != tag:
                facets.append(facet)
                neighbours.append(other[0] if other else -1)
    x = _corners(mesh, np.array(facets, dtype=np.int32))
    gathered = mesh.comm.allgather((x, np.array(neighbours, dtype=np.int64)))
    x = np.concatenate([x for x, _ in gathered if len(x)])
    neighbour = np.concatenate([n for _, n in gathered])
    inside = neighbour >= 0
    names = {value: part for part, value in tagged.cell_names.items()}
    # Corners are in DOLFINx's order: the diagonals of a quadrilateral are 0-3 and 1-2.
    last = x.shape[1] - 1
    areas = np.cross(x[:, last] - x[:, 0], x[:, 2] - x[:, 1]) / 2
    parts = [names[int(value)] for value in neighbour[inside]]
    return x[inside], areas[inside], parts, x[~inside].reshape(-1, 3)


def _corners(mesh, facets: np.ndarray) -> np.ndarray:
    return mesh.geometry.x[facet_nodes(mesh, facets)]
