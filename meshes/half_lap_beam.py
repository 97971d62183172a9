"""Two beams, each cut to half its height where they overlap, bolted in a row; or their section."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np

from fenics_joints.meshes.arguments import MOST_PLACES, Builder, Count, Gap, Size, Solid, made_by
from fenics_joints.meshes.facets import Skin
from fenics_joints.meshes.grid import PlaneGrid, count_intervals, extruded, grid_lines, tensor_grid
from fenics_joints.meshes.lap_beam import CELL_NAMES, lapped, lapped_groups
from fenics_joints.meshes.tagged import MeshLists

#: Side of an O-grid's square over the washer's diameter. Chosen: cells around it keep some width.
_ZONE = 1.25


@dataclass(frozen=True, kw_only=True)
class _HalfLap(Builder):
    """What the beam and its section have in common; see `HalfLapBeam`."""

    length: Size = 0.72
    thickness: Size = 12.7e-3
    lap: Size = 0.12
    gap: Size = 0.2e-3
    bolts: Count = 3
    washer: Gap = 0.015
    layer: Gap = 0.0
    bonded: bool = False
    n_length: Count = 12
    n_lap: Count = 12
    n_thickness: Count = 1
    # Of the bolts; a section has none.
    hole: ClassVar[float] = 0.0

    def check(self) -> None:
        """Refuse arguments that do not fit each other, with MeshError."""
        expected = f"less than length = {self.length:g} m"
        self.require(self.lap < self.length, "lap", expected)
        room = 0.5 * (self.length - self.lap)
        self.require(self.gap < room, "gap", f"less than {room:g} m, what is beside lap")
        expected = f"less than thickness = {self.thickness:g} m"
        self.require(self.layer < self.thickness, "layer", expected)
        expected = f"a whole number of at most {MOST_PLACES}"
        self.require(self.bolts <= MOST_PLACES, "bolts", expected)
        room, where = min(self.rooms())
        expected = f"0 m, or at most {room:g} m, {where}"
        self.require(self.washer <= room * (1 + 1e-9), "washer", expected)

    def rooms(self) -> Iterator[tuple[float, str]]:
        """What limits a washer, m, and why."""
        yield self.lap / (self.bolts + 1), f"the pitch of {self.bolts} bolts on the lap"

    def groups(self) -> tuple[list[str], list[str]]:
        """Names of the parts and of the faces."""
        faces = ["end_1", "end_2"]
        if self.washer > 0:
            numbers = range(1, self.bolts + 1)
            faces += [f"washer_{i}_{side}" for i in numbers for side in ("lower", "upper")]
        return lapped_groups(self.layer, self.bonded, [], faces)

    @property
    def start(self) -> float:
        """Where the lap begins along x; it ends at ``length - start``."""
        return 0.5 * (self.length - self.lap)

    @property
    def places(self) -> np.ndarray:
        """Where the bolts are along x, shape (n,)."""
        return self.start + self.lap * np.arange(1, self.bolts + 1) / (self.bolts + 1)

    def plan(self) -> tuple[np.ndarray, np.ndarray]:
        """Points and cells of the plan: lines along x, and in space the plane of x and y."""
        return tensor_grid(self.x_lines(self.washer, self.lap / self.n_lap))

    def grid(self) -> MeshLists:
        """Cells alone; beams that touch share vertices."""
        points, cells = self.plan()
        pieces = self.pieces(points[cells].mean(axis=1)[:, 0])
        return _joined([extruded(points, cells, *piece, self.cell, CELL_NAMES) for piece in pieces])

    def lists(self) -> MeshLists:
        """The whole mesh."""
        lists = self.with_faces(lapped(self.grid(), self.layer, self.bonded))
        bolts = np.zeros((self.bolts, 3))
        bolts[:, 0] = self.places
        return replace(lists, points={"bolts": bolts})

    def x_lines(self, side: float, size: float) -> np.ndarray:
        """Lines along the beam; ``side`` is that of the squares around the bolts."""
        free = np.linspace(0.0, self.start - self.gap, self.n_length + 1)
        lap = grid_lines(self.lap_edges(side), size)
        return np.concatenate([free, lap, self.length - free[::-1]])

    def lap_edges(self, side: float) -> list[float]:
        """Places along the lap that are lines; ``side`` is that of the squares."""
        around = np.concatenate([self.places - side / 2, self.places + side / 2])
        return [self.start, self.length - self.start, *around]

    def pieces(self, x: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Levels of beam 1, the layer and beam 2, and tags per layer of cells and place x.

        Only over the lap do the levels of the three meet, so none has cells as thin as the layer.
        """
        half, n, start = self.layer / 2, self.n_thickness, self.start
        end, outer = self.length - start, self.thickness / 2
        tongue, rest = (np.linspace(*ends, n + 1) for ends in ((-outer, -half), (-half, outer)))
        lower = np.concatenate([tongue, rest[1:]])
        thick = np.where(x < start - self.gap, CELL_NAMES["beam_1"], 0)
        tongue = np.where(x < end, CELL_NAMES["beam_1"], 0)
        yield lower + 0.0, np.array([tongue] * n + [thick] * n)
        if half > 0:
            yield (
                np.array([-half, half]),
                np.array([np.where((x > start) & (x < end), CELL_NAMES["joint"], 0)]),
            )
        thick = np.where(x > end + self.gap, CELL_NAMES["beam_2"], 0)
        tongue = np.where(x > start, CELL_NAMES["beam_2"], 0)
        yield -lower[::-1] + 0.0, np.array([thick] * n + [tongue] * n)

    def with_faces(self, lists: MeshLists) -> MeshLists:
        """Ends, washers and walls of holes."""
        skin, height, outer = Skin(lists), lists.x.shape[1] - 1, self.thickness / 2
        faces = {"end_1": skin.at(0, 0.0), "end_2": skin.at(0, self.length)}
        axes = np.zeros((self.bolts, height))
        axes[:, 0] = self.places
        distance, nearest = skin.from_axes(axes, 2 if self.hole > 0 else np.inf)
        under = skin.within(distance, self.washer / 2)
        for bolt in range(self.bolts if self.washer > 0 else 0):
            own = under & (nearest == bolt)
            faces[f"washer_{bolt + 1}_lower"] = own & skin.at(height, -outer)
            faces[f"washer_{bolt + 1}_upper"] = own & skin.at(height, outer)
        if self.hole > 0:
            faces["holes"] = skin.equal(distance, self.hole / 2)
        return skin.named(faces)


