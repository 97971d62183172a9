"""Grids of the builders: graded lines, plane grids with O-grids round holes, columns on them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from fenics_joints.errors import items, real, reals
from fenics_joints.meshes.arguments import requirement
from fenics_joints.meshes.facets import FACETS, layer_cells, oriented
from fenics_joints.meshes.tagged import MeshLists

#: Quadrilaterals (v00, v10, v01, v11) cut along v00-v11 or v10-v01; all halves turn anticlockwise.
_CUTS = np.array([[[0, 1, 3], [0, 3, 2]], [[0, 1, 2], [1, 3, 2]]])


def grid_lines(edges: Iterable[float], size: float) -> np.ndarray:
    """Grid lines that pass through every edge exactly, at most ``size`` apart.

    Each interval between neighbouring edges is cut into the fewest equal parts that are not longer
    than ``size``, so a grid whose edges lie on multiples of ``size`` comes out uniform.

    Args:
        edges: Positions that must be lines, in any order, in metres.
        size: Longest distance between two lines, in metres.

    Returns:
        Ascending positions, shape (n_lines,).
    """
    real("size", size, "m", above=0)
    edges = reals("edges", list(items("edges", edges, object, "positions")), (None,), "m")
    edges, counts = _cut(edges, size)
    parts = [
        np.linspace(a, b, int(n), endpoint=False)
        for a, b, n in zip(edges[:-1], edges[1:], counts, strict=True)
    ]
    return np.concatenate([*parts, edges[-1:]])


def count_intervals(
    edges: Iterable[float], size: float, span: tuple[float, float] | None = None
) -> float:
    """How many intervals `grid_lines` would make, at no cost; infinite if no number can hold it.

    Args:
        edges: Positions that must be lines, in any order, in metres.
        size: Longest distance between two lines, in metres.
        span: Count only those between these two of the edges; None for all.
    """
    edges, counts = _cut(edges, size)
    middle = (edges[1:] + edges[:-1]) / 2
    inside = slice(None) if span is None else (middle > span[0]) & (middle < span[1])
    return float(counts[inside].sum())


def _cut(edges: Iterable[float], size: float) -> tuple[np.ndarray, np.ndarray]:
    """Ascending edges, and the number of equal parts between each and the next."""
    edges = np.sort(np.fromiter(edges, dtype=float))
    span = edges[-1] - edges[0]
    # Edges that differ by round-off are one line.
    edges = edges[np.concatenate([[True], np.diff(edges) > 1e-9 * span])]
    with np.errstate(over="ignore"):
        return edges, np.ceil(np.diff(edges) / size * (1 - 1e-9))


def graded_lines(edges: Sequence[float], sizes: Sequence[float]) -> np.ndarray:
    """Grid lines through every edge exactly, whose distance grows from edge to edge.

    Between two edges the distance of the lines is a linear function of the position, from the
    size at the one to the size at the other, so neighbouring intervals have a fixed ratio, about
    exp(difference of the sizes / distance of the edges). A second size of
    ``first + log(g) * distance`` gives a growth by the factor g per interval.

    Args:
        edges: Ascending positions that must be lines, in metres, shape (n,).
        sizes: Longest interval near each edge, in metres, shape (n,).

    Returns:
        Ascending positions, shape (n_lines,).

    Raises:
        MeshError: The edges do not ascend, a size is not above 0 m, or their numbers differ.
    """
    require = requirement("graded_lines")
    edges, sizes = reals("edges", edges, unit="m"), reals("sizes", sizes, unit="m")
    ascend = edges.ndim == 1 and len(edges) > 1 and bool(np.all(np.diff(edges) > 0))
    require(ascend, "edges", edges.tolist(), "two or more ascending positions in metres")
    fits = sizes.shape == edges.shape and bool(np.all(np.isfinite(sizes) & (sizes > 0)))
    require(fits, "sizes", sizes.tolist(), f"{len(edges)} sizes above 0 m, one for each edge")
    parts = []
    for a, b, first, last in zip(edges[:-1], edges[1:], sizes[:-1], sizes[1:], strict=True):
        rate = math.log(last / first)
        even = abs(rate) < 1e-9
        # The number of intervals is the integral of 1 / size over the distance.
        count = (b - a) / first if even else (b - a) * rate / (last - first)
        step = np.arange(math.ceil(count * (1 - 1e-9))) / math.ceil(count * (1 - 1e-9))
        parts.append(a + (b - a) * (step if even else np.expm1(rate * step) / math.expm1(rate)))
    return np.concatenate([*parts, edges[-1:]])


def cut_quads(points: np.ndarray, quads: np.ndarray) -> np.ndarray:
    """Both halves of each quadrilateral, cut along its shorter diagonal, anticlockwise.

    Args:
        points: Vertices, shape (n_points, 2).
        quads: Cells (v00, v10, v01, v11), shape (n_quads, 4).

    Returns:
        Vertices of the halves, shape (n_quads, 2, 3).
    """
    v00, v10, v01, v11 = points[quads].transpose(1, 0, 2)
    rising, falling = np.linalg.norm(v11 - v00, axis=1), np.linalg.norm(v10 - v01, axis=1)
    cut = _CUTS[(falling < rising * (1 - 1e-9)).astype(int)]
    return np.take_along_axis(quads, cut.reshape(-1, 6), axis=1).reshape(-1, 2, 3)


def extruded(points, base, z, values, cell: str, cell_names: dict[str, int]) -> MeshLists:
    """A mesh of the columns of cells over a plan, without named faces.

    The plan is a line, for a mesh in the plane, or a plane mesh. Quadrilaterals that are cut, of
    the section or of the plan, are cut along their shorter diagonal; tetrahedra upright along the
    diagonals that rise from the lower plane vertex number to the higher one. Neighbours see the
    same diagonal, so the cut conforms.

    Args:
        points: Vertices of the plan, shape (n_points, 1 or 2), in metres.
        base: Its cells: intervals, quadrilaterals (v00, v10, v01, v11), or triangles where the
            columns are of tetrahedra, shape (n_base, 2, 4 or 3).
        z: Levels, ascending, shape (n_levels,), in metres.
        values: Tag of each cell, 0 where there is none, shape (n_levels - 1, n_base).
        cell: ``"quadrilateral"`` or ``"triangle"`` over a line, two for each quadrilateral;
            ``"hexahedron"`` or ``"tetrahedron"`` over a plane, six for each hexahedron.
        cell_names: Tag of each named part.

    Returns:
        The mesh, without unused vertices.
    """
    if cell == "tetrahedron" and base.shape[1] == 4:
        base, values = cut_quads(points, base).reshape(-1, 3), np.repeat(values, 2, axis=1)
    layer, column = np.nonzero(values)
    x = np.column_stack([points.repeat(len(z), axis=0), np.tile(z, len(points))])
    lower = base[column] * len(z) + layer[:, None]
    cells = layer_cells(lower, lower + 1, cell == "tetrahedron")
    cells = cut_quads(x, cells).reshape(-1, 3) if cell == "triangle" else oriented(cell, x, cells)
    values = values[layer, column].repeat(len(cells) // len(column))
    used, numbers = np.unique(cells, return_inverse=True)
    none = np.empty((0, FACETS[cell].shape[1]), dtype=np.int64), np.empty(0, dtype=np.int32)
    return MeshLists(cell, x[used], numbers.reshape(cells.shape), values, *none, cell_names, {})


def thickened(flat: MeshLists, thickness: float) -> MeshLists:
    """The solid over a plane mesh, a sheet, half of its thickness on either side of z = 0.

    Quadrilaterals become hexahedra, triangles three tetrahedra each. Named edges become the walls
    over them, and named points become points on both sides.

    Args:
        flat: Triangles or quadrilaterals whose vertices are all used, of shape (n, 2).
        thickness: Thickness of the sheet, m.
    """
    simplex, ends = flat.cell == "triangle", np.array([-0.5, 0.5]) * thickness
    cell = "tetrahedron" if simplex else "hexahedron"
    solid = extruded(flat.x, flat.cells, ends, flat.cell_values[None], cell, flat.cell_names)
    edges = 2 * flat.facets  # vertices at the lower of the two levels, see `extruded`
    points = {
        name: np.vstack([np.column_stack([p[:, :2], np.full(len(p), z)]) for z in ends])
        for name, p in flat.points.items()
    }
    return replace(
        solid,
        facets=layer_cells(edges, edges + 1, simplex),
        facet_values=np.repeat(flat.facet_values, 2 if simplex else 1),
        facet_names=flat.facet_names,
        points=points,
    )


def tensor_grid(*lines: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points and cells of the grid with lines ``x``, or ``x`` and ``y``.

    Returns:
        Points, shape (n_points, 1 or 2), point (i, j) in row ``i * len(y) + j``; and cells, those
        of one line its intervals, (n_cells, 2), of two quadrilaterals (v00, v10, v01, v11),
        (n_cells, 4).
    """
    points = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, len(lines))
    number = np.arange(len(points))
    if len(lines) == 1:
        return points, np.column_stack([number[:-1], number[1:]])
    return points, grid_cells(number.reshape(len(lines[0]), -1))


