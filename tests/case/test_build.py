"""What a case says, in the structure that is built from it."""

from __future__ import annotations

import pytest
from mpi4py import MPI

from fenics_joints.case import build_structure, load_case
from fenics_joints.errors import InputError


def test_case_takes_the_average_density(tmp_path):
    """Of two unlike bodies it is the mean; of three it is not said whose, and a law cannot be."""
    text = """
        mesh = { builder = "dumbbell", element_size = "65 mm", layer = "10 mm" }
        parts.lower = { cells = ["neck_1", "head_1"], E = "130 GPa", nu = 0.27, rho = "7.85 t/m3" }
        parts.upper = { cells = ["head_2", "neck_2"], E = "70 GPa", nu = 0.33, rho = 2700 }
        [joints.layer]
        cells = "joint"
        law = "transition"
        E = "10 GPa"
        nu = 0.24
        h = "5 mm"
        rho = "average"
    """
    (tmp_path / "case.toml").write_text(text)
    case = load_case(tmp_path)
    assert case.nominal()["layer.rho"] == pytest.approx(5275.0)
    model = build_structure(case, MPI.COMM_SELF)
    blocks = 0.24 * 0.18 * 0.09 + 0.12 * 0.063 * 0.04
    wanted = blocks * (7850 + 2700) + 5275 * 0.12 * 0.063 * 0.005
    assert model.total_mass() == pytest.approx(wanted)
    neck = 'parts.neck = { cells = "neck_2", E = "70 GPa", nu = 0.33, rho = 2000 }\n        parts.u'
    three = text.replace("parts.u", neck).replace('["head_2", "neck_2"]', '"head_2"')
    law = text.replace('"transition"', '"uncoupled"')
    for wrong, said in ((three, "expected two parts"), (law, 'or law = "transition"')):
        (tmp_path / "case.toml").write_text(wrong)
        with pytest.raises(InputError, match=said):
            load_case(tmp_path)
