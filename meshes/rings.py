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
from fenics_joints.meshes.grow import area_vectors, fit_circle
from fenics_joints.meshes.tagged import TaggedMesh

#: One less the cosine of the angle of a flat face with its normal (2.6 degrees), and cosine of that
#: of a wall (0.06 degrees off a right angle). Chosen: drawings are exact, meshes nearly.
_FLAT = 1e-3
#: Share of a layer's faces towards parts that may be walls. Chosen: those of a thin layer are less.
_WALLS = 0.02
#: Share of its thickness by which a layer may be uneven, or rings of one joint may differ. Chosen:
#: a law's stiffness is in proportion to it, and known less well.
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
    """The names ``ring_1``, ``ring_2``, ... among others, by their number."""
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
    sides, areas, parts, walls = _outline(tagged, name)
    if not len(sides):
        raise MeshError(
            f"{name}: it touches no other part, expected one on each side "
            "(do the meshes share their vertices?)"
        )
    n = _unit(normal, areas)
    along = np.abs(areas @ n)
    cosine = along / np.linalg.norm(areas, axis=1)
    flat = cosine > 1 - _FLAT
    slanted = ~flat & (cosine > _FLAT)
    if slanted.any() or not flat.any():
        worst = np.flatnonzero(slanted if slanted.any() else ~flat)[0]
        raise MeshError(
            f"{name}: its face towards {parts[worst]!r} is {_degrees(cosine[worst])} degrees off "
            f"the normal {_shown(n)}, expected a ring that is flat along its normal"
        )
    walls = np.concatenate([walls, sides[~flat].reshape(-1, 3)])
    sides, along, parts = sides[flat], along[flat], parts[flat]
    height = sides @ n
    low, high = float(height.min()), float(height.max())
    upper = height.mean(axis=1) > (low + high) / 2
    thickness, size = high - low, np.sqrt(along.sum())
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
    ends = [
        np.average(sides[own].mean(axis=1), axis=0, weights=along[own]) for own in (upper, ~upper)
    ]
    corners = np.concatenate([walls, sides.reshape(-1, 3)])
    centre, distance = _axis(np.mean(ends, axis=0), n, corners)
    r_wai, r_nei = float(distance.max()), float(distance[: len(walls)].min(initial=np.inf))
    return Ring(
        name,
        centre,
        n,
        thickness,
        r_nei if r_nei < 0.98 * r_wai else 0.0,
        r_wai,
        float(along.sum() / 2),
        tuple(sorted(set(parts[~upper]))),
        tuple(sorted(set(parts[upper]))),
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
        if own := set(ring.lower + ring.upper) & set(cells):
            raise MeshError(
                f"{ring.name}: it lies on {', '.join(own)} of the same joint, expected rings side "
                "by side; or give the thickness as meshed"
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
    found = [_outline(tagged, name) for name in cells]
    areas = np.vstack([areas[~np.isin(parts, cells)] for _, areas, parts, _ in found])
    names = ", ".join(cells)
    if not len(areas):
        raise MeshError(f"{names}: it touches no other part, expected one on each side")
    n, size = _unit(normal, areas), np.linalg.norm(areas, axis=1)
    along = np.abs(areas @ n)
    # Walls of a layer touch parts too, but a thin one's have hardly any area.
    off = ~(along / size > 1 - _FLAT)
    if size[off].sum() > _WALLS * size.sum():
        raise MeshError(
            f"{names}: its faces are up to {_degrees((along / size).min())} degrees off the normal "
            f"{_shown(n)}, expected flat layers along one normal (a joint for each direction)"
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
        ring = _flat_ring(tagged, name)
        if ring is not None and abs(ring.normal @ n) < (1 - _FLAT) * np.linalg.norm(n):
            raise MeshError(
                f"{name}: it is flat along {_shown(ring.normal)}, expected that as the normal, not "
                f"{_shown(n)}"
            )


def ring_centres(tagged: TaggedMesh) -> np.ndarray | None:
    """Centres, m, shape (n, 3), of the parts ``ring_1``, ...; None if there are none. Collective.

    Rings that are no flat layers have the mean of their faces there.
    """
    found = []
    for name in ring_names(list(tagged.cell_names)):
        ring = _flat_ring(tagged, name)
        if ring is None:
            sides, _, _, walls = _outline(tagged, name)
            found.append(np.concatenate([sides.reshape(-1, 3), walls]).mean(axis=0))
        else:
            found.append(ring.centre)
    return np.array(found) if found else None


def _flat_ring(tagged: TaggedMesh, name: str) -> Ring | None:
    """A ring; None if it is no flat layer."""
    try:
        return measure_ring(tagged, name)
    except MeshError:
        return None


def _shown(n: np.ndarray) -> str:
    return f"({', '.join(f'{c:.3g}' for c in n)})"


def _degrees(cosine: float) -> str:
    return f"{np.degrees(np.arccos(np.clip(cosine, 0, 1))):.3g}"


def _unit(normal: Sequence[float] | None, areas: np.ndarray) -> np.ndarray:
    """A normal, of length 1; by default that of most of the area, its first large component > 0."""
    if normal is None:
        weighted = areas / np.sqrt(np.linalg.norm(areas, axis=1))[:, None]
        normal = np.linalg.svd(weighted, full_matrices=False)[2][0]
        normal = normal * np.sign(normal[np.abs(normal) > 0.5][0])
    return np.asarray(normal, dtype=float) / np.linalg.norm(normal) + 0.0  # without -0.0


def _axis(middle, n, corners) -> tuple[np.ndarray, np.ndarray]:
    """Centre of the circle of the outermost corners, or else ``middle``; distances from there."""

    def distances(centre):
        away = corners - centre
        return np.linalg.norm(away - np.outer(away @ n, n), axis=1)

    away = distances(middle)
    outer = corners[away > 0.9 * away.max()]
    flat = outer - np.outer((outer - middle) @ n, n)
    centre, radii = fit_circle(flat, n)
    return (centre, distances(centre)) if np.ptp(radii) < 1e-3 * radii.max() else (middle, away)


def _outline(tagged: TaggedMesh, name: str):
    """Facets towards other parts, their area vectors and those parts' names; and other corners.

    Returns:
        Corners of the facets, shape (n, 3 or 4, 3); area vectors, shape (n, 3); names, shape (n,);
        corners of facets on the surface, shape (m, 3). The same on all ranks.
    """
    mesh, tdim = tagged.mesh, tagged.mesh.topology.dim
    if mesh.geometry.dim != 3 or tdim != 3:
        raise MeshError(f"{name}: the mesh is {mesh.geometry.dim}-D, expected rings in space")
    tag, cells = tagged.cell_tag(name), mesh.topology.index_map(tdim)
    mesh.topology.create_connectivity(tdim, tdim - 1)
    mesh.topology.create_connectivity(tdim - 1, tdim)
    facets_of = mesh.topology.connectivity(tdim, tdim - 1)
    cells_of = mesh.topology.connectivity(tdim - 1, tdim)
    of_cell = np.full(cells.size_local + cells.num_ghosts, -1)
    of_cell[tagged.cell_tags.indices] = tagged.cell_tags.values
    own = np.flatnonzero(of_cell[: cells.size_local] == tag)
    n_facets = len(facets_of.array) // len(of_cell) if len(of_cell) else 0
    facets = facets_of.array.reshape(len(of_cell), n_facets)[own].ravel()
    own = own.repeat(n_facets)
    # Of one cell or two: the first and the last of its cells are all of them.
    first, last = cells_of.array[cells_of.offsets[facets]], cells_of.offsets[facets + 1] - 1
    other = np.where(first == own, cells_of.array[last], first)
    neighbour = np.where(other == own, -1, of_cell[other])
    for tie in tagged.ties:
        tied = np.isin(facets, tagged.facet_tags.find(tagged.facet_tag(tie.face)))
        neighbour[tied] = tagged.cell_tag(tie.part)
    outer = neighbour != tag
    x = mesh.geometry.x[facet_nodes(mesh, facets[outer].astype(np.int32))]
    gathered = mesh.comm.allgather((x, neighbour[outer]))
    x = np.concatenate([x for x, _ in gathered if len(x)])
    neighbour = np.concatenate([n for _, n in gathered])
    inside = neighbour >= 0
    names = {value: part for part, value in tagged.cell_names.items()}
    parts = np.array([names[value] for value in neighbour[inside].tolist()], dtype=object)
    return x[inside], area_vectors(x[inside]), parts, x[~inside].reshape(-1, 3)
