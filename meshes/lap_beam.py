"""Two beams that overlap in a bolted lap, clamped at one end; solid, or their section."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np

from fenics_joints.meshes.arguments import Builder, Count, Gap, Size, Solid, is_positive, made_by
from fenics_joints.meshes.facets import Skin, name_between, separate
from fenics_joints.meshes.grid import count_intervals, extruded, grid_lines, tensor_grid
from fenics_joints.meshes.tagged import MeshLists

CELL_NAMES = {"beam_1": 1, "beam_2": 2, "joint": 3, "root": 4}


def _between(layer: float, bonded: bool) -> dict[str, tuple[str, str]]:
    """Faces between two beams: the part that each belongs to, and the part on its other side."""
    if layer > 0:
        return {"joint_lower": ("beam_1", "joint"), "joint_upper": ("beam_2", "joint")}
    if bonded:
        return {"interface": ("beam_1", "beam_2")}
    return {"interface_lower": ("beam_1", "beam_2"), "interface_upper": ("beam_2", "beam_1")}


def lapped_groups(
    layer: float, bonded: bool, cells: Sequence[str], faces: Sequence[str]
) -> tuple[list[str], list[str]]:
    """Names of the parts and of the faces of two beams, one on the other.

    Args:
        layer: Thickness of the layer between them, in metres.
        bonded: Whether they share vertices.
        cells: Names of other parts than those of the beams and the layer.
        faces: Names of other faces than those between the beams.
    """
    joint = ["joint"] if layer > 0 else []
    return ["beam_1", "beam_2", *cells, *joint], [*faces, *_between(layer, bonded)]


def lapped(lists: MeshLists, layer: float, bonded: bool) -> MeshLists:
    """The mesh with faces between the beams, which are made separate bodies if they are to be.

    Args:
        lists: The mesh; beams that touch share vertices.
        layer: Thickness of the layer between the beams, in metres.
        bonded: Whether they go on to share vertices; those of a layer always do.
    """
    faces = _between(layer, bonded)
    if layer > 0 or bonded:
        return name_between(lists, faces)
    bodies = [("root", "beam_1"), "joint", "beam_2"]
    return separate(lists, bodies, {("beam_1", "beam_2"): tuple(faces)})


@dataclass(frozen=True, kw_only=True)
class _Lap(Builder):
    """What the beams and their section have in common; see `LapBeam`."""

    length: Size = 0.235
    thickness: Size = 6e-3
    lap: Size = 0.05
    washer: Gap = 0.01
    layer: Gap = 0.0
    root: Gap = 0.0
    bonded: bool = False
    n_length: Count = 12
    n_lap: Count = 10
    n_thickness: Count = 1

    def check(self) -> None:
        """Refuse arguments that do not fit each other, with MeshError."""
        expected = f"less than length = {self.length:g} m"
        self.require(self.lap < self.length, "lap", expected)
        room = self.room()
        fits = self.washer == 0 or (is_positive(self.washer) and self.washer <= room)
        expected = f"0 m, or a side above it of at most {room:g} m"
        self.require(fits, "washer", expected)

    def room(self) -> float:
        """Largest side of a washer, m."""
        return self.lap

    def groups(self) -> tuple[list[str], list[str]]:
        """Names of the parts and of the faces."""
        faces = ["clamp", "tip"]
        faces += ["washer_lower", "washer_upper"] if self.washer > 0 else []
        return lapped_groups(self.layer, self.bonded, ["root"] if self.root > 0 else [], faces)

    @property
    def bolt(self) -> float:
        """Where the bolt is along x."""
        return self.length - self.lap / 2

    @property
    def end(self) -> float:
        """Where the free end is along x."""
        return 2 * self.length - self.lap

    @property
    def outer(self) -> float:
        """Height of the outer faces, above and below 0."""
        return self.thickness + self.layer / 2

    def lines(self) -> list[np.ndarray]:
        """Lines of the plan: along the beams, and in space also across them."""
        return [self.x_lines()]

    def grid(self) -> MeshLists:
        """Cells alone."""
        points, cells = tensor_grid(*self.lines())
        values = self.values(points[cells][:, :, 0].mean(axis=1))
        return extruded(points, cells, self.levels(), values, self.cell, CELL_NAMES)

    def lists(self) -> MeshLists:
        """The whole mesh."""
        lists = self.with_faces(lapped(self.grid(), self.layer, self.bonded))
        tip = [self.end, self.outer] if lists.x.shape[1] == 2 else [self.end, 0.0, self.outer]
        points = {"bolt": np.array([[self.bolt, 0.0, 0.0]]), "tip": np.array([[*tip, 0.0][:3]])}
        return replace(lists, points=points)

    def x_lines(self) -> np.ndarray:
        start = self.length - self.lap
        free = np.linspace(0.0, start, self.n_length + 1)
        lap = grid_lines(self.lap_edges(), self.lap / self.n_lap)
        root = [-self.root] if self.root > 0 else []
        return np.concatenate([root, free[:-1], lap, self.length + free[1:]])

    def lap_edges(self) -> list[float]:
        half = self.washer / 2
        return [self.length - self.lap, self.bolt - half, self.bolt + half, self.length]

    def levels(self) -> np.ndarray:
        up = np.linspace(0.0, self.thickness, self.n_thickness + 1) + self.layer / 2
        return np.concatenate([-up[::-1], up if self.layer > 0 else up[1:]])

    def values(self, x: np.ndarray) -> np.ndarray:
        """Cell tags per layer of cells and plane cell, whose centres are at ``x``."""
        first, second = x < self.length, x > self.length - self.lap
        lower = np.where(x < 0, CELL_NAMES["root"], first * CELL_NAMES["beam_1"])
        rows = [lower] * self.n_thickness
        if self.layer > 0:
            rows.append((first & second) * CELL_NAMES["joint"])
        rows += [second * CELL_NAMES["beam_2"]] * self.n_thickness
        return np.array(rows)

    def with_faces(self, lists: MeshLists) -> MeshLists:
        skin, height = Skin(lists), lists.x.shape[1] - 1
        bolt = np.array([[self.bolt, 0.0][:height]])
        off, _ = skin.from_axes(bolt, np.inf)
        pressed = skin.within(off, self.washer / 2) & (self.washer > 0)
        return skin.named(
            {
                "clamp": skin.at(0, -self.root),
                "tip": skin.at(0, self.end),
                "washer_lower": pressed & skin.at(height, -self.outer),
                "washer_upper": pressed & skin.at(height, self.outer),
            }
        )


@dataclass(frozen=True, kw_only=True)
class LapBeam(_Lap):
    """Two equal beams that overlap by ``lap``, one on the other.

    The defaults are the lap beam of Iranzad and Ahmadian 2012, which has no size of washers.

    Beam 1 spans x from 0 to ``length`` and lies below z = 0; beam 2 lies above it and spans x from
    ``length - lap`` to ``2 * length - lap``. Both span y from ``-width / 2`` to ``width / 2``. A
    bolt in the middle of the lap is there as the squares of side ``washer`` that its washers press;
    there is no hole.

    The lines of the grid pass through the washers' edges, and lie between them and the edges of
    the lap as densely as ``n_lap`` and ``n_width`` elements do, or a little more.

    Parts: ``beam_1``, ``beam_2``. Faces: ``clamp`` (x = 0, of beam 1), ``tip`` (the free end of
    beam 2), ``washer_lower`` (on the outer face of beam 1), ``washer_upper`` (of beam 2), and
    ``interface_lower``, ``interface_upper``, where the beams touch: they share no vertex. With
    ``bonded=True`` they share their vertices over the lap, the one face ``interface``. With a
    ``layer`` above 0 a layer of that thickness, one element thick, lies between the beams and
    shares vertices with them, and they move apart by half of it each. Then there is a part
    ``joint``, and the faces ``joint_lower``, ``joint_upper`` lie between it and the beams. With a
    ``root`` above 0 a layer of that thickness, one element thick, lies before x = 0, the part
    ``root``: a clamp that may give way. Then ``clamp`` is the end of that.

    Points: ``bolt``, in the middle of the lap at z = 0, and ``tip``, on the outer face of beam 2 in
    the middle of its free end.

    Attributes:
        length: Length of each beam, in metres.
        width: Width of the beams, in metres.
        thickness: Thickness of each beam, in metres.
        lap: Length of the overlap, in metres.
        washer: Side of the squares that the bolt presses, in metres; 0 for none.
        layer: Thickness of the joint layer, in metres; 0 for none.
        root: Thickness of the layer at the clamp, in metres; 0 for none.
        bonded: Whether the beams share vertices; a ``layer`` always does.
        n_length: Elements along each beam outside the lap.
        n_lap: Elements along the lap.
        n_width: Elements across the beams.
        n_thickness: Elements through each beam.
        cell: ``"hexahedron"``, or ``"tetrahedron"`` for six of those in each hexahedron.

    Raises:
        MeshError: A dimension or count is impossible; the message names the argument, its value
            and what was expected.
    """

    function: ClassVar[str] = "lap_beam"

    width: Size = 0.0254
    n_width: Count = 5
    cell: Solid = "hexahedron"

    def room(self) -> float:
        """Largest side of a washer, m."""
        return min(self.lap, self.width)

    def lines(self) -> list[np.ndarray]:
        """Lines of the plan along and across the beams."""
        return [self.x_lines(), grid_lines(self.y_edges(), self.width / self.n_width)]

    def bricks(self) -> list[tuple[float, float, float]]:
        """About how many cells the two beams and the layer have along x, y and z."""
        lap = count_intervals(self.lap_edges(), self.lap / self.n_lap)
        n_y = count_intervals(self.y_edges(), self.width / self.n_width)
        beams = [(self.n_length + lap, n_y, self.n_thickness)] * 2
        return [*beams, (lap, n_y, 1)] if self.layer > 0 else beams

    def y_edges(self) -> list[float]:
        half, edge = self.washer / 2, self.width / 2
        return [-edge, -half, half, edge]


@dataclass(frozen=True, kw_only=True)
class LapBeamSection(_Lap):
    """The section of `LapBeam` along the beams: the plane of x and its z, which is y here.

    A model on it has a width of 1 m. Parts, faces and points have the same names, and the arguments
    are the same but for the ``width``, ``n_width`` and the ``cell``: ``"quadrilateral"``, or
    ``"triangle"`` for two of those in each.
    """

    function: ClassVar[str] = "lap_beam_section"

    cell: Literal["quadrilateral", "triangle"] = "quadrilateral"


lap_beam = made_by(LapBeam, in_cases=True)
lap_beam_section = made_by(LapBeamSection)
