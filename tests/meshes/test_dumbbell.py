"""The dumbbells of Machines 2022: rings around bolts, against regular polygons."""

from __future__ import annotations

import numpy as np
import pytest
from matching_faces import faces, parts, polygon
from mpi4py import MPI

from fenics_joints.meshes import check_mesh, dumbbell

COMM = MPI.COMM_WORLD
SOLID = ("head_1", "neck_1", "neck_2", "head_2")
COARSE = {"element_size": 0.065}

RINGS = {"rings": [(-0.03, 0.0), (0.03, 0.0)], "r_wai": 0.024, **COARSE}


@pytest.mark.parallel
@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
@pytest.mark.parametrize("holes", [False, True])
def test_rings_around_bolts(cell, holes):
    """Volumes of regular polygons, both bodies joined by the rings alone."""
    tagged = dumbbell(COMM, holes=holes, cell=cell, **RINGS)
    assert check_mesh(tagged).bodies == 1
    assert tagged.points["bolts"] == pytest.approx(
        np.array([[-0.03, 0, 0.657e-3 / 2], [0.03, 0, 0.657e-3 / 2]])
    )
    hole = 2 * polygon(0.0175) if holes else 0.0
    areas = {"head": (0.24 * 0.18 - hole) * 0.09, "neck": (0.12 * 0.063 - hole) * 0.04}
    wanted = {name: areas[name[:4]] for name in SOLID}
    ring = polygon(0.048) - polygon(0.0175)
    wanted |= {name: ring * 0.657e-3 for name in ("ring_1", "ring_2")}
    assert parts(tagged) == pytest.approx(wanted, rel=1e-9)
    inside = faces(tagged, inner=True)
    for name in ("joint_lower", "joint_upper"):
        assert inside[name] == pytest.approx(2 * ring, rel=1e-9)
