"""Two equal dumbbell halves joined by a layer, or by rings of it around bolts (seed 000)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from fenics_joints.meshes.arguments import is_count, is_positive, requirement
from fenics_joints.meshes.extrude import Extrusion
from fenics_joints.meshes.plane import disc_grid, grid_lines, o_grid, tensor_grid
from fenics_joints.meshes.tagged import MeshLists, TaggedMesh, distribute
from fenics_joints.parallel import on_root

__all__ = ["dumbbell"]

FACET_NAMES = {"end_1": 1, "end_2": 2, "joint_lower": 3, "joint_upper": 4}
BODIES = ("head_1", "neck_1", "neck_2", "head_2")
_INSIDE, _RING = 1, 2  # of a plane cell: within the hole's circle, within the ring

_require = requirement("dumbbell")


def dumbbell(
    comm: MPI.Intracomm,
    *,
    head: Sequence[float] = (0.24, 0.18, 0.09),
    neck: Sequence[float] = (0.12, 0.063, 0.04),
    layer: float = 0.657e-3,
    element_size: float = 0.03,
    n_layer: int = 1,
    rings: Sequence[tuple[float, float]] = (),
    r_nei: float = 0.00875,
    r_wai: float | None = None,
    zone: float | None = None,
    holes: bool = False,
    cell: str = "hexahedron",
) -> TaggedMesh:
    """Mesh of two blocks with a neck each, neck to neck with a joint layer between.

    The defaults are the specimen of seed 000, section 4.3 (Figure 11): its heads, 240 x 180 mm,
    necks, 120 x 63 mm, and layer are printed, and that the contact is on all of the necks' faces,
    so that the joint is the whole layer. The heads' thickness and the necks' length were in a lost
    figure: they are reconstructed, by a fit to the frequencies that the paper computed (Table 9).
    With the default cells it gives 90.0 and 40.0 mm, which leave 0.8 % (root mean square); with
    cells of 20 mm 91.0 and 38.0 mm. The dumbbells of section 4.2 (Figure 9, lost too) are taken as
    the same blocks with ``layer=0.01``.

    Body 1 lies below z = 0, its neck up; the layer from 0 to ``layer``; body 2 above, its neck
    down. All are centred on x = y = 0, the long sides along x. With ``rings``, the layer is only
    there between the radii R_nei and R_wai around each of these points, as a polygon whose corners
    lie on the circles, and the necks are apart elsewhere.

    Parts: ``head_1``, ``neck_1``, ``neck_2``, ``head_2``, and ``joint`` or with rings ``ring_1``,
    ``ring_2``, ... Faces: ``end_1`` and ``end_2`` (the heads' outer faces), ``joint_lower`` and
    ``joint_upper`` (between the layer or all rings and neck 1, neck 2). Points: ``bolts``, the
    rings' centres at mid-height.

    Args:
        comm: Communicator; the call is collective, the lists are built on rank 0 alone.
        head: Length along x, y and z of each head, in metres.
        neck: Length along x, y and z of each neck, in metres; x and y less than the head's.
        layer: Thickness of the joint layer, in metres.
        element_size: Longest side of an element, in metres; along a ring's square at most a quarter
            of its side.
        n_layer: Elements through the layer.
        rings: Centres (x, y) of the bolts, in metres; none for a layer on the necks' whole faces.
        r_nei: Inner radius of the rings, in metres; by default that of an M16's hole (ISO 273).
        r_wai: Outer radius of the rings, in metres; needed with rings.
        zone: Side of the square of the O-grid around each ring, in metres; None: 2.3 r_wai.
        holes: Whether holes of radius R_nei go through the bodies; they are full otherwise.
        cell: ``"hexahedron"``, or ``"tetrahedron"`` for six of those in each hexahedron.

    Returns:
        The tagged mesh.

    Raises:
        MeshError: A dimension or count is impossible, or a ring's square leaves the neck or meets
            another; the message names the argument, its value and what was expected.
    """
    for name, lengths in (("head", head), ("neck", neck)):
        fits = np.shape(lengths) == (3,) and all(map(is_positive, lengths))
        _require(fits, name, lengths, "three lengths above 0 m, along x, y and z")
    slim = neck[0] < head[0] and neck[1] < head[1]
    _require(slim, "neck", neck, f"less than the head's {head[0]:g} and {head[1]:g} m")
    for name, size in (("layer", layer), ("element_size", element_size)):
        _require(is_positive(size), name, size, "a length above 0 m")
    _require(is_count(n_layer), "n_layer", n_layer, "a whole number of at least 1")
    cells = ("hexahedron", "tetrahedron")
    _require(cell in cells, "cell", cell, " or ".join(map(repr, cells)))
    pairs = all(np.shape(ring) == (2,) for ring in rings)
    _require(pairs, "rings", rings, "a pair (x, y) in metres for each bolt")
    centres = np.array(rings, dtype=float).reshape(-1, 2)
    radii = (0.0, 0.0)
    if len(centres):
        _require(is_positive(r_nei), "r_nei", r_nei, "a radius above 0 m")
        fits = r_wai is not None and is_positive(r_wai) and r_wai > r_nei
        _require(fits, "r_wai", r_wai, f"a radius above r_nei = {r_nei:g} m")
        radii, zone = (r_nei, r_wai), 2.3 * r_wai if zone is None else zone
        _check_zone(centres, zone, r_wai, neck)
    form = _Dumbbell(
        tuple(head), tuple(neck), layer, element_size, n_layer, centres, radii, zone or 0.0, holes,
        cell,
    )  # fmt: skip
    return distribute(comm, on_root(comm, form.lists))


@dataclass(frozen=True)
class _Dumbbell:
    """Checked dimensions of a dumbbell; see ``dumbbell``."""

    head: tuple[float, float, float]
    neck: tuple[float, float, float]
    layer: float
    size: float
    n_layer: int
    rings: np.ndarray
    radii: tuple[float, float]
    zone: float
    holes: bool
    cell: str

    @property
    def cell_names(self) -> dict[str, int]:
        """Tag of each part."""
        joints = [f"ring_{i + 1}" for i in range(len(self.rings))] or ["joint"]
        return {name: i for i, name in enumerate([*BODIES, *joints], start=1)}

    def lists(self) -> MeshLists:
        """The whole mesh."""
        points, quads, kind, ring = self.plan()
        middle = points[quads].mean(axis=1)
        neck = np.all(np.abs(middle) < np.array(self.neck[:2]) / 2, axis=1)
        if self.holes:
            quads, neck, ring = (a[kind != _INSIDE] for a in (quads, neck, ring))
        half = self.half_levels()
        layer = np.linspace(0.0, self.layer, self.n_layer + 1)
        z = np.concatenate([-half[:0:-1], layer, half[1:] + self.layer])
        body = len(half) - 1
        n_neck = int(np.sum(half[1:] < self.neck[2] * (1 + 1e-9)))
        head, n = np.ones(len(quads), dtype=int), len(BODIES)
        joint = np.where(ring > 0, n + ring, 0) if len(self.rings) else (n + 1) * neck
        rows = [head] * (body - n_neck) + [2 * neck] * n_neck + [joint] * self.n_layer
        rows += [3 * neck] * n_neck + [4 * head] * (body - n_neck)
        column = Extrusion(points, quads, z, np.array(rows), self.cell)
        everywhere = np.ones(len(quads), dtype=bool)
        column.tag_level(0, everywhere, FACET_NAMES["end_1"])
        column.tag_level(len(z) - 1, everywhere, FACET_NAMES["end_2"])
        column.tag_level(body, joint > 0, FACET_NAMES["joint_lower"])
        column.tag_level(body + self.n_layer, joint > 0, FACET_NAMES["joint_upper"])
        bolts = np.column_stack([self.rings, np.full(len(self.rings), self.layer / 2)])
        more = {"bolts": bolts} if len(bolts) else {}
        return MeshLists(self.cell, *column.lists(), self.cell_names, dict(FACET_NAMES), more)

    @property
    def n_zone(self) -> int:
        """Cells along each side of a ring's square: an even number."""
        return 2 * int(np.ceil(self.zone / min(self.size, self.zone / 4) / 2 * (1 - 1e-9)))

    def half_levels(self) -> np.ndarray:
        """Distances of a body's levels from the joint."""
        return grid_lines([0.0, self.neck[2], self.neck[2] + self.head[2]], self.size)

    def plan(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Plane points; cells; which lie in a hole or a ring; and the ring of each, from 1."""
        x, y = (self.lines(axis) for axis in range(2))
        points, quads = tensor_grid(x, y)
        number = np.arange(len(points)).reshape(len(x), len(y))
        kind, ring = np.zeros((2, len(quads)), dtype=int)
        for i, centre in enumerate(self.rings, start=1):
            square = number[_between(x, centre[0], self.zone)][:, _between(y, centre[1], self.zone)]
            fits = square.shape == (self.n_zone + 1,) * 2
            _require(fits, "rings", self.rings.tolist(), "rings in rows: squares side by side or "
                     "one above the other")  # fmt: skip
            outside = np.abs(points[quads].mean(axis=1) - centre).max(axis=1) > self.zone / 2
            more, new, where = self.ring(points, square, centre)
            points, quads = np.vstack([points, more]), np.vstack([quads[outside], new])
            kind = np.concatenate([kind[outside], where])
            ring = np.concatenate([ring[outside], np.where(where == _RING, i, 0)])
        return points, quads, kind, ring

    def ring(self, points, square, centre):
        """New points and cells inside a ring's square, and which lie in the hole or the ring."""
        loop = np.concatenate(
            [square[:-1, 0], square[-1, :-1], square[:0:-1, -1], square[0, :0:-1]]
        )
        size, first, n = min(self.size, self.zone / 4), len(points), len(loop)
        x, quads, circle = o_grid(loop, points[loop], centre, self.radii, size, first)
        # The square's loop starts at its corner of least x and y, 3/8 of a turn before the x-axis.
        turn = np.roll(np.arange(n), -3 * n // 8)
        inner, disc = disc_grid(first + turn, x[turn] - centre, size, first + len(x), False)
        where = np.where(circle == 1, _RING, 0)
        return (
            np.vstack([x, inner + centre]),
            np.vstack([quads, disc]),
            np.concatenate([where, np.full(len(disc), _INSIDE)]),
        )

    def lines(self, axis: int) -> np.ndarray:
        """Lines of the plan along x or y, with those of the rings' squares evenly spaced."""
        outer, inner = self.head[axis] / 2, self.neck[axis] / 2
        edges = np.array([-outer, -inner, inner, outer])
        if not len(self.rings):
            return grid_lines(edges, self.size)
        own = self.rings[:, axis, None] + np.linspace(-0.5, 0.5, self.n_zone + 1) * self.zone
        return grid_lines([*edges, *own.ravel()], self.size)


def _between(lines: np.ndarray, centre: float, side: float) -> slice:
    first, last = (int(np.abs(lines - centre - end * side / 2).argmin()) for end in (-1, 1))
    return slice(first, last + 1)


def _check_zone(rings, zone, r_wai, neck) -> None:
    _require(is_positive(zone), "zone", zone, "a side above 0 m")
    fits = r_wai <= 0.45 * zone
    _require(fits, "r_wai", r_wai, f"at most 0.45 * zone = {0.45 * zone:g} m")
    for number, ring in enumerate(rings.tolist()):
        room = min(side / 2 - abs(place) for place, side in zip(ring, neck[:2], strict=True))
        expected = f"at most {2 * room:g} m, so that that of rings[{number}] stays within the neck"
        _require(zone / 2 <= room * (1 + 1e-9), "zone", zone, expected)
        for other in range(number):
            apart = np.abs(rings[number] - rings[other])
            gap = float(apart.max())
            expected = f"at most the distance of rings[{other}] and rings[{number}], {gap:g} m"
            _require(zone <= gap * (1 + 1e-9), "zone", zone, expected)
