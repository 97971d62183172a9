"""Masses from a scale, which tell a density from a modulus: beams, whose mass is known by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from case_tables import write_frequencies
from mpi4py import MPI
from virtual_beams import beams
from virtual_plates import noisy

from fenics_joints.case import build_structure, load_case
from fenics_joints.diagnosis import diagnose
from fenics_joints.diagnosis.evidence.entries import MASS
from fenics_joints.diagnosis.model.prepared import prepare
from fenics_joints.modal import solve_modes
from fenics_joints.progress import Progress

#: By hand: two beams of 20 mm by 10 mm, and a bolt.
RHO, BOLT = 7860.0, 0.02
BEAMS = 0.7 * 0.02 * 0.01 * RHO

SIZE = {"lengths": (0.4, 0.3), "lap": 0.06, "section": (0.02, 0.01)}
KNOWN = 'tolerance = { E = "0.5 %", rho = "0.3 %", thickness = "0.2 %" }\n'
CASE = beams(**SIZE, elements=(14, 10), lap_elements=4, more=KNOWN)
CASE += """
bolted = true

[masses.bolt]
mass = "20 g"
points = [["370 mm", "0 mm", "0 mm"]]

[diagnose]
n_modes = 12
joints = "given"
discrepancy = "0.2 %"
max_effects = 1
patches = 0
effects = ["modulus error", "density error", "thickness error", "width error"]
"""
TEST = """
[test]
frequencies = "frequencies.csv"
noise = "0.05 %"
{more}

[test.sees]
along = "x"
positions = ["0 mm", "120 mm", "240 mm", "370 mm", "480 mm", "640 mm"]
direction = [0, 0, 1]
"""


def case_of(folder: Path, rho: float, more: str = ""):
    """The nominal case with a test of beams of another density."""
    folder.mkdir()
    file = folder / "case.toml"
    dense = CASE.replace("7860.0", str(rho))
    file.write_text(dense, encoding="utf-8")
    modes = solve_modes(build_structure(load_case(folder), MPI.COMM_SELF), n_modes=12)
    hz = modes.frequencies_hz[modes.n_rigid :][:5]
    hz = noisy(hz, 5e-4, np.random.default_rng(4))
    write_frequencies(folder, hz)
    file.write_text(CASE + TEST.format(more=more), encoding="utf-8")
    return load_case(folder)


def said(result):
    return {e.name: e.probability for e in result.effects}


def test_a_scale_splits_density_from_modulus(tmp_path):
    """Frequencies alone do not: the heavier beams are weighed, to 0.3 %."""
    heavier = 1.05 * BEAMS + BOLT
    apart = f'mass = "{heavier} kg"\nmass_noise = "0.3 %"'
    blind = diagnose(case_of(tmp_path / "blind", 1.05 * RHO), MPI.COMM_SELF)
    names = {e.class_name for e in blind.effects if e.name in ("density error", "modulus error")}
    assert len(names) == 1 and max(said(blind).values()) < 0.7
    seen = diagnose(case_of(tmp_path / "seen", 1.05 * RHO, apart), MPI.COMM_SELF)
    assert seen.effects[0].name == "density error" and seen.effects[0].probability > 0.75
    # And where the modulus is off, nothing but the nominal mass comes off the scale.
    plain = f'mass = "{BEAMS + BOLT} kg"\nmass_noise = "0.3 %"'
    other = diagnose(case_of(tmp_path / "other", 1.05 * RHO, plain), MPI.COMM_SELF)
    assert other.effects[0].name == "modulus error" and said(other)["density error"] < 0.05


def test_masses_that_the_model_has(tmp_path):
    """The whole with its bolt, and a part alone; by density, thickness and width."""
    part = CASE.replace("nu = 0.3\n", 'nu = 0.3\nmass = "1.1 kg"\n')
    case_of(tmp_path / "case", RHO)
    text = part + TEST.format(more='mass = "1.12 kg"')
    (tmp_path / "case" / "case.toml").write_text(text, encoding="utf-8")
    model = prepare(load_case(tmp_path / "case"), MPI.COMM_SELF, Progress(silent=True))
    whole, beams = model.evidence.scalars
    assert np.exp(whole.log_value(model.baseline)) == pytest.approx(BEAMS + BOLT, rel=1e-9)
    changed = {**model.baseline, "beams.rho": 2 * RHO, "beams.width": 0.9, "beams.thickness": 1.1}
    assert np.exp(beams.log_value(changed)) == pytest.approx(2 * 0.9 * 1.1 * BEAMS, rel=1e-9)
    kind = model.evidence.entries.kind == MASS
    assert np.exp(model.evidence.data[kind]) == pytest.approx([1.12, 1.1])
    assert model.evidence.noise_sd()[kind] == pytest.approx([0.005, 0.005])
    # No held-out frequency takes a mass with it, and none is of a mode.
    assert model.evidence.without(np.ones((1, 5), dtype=bool)).fitted.sum() == 2
