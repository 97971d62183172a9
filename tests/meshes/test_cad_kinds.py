"""Planes and circles that a file has as splines: mirrored bodies."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI
from step_files import bores

from fenics_joints.meshes import read_step
from fenics_joints.meshes.cad_survey import survey_step
from fenics_joints.meshes.step_writer import write_step

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="gmsh draws on one process")

BOLTS = [(30.0, 20.0), (70.0, 40.0)]


def plates(occ):
    """Two plates, one on the other, and two holes of 9 mm through both."""
    low = occ.addBox(0, 0, 0, 100, 60, 10)
    up = occ.addBox(10, 0, 10, 120, 60, 15)
    occ.cut([(3, low)], bores(occ, BOLTS, -1, 11, 4.5))
    occ.cut([(3, up)], bores(occ, BOLTS, 9, 26, 4.5))


def mirrored(occ):
    """The same at a plane, by which all faces become splines."""
    plates(occ)
    occ.synchronize()
    occ.mirror(occ.getEntities(3), 1, 0, 0, 0)


def test_a_mirrored_drawing_is_the_drawing(tmp_path):
    """Faces, holes and their depths at mirrored places; a mesh with rings and the same volume."""
    one = survey_step(write_step(tmp_path / "drawn.step", plates))
    two = survey_step(write_step(tmp_path / "mirrored.step", mirrored))
    assert two.touching[0].area == pytest.approx(one.touching[0].area, rel=1e-3)
    at = sorted(tuple(np.round(1e3 * hole.centre * [-1, 1, 1], 4)) for hole in two.holes)
    assert at == sorted((x, y, 10.0) for x, y in BOLTS)
    for hole in two.holes:
        assert np.allclose(hole.diameters, 9e-3, atol=1e-6)
        assert np.allclose(hole.depths, (10e-3, 15e-3), atol=1e-6) and hole.room > 9e-3
    mesh = read_step(
        tmp_path / "mirrored.step",
        MPI.COMM_SELF,
        element_size=0.03,
        r_wai=9e-3,
        circle=8,
        ring_size=9e-3,
    )
    assert {"ring_1", "ring_2"} <= set(mesh.cell_names)
