"""Blocks: a box with named faces, and two blocks as separate bodies whose vertices match."""

from __future__ import annotations

from collections.abc import Sequence
from typing import get_args

import numpy as np
from mpi4py import MPI

from fenics_joints.meshes.arguments import Solid, holds, is_count, requirement
from fenics_joints.meshes.arguments import lengths as are_lengths
from fenics_joints.meshes.facets import Skin, separate
from fenics_joints.meshes.grid import extruded, tensor_grid
from fenics_joints.meshes.tagged import MeshLists, TaggedMesh, distribute
from fenics_joints.parallel import on_root

CELL_NAMES = {"lower": 1, "upper": 2}
CELLS = {2: ("quadrilateral", "triangle"), 3: get_args(Solid)}

_require = requirement("stacked_blocks")


def box(
    comm: MPI.Intracomm, lengths: Sequence[float], counts: Sequence[int], cell: str = "hexahedron"
) -> TaggedMesh:
    """Mesh of the box from the origin to ``lengths``.

    The one part is ``body``; the faces are ``x_min``, ``x_max``, ``y_min`` and so on.

    Args:
        comm: Communicator; the call is collective.
        lengths: Side along x, y and z, in metres.
        counts: Elements along x, y and z.
        cell: ``"hexahedron"``, or ``"tetrahedron"`` for six of those in each hexahedron.

    Returns:
        The tagged mesh.

    Raises:
        MeshError: A length is not positive, a count is below 1, or the cell is unknown.
    """
    require = requirement("box")
    fits = are_lengths(lengths, 3)
    require(fits, "lengths", lengths, "three lengths above 0 m")
    fits = holds(lambda given: len(given) == 3 and all(map(is_count, given)), counts)
    require(fits, "counts", counts, "three whole numbers of at least 1")
    fits = isinstance(cell, str) and cell in CELLS[3]
    require(fits, "cell", cell, " or ".join(map(repr, CELLS[3])))
    return distribute(comm, on_root(comm, lambda: _box(lengths, counts, cell)))


def _box(lengths, counts, cell) -> MeshLists:
    x, y, z = (np.linspace(0.0, a, n + 1) for a, n in zip(lengths, counts, strict=True))
    points, quads = tensor_grid(x, y)
    everywhere = np.ones((len(z) - 1, len(quads)), dtype=int)
    skin = Skin(extruded(points, quads, z, everywhere, cell, {"body": 1}))
    sides = {}
    for axis, length in enumerate(lengths):
        sides[f"{'xyz'[axis]}_min"] = skin.at(axis, 0.0)
        sides[f"{'xyz'[axis]}_max"] = skin.at(axis, length)
    return skin.named(sides)


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
    return distribute(comm, on_root(comm, lambda: _blocks(plan, low, high, spans, cell)))


def _blocks(plan, low, high, spans, cell) -> MeshLists:
    heights, lower, upper = np.concatenate([low, high[1:]]), *CELL_NAMES.values()
    covered = np.ones(1, dtype=bool)
    for lines, (first, last) in zip(plan, spans, strict=True):
        middle = (lines[1:] + lines[:-1]) / 2
        covered = np.outer(covered, (middle > first) & (middle < last)).ravel()
    n_low, n_high = len(low) - 1, len(high) - 1
    rows = np.array([np.full(len(covered), lower)] * n_low + [covered * upper] * n_high)
    lists = extruded(*tensor_grid(*plan), heights, rows, cell, CELL_NAMES)
    names = "interface_lower", "interface_upper"
    skin = Skin(separate(lists, CELL_NAMES, {("lower", "upper"): names}))
    sides = {"bottom": skin.at(len(plan), low[0]), "top": skin.at(len(plan), high[-1])}
    for axis, names in enumerate([("left", "right"), ("front", "back")][: len(plan)]):
        for name, own, end in zip(names, spans[axis], (0, -1), strict=True):
            place = np.where(skin.tag == upper, own, plan[axis][end])
            sides[name] = skin.at(axis, place)
    return skin.named(sides)


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
