"""Two C-shaped beams bolted together at their ends."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import numpy as np

from fenics_joints.meshes.arguments import (
    Builder,
    Count,
    Demand,
    Gap,
    Size,
    Solid,
    is_count,
    made_by,
)
from fenics_joints.meshes.facets import Skin
from fenics_joints.meshes.grid import PlaneGrid, count_intervals, extruded, graded_lines, grid_lines
from fenics_joints.meshes.lap_beam import CELL_NAMES, lapped, lapped_groups
from fenics_joints.meshes.tagged import MeshLists

#: Logarithm of the ratio of neighbouring elements between the pads and the slender middle. Chosen,
#: with the sizes by default, to have the published number of elements.
_GROWTH = math.log(1.3)

Counts = Annotated[
    tuple[Count, Count],
    Demand(lambda v: len(v) == 2 and all(map(is_count, v)), "two whole numbers of at least 1"),
]


@dataclass(frozen=True, kw_only=True)
class CBeams(Builder):
    """Two equal C-shaped beams, face to face, with a bolt's hole in each end.

    The defaults are the benchmark of updating contact by a cut-off pressure: its length and
    cross-sections are printed, the pads' length is a fit to the printed frequencies, and the place
    and diameter of the holes and the washers are assumed. Fillets and bolts are left out.

    Both beams span x from 0 to ``length`` and y from ``-width / 2`` to ``width / 2``. Beam 1 lies
    below z = 0, beam 2 mirrored above; over the pads at both ends they touch at z = 0, and between
    the pads there is a gap of ``2 * (pad_thickness - thickness)``. The outer faces are flat, at
    z = -pad_thickness and pad_thickness. The holes are in the middle of the pads.

    In the plan, the pads have elements of ``element_size`` and each hole lies in an O-grid within
    a square of side ``zone``; a hole is a polygon whose corners lie on the circle, four times as
    many as elements along the zone's side. Towards the middle the elements grow along x up to
    ``middle_size``. The defaults have the published resolution: 47,704 hexahedra and 1,004 faces
    on each pad, where the publication has about 47,500 and 1,000. A small one for tests, of 1,848
    hexahedra: ``element_size=6e-3, radial_size=3e-3, middle_size=25e-3, n_thickness=(2, 1)``.

    Parts: ``beam_1``, ``beam_2``. Faces: ``interface_lower`` and ``interface_upper`` (of both pads
    of beam 1 and of beam 2, which share no vertex); ``washer_1_lower``, ``washer_2_lower`` (the
    rings under the washers at the first and second bolt on the outer face of beam 1),
    ``washer_1_upper``, ``washer_2_upper`` (of beam 2); ``holes``. Points: ``bolts``, the bolts'
    axes at z = 0.

    With ``bonded=True`` the beams share their vertices over the pads, the one face ``interface``.
    With a ``layer`` above 0 a layer of that thickness, one element thick, lies between the pads
    and shares vertices with them; the beams move apart by half of it each. Then there is a part
    ``joint``, and the faces ``joint_lower``, ``joint_upper`` lie between it and the beams.

    Attributes:
        length: Length of each beam, in metres.
        width: Width of the beams, in metres.
        thickness: Thickness of the slender middle, in metres.
        pad_thickness: Thickness of the pads, in metres.
        pad_length: Length of each pad, in metres.
        hole_diameter: Diameter of the bolts' holes, in metres.
        washer_diameter: Outer diameter of the washers, in metres.
        zone: Side of the square of the O-grid around each hole, in metres.
        element_size: Longest side of an element in the plan of the pads, in metres.
        radial_size: Longest element of the O-grid along the radius, in metres.
        middle_size: Longest element along the slender middle, in metres.
        n_thickness: Elements through the slender middle, and through the rest of a pad.
        layer: Thickness of the joint layer, in metres; 0 for none.
        bonded: Whether the beams share vertices; a ``layer`` always does.
        cell: ``"hexahedron"``, or ``"tetrahedron"`` for six of those in each hexahedron.

    Raises:
        MeshError: A dimension or count is impossible; the message names the argument, its value
            and what was expected.
    """

    function: ClassVar[str] = "c_beams"

    length: Size = 0.508
    width: Size = 0.0318
    thickness: Size = 9.65e-3
    pad_thickness: Size = 12.7e-3
    pad_length: Size = 0.0497
    hole_diameter: Size = 8.43e-3
    washer_diameter: Size = 17.46e-3
    zone: Size = 0.024
    element_size: Size = 1.5e-3
    radial_size: Size = 1.1e-3
    middle_size: Size = 8e-3
    n_thickness: Counts = (6, 2)
    layer: Gap = 0.0
    bonded: bool = False
    cell: Solid = "hexahedron"

    def check(self) -> None:
        """Refuse arguments that do not fit each other, with MeshError."""
        rooms = [
            ("thickness", "pad_thickness", 1.0),
            ("pad_length", "length", 0.5),
            ("zone", "width", 1.0),
            ("zone", "pad_length", 1.0),
            ("hole_diameter", "washer_diameter", 1.0),
            ("washer_diameter", "zone", 0.9),
        ]
        for name, other, share in rooms:
            value, room = getattr(self, name), share * getattr(self, other)
            factor = "" if share == 1 else f"{share:g} * "
            self.require(value < room, name, f"less than {factor}{other} = {room:g} m")

    def groups(self) -> tuple[list[str], list[str]]:
        """Names of the parts and of the faces."""
        faces = ["holes"]
        faces += [f"washer_{i}_{side}" for i in (1, 2) for side in ("lower", "upper")]
        return lapped_groups(self.layer, self.bonded, [], faces)

    @property
    def bolts(self) -> np.ndarray:
        """Axes of the bolts in the plan, shape (2, 2)."""
        return np.array([[self.pad_length / 2, 0.0], [self.length - self.pad_length / 2, 0.0]])

    def lists(self) -> MeshLists:
        """The whole mesh."""
        plan = PlaneGrid(self.x_lines(), self.y_lines())
        for bolt in self.bolts:
            radii = self.hole_diameter / 2, self.washer_diameter / 2
            plan.fill(bolt, self.zone, radii, self.radial_size)
        x = plan.middle[:, 0]
        pad = (x < self.pad_length) | (x > self.length - self.pad_length)
        values = self.values(pad)
        lists = extruded(plan.points, plan.quads, self.levels(), values, self.cell, CELL_NAMES)
        lists = self.with_faces(lapped(lists, self.layer, self.bonded))
        return replace(lists, points={"bolts": np.column_stack([self.bolts, np.zeros(2)])})

    def bricks(self) -> list[tuple[float, float, float]]:
        """About how many cells the beams have along x, y and z, and around each hole."""
        outer, raised = self.n_thickness
        pad = self.pad_length / self.element_size
        largest = max(self.middle_size, self.element_size)
        growing = math.log(largest / self.element_size) / _GROWTH
        n_x = 2 * pad + (self.length - 2 * self.pad_length) / largest + 2 * growing
        n_y = count_intervals(self.y_edges(), self.element_size)
        radial = (self.zone - self.hole_diameter) / 2 / self.radial_size
        hole = radial, 4 * self.zone / self.element_size, 2 * (outer + raised)
        return [(n_x, n_y, 2 * outer), (2 * pad, n_y, 2 * raised), hole, hole]

    def x_lines(self) -> np.ndarray:
        """Lines of the plan along the beams; symmetric."""
        half = self.zone / 2
        bolt = self.pad_length / 2
        pad = grid_lines([0.0, bolt - half, bolt + half, self.pad_length], self.element_size)
        span = self.length - 2 * self.pad_length
        largest = max(self.middle_size, self.element_size)
        reach = (largest - self.element_size) / _GROWTH
        if reach < 0.45 * span:
            places = [0.0, reach, span - reach, span] if reach > 0 else [0.0, span]
            sizes = [self.element_size, largest, largest, self.element_size]
            sizes = sizes if reach > 0 else sizes[::3]
        else:
            middle = self.element_size + _GROWTH * span / 2
            places = [0.0, span / 2, span]
            sizes = [self.element_size, middle, self.element_size]
        between = graded_lines(np.array(places) + self.pad_length, sizes)
        return np.concatenate([pad[:-1], between, (self.length - pad)[-2::-1]])

    def y_edges(self) -> list[float]:
        return [-self.width / 2, -self.zone / 2, self.zone / 2, self.width / 2]

    def y_lines(self) -> np.ndarray:
        return grid_lines(self.y_edges(), self.element_size)

    def levels(self) -> np.ndarray:
        outer, raised = self.n_thickness
        rise = self.pad_thickness - self.thickness
        up = np.concatenate(
            [
                np.linspace(0.0, rise, raised, endpoint=False),
                np.linspace(rise, self.pad_thickness, outer + 1),
            ]
        )
        up = up + self.layer / 2
        return np.concatenate([-up[::-1], up if self.layer > 0 else up[1:]])

    def values(self, pad: np.ndarray) -> np.ndarray:
        """Cell tags per layer of cells and plane cell; ``pad`` says which are of the pads."""
        outer, raised = self.n_thickness
        everywhere = np.ones(len(pad), dtype=int)
        rows = [everywhere * CELL_NAMES["beam_1"]] * outer
        rows += [pad * CELL_NAMES["beam_1"]] * raised
        if self.layer > 0:
            rows.append(pad * CELL_NAMES["joint"])
        rows += [pad * CELL_NAMES["beam_2"]] * raised
        rows += [everywhere * CELL_NAMES["beam_2"]] * outer
        return np.array(rows)

    def with_faces(self, lists: MeshLists) -> MeshLists:
        skin, outer = Skin(lists), self.pad_thickness + self.layer / 2
        radius, nearest = skin.from_axes(self.bolts)
        faces = {"holes": skin.equal(radius, self.hole_diameter / 2)}
        under = skin.within(radius, self.washer_diameter / 2)
        for side, height in (("lower", -outer), ("upper", outer)):
            for bolt in range(2):
                own = under & (nearest == bolt) & skin.at(2, height)
                faces[f"washer_{bolt + 1}_{side}"] = own
        return skin.named(faces)


c_beams = made_by(CBeams, in_cases=True)
