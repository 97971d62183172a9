"""From torque, bolt and plates to the pressed zone and its stiffness; the command."""

from __future__ import annotations

import csv
import json
import shlex
import sys

import numpy as np
import pytest
from mpi4py import MPI

from fenics_joints.cli import main
from fenics_joints.commands.database_document import rows_document
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
from fenics_joints.report.document import Table

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="about one process")


def test_torque_bolt_and_plates_to_radius_pressure_and_the_identified_interface(seed_surfaces):
    """The engraving machine of Machines 2022: Table 10 to Table 11, and Table 2 at 50 kN, 25 mm."""
    answer = query(seed_surfaces, bolt="M12", torque=120.0, thickness=0.025, roughness=1.6e-6)
    assert answer.force == pytest.approx(50e3) and "K = 0.2" in answer.force_from
    assert answer.radius.low < 0.05155 < answer.radius.high and not answer.extrapolated
    assert answer.pressure.low < 5.89e6 < answer.pressure.high
    found = answer.identified
    assert (found.E, found.nu, found.h) == (6.111e9, 0.253, 7.2e-4)
    assert "the conditions that were asked" in answer.identified_note
    json.dumps(answer.json(), allow_nan=False)


def test_another_way_to_force_and_other_conditions_are_said(seed_surfaces):
    how = TorqueToForce(friction=0.12)
    motosh = query(seed_surfaces, bolt="M12", torque=60.0, thickness=0.02, torque_to_force=how)
    assert motosh.force == pytest.approx(motosh_force(60.0, "M12", 0.12, 0.12))
    assert "Motosh" in motosh.force_from and "0.12" in motosh.force_from
    assert "force, thickness differ" in motosh.identified_note
    with pytest.raises(InputError, match="diameter 12.0 mm only"):
        query(seed_surfaces, bolt="M16", force=3e4, thickness=0.02)
    other = query(seed_surfaces, bolt="M16", torque=90.0, thickness=0.04, extrapolate=True)
    assert other.extrapolated and any("no effect of it" in note for note in other.notes)
    assert other.identified.h == 0.657e-3 and "thickness is not known" in other.identified_note


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


def test_command_adds_and_answers(tmp_path, monkeypatch, capfd):
    own, rows, out = (tmp_path / name for name in ("own.db", "rows.csv", "answer.json"))

    def run(words: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["fenics-joints", "database", *shlex.split(words)])
        with pytest.raises(SystemExit) as end:
            main()
        return end.value.code or 0, *capfd.readouterr()

    seed_database().export_csv(rows)
    assert run(f"add --db {own} --csv {rows}")[0] == 0
    joint = "--bolt M12 --torque '96 N·m' --thickness '25 mm'"
    status, said, _ = run(f"add --db {own} {joint} --E '5 GPa' --nu 0.25 --h '0.7 mm'")
    assert status == 0 and "has 38 now" in said
    status, said, errors = run(f"query --db {own} {joint} --json {out}")
    assert status == 0 and "T = K d F" in said and "mm" in said, errors
    answer = json.loads(out.read_text())
    assert answer["force_N"] == pytest.approx(40e3) and answer["identified"]["E"] == 5e9
    assert answer["radius_m"]["low"] < 0.0502 < answer["radius_m"]["high"]
    status, _, errors = run(f"query {joint.replace(' N·m', '')}")
    assert status == 1 and "error: --torque '96': expected a number with its unit" in errors


def test_rows_and_what_the_others_predict_of_each(seed_surfaces):
    """The table, its CSV and the JSON have the same numbers, those of the rows."""
    rows = seed_surfaces.rows
    document = rows_document("seed", rows, seed_surfaces)
    table = next(b for b in document.blocks if isinstance(b, Table))
    made = list(csv.DictReader(table.to_csv().splitlines()))
    assert [float(row["radius"]) for row in made] == [j.radius for j in rows]
    shown = float(table.rows[0].cells[table.keys.index("force")].text)
    assert shown == pytest.approx(rows[0].force / 1e3, rel=1e-3)
    left = document.data()["leave_one_out"]["radius"]
    error = np.array(left["predicted"]) / [j.radius for j in rows] - 1
    assert left["error"] == pytest.approx(error)
    assert left["mean_absolute_error"] == pytest.approx(np.abs(error).mean())


def test_an_uncertainty_without_bound_is_null_in_json():
    radius = Interpolation(1.0, float("inf"), 0.0, float("inf"), True)
    answer = Answer(thread("M12"), 1e4, "given", 0.02, radius, None, None, "")
    found = json.loads(json_text(answer.json()))["radius_m"]
    assert (found["sd"], found["high"], found["value"]) == (None, None, 1.0)