@dataclass(frozen=True, kw_only=True)
class HalfLapBeam(_HalfLap):
    """A straight beam of two halves, each cut to half its height over the lap in its middle.

    The defaults are about the Brake-Reuss beam as it was tested by Chen et al. (Mechanical Systems
    and Signal Processing 166, 2022, 108401): demos/half_lap_beam has it.

    The beam spans x from 0 to ``length``, y from ``-width / 2`` to ``width / 2`` and z from
    ``-thickness / 2`` to ``thickness / 2``. Beam 1 begins at x = 0; over the lap it is the lower
    half, and beam 2 the upper one. The steps at both ends of the lap stay clear of the other beam
    by ``gap``. Bolts divide the lap into equal lengths, ``lap / (bolts + 1)`` from each to the
    next. Without ``hole`` they are there as the squares of side ``washer`` that they press; with
    it, round holes go through in O-grids, and the washers are rings. A hole is a polygon whose
    corners lie on the circle.

    Parts: ``beam_1``, ``beam_2``. Faces: ``end_1`` (x = 0), ``end_2``; ``washer_1_lower``,
    ``washer_1_upper``, ``washer_2_lower``, ... (under the washers of each bolt, lower on beam 1);
    ``holes`` if there are any; and ``interface_lower``, ``interface_upper``, where the beams touch:
    they share no vertex. With ``bonded=True`` they share their vertices over the lap, the one face
    ``interface``. With a ``layer`` above 0 a layer of that thickness, one element thick, lies in
    the middle of the lap and shares vertices with the beams, of which it takes half each: the beam
    is as high as without. Then there is a part ``joint``, and the faces ``joint_lower``,
    ``joint_upper`` lie between it and the beams.

    Points: ``bolts``, on their axes at z = 0.

    Attributes:
        length: Length of the whole beam, in metres.
        width: Width of the beam, in metres.
        thickness: Height of the beam, in metres.
        lap: Length of the overlap, in metres.
        gap: Clearance at both ends of the lap, in metres.
        bolts: Number of the bolts.
        washer: Side of the squares that the bolts press, or with holes the washers' outer diameter,
            in metres; 0 for none.
        hole: Diameter of the bolts' holes, in metres; 0 for none.
        layer: Thickness of the joint layer, in metres; 0 for none.
        bonded: Whether the beams share vertices; a ``layer`` always does.
        n_length: Elements along each beam outside the lap.
        n_lap: Elements along the lap, or a few more: lines pass through the edges of the squares.
        n_width: Elements across the beam, or a few more.
        n_thickness: Elements through each half of the height.
        cell: ``"hexahedron"``, or ``"tetrahedron"`` for six of those in each hexahedron.

    Raises:
        MeshError: A dimension or count is impossible; the message names the argument, its value
            and what was expected.
    """

    function: ClassVar[str] = "half_lap_beam"

    width: Size = 0.0254
    hole: Gap = 0.0
    n_width: Count = 4
    cell: Solid = "hexahedron"

    def check(self) -> None:
        """Refuse arguments that do not fit each other, with MeshError."""
        super().check()
        if self.hole > 0:
            expected = f"0 m, or less than washer = {self.washer:g} m"
            self.require(self.hole < self.washer, "hole", expected)

    def rooms(self) -> Iterator[tuple[float, str]]:
        """What limits a washer, m, and why."""
        share, why = 1.0, ""
        if self.hole > 0:
            share, why = 1 / _ZONE, f", over {_ZONE:g} for the mesh around holes"
        for room, words in (*super().rooms(), (self.width, "the width")):
            yield share * room, words + why

    def groups(self) -> tuple[list[str], list[str]]:
        """Names of the parts and of the faces."""
        cells, faces = super().groups()
        return cells, faces + (["holes"] if self.hole > 0 else [])

    def bricks(self) -> list[tuple[float, float, float]]:
        """About how many cells the two beams and the layer have along x, y and z."""
        side, size_x, size_y = self.sizes()
        lap, n = count_intervals(self.lap_edges(side), size_x), self.n_thickness
        n_y = count_intervals(self.y_edges(side), size_y)
        pieces = [(self.n_length + 1, n_y, 2 * n), (lap, n_y, n)] * 2
        return [*pieces, (lap, n_y, 1)] if self.layer > 0 else pieces

    def sizes(self) -> tuple[float, float, float]:
        """Side of the squares around the bolts, longest elements along x and y, m."""
        sizes = self.lap / self.n_lap, self.width / self.n_width
        if self.hole == 0:
            return self.washer, *sizes
        side = _ZONE * self.washer
        return side, *(min(size, side / 4) for size in sizes)

    def y_edges(self, side: float) -> list[float]:
        """Places across the beam that are lines."""
        return [-self.width / 2, -side / 2, side / 2, self.width / 2]

    def plan(self) -> tuple[np.ndarray, np.ndarray]:
        """Points and cells of the plane of x and y."""
        side, *sizes = self.sizes()
        plan = PlaneGrid(self.x_lines(side, sizes[0]), grid_lines(self.y_edges(side), sizes[1]))
        for place in self.places if self.hole > 0 else ():
            radii = self.hole / 2, self.washer / 2
            plan.fill(np.array([place, 0.0]), side, radii, min(sizes))
        return plan.points, plan.quads


