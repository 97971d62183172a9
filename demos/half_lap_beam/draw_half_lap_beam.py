"""Draw the Brake-Reuss beam's two halves with gmsh and write them as a STEP file, as CAD would.

    ./with-fenicsx python3 demos/half_lap_beam/draw_half_lap_beam.py [FILE]

Lengths are in millimetres; `README.md` names their sources. The beam is along x, the bolts along z.
"""

from __future__ import annotations

import sys
from pathlib import Path

from fenics_joints.meshes.step_writer import write_step

LENGTH, WIDTH, THICKNESS, LAP, PITCH, HOLE = 720, 25.4, 12.7, 120, 30, 8.4
GAP = 0.2  # clearance at the steps
LABELS = ("Beam 1, steel", "Beam 2, steel")


def draw(occ) -> None:
    """The two halves, in the order of their labels."""
    end, half = (LENGTH + LAP) / 2, THICKNESS / 2
    start = end - LAP
    first = (_block(occ, 0, start, -half, THICKNESS), _block(occ, start, end - GAP, 0, half))
    second = (
        _block(occ, end, LENGTH, -half, THICKNESS),
        _block(occ, start + GAP, end, -half, half),
    )
    for main, tongue in (first, second):
        (solid,), _ = occ.fuse([(3, main)], [(3, tongue)])
        holes = [
            (3, occ.addCylinder(x, 0, -THICKNESS, 0, 0, 2 * THICKNESS, HOLE / 2))
            for x in (LENGTH / 2 - PITCH, LENGTH / 2, LENGTH / 2 + PITCH)
        ]
        occ.cut([solid], holes)


def _block(occ, low: float, high: float, bottom: float, height: float) -> int:
    """A block from ``low`` to ``high`` along x, over the whole width."""
    return occ.addBox(low, -WIDTH / 2, bottom, high - low, WIDTH, height)


if __name__ == "__main__":
    file = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).with_name("beam.step")
    write_step(file, draw, LABELS)
