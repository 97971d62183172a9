"""Joint layers for a mesh that has none: one cell thick, grown where its parts touch.

The faces of the two parts stay where they are but for half the layer's thickness, a ten-thousandth
of the smallest part: nothing is moved that anyone would measure. With a law that is a stiffness
per area (`fenics_joints.structure.laws.SPRINGS`) such a layer is a spring of zero thickness, see
`fenics_joints.forms.thin_layer`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fenics_joints.errors import MeshError
from fenics_joints.meshes.arguments import is_positive, requirement
from fenics_joints.meshes.cad_layer import OF_EDGE, prisms_to_tetrahedra, thin_layer
from fenics_joints.meshes.separate import separate
from fenics_joints.meshes.skin import FACETS, add_faces, row_numbers
from fenics_joints.meshes.tagged import MeshLists
from fenics_joints.meshes.touching import (
    Touch,
    glued,
    round_holes,
    said_pairs,
    shortest_edge,
    touches,
)

#: Most thickness of a layer as a share of the smallest extent of the parts.
_MOST = 5e-2


@dataclass(frozen=True)
class RingPlaces:
    """Where rings round bolts are to be.

    Attributes:
        r_wai: Outer radius, m, one or one for each bolt that is given.
        r_nei: Inner radius, m.
        at: Points on the bolts' axes, m, shape (n, 3); None: in all round holes.
        hole: Least and largest diameter of these, m; None: any below 2 ``r_wai``.
    """

    r_wai: Sequence[float]
    r_nei: float = 0.0
    at: np.ndarray | None = None
    hole: tuple[float, float] | None = None

    def __post_init__(self):
        require, radii = requirement("grow"), np.atleast_1d(np.asarray(self.r_wai, dtype=object))
        fits = radii.ndim == 1 and len(radii) and all(map(is_positive, radii))
        require(bool(fits), "r_wai", self.r_wai, "the outer radius of the rings, above 0 m")
        n = 1 if self.at is None else len(self.at)
        require(len(radii) in (1, n), "r_wai", self.r_wai, f"one radius, or {n}")
        fits = self.r_nei == 0 or is_positive(self.r_nei)
        require(fits and self.r_nei < min(radii), "r_nei", self.r_nei, "a radius below r_wai")


@dataclass(frozen=True)
class Grown:
    """What is to be grown.

    Attributes:
        joint: ``"layer"`` on all that touches, ``"rings"`` round bolts, or ``"contact"``: none,
            but separate parts whose faces match vertex by vertex.
        thickness: Of the layers, m; None: a ten-thousandth of the smallest extent of a part.
        rings: Where the rings are.
        bonded: Pairs of parts that stay one body where they touch.
        between: Pairs of parts that are joined; None: all that touch.

    Raises:
        MeshError: A value makes no sense.
    """

    joint: str
    thickness: float | None = None
    rings: RingPlaces | None = None
    bonded: Sequence[tuple[str, str]] = ()
    between: Sequence[tuple[str, str]] | None = None

    def __post_init__(self):
        require, kinds = requirement("grow"), ("layer", "rings", "contact")
        require(self.joint in kinds, "joint", self.joint, " or ".join(map(repr, kinds)))
        fits = self.thickness is None or is_positive(self.thickness)
        require(fits, "thickness", self.thickness, "a thickness above 0 m, or None")
        fits = isinstance(self.rings, RingPlaces) or self.joint != "rings"
        require(fits, "rings", self.rings, "RingPlaces with joint = 'rings'")


def grow(lists: MeshLists, wanted: Grown) -> MeshLists:
    """Part a mesh where its parts touch, and grow layers of cells in between.

    Parts touch where they share vertices or have vertices at one place. New parts: ``joint``, or
    ``joint_1``, ... where there are several contacts, flat or smooth; or ``ring_1``, ..., the
    facets whose middle is within a ring. New faces, of facets that have no name: ``joint_lower``
    and ``joint_upper`` between layers and parts, and ``A_to_B`` and ``B_to_A`` where parts A and B
    touch with no layer. ``notes`` of the mesh say what was done.

    Raises:
        MeshError: No parts touch vertex by vertex, a part is unknown, a bolt is on no contact or
            has no facets, or the layer is too thick for the mesh.
    """
    if not len(lists.facets):  # of whatever shape, without any
        corners = FACETS[lists.cell].shape[1]
        lists = replace(lists, facets=np.empty((0, corners), np.int64))
    whole = glued(lists)
    _check_pairs(whole, wanted)
    found = touches(whole, wanted.bonded)
    if not found:
        raise MeshError(
            f"no two of the parts {', '.join(map(repr, whole.cell_names))} touch with vertices at "
            "the same places, expected faces whose meshes match (in gmsh: fragment the solids, or "
            "Coherence, before meshing)"
        )
    parted = separate(whole, _bodies(whole, wanted.bonded), {})
    layers, centres, notes = _layers(whole, found, wanted)
    seam = _Seam(whole, parted)
    sides = {name: seam.sides(touch.pick(rows)) for name, (touch, rows) in layers.items()}
    size = _thickness(whole, wanted, found) if layers else 0.0
    x = _opened(parted.x, seam, layers, size)
    grown = _filled(replace(parted, x=x), sides)
    grown = _named_faces(grown, seam, found, layers, sides)
    if centres is not None:
        grown = replace(grown, points={**grown.points, "bolts": centres})
    return replace(grown, notes=(*grown.notes, *_said(layers, size), *notes))


def _check_pairs(lists: MeshLists, wanted: Grown) -> None:
    for key in ("bonded", "between"):
        for pair in getattr(wanted, key) or ():
            known = set(pair) <= set(lists.cell_names)
            if len(pair) != 2 or pair[0] == pair[1] or not known:
                there = ", ".join(lists.cell_names)
                raise MeshError(f"{key} has {list(pair)}, expected two of the parts: {there}")


def _bodies(lists: MeshLists, bonded) -> list[tuple[str, ...]]:
    """The parts of each body."""
    used = set(np.unique(lists.cell_values).tolist())
    groups = [{name} for name, tag in lists.cell_names.items() if tag in used]
    for pair in bonded:
        joined = [g for g in groups if g & set(pair)]
        groups = [g for g in groups if g not in joined] + [set().union(*joined)]
    order = list(lists.cell_names)
    groups = [tuple(sorted(group, key=order.index)) for group in groups]
    return sorted(groups, key=lambda group: order.index(group[0]))


def _thickness(lists: MeshLists, wanted: Grown, found: Sequence[Touch]) -> float:
    names = {part for touch in found for part in touch.parts}
    extents = [
        np.ptp(lists.x[lists.cells[lists.cell_values == lists.cell_names[name]]], axis=(0, 1)).min()
        for name in names
    ]
    smallest, edge = float(min(extents)), shortest_edge(lists)
    if wanted.thickness is None:
        return thin_layer(smallest, edge)
    most = min(_MOST * smallest, OF_EDGE * edge)
    if wanted.thickness > most:
        raise MeshError(
            f"layer is {1e3 * wanted.thickness:g} mm, which is grown into the parts, half into "
            f"each: expected at most {1e3 * most:.3g} mm in this mesh, or none given (the "
            "stiffness of a joint need not know the thickness: law = 'springs')"
        )
    return wanted.thickness


class _Seam:
    """Vertices of the parted mesh on facets of the glued one."""

    def __init__(self, whole: MeshLists, parted: MeshLists):
        self.whole, self.parted, self.corners = whole, parted, FACETS[whole.cell]

    def sides(self, touch: Touch) -> tuple[np.ndarray, np.ndarray]:
        """Vertices of each facet as the first part has them, and opposite as the second."""
        lower = self.parted.cells[touch.cells[:, :1], self.corners[touch.sides[:, 0]]]
        here = self.whole.cells[touch.cells[:, 1:], self.corners[touch.sides[:, 1]]]
        there = self.parted.cells[touch.cells[:, 1:], self.corners[touch.sides[:, 1]]]
        back = np.argsort(np.argsort(touch.facets, axis=1), axis=1)
        order = np.take_along_axis(np.argsort(here, axis=1), back, axis=1)
        return lower, np.take_along_axis(there, order, axis=1)


def _layers(lists: MeshLists, found: list[Touch], wanted: Grown):
    """Facets to be filled: their contact and its rows, by the layer's name; centres and notes."""
    if wanted.between is not None:
        pairs = {frozenset(pair) for pair in wanted.between}
        for pair in wanted.between:
            if not any(set(t.parts) == set(pair) for t in found):
                raise MeshError(
                    f"between: {pair[0]!r} and {pair[1]!r} do not touch, expected two of: "
                    f"{said_pairs(found)}"
                )
        found = [t for t in found if frozenset(t.parts) in pairs]
    if wanted.joint == "contact":
        return {}, None, []
    if wanted.joint == "layer":
        names = ["joint"] if len(found) == 1 else [f"joint_{i + 1}" for i in range(len(found))]
        rows = {n: (t, np.arange(len(t.areas))) for n, t in zip(names, found, strict=True)}
        return rows, None, []
    return _rings(lists, found, wanted)


