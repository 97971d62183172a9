"""Two round plates under one bolt: as a section of revolution, and in three dimensions."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np

from fenics_joints.meshes.arguments import (
    Builder,
    Demand,
    Size,
    Solid,
    is_count,
    is_positive,
    lengths,
    made_by,
)
from fenics_joints.meshes.facets import Skin, separate
from fenics_joints.meshes.grid import (
    disc_grid,
    extruded,
    graded_lines,
    grid_cells,
    grid_lines,
    tensor_grid,
)
from fenics_joints.meshes.tagged import MeshLists

CELL_NAMES = {
    "plate_1": 1,
    "plate_2": 2,
    "washer_1": 3,
    "washer_2": 4,
    "bolt_lower": 5,
    "bolt_upper": 6,
}
PARTS = ("plates", "washers", "bolt")
#: Radii that differ by less than this share of the plates' radius are one: round-off of lines.
_TOLERANCE = 1e-9

Parts = Annotated[str, Demand(PARTS.__contains__, f"one of {', '.join(PARTS)}")]
Pair = Annotated[
    tuple[Size, Size], Demand(lambda v: lengths(v, 2), "two lengths above 0 m, of plate 1 and 2")
]
Ratio = Annotated[float, Demand(lambda v: is_positive(v) and v > 1, "a ratio above 1")]
Touching = Literal["contact", "bonded"]


@dataclass(frozen=True, kw_only=True)
class _Plates(Builder):
    """What `RoundPlates` and `RoundPlatesSection` have in common; see the latter."""

    parts: Parts = "plates"
    thickness: Pair = (0.02, 0.02)
    radius: Size = 0.1
    hole_diameter: Size = 0.0135
    washer_diameter: Size = 0.024
    washer_thickness: Size = 0.0025
    washer_hole: Size = 0.013
    head_diameter: Size = 0.018
    head_height: Size = 0.0075
    bolt_diameter: Size = 0.012
    seats: Touching = "contact"
    heads: Touching = "contact"
    size: Size = 1e-3
    fine_radius: Size | None = None
    growth: Ratio = 1.2

    def check(self) -> None:
        """Refuse arguments that do not fit each other, with MeshError."""
        twice = 2 * self.radius
        fits = self.hole_diameter < self.washer_diameter < twice
        expected = f"between hole_diameter = {self.hole_diameter:g} m and {twice:g} m of the plates"
        self.require(fits, "washer_diameter", expected)
        least = self.washer_diameter / 2
        expected = f"from half washer_diameter = {least:g} m to radius = {self.radius:g} m"
        self.require(least <= self.reach <= self.radius, "fine_radius", expected, self.reach)
        if self.parts == "plates":
            return
        fits = self.washer_hole < self.head_diameter <= self.washer_diameter
        expected = f"above washer_hole = {self.washer_hole:g} m and at most "
        expected += f"washer_diameter = {self.washer_diameter:g} m"
        self.require(fits, "head_diameter", expected)
        if self.parts == "bolt":
            room = min(self.hole_diameter, self.washer_hole)
            expected = f"less than the holes, {room:g} m, so that the shank is free in them"
            self.require(self.bolt_diameter < room, "bolt_diameter", expected)

    @property
    def reach(self) -> float:
        """Radius up to which cells are ``size`` wide, m."""
        if self.fine_radius is not None:
            return self.fine_radius
        return min(self.washer_diameter / 2 + max(self.thickness), self.radius)

    def r_lines(self) -> np.ndarray:
        """Radii of the grid lines, m, from the innermost part to the rim."""
        edges = [self.hole_diameter / 2, self.washer_diameter / 2, self.reach]
        if self.parts != "plates":
            edges += [self.washer_hole / 2, self.head_diameter / 2]
        if self.parts == "bolt":
            edges += [0.0, self.bolt_diameter / 2]
        fine = grid_lines(edges, self.size)
        beyond = self.radius - self.reach
        if beyond <= _TOLERANCE * self.radius:
            return fine
        last = self.size + math.log(self.growth) * beyond
        return np.append(fine[:-1], graded_lines([self.reach, self.radius], [self.size, last]))

    def z_lines(self) -> np.ndarray:
        """Heights of the grid lines, m, from the lowest part to the highest."""
        rate = math.log(self.growth)
        lower, upper = self.thickness
        edges = [-lower, -lower / 2, 0.0, upper / 2, upper]
        middles = self.size + rate * lower / 2, self.size + rate * upper / 2
        sizes = [self.size, middles[0], self.size, middles[1], self.size]
        if self.parts != "plates":
            edges = [edges[0] - self.washer_thickness, *edges, upper + self.washer_thickness]
            sizes = [self.size, *sizes, self.size]
        if self.parts == "bolt":
            edges = [edges[0] - self.head_height, *edges, edges[-1] + self.head_height]
            last = self.size + rate * self.head_height
            sizes = [last, *sizes, last]
        return graded_lines(edges, sizes)

    def values(self, r: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Tags of cells with their middles at ``z`` and ``r``, 0 for no cell, (n_z, n_r)."""
        r, z = r[None, :], z[:, None]
        reach = np.where(z < 0, *self.thickness)
        height = np.abs(z)
        upper = (z > 0).astype(int)  # 0 for plate 1, washer 1 and the lower half of the bolt
        washer = self.washer_thickness if self.parts != "plates" else 0.0
        found = (height < reach) & (r > self.hole_diameter / 2)
        values = found * (CELL_NAMES["plate_1"] + upper)
        if self.parts != "plates":
            found = (height > reach) & (height < reach + washer)
            found = found & (r > self.washer_hole / 2) & (r < self.washer_diameter / 2)
            values = values + found * (CELL_NAMES["washer_1"] + upper)
        if self.parts == "bolt":
            found = (r < self.bolt_diameter / 2) | (height > reach + washer)
            found = found & (r < self.head_diameter / 2)
            values = values + found * (CELL_NAMES["bolt_lower"] + upper)
        return values

    def plan(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points; cells; and for each cell the mid-radius of the ring in which it lies."""
        raise NotImplementedError

    def lists(self) -> MeshLists:
        """The whole mesh."""
        points, cells, middle = self.plan()
        z = self.z_lines()
        rows = self.values(middle, _middle(z))
        skin = Skin(self.parted(extruded(points, cells, z, rows, self.cell, CELL_NAMES)))
        return skin.named(self.faces(skin, np.linalg.norm(skin.x[:, :, :-1], axis=2)))

    def parted(self, lists: MeshLists) -> MeshLists:
        """The mesh with parts as separate bodies, except those that are bonded."""
        below, above = [["plate_1"], ["washer_1"], ["bolt_lower"]], [["plate_2"]]
        above += [["washer_2"], ["bolt_upper"]]
        faces = {("plate_1", "plate_2"): ("interface_lower", "interface_upper")}
        if self.parts != "plates" and self.seats == "contact":
            faces["washer_1", "plate_1"] = ("seat_1_lower", "seat_1_upper")
            faces["plate_2", "washer_2"] = ("seat_2_lower", "seat_2_upper")
        if self.parts == "bolt":
            faces["bolt_lower", "bolt_upper"] = ("section_lower", "section_upper")
            if self.heads == "contact":
                faces["bolt_lower", "washer_1"] = ("head_1_lower", "head_1_upper")
                faces["washer_2", "bolt_upper"] = ("head_2_lower", "head_2_upper")
        bodies = []
        for plate, washer, bolt in (below, above):
            heads = [washer + bolt] if self.heads == "bonded" else [washer, bolt]
            bodies += [plate + heads[0], *heads[1:]] if self.seats == "bonded" else [plate, *heads]
        return separate(lists, bodies, faces)

    def faces(self, skin: Skin, r: np.ndarray) -> dict[str, np.ndarray]:
        """Mask of each face's facets, by the radii of the facets' corners, (n, n_corners)."""
        plate, height = skin.tag <= CELL_NAMES["plate_2"], skin.x.shape[2] - 1
        faces = {
            "hole": plate & skin.equal(r, self.hole_diameter / 2),
            "rim": plate & skin.equal(r, self.radius),
        }
        if self.parts == "bolt":
            return faces
        name, outer, depth = "washer", self.washer_diameter, 0.0
        if self.parts == "washers":
            name, outer, depth = "load", self.head_diameter, self.washer_thickness
        under = skin.within(r, outer / 2)
        heights = -self.thickness[0] - depth, self.thickness[1] + depth
        for number, place in enumerate(heights, start=1):
            faces[f"{name}_{number}"] = under & skin.at(height, place)
        return faces


@dataclass(frozen=True, kw_only=True)
class RoundPlatesSection(_Plates):
    """The section of two round plates under a bolt, x[0] the radius and x[1] the height.

    The plates touch at height 0: plate 1 lies below, plate 2 above. The bolt is an M12 by default:
    hole of the medium series (ISO 273), washer of the normal series (ISO 7089), head and nut as
    discs with their width across flats, 18 mm, as diameter.

    Cells are ``size`` wide from the axis to ``fine_radius`` and grow outwards from there by the
    factor ``growth``; in height they are ``size`` at the faces of the plates, and grow towards
    their middles and to the ends of head and nut. The surfaces of all parts lie on grid lines.

    Each part is a body of its own, whose vertices coincide with its neighbour's where they touch:

    ==================================  =====================================================
    ``interface_lower``, ``_upper``     plate 1 and plate 2
    ``seat_1_lower``, ``_upper``        washer 1 and plate 1; not with ``seats="bonded"``
    ``seat_2_lower``, ``_upper``        plate 2 and washer 2; not with ``seats="bonded"``
    ``head_1_lower``, ``_upper``        nut and washer 1; not with ``heads="bonded"``
    ``head_2_lower``, ``_upper``        washer 2 and head; not with ``heads="bonded"``
    ``section_lower``, ``_upper``       the halves of the shank at height 0, to pretension it
    ==================================  =====================================================

    Parts and other faces: always ``plate_1`` and ``plate_2``, with the faces ``hole`` (the wall of
    both plates' holes) and ``rim`` (both plates at ``radius``). With ``parts="plates"`` there are
    no other parts, and the faces ``washer_1`` and ``washer_2`` are the rings on the plates' outer
    faces from the hole to the washer's diameter. With ``parts="washers"`` there are the washers
    ``washer_1`` and ``washer_2`` too, and the faces ``load_1`` and ``load_2`` are the rings on the
    washers' outer faces under nut and head. With ``parts="bolt"`` there are the washers, the parts
    ``bolt_lower`` (nut and lower half of the shank) and ``bolt_upper``, and the face ``axis`` (of
    the bolt, at radius 0). The shank touches no hole.

    Attributes:
        parts: ``"plates"``; ``"washers"`` for plates and washers; or ``"bolt"`` for all parts.
        thickness: Thickness of plate 1 and of plate 2, in metres.
        radius: Outer radius of the plates, in metres.
        hole_diameter: Diameter of the plates' holes, in metres.
        washer_diameter: Outer diameter of the washers, in metres.
        washer_thickness: Thickness of the washers, in metres.
        washer_hole: Inner diameter of the washers, in metres.
        head_diameter: Diameter of head and nut, in metres.
        head_height: Height of head and nut, in metres.
        bolt_diameter: Diameter of the shank, in metres.
        seats: ``"contact"``, or ``"bonded"`` for washers that share vertices with the plates.
        heads: ``"contact"``, or ``"bonded"`` for head and nut that share vertices with washers.
        size: Longest side of a cell near the joint, in metres.
        fine_radius: Radius up to which cells are ``size`` wide, in metres; None for the washer's
            radius plus the thickness of the thicker plate, at most ``radius``.
        growth: Ratio of the sides of neighbouring cells where they grow.
        cell: ``"quadrilateral"``, or ``"triangle"`` for two triangles in each quadrilateral.

    Raises:
        MeshError: A dimension or word is impossible; the message names the argument, its value and
            what was expected.
    """

    function: ClassVar[str] = "bolted_plates_section"

    cell: Literal["quadrilateral", "triangle"] = "quadrilateral"

    def plan(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points and cells along the radius; and the mid-radius of each cell."""
        r = self.r_lines()
        return *tensor_grid(r), _middle(r)

    def faces(self, skin: Skin, r: np.ndarray) -> dict[str, np.ndarray]:
        """Faces that both meshes have, and the axis of a bolt."""
        axis = {"axis": skin.at(0, 0.0)} if self.parts == "bolt" else {}
        return super().faces(skin, r) | axis


@dataclass(frozen=True, kw_only=True)
class RoundPlates(_Plates):
    """Two round plates under a bolt in 3-D, the bolt's axis along z.

    The section of `RoundPlatesSection` revolved, with parts and faces of the same names except
    ``axis``; circles are polygons whose corners lie on them. The core of the shank has a square
    grid, so that no cell is degenerate.

    The other arguments are those of `RoundPlatesSection`.

    Attributes:
        size: Longest side of a cell near the joint along the radius and in height, in metres.
        n_around: Cells around the whole circle, a multiple of 4; with a bolt, of 8.
        quarter: Only the quarter with x and y above 0, with the faces ``symmetry_x`` (at x = 0) and
            ``symmetry_y`` (at y = 0).
        cell: ``"hexahedron"``, or ``"tetrahedron"`` for six tetrahedra in each hexahedron.

    Raises:
        MeshError: A dimension, count or word is impossible; the message names the argument, its
            value and what was expected.
    """

    function: ClassVar[str] = "bolted_plates"

    size: Size = 2e-3
    n_around: int = 32
    quarter: bool = False
    cell: Solid = "hexahedron"

    def check(self) -> None:
        """Refuse arguments that do not fit each other, with MeshError."""
        super().check()
        unit = 8 if self.parts == "bolt" else 4
        fits = is_count(self.n_around) and self.n_around % unit == 0
        expected = f"a multiple of {unit} with parts = {self.parts!r}"
        self.require(fits, "n_around", expected)

    def faces(self, skin: Skin, r: np.ndarray) -> dict[str, np.ndarray]:
        """Faces that both meshes have, and the planes of symmetry of a quarter."""
        planes = {"symmetry_x": skin.at(0, 0.0), "symmetry_y": skin.at(1, 0.0)}
        return super().faces(skin, r) | (planes if self.quarter else {})

    def plan(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points in the plane; cells; and for each cell the mid-radius of its ring."""
        r = self.r_lines()
        if self.parts == "bolt":
            r = r[r > self.bolt_diameter / 2 - _TOLERANCE * self.radius]
        n = self.n_around // 4 + 1 if self.quarter else self.n_around
        angle = np.arange(n) * (2 * math.pi / self.n_around)
        unit = np.column_stack([np.cos(angle), np.sin(angle)])
        if self.quarter:
            unit[0], unit[-1] = (1.0, 0.0), (0.0, 1.0)  # free of round-off on the symmetry planes
        points = (r[:, None, None] * unit).reshape(-1, 2)
        number = np.arange(len(points)).reshape(len(r), n)
        if not self.quarter:
            number = np.hstack([number, number[:, :1]])
        quads = grid_cells(number)
        middle = np.repeat(_middle(r), number.shape[1] - 1)
        if self.parts == "bolt":
            circle = number[0, :n]
            core = disc_grid(circle, points[circle], self.size, len(points), self.quarter)
            points, quads = np.vstack([points, core[0]]), np.vstack([quads, core[1]])
            middle = np.append(middle, np.full(len(core[1]), self.bolt_diameter / 4))
        return points, quads, middle


bolted_plates_section = made_by(RoundPlatesSection)
bolted_plates = made_by(RoundPlates)


def _middle(lines: np.ndarray) -> np.ndarray:
    return (lines[:-1] + lines[1:]) / 2
