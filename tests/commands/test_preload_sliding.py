"""Two plates with two screws whose faces slide without friction."""

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("dolfinx")

from mpi4py import MPI

from fenics_joints.case import load_case
from fenics_joints.commands.preload import run_preload
from fenics_joints.errors import InputError
from fenics_joints.progress import Progress

CASE = Path(__file__).parent / "data" / "preload"


def test_faces_that_slide_leave_motions_and_six_elastic_modes():
    """A plate glides on the other along two directions and turns; the table has no mode less."""
    found = run_preload(load_case(CASE), MPI.COMM_SELF, Progress(silent=True))
    facts, report = found.json(), found.result
    assert facts["free_motions"] == 3
    hz = facts["frequencies_hz"]
    assert len(hz["stuck"]) == len(hz["preloaded"]) == 6
    assert min(hz["stuck"] + hz["preloaded"]) > 100
    # By their order, freed modes seemed to rise by 20 %; freed of a constraint no mode does.
    pairs = [(a, b) for a, b in zip(hz["stuck"], hz["stuck_become"], strict=True) if b]
    assert len(pairs) >= 2 and all(b < 1.005 * a for a, b in pairs)
    (contact,) = facts["contacts"]
    assert contact["force_n"] == pytest.approx(sum(facts["bolt_forces_n"].values()), rel=1e-6)
    assert contact["area_above_1_mpa_m2"] <= contact["area_m2"] <= contact["whole_area_m2"]
    for bolt, (equal, least, most) in contact["equal_radius_m"].items():
        assert least <= equal <= most and equal <= contact["radius_m"][bolt] * 1.02
    json.dumps(facts)
    # Receding contact: twice the force, twice the pressure on the same area.
    state, solver = report.result["joint"], report.result.solver
    twice = solver.solve({name: 2 * f for name, f in facts["bolt_forces_n"].items()})["joint"]
    assert np.array_equal(twice.status, state.status)
    assert np.abs(twice.pressure - 2 * state.pressure).max() < 1e-6 * twice.pressure.max()
    assert any("receding" in note for note in facts["notes"])


def test_odd_friction_and_torque_are_noted(tmp_path):
    """Friction of 20 holds what touches, as 0.15 does, and is noted, as is a torque of 1e12.

    Friction of 1e9 is refused.
    """
    text, made = (CASE / "case.toml").read_text(), {}
    (tmp_path / "two_w.step").write_bytes((CASE / "two_w.step").read_bytes())
    for friction, torque in (("0.15", '"25 N m"'), ("20", "1e12")):
        changed = text.replace("friction = 0\n", f"friction = {friction}\n")
        changed = changed.replace('torque = "25 N m"', f"torque = {torque}")
        (tmp_path / "case.toml").write_text(changed)
        case = load_case(tmp_path)
        made[friction] = run_preload(case, MPI.COMM_SELF, Progress(silent=True)).json()
    hz = [made[key]["frequencies_hz"]["preloaded"] for key in made]
    assert hz[0] == pytest.approx(hz[1], rel=1e-6)
    assert len(made["20"]["notes"]) == len(made["0.15"]["notes"]) + 2
    (tmp_path / "case.toml").write_text(text.replace("friction = 0\n", "friction = 1e9\n"))
    with pytest.raises(InputError, match="friction"):
        run_preload(load_case(tmp_path), MPI.COMM_SELF, Progress(silent=True))
