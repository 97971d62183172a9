"""Two C-beams: volumes and faces against closed forms."""

import numpy as np
import pytest
import ufl
from matching_faces import assert_pair, faces, parts, polygon
from mpi4py import MPI

from fenics_joints.meshes import c_beams, check_mesh

COMM = MPI.COMM_WORLD
SMALL_BEAMS = {"element_size": 6e-3, "radial_size": 3e-3, "middle_size": 25e-3}


@pytest.mark.parallel
@pytest.mark.parametrize(("layer", "bonded"), [(0.0, False), (0.0, True), (5e-4, False)])
def test_c_beams_measures(layer, bonded):
    tagged = c_beams(COMM, layer=layer, bonded=bonded, n_thickness=(2, 1), **SMALL_BEAMS)
    n = 16  # four elements along the zone's side
    hole = polygon(8.43e-3)
    pads = 2 * (0.0497 * 0.0318 - hole)
    beam = 0.508 * 0.0318 * 9.65e-3 + pads * 3.05e-3 - 2 * hole * 9.65e-3
    expected = {"beam_1": beam, "beam_2": beam}
    assert parts(tagged) == pytest.approx(expected | ({"joint": pads * layer} if layer else {}))
    found = faces(tagged)
    wall = n * 8.43e-3 * np.sin(np.pi / n) * 2 * (25.4e-3 + layer)
    rings = {
        f"washer_{i}_{side}": polygon(17.46e-3) - hole
        for i in (1, 2)
        for side in ("lower", "upper")
    }
    names = ("interface",) if bonded else ("interface_lower", "interface_upper")
    between = dict.fromkeys(("joint_lower", "joint_upper") if layer else names, 0.0)
    if not (layer or bonded):
        between = dict.fromkeys(names, pads)
    assert found == pytest.approx({"holes": wall} | rings | between)
    assert check_mesh(tagged).bodies == (1 if layer or bonded else 2)
    if not (layer or bonded):
        assert_pair(tagged, "interface_lower", "interface_upper", ("beam_1", "beam_2"))
    x = ufl.SpatialCoordinate
    heights = faces(tagged, lambda mesh: x(mesh)[2])
    ring = rings["washer_1_lower"] * (12.7e-3 + layer / 2)
    assert heights["washer_1_lower"] == pytest.approx(-ring)
    assert heights["washer_2_upper"] == pytest.approx(ring)
    along = faces(tagged, lambda mesh: x(mesh)[0])["washer_2_upper"] / rings["washer_2_upper"]
    assert along == pytest.approx(tagged.points["bolts"][1, 0]) == pytest.approx(0.48315)
