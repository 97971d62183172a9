"""Joints split around their bolts, against areas and symmetries known without the mesh."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI
from step_files import bores

from fenics_joints._compat import geometry_dofmap
from fenics_joints.case import Case, build_mesh, build_structure
from fenics_joints.diagnosis.zones.joints import joint_zones
from fenics_joints.errors import InputError
from fenics_joints.meshes.step_writer import write_step

STEEL = {"E": 2e11, "nu": 0.3, "rho": 7800.0}
SOFT = {"E": 1e9, "G": 4e8}
PLATES = {
    "mesh": {"builder": "lap_plates", "n_thickness": 1, "degree": 1},
    "parts": {"plates": {"cells": ["plate_1", "plate_2"], **STEEL}},
    "joints": {
        "near": {"cells": "joint_near", "bolted": True, "tolerance": {"E": 0.2}, **SOFT},
        "away": {"cells": "joint_away", **SOFT},
    },
}
BEAM = {
    "mesh": {"builder": "lap_beam", "layer": 1e-4, "root": 1e-3, "degree": 1},
    "parts": {"beams": {"cells": ["beam_1", "beam_2"], **STEEL}},
    "joints": {
        "lap": {"cells": "joint", **SOFT},
        "root": {"cells": "root", "normal": [1, 0, 0], **SOFT},
    },
}

BOLTS = ("bolt 1", "bolt 2", "bolt 3", "bolt 4")


def zones(data, comm=MPI.COMM_SELF, **joints):
    joints = {name: joint | joints.get(name, {}) for name, joint in data["joints"].items()}
    case = Case.model_validate(data | {"joints": joints})
    return joint_zones(case, build_mesh(case, comm))


def areas(found, attribute=None, label=None):
    """Of all zones, or of those with a label."""
    own = (zone for zone in found if not attribute or getattr(zone, attribute) == label)
    return np.array([zone.area for zone in own])


def test_zones_are_the_joints_and_equal_at_mirrored_bolts():
    found = zones(PLATES)
    assert len(found.names) == 20 == len(set(found.names))
    assert "away_b4_r4" in found.names and "near_b1_r1" in found.names
    area = {name: areas(found, "joint", name).sum() for name in PLATES["joints"]}
    assert area == pytest.approx({"near": 4 * 0.02**2, "away": 0.08**2 - 4 * 0.02**2})
    by_bolt = np.array([areas(found, "bolt", label) for label in BOLTS])
    assert by_bolt == pytest.approx(np.tile(by_bolt[0], (4, 1)))
    span = np.array([z.distance for z in found if z.name.startswith("away_b1")])
    assert np.all(span[1:, 0] > span[:-1, 1])
    # Equal shares, as nearly as small cells allow; 5 mm ones come in lumps.
    fine = zones(PLATES | {"mesh": PLATES["mesh"] | {"element_size": 2e-3}})
    away = areas(fine, "joint", "away")
    assert len(away) == 16 and away == pytest.approx(np.full(16, area["away"] / 16), rel=0.15)
    assert found.case.joints["near_b2_r1"].tolerance.E == 0.2
    assert found.case.joints["near_b2_r1"].bolted


def test_split_structure_is_the_whole_one():
    """The zones' volumes, as a structure sums them, are the areas times the thickness."""
    found = zones(PLATES)
    model = build_structure(found.case, MPI.COMM_SELF, tagged=found.tagged)
    volumes = dict(zip([r.name for r in model.regions], model.volumes(), strict=True))
    assert [volumes[n] for n in found.names] == pytest.approx(areas(found) * 5e-4)
    cells = {r.name: c for r, c in model.field.regions}
    x = model.mesh.geometry.x[geometry_dofmap(model.mesh)].mean(axis=1)
    bolts = found.tagged.points["bolts"]
    for zone in found:
        off = np.linalg.norm(x[cells[zone.name]][:, None, :2] - bolts[:, :2], axis=2)
        assert np.all(off.argmin(axis=1) == BOLTS.index(zone.bolt))
        assert [off.min(axis=1).min(), off.min(axis=1).max()] == pytest.approx(zone.distance)