def _rings(lists: MeshLists, found: list[Touch], wanted: Grown):
    if lists.x.shape[1] != 3:
        raise MeshError("joint = 'rings': the mesh is in the plane, expected one in space")
    rings = wanted.rings
    bolts = (_seen if rings.at is None else _given)(lists.x, found, rings)
    layers, taken, notes = {}, {}, []
    for number, (touch, centre, r_nei, r_wai, hole) in enumerate(bolts, start=1):
        away = touch.middles - centre
        away = away - np.outer(away @ touch.normal, touch.normal)
        distance = np.linalg.norm(away, axis=1)
        rows = np.flatnonzero((distance < r_wai) & (distance > r_nei))
        at = f"bolt {number} at ({', '.join(f'{1e3 * c:.6g}' for c in centre)}) mm"
        if len(rows) < 3:
            raise MeshError(
                f"{at}: {len(rows)} facets of the mesh have their middle between {1e3 * r_nei:g} "
                f"and {1e3 * r_wai:g} mm from its axis, expected at least 3: a finer mesh there, "
                "or a larger r_wai"
            )
        for row in rows:
            if taken.setdefault((id(touch), row), number) != number:
                raise MeshError(
                    f"{at}: its ring of {1e3 * r_wai:g} mm overlaps that of bolt "
                    f"{taken[id(touch), row]}, expected a smaller r_wai"
                )
        area, circle = touch.areas[rows].sum(), np.pi * (r_wai**2 - max(r_nei, hole) ** 2)
        layers[f"ring_{number}"] = touch, rows
        notes.append(
            f"ring_{number} is {len(rows)} facets of the mesh whose middles are within "
            f"{1e3 * r_wai:.3g} mm of ({', '.join(f'{1e3 * c:.4g}' for c in centre)}) mm: their "
            f"area is {100 * area / circle:.0f} % of the round ring's"
        )
    return layers, np.array([bolt[1] for bolt in bolts]), notes


