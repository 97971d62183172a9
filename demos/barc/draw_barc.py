"""Draw the BARC's box, feet and beam with gmsh and write them as a STEP file, as CAD would.

    ./with-fenicsx python3 demos/barc/draw_barc.py [FILE]

Lengths are in millimetres, read off the nodes of the test's public model. In inches: a box of
6 x 6 x 3 with walls of 1/4 and a slot of 1/2 across its roof; channels of 2 x 1, 1/8 thick and 1
long; a beam of 5 x 1, 1/8 thick. The holes of the screws are left out: the screws clamp the whole
of each foot, and most of the mesh would be around holes of 4 mm.
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
