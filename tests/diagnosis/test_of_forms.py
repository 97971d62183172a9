"""Diagnoses of a model by forms of one's own."""

from __future__ import annotations

import numpy as np
import pytest
from clamped_strip import strip

from fenics_joints.diagnosis import Effect, Prior, diagnose
from fenics_joints.diagnosis.where.cells import FormCells
from fenics_joints.errors import InputError
from fenics_joints.measurements import TestData
from fenics_joints.modal import solve_modes

KNOWN = {"E": 0.005, "rho": 0.005}


def measured(model, noise=1e-3, **given) -> TestData:
    hz = solve_modes(model, given, n_modes=7).frequencies_hz
    hz = hz * np.exp(noise * np.random.default_rng(5).standard_normal(len(hz)))
    return TestData([1.0], hz[None], tuple(f"mode {i + 1}" for i in range(len(hz))), noise=noise)


@pytest.mark.survives
@pytest.mark.parallel
@pytest.mark.parametrize(
    ("given", "known", "name"),
    [
        ({"k": 4e10}, KNOWN, "error of k"),
        ({"E": 60e9}, {"rho": 0.005}, "error of E"),
        ({}, KNOWN, "no gap"),
    ],
)
def test_the_parameter_that_was_changed_is_named(given, known, name):
    model = strip()
    found = diagnose(model, measured(model, **given), tolerances=known, discrepancy=2e-3)
    assert found.effects[0].name == name and found.effects[0].probability > 0.8
    assert found.verdict == ("no gap" if not given else "cause")
    if given:
        best = next(h for h in found.hypotheses if name in h.label)
        (key, value), nominal = next(iter(given.items())), model.values()
        row = next(row for row in best.parameters if row["effect"] == name)
        assert row["value"] == pytest.approx(value / nominal[key], rel=0.02)
        assert found.after.rms < 0.2 * found.before.rms


def test_energies_of_cells_are_those_of_the_matrices():
    """All of M; and all of K but for the clamp, which is on facets."""
    model = strip()
    modes = solve_modes(model, n_modes=5)
    cells, (x, y) = FormCells(model), (modes.vector(1), modes.vector(3))
    for one, other in ((x, x), (x, y)):
        stiff, mass = model.cell_energies(one, other)
        K, M = model.stiffness({"k": 1e-6}), model.mass()
        assert mass.sum() == pytest.approx(one.dot(M * other), abs=1e-9)
        assert stiff.sum() == pytest.approx(one.dot(K * other), rel=1e-6, abs=1e-3)
    assert cells.volume.sum() == pytest.approx(0.3 * 0.03 * 0.004)


def test_an_effect_of_one_s_own_and_the_refusals():
    model = strip()
    test = measured(model, E=60e9)

    def damp(values, theta, condition):
        values["E"] *= 1 - theta["lost"]

    wet = Effect("wet strip", "", (Prior("lost", 0.1, 0.7, span=(0.0, 0.9)),), damp)
    found = diagnose(model, test, effects=["error of k", wet], tolerances={"rho": 0.005})
    assert found.effects[0].name == "wet strip"
    assert {e.name for e in found.effects} <= {"wet strip", "error of k", "no gap", "none of these"}
    for more, words in (
        ({"bolts": {}}, "bolts: unknown option"),
        ({"tolerances": {"e": 0.1}}, "tolerances: 'e': expected one of E, k, rho"),
        ({"effects": ["error of e"]}, "'error of e' does not exist; .*error of E"),
    ):
        with pytest.raises(InputError, match=words):
            diagnose(model, test, **more)
    with pytest.raises(InputError, match="nu: a or m is not linear in it"):
        diagnose(strip(nu=0.3), test)
