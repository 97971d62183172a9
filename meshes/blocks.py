"""Two blocks, one on the other, as separate bodies whose vertices match."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from mpi4py import MPI

from fenics_joints.meshes.arguments import requirement
from fenics_joints.meshes.extrude import Extrusion
from fenics_joints.meshes.plane import flat_lists, tensor_grid
from fenics_joints.meshes.separate import separate
from fenics_joints.meshes.skin import add_faces, exterior_facets
from fenics_joints.meshes.tagged import MeshLists, TaggedMesh, distribute
from fenics_joints.parallel import on_root

CELL_NAMES = {"lower": 1, "upper": 2}
CELLS = {2: ("quadrilateral", "triangle"), 3: ("hexahedron", "tetrahedron")}
_TOLERANCE = 1e-9  # of two lines taken for one, relative to the blocks

_require = requirement("stacked_blocks")


def stacked_blocks(
    comm: MPI.Intracomm,
    *,
    lower: Sequence[Sequence[float]],
    upper: Sequence[float],
    upper_span: Sequence | None = None,
    cell: str | None = None,
) -> TaggedMesh:
    """Mesh of two blocks that touch at height 0 and share no vertex, from their grid lines.

    The height is the last coordinate: z in 3-D, y in 2-D. A mesh in 2-D whose x starts at 0 or
    above serves as a section of revolution too, x[0] the radius. ``graded_lines`` and
    ``grid_lines`` of ``fenics_joints.meshes`` make lines.

    Parts: ``lower``, ``upper``. Faces: ``interface_lower`` and ``interface_upper`` (where the
    blocks touch, each block's own), ``bottom``, ``top``, and of both blocks together ``left`` and
    ``right`` (their ends of least and most x) and in 3-D ``front`` and ``back`` (of least and most
    y). Where the upper block is shorter, its own ends count; what it leaves free has no name.

    Args:
        comm: Communicator; the call is collective, the lists are built on rank 0 alone.
        lower: Lines of the lower block: (x, height) in 2-D, (x, y, height) in 3-D, each ascending,
            in metres; its height ends at 0.
        upper: Heights of the upper block's lines, ascending from 0, in metres.
        upper_span: Where the upper block stands: (first, last) line of x, and in 3-D a pair of
            such pairs, for x and for y; coordinates of lines of ``lower``, in metres. None for
            all of the lower block.
        cell: ``"quadrilateral"`` or ``"triangle"`` in 2-D, ``"hexahedron"`` or ``"tetrahedron"``
            in 3-D; None for the first of them.

    Returns:
        The tagged mesh.

    Raises:
        MeshError: Lines do not ascend, or do not meet at height 0; a span is not on lines; the
            cell does not fit the dimension.
    """
    dim = len(lower)
    _require(dim in CELLS, "lower", lower, "lines (x, height), or (x, y, height)")
    plan = [_lines(f"lower[{axis}]", lines) for axis, lines in enumerate(lower[:-1])]
    low, high = _lines(f"lower[{dim - 1}]", lower[-1]), _lines("upper", upper)
    _require(low[-1] == 0, f"lower[{dim - 1}]", low.tolist(), "heights that end at 0 m")
    _require(high[0] == 0, "upper", high.tolist(), "heights that start at 0 m")
    cell = cell or CELLS[dim][0]
    _require(cell in CELLS[dim], "cell", cell, f"one of {', '.join(CELLS[dim])} in {dim}-D")
    spans = _spans(plan, upper_span)
    return distribute(comm, on_root(comm, lambda: _lists(plan, low, high, spans, cell)))


def _lists(plan, low, high, spans, cell) -> MeshLists:
    heights = np.concatenate([low, high[1:]])
    if len(plan) == 1:
        whole = _flat(plan[0], low, heights, spans, cell)
    else:
        whole = _solid(plan, low, heights, spans, cell)
    names = "interface_lower", "interface_upper"
    whole = separate(whole, whole.cell_names, {("lower", "upper"): names})
    return _with_sides(whole, plan, spans)


def _flat(x, low, heights, spans, cell) -> MeshLists:
    points, quads = tensor_grid(x, heights)
    middle = points[quads].mean(axis=1)
    covered = (middle[:, 0] > spans[0][0]) & (middle[:, 0] < spans[0][1])
    values = np.where(middle[:, 1] < 0, CELL_NAMES["lower"], covered * CELL_NAMES["upper"])
    return flat_lists(points, quads, values, cell, CELL_NAMES)


def _solid(plan, low, heights, spans, cell) -> MeshLists:
    points, quads = tensor_grid(*plan)
    middle = points[quads].mean(axis=1)
    (x0, x1), (y0, y1) = spans
    x, y = middle.T
    covered = (x > x0) & (x < x1) & (y > y0) & (y < y1)
    rows = [np.full(len(quads), CELL_NAMES["lower"])] * (len(low) - 1)
    rows += [covered * CELL_NAMES["upper"]] * (len(heights) - len(low))
    column = Extrusion(points, quads, heights, np.array(rows), cell)
    return MeshLists(cell, *column.lists(), CELL_NAMES, {})


def _with_sides(lists: MeshLists, plan, spans) -> MeshLists:
    facets, cells = exterior_facets(lists)
    x = lists.x[facets]
    above = lists.cell_values[cells] == CELL_NAMES["upper"]

    def on(axis, place):
        # Facets all of whose vertices are there; the place may differ from body to body.
        tolerance = _TOLERANCE * np.ptp(lists.x[:, axis])
        return np.all(np.abs(x[:, :, axis] - np.reshape(place, (-1, 1))) < tolerance, axis=1)

    last = lists.x.shape[1] - 1
    faces = {"bottom": on(last, lists.x[:, last].min()), "top": on(last, lists.x[:, last].max())}
    for axis, names in enumerate([("left", "right"), ("front", "back")][: len(plan)]):
        for name, own, end in zip(names, spans[axis], (0, -1), strict=True):
            faces[name] = on(axis, np.where(above, own, plan[axis][end]))
    return add_faces(lists, {name: facets[mask] for name, mask in faces.items()})


def _lines(name: str, lines) -> np.ndarray:
    lines = np.asarray(lines, dtype=float)
    ascend = lines.ndim == 1 and len(lines) > 1 and bool(np.all(np.diff(lines) > 0))
    _require(ascend, name, lines.tolist(), "two or more ascending positions in metres")
    return lines


def _spans(plan, upper_span) -> list[tuple[float, float]]:
    """Where the upper block starts and ends along each axis of the plan."""
    if upper_span is None:
        return [(lines[0], lines[-1]) for lines in plan]
    shape = (2,) if len(plan) == 1 else (2, 2)
    expected = "a pair of lines of x" if len(plan) == 1 else "two pairs, lines of x and of y"
    _require(np.shape(upper_span) == shape, "upper_span", upper_span, expected)
    found = []
    for axis, (lines, span) in enumerate(zip(plan, np.reshape(upper_span, (-1, 2)), strict=True)):
        nearest = [int(np.abs(lines - place).argmin()) for place in span]
        fits = np.all(np.abs(lines[nearest] - span) <= 1e-6 * np.ptp(lines))
        expected = f"two ascending lines of lower[{axis}]"
        _require(bool(fits) and nearest[0] < nearest[1], "upper_span", upper_span, expected)
        found.append((lines[nearest[0]], lines[nearest[1]]))
    return found
