"""Two plates lapped over a bolted joint with a thin layer between them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from fenics_joints.meshes.arguments import is_count, is_positive, requirement
from fenics_joints.meshes.extrude import Extrusion
from fenics_joints.meshes.plane import grid_lines, o_grid, tensor_grid
from fenics_joints.meshes.tagged import MeshLists, TaggedMesh, distribute
from fenics_joints.parallel import on_root

__all__ = ["lap_plates"]

CELL_NAMES = {"plate_1": 1, "plate_2": 2, "joint_near": 3, "joint_away": 4}
FACET_NAMES = {
    "end_1": 1, "end_2": 2, "bottom": 3, "top": 4,
    "joint_lower": 5, "joint_upper": 6, "interface": 7, "holes": 8, "washers": 9,
}  # fmt: skip
BOLTS = ((0.14, 0.02), (0.14, 0.06), (0.18, 0.02), (0.18, 0.06))

_require = requirement("lap_plates")


def lap_plates(
    comm: MPI.Intracomm,
    *,
    length: float = 0.2,
    width: float = 0.08,
    thickness: float = 0.008,
    lap: float = 0.08,
    layer: float = 0.5e-3,
    element_size: float = 5e-3,
    n_length: int | None = None,
    n_width: int | None = None,
    n_thickness: int = 2,
    bolts: Sequence[tuple[float, float]] = BOLTS,
    zone: float = 0.02,
    hole_diameter: float | None = None,
    washer_diameter: float | None = None,
    cell: str = "hexahedron",
) -> TaggedMesh:
    """Mesh of two equal plates that overlap by ``lap``, with a joint layer one element thick.

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

    Args:
        comm: Communicator; the call is collective, the lists are built on rank 0 alone.
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

    Returns:
        The tagged mesh.

    Raises:
        MeshError: A dimension or count is impossible, or a zone leaves the lap; the message names
            the argument, its value and what was expected.
    """
    _check_dimensions(length, width, thickness, lap, layer, n_thickness, cell)
    size_x = _size("n_length", n_length, length, element_size)
    size_y = _size("n_width", n_width, width, element_size)
    pairs = all(np.shape(bolt) == (2,) for bolt in bolts)
    _require(pairs, "bolts", bolts, "a pair (x, y) in metres for each bolt")
    bolts = np.array(bolts, dtype=float).reshape(-1, 2)
    _check_zones(bolts, zone, (length - lap, length), (0.0, width))
    radii = _check_holes(bolts, zone, hole_diameter, washer_diameter)
    if radii:
        size_x, size_y = min(size_x, zone / 4), min(size_y, zone / 4)
    form = _LapPlates(length, width, thickness, lap, layer, n_thickness, bolts, zone, radii, cell)
    return distribute(comm, on_root(comm, lambda: form.lists(size_x, size_y)))


@dataclass(frozen=True)
class _LapPlates:
    """Checked dimensions of lap plates; see ``lap_plates``."""

    length: float
    width: float
    thickness: float
    lap: float
    layer: float
    n_thickness: int
    bolts: np.ndarray
    zone: float
    radii: tuple[float, ...]
    cell: str

    def lists(self, size_x: float, size_y: float) -> MeshLists:
        """The whole mesh with elements not longer than the sizes, in metres."""
        x, y = self.lines(size_x, size_y)
        points, quads = tensor_grid(x, y)
        left = np.arange(len(y))
        right = left + len(points) - len(y)
        points, quads, circle, rims = self.drill(x, y, points, quads, min(size_x, size_y))
        middle = points[quads].mean(axis=1)
        column = Extrusion(points, quads, self.levels(), self.values(middle), self.cell)
        self.tag_faces(column, middle, circle == 1, _chain(left), _chain(right), rims)
        centres = np.full((len(self.bolts), 3), self.thickness + self.layer / 2)
        centres[:, :2] = self.bolts
        return MeshLists(self.cell, *column.lists(), CELL_NAMES, FACET_NAMES, {"bolts": centres})

    def lines(self, size_x: float, size_y: float) -> tuple[np.ndarray, np.ndarray]:
        half = self.zone / 2
        around = np.concatenate([self.bolts - half, self.bolts + half])
        x = [0.0, self.length - self.lap, self.length, 2 * self.length - self.lap, *around[:, 0]]
        return grid_lines(x, size_x), grid_lines([0.0, self.width, *around[:, 1]], size_y)

    def drill(self, x, y, points, quads, size):
        """Replace the inside of each zone by an O-grid around the bolt's hole, if there are holes.

        Returns:
            Points; cells; the circle of each cell, 1 within the washer; the holes' edges, (n, 2).
        """
        circle, rims = np.zeros(len(quads), dtype=int), [np.empty((0, 2), dtype=np.int64)]
        for bolt in self.bolts if self.radii else ():
            loop = self.loop(bolt, x, y)
            outside = np.abs(points[quads].mean(axis=1) - bolt).max(axis=1) > self.zone / 2
            new = o_grid(loop, points[loop], bolt, self.radii, size, len(points))
            rim = len(points) + np.arange(len(loop))
            rims.append(_chain(np.append(rim, rim[0])))
            points = np.vstack([points, new[0]])
            quads = np.vstack([quads[outside], new[1]])
            circle = np.concatenate([circle[outside], new[2]])
        return points, quads, circle, np.vstack(rims)

    def loop(self, bolt, x, y) -> np.ndarray:
        """Numbers of the grid points on the boundary of the bolt's zone, anticlockwise."""
        i0, i1 = _nearest(x, bolt[0] - self.zone / 2), _nearest(x, bolt[0] + self.zone / 2)
        j0, j1 = _nearest(y, bolt[1] - self.zone / 2), _nearest(y, bolt[1] + self.zone / 2)
        i, j = np.arange(i0, i1 + 1), np.arange(j0, j1 + 1)
        n = len(y)
        sides = i[:-1] * n + j0, i1 * n + j[:-1], i[:0:-1] * n + j1, i0 * n + j[:0:-1]
        return np.concatenate(sides)

    def levels(self) -> np.ndarray:
        plate = np.linspace(0.0, self.thickness, self.n_thickness + 1)
        upper = plate + self.thickness + self.layer
        return np.concatenate([plate, upper if self.layer > 0 else upper[1:]])

    def values(self, middle: np.ndarray) -> np.ndarray:
        """Cell tags per layer of cells and plane cell, whose centres are ``middle``, (n, 2)."""
        first, second, lap = self.regions(middle)
        from_bolts = np.abs(middle[:, None, :] - self.bolts).max(axis=2)
        near = (from_bolts < self.zone / 2).any(axis=1)
        joint = np.where(near, CELL_NAMES["joint_near"], CELL_NAMES["joint_away"])
        rows = [np.where(first, CELL_NAMES["plate_1"], 0)] * self.n_thickness
        if self.layer > 0:
            rows.append(np.where(lap, joint, 0))
        rows += [np.where(second, CELL_NAMES["plate_2"], 0)] * self.n_thickness
        return np.array(rows)

    def regions(self, middle: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Which plane cells belong to plate 1, to plate 2 and to the lap."""
        first = middle[:, 0] < self.length
        second = middle[:, 0] > self.length - self.lap
        return first, second, first & second

    def tag_faces(self, column, middle, washer, left, right, rims) -> None:
        first, second, lap = self.regions(middle)
        n, last = self.n_thickness, len(column.z) - 1
        column.tag_wall(left, np.arange(n), FACET_NAMES["end_1"])
        column.tag_wall(right, np.arange(last - n, last), FACET_NAMES["end_2"])
        column.tag_level(0, first & ~washer, FACET_NAMES["bottom"])
        column.tag_level(last, second & ~washer, FACET_NAMES["top"])
        column.tag_wall(rims, np.arange(last), FACET_NAMES["holes"])
        for level in (0, last):
            column.tag_level(level, washer, FACET_NAMES["washers"])
        if self.layer > 0:
            column.tag_level(n, lap, FACET_NAMES["joint_lower"])
            column.tag_level(n + 1, lap, FACET_NAMES["joint_upper"])
        else:
            column.tag_level(n, lap, FACET_NAMES["interface"])


def _nearest(lines: np.ndarray, position: float) -> int:
    return int(np.abs(lines - position).argmin())


def _chain(points: np.ndarray) -> np.ndarray:
    return np.column_stack([points[:-1], points[1:]])


def _check_dimensions(length, width, thickness, lap, layer, n_thickness, cell) -> None:
    sizes = {"length": length, "width": width, "thickness": thickness, "lap": lap}
    for name, value in sizes.items():
        _require(is_positive(value), name, value, "a length above 0 m")
    _require(lap < length, "lap", lap, f"less than length = {length:g} m")
    _require(layer == 0 or is_positive(layer), "layer", layer, "0 m or a thickness above it")
    _require(is_count(n_thickness), "n_thickness", n_thickness, "a whole number of at least 1")
    cells = "'hexahedron' or 'tetrahedron'"
    _require(cell in ("hexahedron", "tetrahedron"), "cell", cell, cells)


def _size(name: str, count: int | None, span: float, element_size: float) -> float:
    if count is None:
        _require(is_positive(element_size), "element_size", element_size, "a size above 0 m")
        return element_size
    _require(is_count(count), name, count, "a whole number of at least 1")
    return span / count


def _check_zones(bolts, zone, x_range, y_range) -> None:
    _require(zone == 0 or is_positive(zone), "zone", zone, "0 m or a side above it")
    for number, bolt in enumerate(bolts.tolist()):
        for axis, value, (low, high) in zip("xy", bolt, (x_range, y_range), strict=True):
            room = min(value - low, high - value)
            span = f"{low:g} to {high:g} m of the lap along {axis}"
            where = f"bolts[{number}] {axis}"
            _require(room > 0, where, value, f"a position within {span}")
            fits = zone / 2 <= room + 1e-9 * (high - low)
            expected = f"at most {2 * room:g} m, so that the zone of {where} = {value:g} m stays "
            _require(fits, "zone", zone, expected + f"within {span}")


def _check_holes(bolts, zone, hole, washer) -> tuple[float, ...]:
    """Radii of the hole and the washer, those that are given."""
    if hole is None:
        _require(washer is None, "washer_diameter", washer, "None when hole_diameter is None")
        return ()
    # The O-grid needs room between the outer circle and the square.
    room = f"at most 0.9 * zone = {0.9 * zone:g} m"
    fits = is_positive(hole) and hole <= 0.9 * zone
    _require(fits, "hole_diameter", hole, "a diameter above 0 m and " + room)
    for number, bolt in enumerate(bolts):
        for other in range(number):
            gap = np.abs(bolt - bolts[other]).max()
            pair = f"the distance of bolts[{other}] and bolts[{number}], {gap:g} m, with holes"
            _require(zone <= gap * (1 + 1e-9), "zone", zone, "at most " + pair)
    if washer is None:
        return (hole / 2,)
    expected = f"more than hole_diameter = {hole:g} m and {room}"
    fits = math.isfinite(washer) and hole < washer <= 0.9 * zone
    _require(fits, "washer_diameter", washer, expected)
    return hole / 2, washer / 2
