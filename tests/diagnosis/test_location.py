"""Where the gap lies, on the measured lap plates of Tian et al. 2021 with the cause withheld."""

from __future__ import annotations

import json

import pytest
from measured_points import reduced
from mpi4py import MPI

from fenics_joints.case import build_structure, load_case
from fenics_joints.diagnosis.location import locate_gap
from fenics_joints.measurements import pair_modes
from fenics_joints.modal import solve_modes

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="writes a case in a folder")


def test_the_measured_gap_lies_in_the_joint_away_from_the_bolts(write_case, tmp_path):
    """The paper's own finding, from tests of zones alone: the layer away from the bolts is the
    most probable place, with a signed map and shares that agree; the lowest torque misfits most."""
    few = '[diagnose]\nsamples = 8\neffects = ["joint normal and tangential compliance", '
    few += '"compliance away from the bolts only", "compliance at one bolt"]\n'
    case = load_case(write_case(tmp_path, ("[diagnose]\n", few)))
    full = build_structure(case, MPI.COMM_SELF)
    modes = solve_modes(full, n_modes=16)
    shapes = modes.at(case.sensors())[:, pair_modes(modes, 4, case.sensors()).index]
    rows = [",".join(f"bending {j}" for j in range(1, 5))]
    rows += [",".join(f"{x:.6g}" for x in row) for row in shapes * 1e3]
    (tmp_path / "shapes.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    text = (tmp_path / "case.toml").read_text(encoding="utf-8")
    (tmp_path / "case.toml").write_text(
        text.replace('damping = "damping.csv"', 'shapes = "shapes.csv"'), encoding="utf-8"
    )
    found = locate_gap(reduced(load_case(tmp_path)), n_patches=6)
    regions = {test.zone: test for test in found.regions}
    assert max(regions, key=lambda name: regions[name].share) == "away"
    first = found.ranked[0]
    assert first.region == found.shares[0].region == "away" and first.log_f < 0
    assert sum(row.share for row in found.shares) == pytest.approx(1.0)
    assert regions["away"].p_adjusted < 1e-6
    by_torque = [part for part in found.attribution if part.by == "condition"]
    assert max(by_torque, key=lambda part: part.chi2).label == "2"
    for by in ("mode", "band", "condition", "kind"):
        total = sum(part.chi2 for part in found.attribution if part.by == by)
        assert total == pytest.approx(found.misfit, rel=1e-9)
    best = max(found.patches.tests, key=lambda test: test.log_evidence)
    assert best.zone.startswith("away") and found.middle(best) is not None
    assert json.loads(json.dumps(found.to_json()))["misfit"] == found.misfit
