"""A cast bed and column joined by rings of transition material around bolts (seed 000, section 5).

A stand-in: of the engraving machine in seed 000 the text has the bolts, the materials and five
frequencies, while all dimensions of its frame were in a lost figure (Figure 14).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from fenics_joints.meshes.arguments import is_count, is_positive, requirement
from fenics_joints.meshes.extrude import Extrusion
from fenics_joints.meshes.plane import disc_grid, grid_lines, o_grid, tensor_grid
from fenics_joints.meshes.tagged import MeshLists, TaggedMesh, distribute
from fenics_joints.parallel import on_root

__all__ = ["engraving_machine", "number_of_bolts"]

FACET_NAMES = {"bottom": 1, "top": 2, "joint_lower": 3, "joint_upper": 4}
BODIES = ("bed", "column")
BOLTS = (5, 5)
#: Part of a ring's square that its polygon may reach, so that cells around it keep some width.
_ROOM = 0.98

_require = requirement("engraving_machine")


def engraving_machine(
    comm: MPI.Intracomm,
    *,
    bed: tuple[float, float, float] = (0.924, 1.39, 0.263),
    column: float = 1.165,
    arm: tuple[float, float] = (0.78, 0.262),
    wall: float = 0.033,
    flange: float = 0.025,
    gusset: float = 0.16,
    ribs: int = 3,
    bolts: tuple[int, int] = BOLTS,
    layer: float = 0.72e-3,
    r_nei: float = 0.00675,
    r_wai: float = 0.0514,
    zone: float | None = None,
    element_size: float = 0.12,
    n_layer: int = 1,
    cell: str = "hexahedron",
) -> TaggedMesh:
    """Mesh of a machine frame: a bed and a column with an arm, bolted flange to flange.

    A stand-in for the engraving machine of seed 000, section 5, whose dimensions are lost. Those
    of ``bed``, ``column``, ``arm``, ``wall`` and ``gusset`` by default are a fit to the first five
    frequencies that the paper computed (Table 12): with its materials and rings, iron of 7250 kg/m3
    and elements of 30 mm they come within 0.5 %, which therefore validates nothing. Elements of
    150 mm give 1 to 4 % more.

    The bed lies below z = 0: a plate, ``flange`` thick, on walls and ribs, open below as castings
    are. The column stands on a flange centred on x = y = 0: a hollow box with a hollow arm towards
    -y, where the bed goes on. The flange's bolts are in the outer rows of a grid of
    ``bolts`` places, each in a pocket between gussets above and ribs below, which are in line with
    the column's walls. Bed and column share no vertex: the rings of ``layer``, from R_nei to R_wai
    around each bolt, alone join them, and the flanges are apart elsewhere. Holes of radius R_nei
    go through both; the bolts themselves are left out, as in the seed. Circles are regular polygons
    of the same area. The frame is symmetric about x = 0.

    Parts: ``bed``, ``column``, and ``ring_1``, ``ring_2``, ... anticlockwise seen from above, from
    the corner of least x and y. Faces: ``bottom`` (rims of the bed's walls), ``top`` (of column
    and arm), ``joint_lower`` and ``joint_upper`` (between all rings and bed, column). Points:
    ``bolts``, the rings' centres at mid-height, and ``head``, the middle of the arm's end.

    Args:
        comm: Communicator; the call is collective, the lists are built on rank 0 alone.
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
            the package says of M12, 120 N·m, flanges of 25 mm (seed 000, Table 2).
        zone: Side of the square of each bolt's pocket, in metres; None: 2.25 r_wai.
        element_size: Longest side of an element, in metres; in a pocket at most half its side.
        n_layer: Elements through the rings.
        cell: ``"hexahedron"``, or ``"tetrahedron"`` for six of those in each hexahedron.

    Returns:
        The tagged mesh.

    Raises:
        MeshError: A dimension or count is impossible; the message names the argument, its value
            and what was expected.
    """
    cells = ("hexahedron", "tetrahedron")
    _require(cell in cells, "cell", cell, " or ".join(map(repr, cells)))
    _check_lengths("bed", bed, 3, "along x, y and z")
    _check_lengths("arm", arm, 2, "along -y and z")
    for name, size in (
        ("column", column), ("wall", wall), ("flange", flange), ("gusset", gusset),
        ("layer", layer), ("r_nei", r_nei), ("r_wai", r_wai), ("element_size", element_size),
    ):  # fmt: skip
        _require(is_positive(size), name, size, "a length above 0 m")
    _require(r_wai > r_nei, "r_wai", r_wai, f"a radius above r_nei = {r_nei:g} m")
    _require(is_count(n_layer), "n_layer", n_layer, "a whole number of at least 1")
    _require(is_count(ribs), "ribs", ribs, "a whole number of at least 1")
    fits = len(np.atleast_1d(bolts)) == 2 and all(is_count(n) and n >= 3 for n in bolts)
    _require(fits, "bolts", bolts, "two whole numbers of at least 3, places along x and y")
    zone = 2.25 * r_wai if zone is None else zone
    _require(is_positive(zone), "zone", zone, "a side above 0 m")
    frame = _Frame(tuple(bed), column, tuple(arm), wall, flange, gusset, ribs, tuple(bolts), layer,
                   zone)  # fmt: skip
    frame.check()
    machine = _Machine(frame, (r_nei, r_wai), element_size, n_layer, cell)
    reach = machine.corners()[1]
    expected = f"at least {2 * reach / _ROOM:g} m, for the polygon around r_wai = {r_wai:g} m"
    _require(2 * reach <= _ROOM * zone, "zone", zone, expected)
    return distribute(comm, on_root(comm, machine.lists))


def number_of_bolts(bolts: tuple[int, int] = BOLTS) -> int:
    """Number of bolts in the outer rows of a grid of ``bolts`` places."""
    return 2 * (bolts[0] + bolts[1]) - 4


def _check_lengths(name: str, lengths, n: int, which: str) -> None:
    fits = np.shape(lengths) == (n,) and all(map(is_positive, lengths))
    _require(fits, name, lengths, f"{n} lengths above 0 m, {which}")


@dataclass(frozen=True)
class _Frame:
    """Dimensions of a machine's frame; see ``engraving_machine``."""

    bed: tuple[float, float, float]
    column: float
    arm: tuple[float, float]
    wall: float
    flange: float
    gusset: float
    ribs: int
    bolts: tuple[int, int]
    layer: float
    zone: float

    def check(self) -> None:
        """Refuse what does not go together, with MeshError."""
        (width, length, height), (reach, tall) = self.bed, self.arm
        t, half = self.wall, self.half_flange
        least = 2 * (half[0] + t)
        _require(width >= least * (1 - 1e-9), "bed", self.bed, f"a width of at least {least:g} m")
        least = 2 * half[1] + (self.ribs + 3) * t
        _require(length > least, "bed", self.bed, f"a length above {least:g} m")
        _require(height > self.flange, "bed", self.bed, f"a height above {self.flange:g} m")
        least = self.zone + t
        expected = f"a length of at least {least:g} m, beyond the flange"
        _require(reach >= least * (1 - 1e-9), "arm", self.arm, expected)
        _require(tall > 2 * t, "arm", self.arm, f"a height above {2 * t:g} m")
        least = self.flange + self.gusset + tall
        _require(self.column > least, "column", self.column, f"more than {least:g} m")

    @property
    def half_flange(self) -> np.ndarray:
        """Half the flange's side along x and y."""
        n = np.array(self.bolts)
        return (n * self.zone + (n - 1) * self.wall) / 2

    @property
    def half_box(self) -> np.ndarray:
        """Half the column's outer side along x and y: the outer rows of bolts are outside it."""
        return self.half_flange - self.zone

    @property
    def y_bed(self) -> tuple[float, float]:
        """Front and rear of the bed."""
        rear = float(self.half_flange[1]) + self.wall
        return rear - self.bed[1], rear

    def centres(self) -> np.ndarray:
        """Centres (x, y) of the bolts, anticlockwise from the corner of least x and y."""
        (nx, ny), pitch = self.bolts, self.zone + self.wall
        i, j = np.arange(nx), np.arange(ny)
        places = np.vstack([
            np.column_stack([i[:-1], 0 * i[:-1]]), np.column_stack([0 * j[:-1] + nx - 1, j[:-1]]),
            np.column_stack([i[:0:-1], 0 * i[:0:-1] + ny - 1]),
            np.column_stack([0 * j[:0:-1], j[:0:-1]]),
        ])  # fmt: skip
        return (places - (np.array(self.bolts) - 1) / 2) * pitch

    def gaps(self, axis: int) -> list[tuple[float, float]]:
        """Where a wall, rib or gusset can pass between rows of bolts."""
        start, pitch = self.zone - float(self.half_flange[axis]), self.zone + self.wall
        return [(start + i * pitch, start + i * pitch + self.wall)
                for i in range(self.bolts[axis] - 1)]  # fmt: skip

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


