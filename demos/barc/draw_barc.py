"""Draw the BARC's box, feet and beam with gmsh and write them as a STEP file, as CAD would.

    ./with-fenicsx python3 demos/barc/draw_barc.py [FILE]

Lengths in millimetres, read off the nodes of the test's public model (inches: box 6 x 6 x 3 of 1/4
with a slot of 1/2 across its roof, channels 2 x 1 of 1/8, 1 long, beam 5 x 1 of 1/8). The screws'
holes are left out: their clamped area is the whole of each foot, and holes of 4 mm would make
most of the mesh.
"""

from __future__ import annotations

import sys
from pathlib import Path

from fenics_joints.meshes.step_writer import write_step

LABELS = ("Box", "Foot left", "Foot right", "Beam")
IN = 25.4


def draw(occ) -> None:
    """The four solids, in the order of their labels."""
    outer = occ.addBox(-3 * IN, -3 * IN, 0, 6 * IN, 6 * IN, 3 * IN)
    inner = occ.addBox(-2.75 * IN, -2.75 * IN, 0, 5.5 * IN, 5.5 * IN, 3 * IN)
    slot = occ.addBox(-0.25 * IN, 2.5 * IN, 0, 0.5 * IN, IN, 3 * IN)
    occ.cut([(3, outer)], [(3, inner), (3, slot)])
    left = occ.addBox(-2.5 * IN, 3 * IN, IN, IN, 2 * IN, IN)
    occ.cut([(3, left)], [(3, occ.addBox(-2.5 * IN, 3.125 * IN, 1.125 * IN, IN, 1.75 * IN, IN))])
    right = occ.addBox(1.5 * IN, 3 * IN, IN, IN, 2 * IN, IN)
    occ.cut([(3, right)], [(3, occ.addBox(1.5 * IN, 3.125 * IN, IN, 0.875 * IN, 1.75 * IN, IN))])
    occ.addBox(-2.5 * IN, 5 * IN, IN, 5 * IN, 0.125 * IN, IN)


if __name__ == "__main__":
    file = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).with_name("barc.step")
    write_step(file, draw, LABELS)
