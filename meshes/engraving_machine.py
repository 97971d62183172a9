"""Cast bed and column joined by rings of transition material (Machines 2022, section 5).

A stand-in: of the engraving machine in Machines 2022 the text has the bolts, the materials and five
frequencies, while all dimensions of its frame were in a lost figure (Figure 14).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import numpy as np

from fenics_joints.meshes.arguments import (
    Builder,
    Count,
    Demand,
    Size,
    Solid,
    is_count,
    lengths,
    made_by,
)
from fenics_joints.meshes.dumbbell import Sides, with_joint_faces
from fenics_joints.meshes.grid import PlaneGrid, count_intervals, extruded, grid_lines
from fenics_joints.meshes.tagged import MeshLists

FACES = ("bottom", "top", "joint_lower", "joint_upper")
BODIES = ("bed", "column")
#: Share of half a ring's square that its polygon may reach. Chosen: cells beside it keep a width.
_ROOM = 0.98

Two = Annotated[
    tuple[Size, Size], Demand(lambda v: lengths(v, 2), "2 lengths above 0 m, along -y and z")
]

#: Most rows of bolts, and ribs. Chosen: each is a box, whose edges are lines of the whole grid.
_MOST_ROWS = 100


Ribs = Annotated[Count, Demand(lambda n: n <= _MOST_ROWS, f"at most {_MOST_ROWS} ribs")]


def _is_grid(places) -> bool:
    fits = len(np.atleast_1d(places)) == 2
    return fits and all(is_count(n) and 3 <= n <= _MOST_ROWS for n in places)


@dataclass(frozen=True, kw_only=True)
class EngravingMachine(Builder):
    """A machine frame: a bed and a column with an arm, bolted flange to flange.

    A stand-in for the engraving machine of Machines 2022, section 5, whose dimensions are lost.
    Those of ``bed``, ``column``, ``arm``, ``wall`` and ``gusset`` by default are a fit to the first
    five frequencies that the paper computed (Table 12): with its materials and rings, iron of 7250
    kg/m3 and elements of 30 mm they come within 0.5 %, which therefore validates nothing. Elements
    of 150 mm give 1 to 4 % more.

    The bed lies below z = 0: a plate, ``flange`` thick, on walls and ribs, open below as castings
    are. The column stands on a flange centred on x = y = 0: a hollow box with a hollow arm towards
    -y, where the bed goes on. The flange's bolts are in the outer rows of a grid of
    ``bolts`` places, each in a pocket between gussets above and ribs below, which are in line with
    the column's walls. Bed and column share no vertex: the rings of ``layer``, from R_nei to R_wai
    around each bolt, alone join them, and the flanges are apart elsewhere. Holes of radius R_nei
    go through both; the bolts themselves are left out, as in the paper. Circles are regular
    polygons of the same area. The frame is symmetric about x = 0.

    Parts: ``bed``, ``column``, and ``ring_1``, ``ring_2``, ... anticlockwise seen from above, from
    the corner of least x and y. Faces: ``bottom`` (rims of the bed's walls), ``top`` (of column
    and arm), ``joint_lower`` and ``joint_upper`` (between all rings and bed, column). Points:
    ``bolts``, the rings' centres at mid-height, and ``head``, the middle of the arm's end.

    Attributes:
        bed: Width (x), length (y) and height of the bed, in metres.
        column: Height of the column, its flange included, in metres.
        arm: Length from the column's front and height, in metres.
        wall: Thickness of all walls, ribs and gussets, in metres.
        flange: Thickness of the column's flange and of the bed's plate, in metres.
        gusset: Height of the gussets on the flange, in metres.
        ribs: Number of ribs across the bed in front of the column.
        bolts: Places along x and y of the grid whose outer rows have the bolts.
        layer: Thickness of the rings, in metres.
        r_nei: Inner radius of the rings, in metres; by default that of an M12's hole (ISO 273).
        r_wai: Outer radius of the rings, in metres; by default what the database that comes with
            the package says of M12, 120 N·m, flanges of 25 mm (Machines 2022, Table 2).
        zone: Side of the square of each bolt's pocket, in metres; None: 2.25 r_wai.
        element_size: Longest side of an element, in metres; in a pocket at most half its side.
        n_layer: Elements through the rings.
        cell: ``"hexahedron"``, or ``"tetrahedron"`` for six of those in each hexahedron.

    Raises:
        MeshError: A dimension or count is impossible; the message names the argument, its value
            and what was expected.
    """

    function: ClassVar[str] = "engraving_machine"

    bed: Sides = (0.924, 1.39, 0.263)
    column: Size = 1.165
    arm: Two = (0.78, 0.262)
    wall: Size = 0.033
    flange: Size = 0.025
    gusset: Size = 0.16
    ribs: Ribs = 3
    bolts: Annotated[
        tuple[Count, Count],
        Demand(_is_grid, f"two whole numbers from 3 to {_MOST_ROWS}, places along x and y"),
    ] = (5, 5)
    layer: Size = 0.72e-3
    r_wai: Size = 0.0514
    zone: Size | None = None
    r_nei: Size = 0.00675
    element_size: Size = 0.12
    n_layer: Count = 1
    cell: Solid = "hexahedron"

    def groups(self) -> tuple[list[str], list[str]]:
        """Names of the parts and of the faces."""
        rings = 2 * sum(self.bolts) - 4  # in the outer rows of the grid
        return [*BODIES, *(f"ring_{i + 1}" for i in range(rings))], list(FACES)

    @property
    def side(self) -> float:
        """Side of the square of each bolt's pocket, m."""
        return 2.25 * self.r_wai if self.zone is None else self.zone

    def check(self) -> None:
        """Refuse arguments that do not fit each other, with MeshError."""
        expected = f"a radius above r_nei = {self.r_nei:g} m"
        self.require(self.r_wai > self.r_nei, "r_wai", expected)
        (width, length, height), (reach, tall) = self.bed, self.arm
        t, half = self.wall, self.half_flange
        least = 2 * (half[0] + t)
        fits = width >= least * (1 - 1e-9)
        self.require(fits, "bed", f"a width of at least {least:g} m")
        least = 2 * half[1] + (self.ribs + 3) * t
        self.require(length > least, "bed", f"a length above {least:g} m")
        self.require(height > self.flange, "bed", f"a height above {self.flange:g} m")
        least = self.side + t
        expected = f"a length of at least {least:g} m, beyond the flange"
        self.require(reach >= least * (1 - 1e-9), "arm", expected)
        self.require(tall > 2 * t, "arm", f"a height above {2 * t:g} m")
        least = self.flange + self.gusset + tall
        self.require(self.column > least, "column", f"more than {least:g} m")
        least = 2 * self.corners()[1] / _ROOM
        expected = f"at least {least:g} m, for the polygon around r_wai = {self.r_wai:g} m"
        self.require(least <= self.side, "zone", expected, self.side)

    @property
    def half_flange(self) -> np.ndarray:
        """Half the flange's side along x and y."""
        n = np.array(self.bolts)
        return (n * self.side + (n - 1) * self.wall) / 2

    @property
    def half_box(self) -> np.ndarray:
        """Half the column's outer side along x and y: the outer rows of bolts are outside it."""
        return self.half_flange - self.side

    @property
    def y_bed(self) -> tuple[float, float]:
        """Front and rear of the bed."""
        rear = float(self.half_flange[1]) + self.wall
        return rear - self.bed[1], rear

    def centres(self) -> np.ndarray:
        """Centres (x, y) of the bolts, anticlockwise from the corner of least x and y."""
        (nx, ny), pitch = self.bolts, self.side + self.wall
        i, j = np.arange(nx), np.arange(ny)
        places = np.vstack(
            [
                np.column_stack([i[:-1], 0 * i[:-1]]),
                np.column_stack([0 * j[:-1] + nx - 1, j[:-1]]),
                np.column_stack([i[:0:-1], 0 * i[:0:-1] + ny - 1]),
                np.column_stack([0 * j[:0:-1], j[:0:-1]]),
            ]
        )
        return (places - (np.array(self.bolts) - 1) / 2) * pitch

    def gaps(self, axis: int) -> list[tuple[float, float]]:
        """Where a wall, rib or gusset can pass between rows of bolts."""
        start, pitch = self.side - float(self.half_flange[axis]), self.side + self.wall
        return [
            (start + i * pitch, start + i * pitch + self.wall) for i in range(self.bolts[axis] - 1)
        ]

    def bed_boxes(self) -> list[tuple[float, ...]]:
        """The bed as boxes (x0, x1, y0, y1, z0, z1) that may overlap."""
        (width, _, height), t, (front, rear) = self.bed, self.wall, self.y_bed
        w, fy = width / 2, float(self.half_flange[1])
        along = [(-w, t - w), (w - t, w), self.gaps(0)[0], self.gaps(0)[-1]]
        across = [(front, front + t), (rear - t, rear), (-fy - t, -fy)]
        across += [self.gaps(1)[0], self.gaps(1)[-1]]
        middle = np.linspace(front, -fy - t, self.ribs + 2)[1:-1]
        across += [(y, y + t) for y in middle.tolist()]
        boxes = [(-w, w, front, rear, -self.flange, 0.0)]
        boxes += [(*x, front, rear, -height, 0.0) for x in along]
        return boxes + [(-w, w, *y, -height, 0.0) for y in across]

    def column_boxes(self) -> list[tuple[float, ...]]:
        """The column with its flange, gussets and arm, likewise."""
        t, low, top = self.wall, self.layer, self.layer + self.column
        (fx, fy), (cx, cy) = self.half_flange.tolist(), self.half_box.tolist()
        end, floor = -cy - self.arm[0], top - self.arm[1]

        def tube(x, y, z):
            # Four walls, as thick as the others, outwards to x and y.
            sides = [(-x, t - cx, -y, y, *z), (cx - t, x, -y, y, *z)]
            return [*sides, (-x, x, -y, t - cy, *z), (-x, x, cy - t, y, *z)]

        boxes = tube(fx, fy, (low, low + self.flange)) + tube(cx, cy, (low, top))
        foot = low + self.flange, low + self.flange + self.gusset
        for x in self.gaps(0):
            boxes += [(*x, -fy, -cy, *foot), (*x, cy, fy, *foot)]
        for y in self.gaps(1):
            boxes += [(-fx, -cx, *y, *foot), (cx, fx, *y, *foot)]
        boxes += [(-cx, cx, end, cy, top - t, top), (-cx, cx, end, -cy, floor, floor + t)]
        boxes += [(-cx, cx, end, end + t, floor, top)]
        return boxes + [(*x, end, -cy, floor, top) for x in (self.gaps(0)[0], self.gaps(0)[-1])]

    def levels(self) -> list[float]:
        """Heights of the column at which something begins or ends."""
        low, top = self.layer, self.layer + self.column
        foot, floor = low + self.flange, top - self.arm[1]
        return [low, foot, foot + self.gusset, floor, floor + self.wall, top - self.wall, top]

    @property
    def n_zone(self) -> int:
        """Cells along each side of a pocket: an even number."""
        zone = self.side
        n = zone / min(self.element_size, zone / 2) / 2
        return 2 * int(np.ceil(min(n, 1e9) * (1 - 1e-9)))

    def corners(self) -> tuple[float, float]:
        """Radii at the corners of the regular polygons with the circles' areas."""
        angle = 2 * np.pi / (4 * self.n_zone)
        inner, outer = (float(r * np.sqrt(angle / np.sin(angle))) for r in (self.r_nei, self.r_wai))
        return inner, outer

    def lists(self) -> MeshLists:
        """The whole mesh."""
        n = len(BODIES)
        bolts = self.centres()
        plan = PlaneGrid(self.lines(0), self.lines(1))
        for centre in bolts:
            size = min(self.element_size, self.side / 2)
            plan.fill(centre, self.side, self.corners(), size, full=True)
        ring = plan.number * plan.kind  # below 0 in a hole
        below = grid_lines([-self.bed[2], -self.flange, 0.0], self.element_size)
        layer = np.linspace(0.0, self.layer, self.n_layer + 1)
        above = grid_lines(self.levels(), self.element_size)
        z = np.concatenate([below, layer[1:-1], above])
        rows = np.zeros((len(z) - 1, len(ring)), dtype=int)
        for tag, boxes in enumerate((self.bed_boxes(), self.column_boxes()), start=1):
            for box in boxes:
                rows[np.ix_(_inside(z, box[4:]), _in_plan(plan.middle, box[:4]))] = tag
        first = len(below) - 1
        rows[first : first + self.n_layer] = np.where(ring > 0, n + ring, 0)
        # The holes end with the flanges: the arm may be above them.
        rows[np.ix_(_inside(z, (z[0], self.layer + self.flange)), np.flatnonzero(ring < 0))] = 0
        head = 0.0, -self.half_box[1] - self.arm[0], z[-1] - self.arm[1] / 2
        names = {name: i for i, name in enumerate(self.groups()[0], start=1)}
        lists = extruded(plan.points, plan.quads, z, rows, self.cell, names)
        bolts = np.column_stack([bolts, np.full(len(bolts), self.layer / 2)])
        lists = replace(lists, points={"bolts": bolts, "head": np.array([head])})
        return with_joint_faces(lists, *BODIES, {"bottom": z[0], "top": z[-1]})

    def lines(self, axis: int) -> np.ndarray:
        """Lines of the plan along x or y: all walls', and those of the pockets evenly spaced."""
        step = np.linspace(-0.5, 0.5, self.n_zone + 1) * self.side
        own = self.centres()[:, axis, None] + step
        return grid_lines([*self.walls(axis), *own.ravel()], self.element_size)

    def walls(self, axis: int) -> np.ndarray:
        """Where walls begin and end along an axis."""
        boxes = np.array(self.bed_boxes() + self.column_boxes())
        return boxes[:, 2 * axis : 2 * axis + 2].ravel()

    def bricks(self) -> list[tuple[float, float, float]]:
        """About how many cells each wall has along x, y and z, with the lines of the others."""
        step = np.array([-0.5, 0.5]) * self.side
        centres = self.centres()
        edges = [
            np.append(self.walls(0), centres[:, 0, None] + step),
            np.append(self.walls(1), centres[:, 1, None] + step),
            [-self.bed[2], -self.flange, 0.0, *self.levels()],
        ]
        size = min(self.element_size, self.side / 2)
        sizes = size, size, self.element_size
        boxes = np.array(self.bed_boxes() + self.column_boxes()).reshape(-1, 3, 2)
        counts = [tuple(map(count_intervals, edges, sizes, box)) for box in boxes]
        # Where walls cross they overlap, and count once.
        once = _volume(boxes) / np.prod(np.diff(boxes), axis=1).sum()
        n_zone = self.side / size
        rings = n_zone * len(centres), n_zone, self.n_layer
        return [*((once * n_x, n_y, n_z) for n_x, n_y, n_z in counts), rings]


def _volume(boxes: np.ndarray) -> float:
    """Volume of boxes that may overlap, each a row of (low, high) by axis, shape (n, 3, 2)."""
    lines = [np.unique(boxes[:, axis]) for axis in range(3)]
    filled = np.zeros([len(line) - 1 for line in lines], dtype=bool)
    for box in boxes:
        filled[np.ix_(*map(_inside, lines, box))] = True
    return float(np.einsum("ijk,i,j,k->", filled, *map(np.diff, lines)))


def _inside(lines: np.ndarray, span) -> np.ndarray:
    """Numbers of the intervals between lines that lie in a span."""
    middle = (lines[:-1] + lines[1:]) / 2
    return np.flatnonzero((middle > span[0]) & (middle < span[1]))


def _in_plan(middle: np.ndarray, box) -> np.ndarray:
    """Numbers of the plane cells that lie in a box (x0, x1, y0, y1)."""
    x, y = middle.T
    return np.flatnonzero((x > box[0]) & (x < box[1]) & (y > box[2]) & (y < box[3]))


engraving_machine = made_by(EngravingMachine, in_cases=True)