@dataclass(frozen=True)
class _Machine:
    """A frame with its rings and the sizes of its elements."""

    frame: _Frame
    radii: tuple[float, float]
    size: float
    n_layer: int
    cell: str

    @property
    def n_zone(self) -> int:
        """Cells along each side of a pocket: an even number."""
        zone = self.frame.zone
        return 2 * int(np.ceil(zone / min(self.size, zone / 2) / 2 * (1 - 1e-9)))

    def corners(self) -> tuple[float, float]:
        """Radii at the corners of the regular polygons with the circles' areas."""
        angle = 2 * np.pi / (4 * self.n_zone)
        inner, outer = (float(r * np.sqrt(angle / np.sin(angle))) for r in self.radii)
        return inner, outer

    def lists(self) -> MeshLists:
        """The whole mesh."""
        frame, n = self.frame, len(BODIES)
        bolts = frame.centres()
        names = [*BODIES, *(f"ring_{i + 1}" for i in range(len(bolts)))]
        points, quads, ring = self.plan(bolts)
        middle = points[quads].mean(axis=1)
        below = grid_lines([-frame.bed[2], -frame.flange, 0.0], self.size)
        layer = np.linspace(0.0, frame.layer, self.n_layer + 1)
        above = grid_lines(frame.levels(), self.size)
        z = np.concatenate([below, layer[1:-1], above])
        rows = np.zeros((len(z) - 1, len(quads)), dtype=int)
        for tag, boxes in enumerate((frame.bed_boxes(), frame.column_boxes()), start=1):
            for box in boxes:
                rows[np.ix_(_inside(z, box[4:]), _in_plan(middle, box[:4]))] = tag
        first = len(below) - 1
        rows[first : first + self.n_layer] = np.where(ring > 0, n + ring, 0)
        # The holes end with the flanges: the arm may be above them.
        rows[np.ix_(_inside(z, (z[0], frame.layer + frame.flange)), np.flatnonzero(ring < 0))] = 0
        column = Extrusion(points, quads, z, rows, self.cell)
        for level, cells, name in (
            (0, rows[0] > 0, "bottom"), (len(z) - 1, rows[-1] > 0, "top"),
            (first, ring > 0, "joint_lower"), (first + self.n_layer, ring > 0, "joint_upper"),
        ):  # fmt: skip
            column.tag_level(level, cells, FACET_NAMES[name])
        head = 0.0, -frame.half_box[1] - frame.arm[0], z[-1] - frame.arm[1] / 2
        named = {"bolts": np.column_stack([bolts, np.full(len(bolts), frame.layer / 2)]),
                 "head": np.array([head])}  # fmt: skip
        cell_names = {name: i for i, name in enumerate(names, start=1)}
        return MeshLists(self.cell, *column.lists(), cell_names, dict(FACET_NAMES), named)

    def plan(self, bolts: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Plane points; cells; and the ring of each cell, from 1, or minus that of its hole."""
        x, y = self.lines(0), self.lines(1)
        points, quads = tensor_grid(x, y)
        number = np.arange(len(points)).reshape(len(x), len(y))
        ring, side = np.zeros(len(quads), dtype=int), self.frame.zone
        for i, centre in enumerate(bolts, start=1):
            square = number[_pocket(x, centre[0], side)][:, _pocket(y, centre[1], side)]
            outside = np.abs(points[quads].mean(axis=1) - centre).max(axis=1) > side / 2
            more, new, where = self.pocket(points, square, centre)
            points, quads = np.vstack([points, more]), np.vstack([quads[outside], new])
            ring = np.concatenate([ring[outside], i * where])
        return points, quads, ring

    def pocket(self, points, square, centre):
        """New points and cells inside a pocket; 1 for those in the ring, -1 in the hole."""
        sides = square[:-1, 0], square[-1, :-1], square[:0:-1, -1], square[0, :0:-1]
        loop = np.concatenate(sides)
        size, first, n = min(self.size, self.frame.zone / 2), len(points), len(loop)
        x, quads, circle = o_grid(loop, points[loop], centre, self.corners(), size, first)
        # The square's loop starts at its corner of least x and y, 3/8 of a turn before the x-axis.
        turn = np.roll(np.arange(n), -3 * n // 8)
        inner, disc = disc_grid(first + turn, x[turn] - centre, size, first + len(x), False)
        where = np.concatenate([np.where(circle == 1, 1, 0), np.full(len(disc), -1)])
        return np.vstack([x, inner + centre]), np.vstack([quads, disc]), where

    def lines(self, axis: int) -> np.ndarray:
        """Lines of the plan along x or y: all walls', and those of the pockets evenly spaced."""
        frame = self.frame
        boxes = np.array(frame.bed_boxes() + frame.column_boxes())
        step = np.linspace(-0.5, 0.5, self.n_zone + 1) * frame.zone
        own = frame.centres()[:, axis, None] + step
        return grid_lines([*boxes[:, 2 * axis : 2 * axis + 2].ravel(), *own.ravel()], self.size)


def _pocket(lines: np.ndarray, centre: float, side: float) -> np.ndarray:
    """Numbers of the lines across a pocket."""
    return np.flatnonzero(np.abs(lines - centre) < side / 2 * (1 + 1e-6))


def _inside(lines: np.ndarray, span) -> np.ndarray:
    """Numbers of the intervals between lines that lie in a span."""
    middle = (lines[:-1] + lines[1:]) / 2
    return np.flatnonzero((middle > span[0]) & (middle < span[1]))


def _in_plan(middle: np.ndarray, box) -> np.ndarray:
    """Numbers of the plane cells that lie in a box (x0, x1, y0, y1)."""
    x, y = middle.T
    return np.flatnonzero((x > box[0]) & (x < box[1]) & (y > box[2]) & (y < box[3]))