@dataclass(frozen=True, kw_only=True)
class HalfLapBeamSection(_HalfLap):
    """The section of `HalfLapBeam` along the beam: the plane of x and its z, which is y here.

    A model on it has a width of 1 m. Parts, faces and points have the same names, and the arguments
    are the same but for the ``width``, ``hole``, ``n_width`` and the ``cell``:
    ``"quadrilateral"``, or ``"triangle"`` for two of those in each.
    """

    function: ClassVar[str] = "half_lap_beam_section"

    cell: Literal["quadrilateral", "triangle"] = "quadrilateral"


def _joined(lists: list[MeshLists]) -> MeshLists:
    """Meshes as one, in which vertices at the same place, to the last bit, are one."""
    first = np.cumsum([0, *(len(piece.x) for piece in lists)])
    x, number = np.unique(np.vstack([piece.x for piece in lists]), axis=0, return_inverse=True)
    number = number.ravel()
    cells = [piece.cells + start for piece, start in zip(lists, first[:-1], strict=True)]
    values = np.concatenate([piece.cell_values for piece in lists])
    return replace(lists[0], x=x, cells=number[np.vstack(cells)], cell_values=values)


half_lap_beam = made_by(HalfLapBeam, in_cases=True)
half_lap_beam_section = made_by(HalfLapBeamSection)
