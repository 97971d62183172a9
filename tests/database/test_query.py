"""From torque, bolt and plates to the pressed zone and its stiffness; the command."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
from mpi4py import MPI

from fenics_joints.database import (
    Answer,
    JointRow,
    JointSurfaces,
    TorqueToForce,
    query,
    seed_database,
)
from fenics_joints.database.kriging import Interpolation
from fenics_joints.errors import InputError
from fenics_joints.files import json_text
from fenics_joints.preload import thread
from fenics_joints.preload.torque import motosh_force

serial = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="about one process")


@serial
def test_torque_bolt_and_plates_to_radius_pressure_and_the_identified_interface(seed_surfaces):
    """The engraving machine of Machines 2022: Table 10 to Table 11, and Table 2 at 50 kN, 25 mm."""
    answer = query(seed_surfaces, bolt="M12", torque=120.0, thickness=0.025, roughness=1.6e-6)
    assert answer.force == pytest.approx(50e3) and "K = 0.2" in answer.force_from
    assert answer.radius.low < 0.05155 < answer.radius.high and not answer.extrapolated
    assert answer.pressure.low < 5.89e6 < answer.pressure.high
    assert (answer.identified.E, answer.identified.nu, answer.identified.h) == (
        6.111e9,
        0.253,
        7.2e-4,
    )
    assert "the conditions that were asked" in answer.identified_note
    json.dumps(answer.json(), allow_nan=False)


@serial
def test_another_way_to_force_and_other_conditions_are_said(seed_surfaces):
    motosh = query(
        seed_surfaces,
        bolt="M12",
        torque=60.0,
        thickness=0.02,
        torque_to_force=TorqueToForce(friction=0.12),
    )
    assert motosh.force == pytest.approx(motosh_force(60.0, "M12", 0.12, 0.12))
    assert "Motosh" in motosh.force_from and "0.12" in motosh.force_from
    assert "force, thickness differ" in motosh.identified_note
    with pytest.raises(InputError, match="diameter 12.0 mm only"):
        query(seed_surfaces, bolt="M16", force=3e4, thickness=0.02)
    other = query(seed_surfaces, bolt="M16", torque=90.0, thickness=0.04, extrapolate=True)
    assert other.extrapolated and any("no effect of it" in note for note in other.notes)
    assert other.identified.h == 0.657e-3 and "thickness is not known" in other.identified_note


@serial
@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"bolt": "M12", "thickness": 0.02}, "a torque or a force"),
        ({"bolt": "M12", "thickness": 0.02, "torque": 9.0, "force": 1e4}, "a torque or a force"),
        ({"bolt": "M12", "thickness": -0.02, "force": 3e4}, "thickness = -0.02"),
        ({"bolt": "M11", "thickness": 0.02, "force": 3e4}, "'M11' is not in the table"),
    ],
)
def test_a_bad_question_is_an_input_error(seed_surfaces, arguments, match):
    with pytest.raises(InputError, match=match):
        query(seed_surfaces, **arguments)


@serial
def test_rows_of_two_models_are_never_mixed():
    store = seed_database()
    store.add(
        JointRow(diameter=0.012, force=f, thickness=b, radius=0.02, model="other")
        for f in (1e4, 2e4, 3e4)
        for b in (0.01, 0.02)
    )
    with pytest.raises(InputError, match="several models, expected one: contact .*; other"):
        JointSurfaces.fit(store)
    assert len(JointSurfaces.fit(store, "other").rows) == 6


def _run(*arguments: object) -> subprocess.CompletedProcess:
    return subprocess.run(
        [sys.executable, "-m", "fenics_joints", "database", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=120,
    )


@serial
def test_command_adds_and_answers(tmp_path):
    database, out = tmp_path / "own.db", tmp_path / "answer.json"
    seed_database().export_csv(tmp_path / "rows.csv")
    assert _run("add", "--db", database, "--csv", tmp_path / "rows.csv").returncode == 0
    added = _run(
        "add",
        "--db",
        database,
        "--bolt",
        "M12",
        "--torque",
        "96 N·m",
        "--thickness",
        "25 mm",
        "--E",
        "5 GPa",
        "--nu",
        0.25,
        "--h",
        "0.7 mm",
    )
    assert added.returncode == 0 and "has 38 now" in added.stdout
    asked = _run(
        "query",
        "--db",
        database,
        "--torque",
        "96 N·m",
        "--bolt",
        "M12",
        "--thickness",
        "25 mm",
        "--json",
        out,
    )
    assert asked.returncode == 0, asked.stderr
    answer = json.loads(out.read_text())
    assert answer["force_N"] == pytest.approx(40e3) and answer["identified"]["E"] == 5e9
    assert answer["radius_m"]["low"] < 0.0502 < answer["radius_m"]["high"]
    assert "T = K d F" in asked.stdout and "mm" in asked.stdout
    wrong = _run("query", "--torque", "96", "--bolt", "M12", "--thickness", "25 mm")
    assert wrong.returncode == 1
    assert "error: --torque '96': expected a number with its unit" in wrong.stderr


def test_an_uncertainty_without_bound_is_null_in_json():
    radius = Interpolation(1.0, float("inf"), 0.0, float("inf"), True)
    answer = Answer(thread("M12"), 1e4, "given", 0.02, radius, None, None, "")
    found = json.loads(json_text(answer.json()))["radius_m"]
    assert (found["sd"], found["high"], found["value"]) == (None, None, 1.0)