def grid_cells(number: np.ndarray) -> np.ndarray:
    """Cells (v00, v10, v01, v11) of a grid of points with these numbers, shape (n_cells, 4)."""
    corners = number[:-1, :-1], number[1:, :-1], number[:-1, 1:], number[1:, 1:]
    return np.stack(corners, axis=-1).reshape(-1, 4)


class PlaneGrid:
    """A plane tensor grid, in which O-grids round holes can take the place of squares.

    Args:
        x, y: Its lines, in metres.

    Attributes:
        points: Vertices, shape (n_points, 2), in metres.
        quads: Cells (v00, v10, v01, v11), shape (n_quads, 4).
        kind: 1 for cells between the first and second circle of an O-grid, -1 for those inside the
            first, 0 for others, shape (n_quads,).
        number: Number of the O-grid that a cell is in, from 1, 0 for none, shape (n_quads,).
    """

    def __init__(self, x: np.ndarray, y: np.ndarray):
        self._lines, self._filled = (x, y), 0
        self.points, self.quads = tensor_grid(x, y)
        self._grid = np.arange(len(self.points)).reshape(len(x), len(y))
        self.kind, self.number = np.zeros((2, len(self.quads)), dtype=int)

    @property
    def middle(self) -> np.ndarray:
        """Centres of the cells, shape (n_quads, 2)."""
        return self.points[self.quads].mean(axis=1)

    def square(self, centre: np.ndarray, side: float) -> np.ndarray:
        """Numbers of the points in a square, whose sides are lines of the grid; shape (m, n)."""
        i, j = (_between(line, c, side) for line, c in zip(self._lines, centre, strict=True))
        return self._grid[i, j]

    def fill(
        self, centre: np.ndarray, side: float, radii: Sequence[float], size: float, *, full=False
    ) -> None:
        """Put quadrilaterals round a circle, the O-grid, in the place of a square.

        The square's sides map to quarters of the circle with angle in proportion to distance, so
        an even square gives a regular polygon whose corners lie on the circle. Circles of the
        given radii are followed exactly by element edges; the rings between two of them, and the
        last between a circle and the square, are cut into the fewest equal parts not longer than
        ``size``.

        Args:
            centre: Centre of the square and of the circles, shape (2,), in metres.
            side: Side of the square, whose sides are lines of the grid, in metres.
            radii: Radii of the hole and of the circles around it, ascending, in metres.
            size: Longest element along the radius, halfway along a side, in metres.
            full: Whether there are cells in the hole too; needs an even number of cells, the same
                along all sides of the square.
        """
        first, loop = len(self.points), _loop_around(self.square(centre, side))
        outside = np.abs(self.middle - centre).max(axis=1) > side / 2
        offset, n = self.points[loop] - centre, len(loop)
        half = np.abs(offset).max()
        angle = _square_angle(offset / half)
        unit = np.column_stack([np.cos(angle), np.sin(angle)])
        curves, reach = [*(radius * unit for radius in radii), offset], [*radii, half]
        rings, kinds = [], []
        for band in range(len(radii)):
            parts = math.ceil((reach[band + 1] - reach[band]) / size * (1 - 1e-9))
            for step in np.arange(parts) / parts:
                rings.append(centre + (1 - step) * curves[band] + step * curves[band + 1])
                kinds.append(int(band == 0 and len(radii) > 1))
        points = np.vstack(rings)
        number = np.vstack([first + np.arange(len(points)).reshape(-1, n), loop])
        quads, kind = grid_cells(np.hstack([number, number[:, :1]])), np.repeat(kinds, n)
        if full:
            # The loop starts at the square's corner of least x and y, 3/8 of a turn off the x-axis.
            turn = np.roll(np.arange(n), -3 * n // 8)
            circle = points[turn] - centre
            inner, disc = disc_grid(first + turn, circle, size, first + len(points), False)
            points, quads = np.vstack([points, inner + centre]), np.vstack([quads, disc])
            kind = np.append(kind, np.full(len(disc), -1))
        self._filled += 1
        self.points = np.vstack([self.points, points])
        self.quads = np.vstack([self.quads[outside], quads])
        self.kind = np.append(self.kind[outside], kind)
        self.number = np.append(self.number[outside], np.full(len(quads), self._filled))


def disc_grid(
    circle: np.ndarray, circle_points: np.ndarray, size: float, first_new: int, quarter: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Quadrilaterals inside a circle around the origin: a square, and rings around it.

    Args:
        circle: Numbers of the circle's points, anticlockwise from the x-axis, shape (n,), n a
            multiple of 8; for a quarter from the x-axis to the y-axis, n odd.
        circle_points: Their positions, equal angles apart, shape (n, 2), in metres.
        size: Longest element of the rings along the radius, on the axes, in metres.
        first_new: Number of the first new point.
        quarter: Whether to fill only the quarter of x and y above 0.

    Returns:
        New points, shape (n_new, 2); cells (v00, v10, v01, v11), shape (n_cells, 4).
    """
    outer = float(np.linalg.norm(circle_points[0]))
    side = 0.55 * outer  # half the square's; makes its cells and the rings' about as wide
    half = len(circle) // 2 if quarter else len(circle) // 8
    lines = np.linspace(0.0 if quarter else -side, side, half + 1 if quarter else 2 * half + 1)
    points, quads = tensor_grid(lines, lines)
    number = np.arange(len(points)).reshape(len(lines), -1)
    if quarter:
        loop = np.concatenate([number[-1], number[-2::-1, -1]])
    else:
        loop = np.roll(_loop_around(number), -3 * half)
    parts = math.ceil((outer - side) / size * (1 - 1e-9))
    rings, numbers = [points], [first_new + loop]
    for step in range(1, parts):
        rings.append(points[loop] + (circle_points - points[loop]) * (step / parts))
        numbers.append(first_new + len(points) + (step - 1) * len(loop) + np.arange(len(loop)))
    number = np.vstack([*numbers, circle])
    if not quarter:
        number = np.hstack([number, number[:, :1]])
    return np.vstack(rings), np.vstack([first_new + quads, grid_cells(number)])


def _square_angle(p: np.ndarray) -> np.ndarray:
    """Angle for points on the square with corners (-1, -1) and (1, 1), linear along each side."""
    x, y = p.T
    upright = np.abs(x) >= np.abs(y)
    turned = np.where(upright, np.where(x > 0, 0, np.pi), np.where(y > 0, np.pi / 2, -np.pi / 2))
    along = np.where(upright, np.sign(x) * y, -np.sign(y) * x)
    return turned + np.pi / 4 * along


def _between(lines: np.ndarray, centre: float, side: float) -> slice:
    """Numbers of the lines across a square, those of its sides included."""
    first, last = (int(np.abs(lines - centre - end * side / 2).argmin()) for end in (-1, 1))
    return slice(first, last + 1)


def _loop_around(square: np.ndarray) -> np.ndarray:
    """Numbers of the points on the sides of a square grid, anticlockwise from the first corner.

    Args:
        square: Numbers of the grid's points, shape (n_x, n_y).
    """
    sides = square[:-1, 0], square[-1, :-1], square[:0:-1, -1], square[0, :0:-1]
    return np.concatenate(sides)
