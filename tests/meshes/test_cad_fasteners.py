"""Bolts, nuts and washers in a drawing are told from its parts, and faces under heads are drawn."""

from __future__ import annotations

import numpy as np
import pytest
from mesh_measures import areas, volumes
from mpi4py import MPI
from step_files import bores, joined, screws
from step_meshes import meshed

from fenics_joints.errors import MeshError
from fenics_joints.meshes.cad_survey import survey_step
from fenics_joints.meshes.step_writer import write_step

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="gmsh runs on one rank")

AT = [(30, 20), (70, 20)]


def with_spacers(occ):
    """Two plates apart, a spacer on each bolt between them, a washer under each head."""
    joined(occ, AT, gap=5)
    for x, y in AT:
        for z, t, r in ((10, 5, 7), (-1.6, 1.6, 8)):
            ring = occ.addCylinder(x, y, z, 0, 0, t, r)
            occ.cut([(3, ring)], bores(occ, [(x, y)], z - 1, z + t + 1, 4.2))
    screws(occ, AT, -1.6, 25)


def turned(occ):
    joined(occ, AT)
    screws(occ, AT, 0, 20, nut=True)
    occ.rotate(occ.getEntities(3), 0, 0, 0, 1, 2, -0.5, 0.7)


def tapped(occ):
    """Screws in holes that are narrower than their threads."""
    joined(occ, AT, radii=(4.5, 3.4))
    screws(occ, AT, 0, 18)


def twice(occ):
    joined(occ, AT)
    joined(occ, AT)


def shaft(occ):
    joined(occ, [(50, 20)])
    screws(occ, [(50, 20)], 0, 300)


DRAWN = {
    "spacers": (with_spacers, {"bolt": 2, "ring": 2}, 4),
    "turned": (turned, {"bolt": 2, "ring": 2}, 2),
    "tapped": (tapped, {"bolt": 2}, 2),
    "twice": (twice, {"twin": 2}, 2),
    "long rod": (shaft, {}, 2),
}


@pytest.mark.parametrize("name", DRAWN)
def test_fasteners_are_no_parts(tmp_path, name):
    draw, expected, holes = DRAWN[name]
    survey = survey_step(write_step(tmp_path / "a.step", draw))
    kinds = [item.kind for item in survey.left_out]
    assert {kind: kinds.count(kind) for kind in set(kinds)} == expected
    assert len(survey.holes) == holes


def test_washers_are_drawn_and_bolts_left_out(tmp_path):
    """Faces under heads have the area of a ring, and the mesh the volume of two bored plates."""
    given = {"washers": {"head": ([0.03, 0.02, 0], 7e-3)}, "joint": "contact", "circle": 60}

    def draw(occ):
        joined(occ, AT)
        screws(occ, AT, 0, 20, nut=True)

    tagged = meshed(tmp_path, draw, without=[3, 4, 5, 6], **given)
    assert len(tagged.cell_names) == 2
    ring = np.pi * (7e-3**2 - 4.5e-3**2)
    assert areas(tagged)["head"] == pytest.approx(ring, rel=5e-3)
    bored = 2 * (0.1 * 0.04 - 2 * np.pi * 4.5e-3**2) * 0.01
    assert sum(volumes(tagged).values()) == pytest.approx(bored, rel=1e-3)


@pytest.mark.parametrize(
    "given, match",
    [
        ({"washers": {"head": ([0.05, 0.02, 0], 7e-3)}}, "0 outer flat faces have a round hole"),
        ({"washers": {"head": ([0.03, 0.02, 0], 4e-3)}}, "more than the hole's, 4.5 mm"),
        ({"washers": {"head": ([0.03, 0.02, 0], 25e-3)}}, "% of the face of 25 mm"),
        ({"without": [1, 2]}, "leaves out all solids"),
        ({"without": [3]}, r"without\[0\] = 3 fits 0 solids"),
    ],
)
def test_refused_washers(tmp_path, given, match):
    with pytest.raises(MeshError, match=match):
        meshed(tmp_path, lambda occ: joined(occ, AT), joint="contact", **given)
