"""Two equal dumbbell halves joined by a layer, or by rings of it around bolts (Machines 2022)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import numpy as np

from fenics_joints.meshes.arguments import (
    Builder,
    Count,
    Demand,
    Places,
    Size,
    Solid,
    check_squares,
    lengths,
    made_by,
)
from fenics_joints.meshes.facets import Skin, name_between
from fenics_joints.meshes.grid import PlaneGrid, count_intervals, extruded, grid_lines
from fenics_joints.meshes.tagged import MeshLists

FACES = ("end_1", "end_2", "joint_lower", "joint_upper")
BODIES = ("head_1", "neck_1", "neck_2", "head_2")

Sides = Annotated[
    tuple[Size, Size, Size],
    Demand(lambda v: lengths(v, 3), "three lengths above 0 m, along x, y and z"),
]


def with_joint_faces(
    lists: MeshLists, below: str, above: str, ends: Mapping[str, float]
) -> MeshLists:
    """The mesh with faces between two parts and the layer or rings between them, and its ends.

    Args:
        lists: The mesh, all of whose other parts than the bodies are layers.
        below: The part below the layers.
        above: That above.
        ends: Heights of the flat outer faces, by their names, m.
    """
    skin, layers = Skin(lists), [n for n in lists.cell_names if n.startswith(("joint", "ring_"))]
    lists = skin.named({name: skin.at(2, height) for name, height in ends.items()})
    faces = {"joint_lower": (below, *layers), "joint_upper": (above, *layers)}
    return name_between(lists, faces)


@dataclass(frozen=True, kw_only=True)
class Dumbbell(Builder):
    """Two blocks with a neck each, neck to neck with a joint layer between.

    The defaults are the specimen of Machines 2022, section 4.3 (Figure 11): its heads, 240 x 180
    mm, necks, 120 x 63 mm, and layer are printed, and that the contact is on all of the necks'
    faces, so that the joint is the whole layer. The heads' thickness and the necks' length were
    in a lost figure: they are reconstructed, by a fit to the frequencies that the paper computed
    (Table 9). With the default cells it gives 90.0 and 40.0 mm, which leave 0.8 % (root mean
    square); with cells of 20 mm 91.0 and 38.0 mm. The dumbbells of section 4.2 (Figure 9, lost too)
    are taken as the same blocks with ``layer=0.01``.

    Body 1 lies below z = 0, its neck up; the layer from 0 to ``layer``; body 2 above, its neck
    down. All are centred on x = y = 0, the long sides along x. With ``rings``, the layer is only
    there between the radii R_nei and R_wai around each of these points, as a polygon whose corners
    lie on the circles, and the necks are apart elsewhere.

    Parts: ``head_1``, ``neck_1``, ``neck_2``, ``head_2``, and ``joint`` or with rings ``ring_1``,
    ``ring_2``, ... Faces: ``end_1`` and ``end_2`` (the heads' outer faces), ``joint_lower`` and
    ``joint_upper`` (between the layer or all rings and neck 1, neck 2). Points: ``bolts``, the
    rings' centres at mid-height.

    Attributes:
        head: Length along x, y and z of each head, in metres.
        neck: Length along x, y and z of each neck, in metres; x and y less than the head's.
        layer: Thickness of the joint layer, in metres.
        element_size: Longest side of an element, in metres; along a ring's square at most a quarter
            of its side.
        n_layer: Elements through the layer.
        rings: Centres (x, y) of the bolts, in metres; none for a layer on the necks' whole faces.
        r_nei: Inner radius of the rings, in metres; by default that of an M16's hole (ISO 273).
        r_wai: Outer radius of the rings, in metres; needed with rings.
        zone: Side of the square of the O-grid around each ring, in metres; None: 2.3 r_wai.
        holes: Whether holes of radius R_nei go through the bodies; they are full otherwise.
        cell: ``"hexahedron"``, or ``"tetrahedron"`` for six of those in each hexahedron.

    Raises:
        MeshError: A dimension or count is impossible, or a ring's square leaves the neck or meets
            another; the message names the argument, its value and what was expected.
    """

    function: ClassVar[str] = "dumbbell"

    head: Sides = (0.24, 0.18, 0.09)
    neck: Sides = (0.12, 0.063, 0.04)
    layer: Size = 0.657e-3
    element_size: Size = 0.03
    n_layer: Count = 1
    rings: Places = ()
    r_nei: Size = 0.00875
    r_wai: Size | None = None
    zone: Size | None = None
    holes: bool = False
    cell: Solid = "hexahedron"

    @property
    def centres(self) -> np.ndarray:
        """Centres of the rings in the plan, shape (n, 2)."""
        return np.array(self.rings, dtype=float).reshape(-1, 2)

    @property
    def side(self) -> float:
        """Side of the square around each ring, m."""
        return 2.3 * self.r_wai if self.zone is None else self.zone

    def groups(self) -> tuple[list[str], list[str]]:
        """Names of the parts and of the faces."""
        joints = [f"ring_{i + 1}" for i in range(len(self.centres))] or ["joint"]
        return [*BODIES, *joints], list(FACES)

    def check(self) -> None:
        """Refuse arguments that do not fit each other, with MeshError."""
        head, neck = self.head, self.neck
        slim = neck[0] < head[0] and neck[1] < head[1]
        self.require(slim, "neck", f"less than the head's {head[0]:g} and {head[1]:g} m")
        if not len(self.centres):
            return
        fits = self.r_wai is not None and self.r_wai > self.r_nei
        self.require(fits, "r_wai", f"a radius above r_nei = {self.r_nei:g} m")
        fits = self.r_wai <= 0.45 * self.side
        self.require(fits, "r_wai", f"at most 0.45 * zone = {0.45 * self.side:g} m")
        spans = [(-side / 2, side / 2) for side in neck[:2]]
        check_squares(self, "rings", self.side, spans, apart=True)

    @property
    def cell_names(self) -> dict[str, int]:
        """Tag of each part."""
        return {name: i for i, name in enumerate(self.groups()[0], start=1)}

    def lists(self) -> MeshLists:
        """The whole mesh."""
        plan = self.plan()
        kind, quads, ring = plan.kind, plan.quads, plan.number * (plan.kind > 0)
        neck = np.all(np.abs(plan.middle) < np.array(self.neck[:2]) / 2, axis=1)
        if self.holes:
            quads, neck, ring = (a[kind >= 0] for a in (quads, neck, ring))
        half = self.half_levels()
        layer = np.linspace(0.0, self.layer, self.n_layer + 1)
        z = np.concatenate([-half[:0:-1], layer, half[1:] + self.layer])
        body = len(half) - 1
        n_neck = int(np.sum(half[1:] < self.neck[2] * (1 + 1e-9)))
        head, n = np.ones(len(quads), dtype=int), len(BODIES)
        joint = np.where(ring > 0, n + ring, 0) if len(self.centres) else (n + 1) * neck
        rows = [head] * (body - n_neck) + [2 * neck] * n_neck + [joint] * self.n_layer
        rows += [3 * neck] * n_neck + [4 * head] * (body - n_neck)
        lists = extruded(plan.points, quads, z, np.array(rows), self.cell, self.cell_names)
        if len(self.centres):
            bolts = np.column_stack([self.centres, np.full(len(self.centres), self.layer / 2)])
            lists = replace(lists, points={"bolts": bolts})
        return with_joint_faces(lists, "neck_1", "neck_2", {"end_1": z[0], "end_2": z[-1]})

    @property
    def n_zone(self) -> int:
        """Cells along each side of a ring's square: an even number."""
        n = self.side / min(self.element_size, self.side / 4) / 2
        return 2 * int(np.ceil(min(n, 1e9) * (1 - 1e-9)))

    def bricks(self) -> list[tuple[float, float, float]]:
        """About how many cells heads, necks and layer have along x, y and z."""
        size, rings = self.element_size, len(self.centres)
        n_zone = self.side / min(size, self.side / 4) if rings else 0.0
        counts = []
        for axis in (0, 1):
            outer, inner = self.head[axis] / 2, self.neck[axis] / 2
            whole = count_intervals([-outer, -inner, inner, outer], size)
            neck = count_intervals([-inner, inner], size)
            # Rings' squares side by side are in one another's lines.
            more = n_zone * len(np.unique(np.round(self.centres[:, axis], 9)))
            counts.append((max(whole, more), max(neck, more)))
        (head_x, neck_x), (head_y, neck_y) = counts
        heads, necks = (2 * count_intervals([0.0, s[2]], size) for s in (self.head, self.neck))
        layer = (n_zone * rings, n_zone, self.n_layer) if rings else (neck_x, neck_y, self.n_layer)
        return [(head_x, head_y, heads), (neck_x, neck_y, necks), layer]

    def half_levels(self) -> np.ndarray:
        """Distances of a body's levels from the joint."""
        return grid_lines([0.0, self.neck[2], self.neck[2] + self.head[2]], self.element_size)

    def plan(self) -> PlaneGrid:
        """The plan, with the rings, whose cells have the kind 1, those of their holes -1."""
        plan = PlaneGrid(self.lines(0), self.lines(1))
        for centre in self.centres:
            fits = plan.square(centre, self.side).shape == (self.n_zone + 1,) * 2
            expected = "rings in rows: squares side by side or one above the other"
            self.require(fits, "rings", expected)
            radii, size = (self.r_nei, self.r_wai), min(self.element_size, self.side / 4)
            plan.fill(centre, self.side, radii, size, full=True)
        return plan

    def lines(self, axis: int) -> np.ndarray:
        """Lines of the plan along x or y, with those of the rings' squares evenly spaced."""
        outer, inner = self.head[axis] / 2, self.neck[axis] / 2
        edges = np.array([-outer, -inner, inner, outer])
        if not len(self.centres):
            return grid_lines(edges, self.element_size)
        own = self.centres[:, axis, None] + np.linspace(-0.5, 0.5, self.n_zone + 1) * self.side
        return grid_lines([*edges, *own.ravel()], self.element_size)


dumbbell = made_by(Dumbbell, in_cases=True)