def test_a_layer_far_from_the_bolt_stays_whole():
    found = zones(BEAM)
    assert (found.all[-1].name, found.all[-1].joint, found.all[-1].bolt) == ("root", "root", "")
    assert set(found.names[:-1]) == {f"lap_r{k}" for k in range(1, len(found.names))}
    assert len(found.names) >= 4 and np.isnan(found.all[-1].distance).all()
    assert areas(found)[:-1].sum() == pytest.approx(0.05 * 0.0254)
    two = zones(BEAM, lap={"bolts": [[0.19, 0.0], [0.23, 0.0]]})
    left, right = (areas(two, "bolt", label).sum() for label in BOLTS[:2])
    assert left == pytest.approx(right) and left + right == pytest.approx(areas(found)[:-1].sum())


#: Screws of a wall between two plates, mm: as many in the one as in the other, in line.
SCREWS = [(20, 10), (60, 10), (100, 10)]


def _walled(occ):
    plates = [(3, occ.addBox(0, 0, z, 120, 20, 8)) for z in (0, 48)]
    wall = (3, occ.addBox(0, 0, 8, 120, 20, 40))
    occ.cut([*plates, wall], bores(occ, SCREWS, -1, 57, 3))


@pytest.mark.parallel
def test_screws_in_line_hold_their_own_ends_of_a_wall(shared_tmp_path):
    """One joint section for all: each screw has its own ring, each end of the wall is a face."""
    path = shared_tmp_path / "wall.step"
    if MPI.COMM_WORLD.rank == 0:
        write_step(path, _walled)
    MPI.COMM_WORLD.barrier()
    points = [[x * 1e-3, y * 1e-3, z * 1e-3] for z in (8, 48) for x, y in SCREWS]
    parts = {"base": 4, "wall": 28, "lid": 52}
    data = {
        "mesh": {
            "file": str(path),
            "size": 0.02,
            "ring_size": 6e-3,
            "circle": 8,
            "parts": {name: [0.04, 0.01, z * 1e-3] for name, z in parts.items()},
            "bolts": {"at": points, "r_nei": 3e-3, "r_wai": 7e-3},
        },
        "parts": {name: {"cells": [name], **STEEL} for name in parts},
        "joints": {"all": {"cells": "ring_*", "law": "springs", "k_n": 1e14, "k_t": 1e14}},
    }
    found = zones(data, MPI.COMM_WORLD, all={})
    assert list(found.by("bolt")) == [f"bolt {i}" for i in range(1, 7)]
    for i, (*_, z) in enumerate(points, start=1):
        own = areas(found, "bolt", f"bolt {i}")
        assert own.sum() == pytest.approx(np.pi * (7**2 - 3**2) * 1e-6, rel=0.15)
        names = [zone.name for zone in found if zone.bolt == f"bolt {i}"]
        face = "base and wall" if z < 0.03 else "wall and lid"
        assert set(names) <= set(found.places["joint"][face])
    assert list(found.places["joint"]) == ["base and wall", "wall and lid"]


@pytest.mark.parallel
@pytest.mark.parametrize("size", [5e-3, 2e-2])
def test_two_ranks_make_the_same_zones(size):
    """Some of the larger cells are half-way between bolts, which share them as well as can be."""
    plates = PLATES | {"mesh": PLATES["mesh"] | {"element_size": size}}
    alone, together = (zones(plates, comm) for comm in (MPI.COMM_SELF, MPI.COMM_WORLD))
    assert together.names == alone.names
    assert areas(together) == pytest.approx(areas(alone))
    share = [areas(alone, "bolt", bolt).sum() / 0.04**2 for bolt in BOLTS]
    assert share == pytest.approx([1.0] * 4, abs=1e-9 if size < 0.01 else 0.07)
    spans = [np.array([zone.distance for zone in each]) for each in (together, alone)]
    assert spans[0] == pytest.approx(spans[1])
    model = build_structure(together.case, MPI.COMM_WORLD, tagged=together.tagged)
    volumes = dict(zip([r.name for r in model.regions], model.volumes(), strict=True))
    assert [volumes[n] for n in together.names] == pytest.approx(areas(alone) * 5e-4)


def test_bad_bolts_are_named():
    with pytest.raises(InputError, match=r"joints.lap.bolts\[0\] = .*outside the joint"):
        zones(BEAM, lap={"bolts": [[0.05, 0.0]]})
    with pytest.raises(ValueError, match=r"bolts\[1\].*expected each bolt once"):
        zones(BEAM, lap={"bolts": [[0.2, 0.0], [0.2, 0.0]]})
