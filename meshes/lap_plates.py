"""Two plates lapped over a bolted joint with a thin layer between them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from fenics_joints.meshes.arguments import (
    Builder,
    Count,
    Gap,
    Places,
    Size,
    Solid,
    check_squares,
    made_by,
)
from fenics_joints.meshes.facets import Skin, name_between
from fenics_joints.meshes.grid import PlaneGrid, count_intervals, extruded, grid_lines
from fenics_joints.meshes.tagged import MeshLists

CELL_NAMES = {"plate_1": 1, "plate_2": 2, "joint_near": 3, "joint_away": 4}
FACET_NAMES = {
    "end_1": 1,
    "end_2": 2,
    "bottom": 3,
    "top": 4,
    "joint_lower": 5,
    "joint_upper": 6,
    "interface": 7,
    "holes": 8,
    "washers": 9,
}
#: Axes of the bolts, x and y, m: fitted to the frequencies that Tian et al. 2021 compute.
BOLTS = ((0.14, 0.02), (0.14, 0.06), (0.18, 0.02), (0.18, 0.06))


@dataclass(frozen=True, kw_only=True)
class LapPlates(Builder):
    """Two equal plates that overlap by ``lap``, with a joint layer one element thick.

    Plate 1 spans x from 0 to ``length`` and z from 0 to ``thickness``; the layer lies on it over
    the lap, x from ``length - lap`` to ``length``; plate 2 lies on the layer and ends at
    x = ``2 * length - lap``. Both span y from 0 to ``width``.

    Grid lines stand at the ends, at the lap's edges and at the zones' edges exactly; each interval
    between them is cut into the fewest equal parts not longer than the element size. The counts
    ``n_length`` and ``n_width`` set that size to ``length / n_length`` and ``width / n_width``,
    so they are met exactly when the edges are multiples of it, and exceeded a little otherwise.

    Parts: ``plate_1``, ``plate_2``, ``joint_near`` (the layer within squares of side ``zone``
    centred on the bolts, their union if they overlap) and ``joint_away`` (the rest of the layer).
    Faces: ``end_1`` (x = 0), ``end_2``, ``bottom`` (of plate 1, z = 0), ``top`` (of plate 2),
    ``joint_lower`` and ``joint_upper`` (between the layer and plate 1, plate 2). With ``layer=0``
    the plates share their vertices over the lap: no joint parts, and the one face ``interface``.
    Points: ``bolts``, at mid-height of the joint.

    With ``hole_diameter``, a hole goes through everything at each bolt, the inside of each zone is
    an O-grid between the hole and the zone's square, and the element size is at most a quarter of
    the zone. A hole is a polygon whose corners lie on the circle, four times as many as elements
    along the zone's side. More faces: ``holes`` (their walls) and, with ``washer_diameter``,
    ``washers`` (the rings under head and nut; they are then no part of ``bottom`` and ``top``).

    Attributes:
        length: Length of each plate, in metres.
        width: Width of the plates, in metres.
        thickness: Thickness of each plate, in metres.
        lap: Length of the overlap, in metres.
        layer: Thickness of the joint layer, in metres; 0 for none.
        element_size: Longest side of an element in the plane, in metres.
        n_length: Elements along each plate, instead of ``element_size``.
        n_width: Elements across the plates, instead of ``element_size``.
        n_thickness: Elements through each plate.
        bolts: Centres (x, y) of the bolts, in metres.
        zone: Side of the square zone around each bolt, in metres; 0 for none.
        hole_diameter: Diameter of the bolts' holes, in metres; None for plates without holes.
        washer_diameter: Outer diameter of the washers, in metres; None for none.
        cell: ``"hexahedron"``, or ``"tetrahedron"`` for six of those in each hexahedron.

    Raises:
        MeshError: A dimension or count is impossible, or a zone leaves the lap; the message names
            the argument, its value and what was expected.
    """

    function: ClassVar[str] = "lap_plates"

    length: Size = 0.2
    width: Size = 0.08
    thickness: Size = 0.008
    lap: Size = 0.08
    layer: Gap = 0.5e-3
    element_size: Size = 5e-3
    n_length: Count | None = None
    n_width: Count | None = None
    n_thickness: Count = 2
    bolts: Places = BOLTS
    zone: Gap = 0.02
    hole_diameter: Size | None = None
    washer_diameter: Size | None = None
    cell: Solid = "hexahedron"

    @property
    def centres(self) -> np.ndarray:
        """Centres of the bolts in the plan, shape (n, 2)."""
        return np.array(self.bolts, dtype=float).reshape(-1, 2)

    @property
    def radii(self) -> tuple[float, ...]:
        """Radii of the hole and the washer, those that are given."""
        return tuple(d / 2 for d in (self.hole_diameter, self.washer_diameter) if d is not None)

    def groups(self) -> tuple[list[str], list[str]]:
        """Names of the parts and of the faces, also of those that are empty."""
        return list(CELL_NAMES), list(FACET_NAMES)

    def check(self) -> None:
        """Refuse arguments that do not fit each other, with MeshError."""
        expected = f"less than length = {self.length:g} m"
        self.require(self.lap < self.length, "lap", expected)
        spans = (self.length - self.lap, self.length), (0.0, self.width)
        hole, washer, zone = self.hole_diameter, self.washer_diameter, self.zone
        check_squares(self, "bolts", zone, spans, apart=hole is not None)
        if hole is None:
            self.require(washer is None, "washer_diameter", "None when hole_diameter is None")
            return
        # The O-grid needs room between the outer circle and the square.
        room = f"at most 0.9 * zone = {0.9 * zone:g} m"
        self.require(hole <= 0.9 * zone, "hole_diameter", "a diameter above 0 m and " + room)
        if washer is not None:
            expected = f"more than hole_diameter = {hole:g} m and {room}"
            self.require(hole < washer <= 0.9 * zone, "washer_diameter", expected)

    def sizes(self) -> tuple[float, float]:
        """Longest sides of elements along x and y, m."""
        n_x, n_y = self.n_length, self.n_width
        sizes = (
            self.element_size if n_x is None else self.length / n_x,
            self.element_size if n_y is None else self.width / n_y,
        )
        return tuple(min(size, self.zone / 4) if self.radii else size for size in sizes)

    def lists(self) -> MeshLists:
        """The whole mesh."""
        (x, y), (size_x, size_y) = self.edges(), self.sizes()
        plan = PlaneGrid(grid_lines(x, size_x), grid_lines(y, size_y))
        for bolt in self.centres if self.radii else ():
            plan.fill(bolt, self.zone, self.radii, min(size_x, size_y))
        rows = self.values(plan.middle)
        lists = extruded(plan.points, plan.quads, self.levels(), rows, self.cell, CELL_NAMES)
        centres = np.full((len(self.centres), 3), self.thickness + self.layer / 2)
        centres[:, :2] = self.centres
        lists = replace(lists, facet_names=FACET_NAMES, points={"bolts": centres})
        return self.with_faces(lists)

    def with_faces(self, lists: MeshLists) -> MeshLists:
        """The ends, the outer faces and holes; and what is between the plates."""
        skin, top = Skin(lists), 2 * self.thickness + self.layer
        faces = {"bottom": skin.at(2, 0.0), "top": skin.at(2, top)}
        if self.radii and len(self.centres):
            radius, _ = skin.from_axes(self.centres)
            washer = skin.within(radius, self.radii[-1]) & (faces["bottom"] | faces["top"])
            faces = {name: own & ~washer for name, own in faces.items()}
            faces |= {"washers": washer, "holes": skin.equal(radius, self.radii[0])}
        faces |= {"end_1": skin.at(0, 0.0), "end_2": skin.at(0, 2 * self.length - self.lap)}
        lists = skin.named(faces)
        if self.layer == 0:
            return name_between(lists, {"interface": ("plate_1", "plate_2")})
        lower, upper = ((plate, "joint_near", "joint_away") for plate in ("plate_1", "plate_2"))
        return name_between(lists, {"joint_lower": lower, "joint_upper": upper})

    def edges(self) -> tuple[list[float], list[float]]:
        """Places along x and y that are lines of the grid."""
        half = self.zone / 2
        around = np.concatenate([self.centres - half, self.centres + half])
        x = [0.0, self.length - self.lap, self.length, 2 * self.length - self.lap, *around[:, 0]]
        return x, [0.0, self.width, *around[:, 1]]

    def bricks(self) -> list[tuple[float, float, float]]:
        """About how many cells the two plates and the layer have along x, y and z."""
        (x, y), (size_x, size_y) = self.edges(), self.sizes()
        spans = [(0.0, self.length), (self.length - self.lap, 2 * self.length - self.lap)]
        n_y = count_intervals(y, size_y)
        plates = [(count_intervals(x, size_x, span), n_y, self.n_thickness) for span in spans]
        lap = count_intervals(x, size_x, (self.length - self.lap, self.length))
        return [*plates, (lap, n_y, 1)] if self.layer > 0 else plates

    def levels(self) -> np.ndarray:
        plate = np.linspace(0.0, self.thickness, self.n_thickness + 1)
        upper = plate + self.thickness + self.layer
        return np.concatenate([plate, upper if self.layer > 0 else upper[1:]])

    def values(self, middle: np.ndarray) -> np.ndarray:
        """Cell tags per layer of cells and plane cell, whose centres are ``middle``, (n, 2)."""
        first = middle[:, 0] < self.length
        second = middle[:, 0] > self.length - self.lap
        from_bolts = np.abs(middle[:, None, :] - self.centres).max(axis=2)
        near = (from_bolts < self.zone / 2).any(axis=1)
        joint = np.where(near, CELL_NAMES["joint_near"], CELL_NAMES["joint_away"])
        rows = [np.where(first, CELL_NAMES["plate_1"], 0)] * self.n_thickness
        if self.layer > 0:
            rows.append(np.where(first & second, joint, 0))
        rows += [np.where(second, CELL_NAMES["plate_2"], 0)] * self.n_thickness
        return np.array(rows)


lap_plates = made_by(LapPlates, in_cases=True)
