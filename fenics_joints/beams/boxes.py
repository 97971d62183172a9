"""Elements of beams and of their laps as boxes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fenics_joints.beams.components import Beam
from fenics_joints.beams.layout import Layout

#: Height of the box of a joint element, over that of its beams: the interface itself has none.
_INTERFACE = 0.05


@dataclass(frozen=True)
class BeamCells:
    """A box for each element of each beam, laps included, then one for each joint element.

    Attributes:
        vertices: Corners, m, in the order of DOLFINx's hexahedra, (n_cells, 8, 3).
        beam: Number of the beam of each cell; -1 for a joint element.
        lap: Number of the lap that it is in, or -1.
        element: Number of its element.
        volume: Volume, m3; of a joint element that of both beams there, whose bending stiffness
            it has.
    """

    vertices: np.ndarray
    beam: np.ndarray
    lap: np.ndarray
    element: np.ndarray
    volume: np.ndarray


def beam_cells(layout: Layout, beams: Sequence[Beam]) -> BeamCells:
    """The cells of beams."""
    x, boxes, rows = layout.x, [], []
    for joints in (False, True):
        for stretch in layout.stretches:
            if joints and stretch.joint is None:
                continue
            there = [beams[i] for i in stretch.beams]
            lap = -1 if stretch.joint is None else stretch.joint
            for e in range(stretch.first, stretch.first + stretch.n):
                ends = x[e], x[e + 1]
                if joints:
                    z = 0.5 * _INTERFACE * min(b.height for b in there)
                    boxes.append((ends, min(b.breadth for b in there), (-z, z)))
                    volume = sum(b.breadth * b.height for b in there) * stretch.length
                    rows.append((-1, lap, e, volume))
                    continue
                for i, b in zip(stretch.beams, there, strict=True):
                    boxes.append(
                        (ends, b.breadth, (0.0, b.height) if i % 2 == 0 else (-b.height, 0.0))
                    )
                    rows.append((i, lap, e, b.breadth * b.height * stretch.length))
    beam, lap, element, volume = map(np.array, zip(*rows, strict=True))
    return BeamCells(np.array([_box(*box) for box in boxes]), beam, lap, element, volume)


def _box(x: tuple[float, float], width: float, z: tuple[float, float]) -> list:
    y = -width / 2, width / 2
    return [(x[i], y[j], z[k]) for k in range(2) for j in range(2) for i in range(2)]
