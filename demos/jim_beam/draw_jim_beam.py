"""Draw the Jim beam's three plates with gmsh and write them as a STEP file, as CAD would.

    ./with-fenicsx python3 demos/jim_beam/draw_jim_beam.py [FILE]

Lengths are in millimetres, read off the nodes of the test's public model: two plates of 300 x 150 x
10, and a third of 100 x 150 x 10 between their ends. This model has no screws, so none are drawn.
"""

from __future__ import annotations

import sys
from pathlib import Path

from fenics_joints.meshes.step_writer import write_step

LABELS = ("Side 1, aluminium", "Side 2, aluminium", "Back, aluminium")


def draw(occ) -> None:
    """The three solids, in the order of their labels."""
    for x in (0, 110):
        occ.addBox(x, -150, -300, 10, 150, 300)
    occ.addBox(10, -150, -10, 100, 150, 10)


if __name__ == "__main__":
    file = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).with_name("jim_beam.step")
    write_step(file, draw, LABELS)