def _seen(x: np.ndarray, found: list[Touch], rings: RingPlaces):
    """Bolts in the round holes of the contacts."""
    low, high = rings.hole or (0.0, 2 * rings.r_wai[0])
    holes = [(t, h) for t in found for h in round_holes(x, t)]
    bolts = [
        (t, h.centre, rings.r_nei, rings.r_wai[0], h.radius)
        for t, h in holes
        if low * 0.98 <= 2 * h.radius <= high * 1.02
    ]
    if not bolts:
        there = "; ".join(
            f"{2e3 * h.radius:.4g} mm at ({', '.join(f'{1e3 * c:.5g}' for c in h.centre)}) mm"
            for _, h in holes
        )
        raise MeshError(
            f"no bolt: expected round holes of {1e3 * low:g} to {1e3 * high:g} mm in flat faces "
            f"that touch; there are: {there or 'none'}"
        )
    return bolts


def _given(x: np.ndarray, found: list[Touch], rings: RingPlaces):
    """Bolts at given points, each on the contact with most area round it."""
    bolts = []
    radii = np.broadcast_to(np.asarray(rings.r_wai, dtype=float), len(rings.at))
    for number, (point, r_wai) in enumerate(zip(rings.at, radii, strict=True), start=1):
        best, most = None, 0.0
        for touch in (t for t in found if t.is_flat):
            away = touch.middles - point
            height = away @ touch.normal
            near = np.linalg.norm(away - np.outer(height, touch.normal), axis=1) < r_wai
            area = touch.areas[near & (np.abs(height) < r_wai)].sum()
            if area > most:
                best, most = touch, area
        if best is None:
            at = ", ".join(f"{1e3 * c:.6g}" for c in point)
            raise MeshError(
                f"bolt {number} at ({at}) mm: no two flat faces touch within {1e3 * r_wai:g} mm, "
                f"expected those of: {said_pairs(found)} (in which unit is it given?)"
            )
        n = best.normal
        centre = point - ((point - best.middles[0]) @ n) * n
        near = [h.radius for h in round_holes(x, best) if math.dist(h.centre, centre) < h.radius]
        bolts.append((best, centre, rings.r_nei, float(r_wai), max(near, default=0.0)))
    return bolts


