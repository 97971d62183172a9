"""Two beams that overlap in a bolted lap, clamped at one end; solid, or their section."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI

from fenics_joints.meshes.arguments import is_count, is_positive, requirement
from fenics_joints.meshes.extrude import Extrusion
from fenics_joints.meshes.plane import flat_lists, grid_lines, tensor_grid
from fenics_joints.meshes.separate import separate
from fenics_joints.meshes.skin import add_faces, exterior_facets, facets_between
from fenics_joints.meshes.tagged import MeshLists, TaggedMesh, distribute
from fenics_joints.parallel import on_root

__all__ = ["lap_beam", "lap_beam_section"]

CELL_NAMES = {"beam_1": 1, "beam_2": 2, "joint": 3, "root": 4}
_TOLERANCE = 1e-9  # of a vertex on a plane, relative to the length

_require = requirement("lap_beam")


def lap_beam(
    comm: MPI.Intracomm,
    *,
    length: float = 0.235,
    width: float = 0.0254,
    thickness: float = 6e-3,
    lap: float = 0.05,
    washer: float = 0.01,
    layer: float = 0.0,
    root: float = 0.0,
    bonded: bool = False,
    n_length: int = 12,
    n_lap: int = 10,
    n_width: int = 5,
    n_thickness: int = 1,
    cell: str = "hexahedron",
) -> TaggedMesh:
    """Mesh of two equal beams that overlap by ``lap``, one on the other.

    The defaults are the lap beam of seed 003; the washers' size is not printed there.

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

    Args:
        comm: Communicator; the call is collective, the lists are built on rank 0 alone.
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

    Returns:
        The tagged mesh.

    Raises:
        MeshError: A dimension or count is impossible; the message names the argument, its value
            and what was expected.
    """
    sizes = {"length": length, "width": width, "thickness": thickness, "lap": lap}
    counts = {
        "n_length": n_length, "n_lap": n_lap, "n_width": n_width, "n_thickness": n_thickness,
    }  # fmt: skip
    _check(sizes, washer, layer, root, counts)
    cells = "'hexahedron' or 'tetrahedron'"
    _require(cell in ("hexahedron", "tetrahedron"), "cell", cell, cells)
    form = _LapBeam(
        length, width, thickness, lap, washer, layer, root, bonded, n_length, n_lap, n_width,
        n_thickness, cell,
    )  # fmt: skip
    return distribute(comm, on_root(comm, form.lists))


def lap_beam_section(
    comm: MPI.Intracomm,
    *,
    length: float = 0.235,
    thickness: float = 6e-3,
    lap: float = 0.05,
    washer: float = 0.01,
    layer: float = 0.0,
    root: float = 0.0,
    bonded: bool = False,
    n_length: int = 12,
    n_lap: int = 10,
    n_thickness: int = 1,
    cell: str = "quadrilateral",
) -> TaggedMesh:
    """Mesh of the section of `lap_beam` along the beams: the plane of x and its z, which is y here.

    A model on it has a width of 1 m. Parts, faces and points have the same names.

    Args:
        comm: Communicator; the call is collective, the lists are built on rank 0 alone.
        length: Length of each beam, in metres.
        thickness: Thickness of each beam, in metres.
        lap: Length of the overlap, in metres.
        washer: Length that the bolt presses, in metres; 0 for none.
        layer: Thickness of the joint layer, in metres; 0 for none.
        root: Thickness of the layer at the clamp, in metres; 0 for none.
        bonded: Whether the beams share vertices; a ``layer`` always does.
        n_length: Elements along each beam outside the lap.
        n_lap: Elements along the lap.
        n_thickness: Elements through each beam.
        cell: ``"quadrilateral"``, or ``"triangle"`` for two of those in each.

    Returns:
        The tagged mesh.

    Raises:
        MeshError: As `lap_beam`.
    """
    sizes = {"length": length, "thickness": thickness, "lap": lap}
    counts = {"n_length": n_length, "n_lap": n_lap, "n_thickness": n_thickness}
    _check(sizes, washer, layer, root, counts)
    cells = "'quadrilateral' or 'triangle'"
    _require(cell in ("quadrilateral", "triangle"), "cell", cell, cells)
    form = _LapBeam(
        length, None, thickness, lap, washer, layer, root, bonded, n_length, n_lap, None,
        n_thickness, cell,
    )  # fmt: skip
    return distribute(comm, on_root(comm, form.lists))


@dataclass(frozen=True)
class _LapBeam:
    """Checked dimensions of a lap beam; of its section if the width is None. See ``lap_beam``."""

    length: float
    width: float | None
    thickness: float
    lap: float
    washer: float
    layer: float
    root: float
    bonded: bool
    n_length: int
    n_lap: int
    n_width: int | None
    n_thickness: int
    cell: str

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

    def lists(self) -> MeshLists:
        """The whole mesh."""
        lists = self.section() if self.width is None else self.solid()
        lists = self.with_faces(self.with_interface(lists))
        tip = [self.end, self.outer, 0.0] if self.width is None else [self.end, 0.0, self.outer]
        points = {"bolt": np.array([[self.bolt, 0.0, 0.0]]), "tip": np.array([tip])}
        return replace(lists, points=points)

    def solid(self) -> MeshLists:
        points, quads = tensor_grid(self.x_lines(), self.y_lines())
        values = self.values(points[quads][:, :, 0].mean(axis=1))
        column = Extrusion(points, quads, self.levels(), values, self.cell)
        return MeshLists(self.cell, *column.lists(), CELL_NAMES, {})

    def section(self) -> MeshLists:
        x = self.x_lines()
        points, quads = tensor_grid(x, self.levels())
        # Cells come with the height running fastest.
        values = self.values((x[:-1] + x[1:]) / 2).T.ravel()
        return flat_lists(points, quads, values, self.cell, CELL_NAMES)

    def x_lines(self) -> np.ndarray:
        start = self.length - self.lap
        free = np.linspace(0.0, start, self.n_length + 1)
        half = self.washer / 2
        edges = [start, self.bolt - half, self.bolt + half, self.length]
        lap = grid_lines(edges, self.lap / self.n_lap)
        root = [-self.root] if self.root > 0 else []
        return np.concatenate([root, free[:-1], lap, self.length + free[1:]])

    def y_lines(self) -> np.ndarray:
        half, edge = self.washer / 2, self.width / 2
        return grid_lines([-edge, -half, half, edge], self.width / self.n_width)

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

    def with_interface(self, lists: MeshLists) -> MeshLists:
        """Faces between the beams, which are made separate bodies if they are to be."""
        if self.layer > 0:
            faces = {
                "joint_lower": facets_between(lists, "joint", "beam_1"),
                "joint_upper": facets_between(lists, "joint", "beam_2"),
            }
            return add_faces(lists, faces)
        if self.bonded:
            return add_faces(lists, {"interface": facets_between(lists, "beam_1", "beam_2")})
        names = "interface_lower", "interface_upper"
        bodies = [("root", "beam_1"), "joint", "beam_2"]
        return separate(lists, bodies, {("beam_1", "beam_2"): names})

    def with_faces(self, lists: MeshLists) -> MeshLists:
        facets, _ = exterior_facets(lists)
        x = lists.x[facets]
        tolerance = _TOLERANCE * self.length

        def on(axis: int, place: float) -> np.ndarray:
            return np.all(np.abs(x[:, :, axis] - place) < tolerance, axis=1)

        pressed = np.full(len(facets), self.washer > 0)
        for axis, middle in enumerate([self.bolt, 0.0][: x.shape[2] - 1]):
            off = np.abs(x[:, :, axis] - middle)
            pressed &= np.all(off < self.washer / 2 + tolerance, axis=1)
        height = x.shape[2] - 1
        faces = {
            "clamp": on(0, -self.root),
            "tip": on(0, self.end),
            "washer_lower": pressed & on(height, -self.outer),
            "washer_upper": pressed & on(height, self.outer),
        }
        return add_faces(lists, {name: facets[mask] for name, mask in faces.items()})


def _check(sizes: dict[str, float], washer, layer, root, counts: dict[str, int]) -> None:
    for name, value in sizes.items():
        _require(is_positive(value), name, value, "a length above 0 m")
    length, lap = sizes["length"], sizes["lap"]
    _require(lap < length, "lap", lap, f"less than length = {length:g} m")
    room = min(lap, sizes.get("width", lap))
    fits = washer == 0 or (is_positive(washer) and washer <= room)
    _require(fits, "washer", washer, f"0 m, or a side above it of at most {room:g} m")
    for name, value in {"layer": layer, "root": root}.items():
        _require(value == 0 or is_positive(value), name, value, "0 m or a thickness above it")
    for name, value in counts.items():
        _require(is_count(value), name, value, "a whole number of at least 1")
