"""What lies on what in a drawing: sheets, washers and spacers, small overlaps; splines."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI
from step_files import bores
from step_meshes import meshed

from fenics_joints.errors import MeshError
from fenics_joints.meshes import measure_ring
from fenics_joints.meshes.cad_survey import survey_step
from fenics_joints.meshes.step_writer import write_step

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="gmsh draws on one process")


def touching(survey) -> set[tuple[str, str, int]]:
    """Pairs that touch by the labels, and their gaps, um."""
    return {
        (*(survey.solids[i].label for i in touch.solids), round(1e6 * touch.gap))
        for touch in survey.touching
    }


def spacers(occ):
    """Two plates on two rings of 1 mm; between the plates there is air."""
    plates = [occ.addBox(0, 0, z, 100, 50, 10) for z in (0, 11)]
    rings = [occ.addCylinder(x, 25, 10, 0, 0, 1, 9) for x in (25, 75)]
    places = [(25, 25), (75, 25)]
    for tag in plates + rings:
        occ.cut([(3, tag)], bores(occ, places, -1, 22, 4.5))


def shim(occ):
    """A foil of half a millimetre under one half of a block."""
    occ.addBox(0, 0, 0, 100, 50, 10)
    occ.addBox(10, 10, 10, 20, 30, 0.5)
    occ.addBox(10, 10, 10.5, 80, 30, 10)


def in_a_frame(occ):
    """A frame 0.3 mm above a plate, and a block on the plate in its opening."""
    occ.addBox(0, 0, 0, 100, 50, 10)
    frame, opening = occ.addBox(0, 0, 10.3, 100, 50, 5), occ.addBox(30, 15, 10, 40, 20, 20)
    occ.cut([(3, frame)], [(3, opening)])
    occ.addBox(35, 20, 10, 30, 10, 20)


STACKS = {
    "rings between plates": (
        spacers,
        "abrs",
        {("a", "r", 0), ("a", "s", 0), ("b", "r", 0), ("b", "s", 0)},
    ),
    "foil under a half": (shim, "abc", {("a", "b", 0), ("b", "c", 0)}),
    "frame round a block": (in_a_frame, "abc", {("a", "b", 300), ("a", "c", 0)}),
}


@pytest.mark.parametrize("name", STACKS)
def test_what_lies_between_keeps_faces_apart(tmp_path, name):
    draw, labels, expected = STACKS[name]
    survey = survey_step(write_step(tmp_path / "a.step", draw, labels=labels))
    assert touching(survey) == expected


@pytest.mark.parametrize(
    "apart, touches", [(-0.05, False), (-0.015, True), (0.3, True), (1.2, False)]
)
def test_small_overlaps_touch(tmp_path, apart, touches):
    def draw(occ):
        occ.addBox(0, 0, 0, 100, 50, 10)
        occ.addBox(0, 0, 10 + apart, 100, 50, 10)

    path = write_step(tmp_path / "a.step", draw, labels="ab")
    if apart < 0 and not touches:
        with pytest.raises(MeshError, match="overlap by 250 mm3"):
            survey_step(path)
    else:
        gaps = [touch.gap for touch in survey_step(path).touching]
        assert np.allclose(gaps, 1e-3 * np.array([apart] * touches))


def test_rooms_of_many_holes(tmp_path):
    """Of rings in a pattern of 36 holes, 20 mm apart: half of it less 2 %, in steps of 7 %."""
    places = [(10 + 20 * i, 10 + 20 * j) for i in range(6) for j in range(6)]

    def draw(occ):
        for z in (0, 10):
            plate = [(3, occ.addBox(0, 0, z, 120, 120, 10))]
            occ.cut(plate, bores(occ, places, z - 1, z + 11, 4.5))

    survey = survey_step(write_step(tmp_path / "a.step", draw))
    found = {tuple(np.round(1e3 * hole.centre[:2]).astype(int)) for hole in survey.holes}
    assert found == set(places) and len(survey.holes) == 36
    rooms = np.array([hole.room for hole in survey.holes])
    assert np.all(rooms <= 0.98 * 0.01) and np.all(rooms > 0.93 * 0.98 * 0.01)
    assert np.allclose([hole.depths for hole in survey.holes], 0.01)


def thin_pack(occ):
    """Four sheets of 0.5 mm with one hole through all."""
    for i in range(4):
        sheet = [(3, occ.addBox(0, 0, 0.5 * i, 60, 60, 0.5))]
        occ.cut(sheet, bores(occ, [(30, 30)], -1, 4, 4.5))


def test_rings_of_a_pack_of_thin_sheets(tmp_path):
    """Each given centre is on the faces that are nearest to it, not on the first within reach."""
    at = [(0.03, 0.03, 0.0005 * i) for i in (1, 2, 3)]
    tagged = meshed(tmp_path, thin_pack, bolts=at, r_wai=0.01)
    assert np.allclose(tagged.points["bolts"], at, atol=1e-6)
    rings = [measure_ring(tagged, f"ring_{n}") for n in (1, 2, 3)]
    assert len({frozenset(ring.lower + ring.upper) for ring in rings}) == 3


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
    mesh = meshed(tmp_path, mirrored, r_wai=9e-3, ring_size=9e-3)
    assert {"ring_1", "ring_2"} <= set(mesh.cell_names)
