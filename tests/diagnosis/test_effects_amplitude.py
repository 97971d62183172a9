"""Backbones as laboratories have them: friction among what is named, and what cannot be told.

The measured one is of the Brake-Reuss beam's first mode, response-controlled (data:
mattiacenedese/BRBtesting): it softens a little, then hardens, and its damping grows fourfold.
"""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("dolfinx")

from mpi4py import MPI

from fenics_joints.case import load_case
from fenics_joints.commands.diagnose.explanation import explain
from fenics_joints.diagnosis import diagnose
from fenics_joints.diagnosis.effects.amplitude import FRICTION, GROWING, NAMES, SOFTENING

LEVELS = (5, 20, 30, 40, 50, 60, 70, 80)
HERTZ = (80.379, 80.204, 80.211, 80.132, 80.266, 80.344, 80.414, 80.455)
PERCENT = (0.1451, 0.1914, 0.2342, 0.2980, 0.3706, 0.4482, 0.5487, 0.6399)

_CASE = f"""
title = "Brake-Reuss beam, coarse"

[mesh]
builder = "half_lap_beam"
length = "720 mm"
width = "25.4 mm"
thickness = "12.7 mm"
lap = "120 mm"
bolts = 3
washer = "15 mm"
gap = "0.2 mm"
layer = "0.1 mm"
n_length = 6
n_lap = 6
n_width = 2
n_thickness = 1

[parts.beams]
cells = ["beam_1", "beam_2"]
E = "194 GPa"
nu = 0.3
rho = "7745 kg/m3"

[joints.lap]
cells = ["joint"]
E = "2.2 MPa"
G = "10.2 MPa"

[test]
frequencies = "backbone.csv"
condition = "level"
modes = ["bending 1"]
noise = "0.05 %"
damping_noise = "5 %"

[test.sees]
points = [["85 mm", "0 mm", "6.35 mm"], ["700 mm", "0 mm", "6.35 mm"]]
direction = [0, 0, 1]

[diagnose]
n_modes = 8
samples = 4
max_effects = 2
nested = 0
patches = 0
effects = ["joint normal and tangential compliance", {", ".join(f'"{name}"' for name in NAMES)}]
"""


@pytest.fixture(scope="module")
def diagnosed(tmp_path_factory):
    def run(hertz, percent):
        folder = tmp_path_factory.mktemp("backbone")
        rows = ["level [m/s2],bending 1 [Hz],damping [%]"]
        rows += [f"{a},{f},{z}" for a, f, z in zip(LEVELS, hertz, percent, strict=True)]
        (folder / "backbone.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
        (folder / "case.toml").write_text(_CASE, encoding="utf-8")
        return diagnose(load_case(folder), MPI.COMM_SELF)

    return run


def probabilities(result) -> dict[str, float]:
    return {e.name: e.probability for e in result.effects}


def test_friction_is_among_what_the_brake_reuss_beam_has(diagnosed):
    result = diagnosed(HERTZ, PERCENT)
    p, words = probabilities(result), explain(result)
    assert p[FRICTION] > 0.3 and p[FRICTION] > p[GROWING] and p[SOFTENING] < 0.1
    # One mode does not say whether the joint or all of the structure dissipates: that is told.
    (group,) = {e.class_name for e in result.effects if e.name in (FRICTION, GROWING)}
    assert FRICTION in group and GROWING in group
    assert FRICTION in words.which and GROWING in words.which and "cannot tell apart" in words.which
    assert min(row["probability"] for row in result.to_json()["effects"]) >= 0.01


def test_friction_that_hardens_is_found_where_it_is_known_to_be(diagnosed):
    """Softening of 0.3 % that a square of the level brings back, thrice the damping that Masing's
    rule gives it, and curves that drift by 0.05 % from one to the next."""
    x = np.array(LEVELS) / 80
    rng = np.random.default_rng(3)
    hertz = 80.3 * (1 - 0.003 * x**0.6 + 0.003 * x**2) * np.exp(5e-4 * rng.standard_normal(8))
    percent = 0.14 + 0.35 * x**1.1 * np.exp(0.03 * rng.standard_normal(8))
    result = diagnosed(hertz, percent)
    p = probabilities(result)
    assert p[FRICTION] > 0.5 > p[GROWING]
    lead = {r["name"]: r for r in result.hypotheses[0].parameters if FRICTION in r["effect"]}
    assert abs(lead["power"]["value"] - 1.1) < 0.3