def _opened(x: np.ndarray, seam: _Seam, layers, size: float) -> np.ndarray:
    """Vertices with the two sides of filled facets moved apart, half the thickness each."""
    moves = np.zeros_like(x)
    contacts = {id(touch): touch for touch, _ in layers.values()}
    for touch in contacts.values():
        # All rings of a contact together, as they may share vertices.
        rows = np.concatenate([rows for other, rows in layers.values() if other is touch])
        normals = np.broadcast_to(touch.normal, touch.normals.shape) if touch.is_flat else None
        picked = touch.pick(np.unique(rows))
        weighted = (picked.normals if normals is None else normals[: len(picked.areas)]).copy()
        weighted *= picked.areas[:, None]
        for corners, way in zip(seam.sides(picked), (-0.5, 0.5), strict=True):
            nodes, local = np.unique(corners, return_inverse=True)
            total = np.zeros((len(nodes), x.shape[1]))
            np.add.at(total, local.ravel(), weighted.repeat(corners.shape[1], axis=0))
            moves[nodes] += way * size * total / np.linalg.norm(total, axis=1)[:, None]
    return x + moves


def _filled(lists: MeshLists, sides: Mapping[str, tuple]) -> MeshLists:
    """The mesh with a layer of cells between the sides of each name."""
    names = dict(lists.cell_names)
    cells, values = [lists.cells], [lists.cell_values]
    for name, (lower, upper) in sides.items():
        if name in names:
            raise MeshError(
                f"the mesh has a part {name!r} already, which is the name of a new layer; expected "
                "another name, or no joint for [mesh]"
            )
        names[name] = max(names.values()) + 1
        cells.append(_turned(lists, _cells(lists.cell, lower, upper)))
        values.append(np.full(len(cells[-1]), names[name], dtype=lists.cell_values.dtype))
    return replace(
        lists, cells=np.vstack(cells), cell_values=np.concatenate(values), cell_names=names
    )


def _cells(cell: str, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    if cell == "tetrahedron":
        return prisms_to_tetrahedra(lower, upper, lower)
    if cell == "triangle":
        (a, b), (c, d) = lower.T, upper.T
        return np.vstack([np.column_stack([a, b, d]), np.column_stack([a, c, d])])
    return np.hstack([lower, upper])


def _turned(lists: MeshLists, cells: np.ndarray) -> np.ndarray:
    """The same cells, all with a positive volume."""
    flips = {
        "tetrahedron": ((1, 2, 3), [0, 1, 3, 2]),
        "triangle": ((1, 2), [0, 2, 1]),
        "quadrilateral": ((1, 2), [1, 0, 3, 2]),
        "hexahedron": ((1, 2, 4), [1, 0, 3, 2, 5, 4, 7, 6]),
    }
    ends, flip = flips[lists.cell]
    x = lists.x[cells]
    inside_out = np.linalg.det(x[:, list(ends)] - x[:, :1]) < 0
    cells = cells.copy()
    cells[inside_out] = cells[inside_out][:, flip]
    return cells


def _named_faces(lists: MeshLists, seam: _Seam, found, layers, sides) -> MeshLists:
    """Names for the facets between layers and parts, and for those of contacts with no layer."""
    faces: dict[str, list[np.ndarray]] = {}
    for lower, upper in sides.values():
        faces.setdefault("joint_lower", []).append(lower)
        faces.setdefault("joint_upper", []).append(upper)
    for touch in found:
        filled = [rows for t, rows in layers.values() if t is touch]
        bare = np.setdiff1d(np.arange(len(touch.areas)), np.concatenate([[], *filled]))
        if len(bare):
            (a, b), (lower, upper) = touch.parts, seam.sides(touch.pick(bare))
            faces.setdefault(f"{a}_to_{b}", []).append(lower)
            faces.setdefault(f"{b}_to_{a}", []).append(upper)
    new = {}
    for name, found_facets in faces.items():
        facets = np.vstack(found_facets)
        numbers = row_numbers(np.vstack([facets, lists.facets.reshape(-1, facets.shape[1])]))
        free = ~np.isin(numbers[: len(facets)], numbers[len(facets) :])
        if free.any():
            new[name] = facets[free]
    return add_faces(lists, new)


def _extent(area: float, touch: Touch) -> str:
    """An area, or in the plane a length, in words."""
    return f"{1e6 * area:.4g} mm2" if touch.middles.shape[1] == 3 else f"{1e3 * area:.4g} mm"


def _said(layers, size: float) -> list[str]:
    if not layers:
        return []
    names = list(layers)
    pairs = "; ".join(
        f"{name} between {t.parts[0]} and {t.parts[1]}, {_extent(t.areas[rows].sum(), t)}"
        for name, (t, rows) in list(layers.items())[:12]
    )
    more = f"; and {len(names) - 12} more" if len(names) > 12 else ""
    return [
        f"the mesh had no layer where its parts touch: one of {1e6 * size:.3g} um was grown, half "
        f"into each part ({pairs}{more})"
    ]
