"""A measured static stiffness in a diagnosis: clamped lap plates, and a cantilever by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from case_tables import write_frequencies
from measured_points import Plates, check_derivatives, measure_again, reduced, said, solved, sparse
from mpi4py import MPI
from virtual_beams import beams
from virtual_plates import E

from fenics_joints.case import load_case
from fenics_joints.diagnosis.evidence.entries import STIFFNESS
from fenics_joints.errors import InputError
from fenics_joints.meshes import box
from fenics_joints.reduction.receptances import StaticModel, StaticSolver
from fenics_joints.structure import Parameter, Sensors, Structure, Support, part

CLAMP = """
[supports.clamp]
facets = "end_1"
"""
METAL = ("modulus error", "density error")
PLATES = Plates((*METAL, "joint normal compliance"), 18, 0.5, CLAMP)
TIP = Sensors([0.31, 0.04, 0.0165], [0, 0, 1])


def static(k: float) -> str:
    return f"""
[test.stiffness.tip]
point = ["310 mm", "40 mm", "16.5 mm"]
direction = [0, 0, 1]
stiffness = "{k} N/m"
noise = "0.5 %"
"""


def exact_stiffness(full: Structure, given) -> float:
    load = full.loads(TIP)[:, 0]
    return 1 / float(load @ solved(sparse(full.stiffness(given)), load))


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """Frequencies of plates of a softer metal, and their stiffness."""
    full, bonded, _, hz = PLATES.true(tmp_path_factory.mktemp("true"), 18, E=0.93 * E)
    return hz, exact_stiffness(full, bonded)


def test_a_stiffness_splits_modulus_from_density(tmp_path, measured, models):
    """Frequencies alone do not: the metal is softer. Of one as stiff as it should be, the density
    is off."""
    seen, other = (
        said(PLATES.tested(tmp_path / name, measured[0], static(k)), models)
        for name, k in (("seen", measured[1]), ("other", measured[1] / 0.93))
    )
    assert seen["modulus error"] > 0.5 and seen["density error"] < 0.01
    assert other["density error"] > 0.5 and other["modulus error"] < 0.01


def test_it_is_an_entry_that_the_mesh_and_any_model_err_in(tmp_path, measured, models):
    model = reduced(PLATES.tested(tmp_path / "case", measured[0], static(measured[1])), models)
    (tip,) = model.evidence.scalars
    (own,) = np.flatnonzero(model.evidence.entries.kind == STIFFNESS)
    assert model.evidence.data[own] == pytest.approx(np.log(measured[1]))
    assert 0.0078 < model.evidence.noise_sd()[own] < 0.02  # noise, and twice 0.3 %, and the mesh's
    assert 0 < tip.mesh < 0.05
    changed = {**model.baseline, "plates.E": 0.9 * E, "plates.rho": 2000.0}
    exact = exact_stiffness(model.full, changed)
    assert tip.log_value(changed) + tip.mesh == pytest.approx(np.log(exact), abs=5e-4)
    # Its derivatives are those of what is predicted, one by one and of many points together.
    check_derivatives(model, model.hypothesis(model.effects[-1:]), np.array([own]), -1)
    # All patches softer by the expected size are a softer metal; near the clamp there is most.
    parts = ~model.evidence.signatures.of_joint
    assert np.sum(tip.patches[0, parts]) == pytest.approx(0.15, rel=0.02)
    assert np.all(tip.patches[0, parts] >= 0)
    middle = model.evidence.signatures.middle[:, 0]
    assert middle[parts][np.argmax(tip.patches[0, parts])] < 0.12
    # What is refused of it, once the model is there.
    for changes, said_ in (
        ({"point": [0.9, 0.04, 0.0165]}, "test.stiffness.tip"),
        ({"at": 7.0}, "test.stiffness.tip.at = 7: expected a condition"),
    ):
        with pytest.raises(InputError, match=said_):
            measure_again(model, "stiffness", "tip", **changes)
    model.surrogate.nominal = replace(model.surrogate.nominal, n_rigid=6)
    with pytest.raises(InputError, match=r"test.stiffness: the structure is free to move \(6 "):
        measure_again(model, "stiffness", "tip")


def test_a_plan_ranks_it(tmp_path, models):
    """It would tell the metal's modulus from its density, at the free end."""
    gained = PLATES.gains(tmp_path, models)
    assert gained["the static stiffness at (310, 40, 16) mm, to 2 %"] > 0.5


CLAMPED = """
[supports.clamp]
facets = "left"

[test]
frequencies = "frequencies.csv"
noise = "0.1 %"

[test.sees]
along = "x"
positions = ["120 mm", "370 mm", "480 mm", "640 mm"]
direction = [0, 0, 1]

[test.stiffness.end]
point = ["640 mm", "0 mm", "0 mm"]
direction = [0, 0, 1]
stiffness = "4 kN/m"
"""


def test_beams_have_it_without_a_reduced_model(tmp_path):
    """Softer than one beam as long and as thick as they are, stiffer than with a lap as thin."""
    size = {"lengths": (0.4, 0.3), "lap": 0.06, "section": (0.02, 0.01)}
    case = beams(**size, elements=(14, 10), lap_elements=4) + CLAMPED
    (tmp_path / "case.toml").write_text(case, encoding="utf-8")
    write_frequencies(tmp_path, [20.0, 125.0])
    model = reduced(load_case(tmp_path))
    (end,) = model.evidence.scalars
    k = np.exp(end.log_value(model.baseline))
    uniform = 3 * 208e9 * 0.02 * 0.01**3 / 12 / 0.64**3
    assert 0.98 * uniform < k < 1.3 * uniform
    halved = {**model.baseline, "beams.E": 104e9}
    assert np.exp(end.log_value(halved)) < 0.6 * k
    parts = ~model.evidence.signatures.of_joint
    assert 0.1 < np.sum(end.patches[0, parts]) < 0.151


@pytest.mark.parallel
def test_a_cantilever_bends_as_by_hand():
    """3 E I / L^3, less what it shears, at any modulus and thickness; and many values together."""
    length, width, height = 0.3, 0.02, 0.01
    body = part("bar", "body", E="E", nu=0.0, rho=7800.0, stretch="s")
    full = Structure(
        box(MPI.COMM_WORLD, (length, width, height), (12, 1, 1)),
        [body],
        [Parameter("E", 2e11), Parameter("s", 1.0)],
        supports=[Support("x_min")],
    )
    tip = Sensors([length, width / 2, height / 2], [0, 0, 1])
    solver = StaticSolver(full, tip)
    samples = [{"E": 2e11, "s": s} for s in (0.8, 1.0, 1.25)]
    model = StaticModel.made(solver, samples, fresh=lambda turn: [])  # none that was not used
    for modulus, s in ((1.5e11, 0.9), (2.3e11, 1.15)):
        area, inertia = width * s * height, width * (s * height) ** 3 / 12
        by_hand = length**3 / (3 * modulus * inertia) + length / (5 / 6 * modulus / 2 * area)
        found = model.log_compliance({"E": modulus, "s": s})
        assert np.exp(found[0]) == pytest.approx(by_hand, rel=3e-3)
        assert found == pytest.approx(solver({"E": modulus, "s": s})[0], abs=1e-5)
    both = model.log_compliance({"E": np.array([1.5e11, 2.3e11]), "s": np.array([0.9, 1.15])})
    assert both[1] == pytest.approx(found)
    solver.destroy()
