"""Draw the demo's bracket with gmsh and write it as a STEP file, as a CAD program would.

    ./with-fenicsx python3 demos/cad_bracket/draw_bracket.py [FILE]

A plate of 200 x 160 x 20 mm has four tapped holes for M12 (10.2 mm). On it stands an L-shaped
bracket with a foot of 160 x 120 x 12 mm, holes of 13.5 mm and a rib. Lengths are in millimetres.
"""

from __future__ import annotations

import sys
from pathlib import Path

from fenics_joints.meshes.step_writer import write_step

LABELS = ("Base plate", "Bracket")
BOLTS = [(x, y) for x in (-50, 50) for y in (30, 90)]


def draw(occ) -> None:
    """The two solids, the plate first."""
    plate = occ.addBox(-100, -20, -20, 200, 160, 20)
    foot, wall = occ.addBox(-80, 0, 0, 160, 120, 12), occ.addBox(-80, 0, 12, 160, 12, 138)
    corners = [occ.addPoint(-6, y, z) for y, z in ((12, 12), (80, 12), (12, 90))]
    lines = [occ.addLine(corners[i], corners[(i + 1) % 3]) for i in range(3)]
    side = occ.addPlaneSurface([occ.addCurveLoop(lines)])
    rib = [(dim, tag) for dim, tag in occ.extrude([(2, side)], 12, 0, 0) if dim == 3]
    bracket, _ = occ.fuse([(3, foot)], [(3, wall), *rib])
    for solid, low, height, radius in (([(3, plate)], -21, 22, 5.1), (bracket, -1, 14, 6.75)):
        drills = [(3, occ.addCylinder(x, y, low, 0, 0, height, radius)) for x, y in BOLTS]
        occ.cut(solid, drills)


if __name__ == "__main__":
    file = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).with_name("bracket.step")
    write_step(file, draw, LABELS)
