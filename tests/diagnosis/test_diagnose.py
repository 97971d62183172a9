"""The diagnosis on virtual tests whose cause is known, from a mesh unlike the diagnosed model's."""

from __future__ import annotations

import json

import numpy as np
import pytest
from mpi4py import MPI
from virtual_plates import TORQUES, Measured, virtual_test, write_virtual_case

from fenics_joints.case import load_case
from fenics_joints.commands.diagnose.words import effect_classes
from fenics_joints.diagnosis import diagnose
from fenics_joints.errors import ConvergenceError

#: One effect at a time, and nothing that has tests of its own. What a discrepancy does is looked at
#: here, and these elements of 20 mm are up to 1.5 % off.
FEW = ("max_effects = 1", "patches = 0", "mesh_error = false")
#: What the tests are about, and what could be taken for it: a sixth of the library.
EFFECTS = [
    "joint tangential compliance",
    "joint normal compliance",
    "modulus error",
    "density error",
    "thickness error",
    "accelerometer mass",
    "temperature",
]


@pytest.fixture(scope="module")
def diagnosed(tmp_path_factory, models):
    """A function that puts noise on a virtual test and diagnoses it; remembers what it did."""
    done = {}

    def run(clean, discrepancy="1 %", library=EFFECTS, anew=False):
        key = clean.frequencies_hz.tobytes(), discrepancy, library is EFFECTS
        if anew or key not in done:
            folder = tmp_path_factory.mktemp("virtual")
            lines = [*FEW, f'discrepancy = "{discrepancy}"']
            lines += [f"effects = {json.dumps(library)}"] if library else []
            case = load_case(write_virtual_case(folder, clean.noisy(), *lines))
            done[key] = diagnose(case, MPI.COMM_SELF, keep=models)
        return done[key]

    return run


@pytest.mark.parametrize(
    ("truth", "discrepancy", "cause", "regions", "held", "over_placebo"),
    [
        ({"k_t": 3e11}, "1 %", "joint tangential compliance", {"near", "away"}, 0.4, 0.75),
        ({"modulus": 0.85}, "1 %", "modulus error", {"plates"}, 0.4, 0.75),
        # 20 g in 1.2 kg shift the frequencies by no more than 5 %: a model good to 1.5 % cannot
        # tell that from the plates' tolerances, one good to 0.5 % can. Without one of the four
        # modes, though, the library has others that would do as well.
        ({"mass": 0.02}, "0.5 %", "accelerometer mass", {"accelerometer"}, 0.6, 0.9),
    ],
)
def test_one_effect_is_named(diagnosed, truth, discrepancy, cause, regions, held, over_placebo):
    """The joint's of the whole library."""
    library = None if "k_t" in truth else EFFECTS
    result = diagnosed(virtual_test(**truth), discrepancy, library)
    assert result.verdict == "cause", result.summary
    assert result.effects[0].name == cause
    leading = effect_classes(result)[0].name
    assert cause in leading.split(" or ") and leading == result.effects[0].class_name
    assert result.after.rms < 0.25 * result.before.rms
    assert result.heldout_after < held * result.heldout_before
    assert result.heldout_after < over_placebo * result.placebo_after < result.heldout_before
    where = {zone.region: zone.share for zone in result.where}
    assert result.where[0].region in regions
    assert sum(where[region] for region in regions) > 0.5
    assert sum(where.values()) == pytest.approx(1.0)
    assert result.model_error < 1e-3


def test_fitted_stiffness_is_the_true_one(diagnosed):
    """One sigma or two: the interval is honest although layer, mesh and noise differ."""
    result = diagnosed(virtual_test(k_t=3e11), library=None)
    leader = next(h for h in result.hypotheses if h.label == "joint tangential compliance")
    rows = {row["name"]: row for row in leader.parameters}
    k, beta = rows["k_t"], rows["beta_t"]
    sd = 0.5 * np.log(k["high"] / k["low"])
    assert abs(np.log(k["value"] / 3e11)) < 2 * sd < 1.0
    assert abs(beta["value"] - 0.5) < beta["high"] - beta["low"]


def test_wrong_thickness_is_not_missed(diagnosed):
    """Far from the nominal thickness the reduced model must still fit what the full one does.

    Bending alone cannot tell thickness from modulus or density: one class.
    """
    result = diagnosed(virtual_test(thickness=0.85))
    fitted = {h.label: h for h in result.hypotheses}
    assert fitted["thickness error"].p_value > 0.05
    assert fitted["thickness error"].gap < 0.01
    thickness = next(e for e in result.effects if e.name == "thickness error")
    assert set(thickness.class_name.split(" or ")) == {
        "modulus error",
        "density error",
        "thickness error",
    }
    assert result.verdict == "cause" and result.effects[0].class_name == thickness.class_name


def test_a_suggestion_that_fails_takes_no_answer_with_it(diagnosed, monkeypatch):
    """What would split a class needs models of its own: those may not be solved."""
    clean = virtual_test(thickness=0.85)
    result = diagnosed(clean)
    assert result.separations and not any("No measurement" in n for n in result.model["notes"])

    def fails(*arguments, **options):
        raise ConvergenceError("modal problem: 3 of 10 modes converged")

    monkeypatch.setattr("fenics_joints.diagnosis.separation.solve_modes", fails)
    again = diagnosed(clean, anew=True)
    assert again.separations == [] and again.verdict == result.verdict
    (note,) = (n for n in again.model["notes"] if "No measurement" in n)
    assert "thickness error" in note and "3 of 10 modes converged" in note


@pytest.mark.smoke
def test_no_gap_without_an_effect(diagnosed):
    result = diagnosed(virtual_test())
    assert result.verdict == "no gap", result.summary
    assert result.effects[0].name == "no gap"
    total = sum(h.probability for h in result.hypotheses)
    assert total == pytest.approx(1.0)
    # Idle effects are no candidates for a cause, and stand for nothing together.
    others = [e for e in result.effects if e.name != "no gap"]
    assert all(e.class_name in (e.name, f"{e.name} ({e.region})") for e in others)


@pytest.mark.parametrize(("mode", "factor"), [(1, 1.10), (2, 0.90)])
def test_what_no_effect_explains_is_unknown(diagnosed, mode, factor):
    """One mode alone is shifted by 10 %, and more with the torque."""
    clean = virtual_test()
    shifted = clean.frequencies_hz.copy()
    shifted[:, mode] *= factor * (TORQUES / 24.0) ** (0.5 * (factor - 1))
    result = diagnosed(Measured(shifted, clean.shapes))
    assert result.verdict == "unknown", result.summary
    assert result.effects[0].name == "none of these"
    assert result.at_once < 0.01


def test_small_mass_is_left_open_by_a_coarse_model(diagnosed):
    """Neither a false cause nor a false all-clear where the discrepancy hides the effect."""
    result = diagnosed(virtual_test(mass=0.02), "1.5 %")
    assert result.verdict == "ambiguous", result.summary
    causes = [e for e in result.effects if e.name != "no gap"]
    assert causes[0].name == "accelerometer mass" and causes[0].probability > 0.15
    assert result.effects[0].probability < 0.5
    assert "accelerometer mass" in result.summary


# -- pairs, on two ranks ---------------------------------------------------------------------------

PAIRS = (
    "max_effects = 2",
    "mesh_error = false",
    "patches = 0",
    'discrepancy = "0.5 %"',
    'effects = ["accelerometer mass", "joint tangential compliance", "temperature"]',
)


def by_hypothesis(result) -> dict[tuple[str, ...], float]:
    return {h.effects or (h.label,): h.probability for h in result.hypotheses}


@pytest.mark.skipif(MPI.COMM_WORLD.size == 1, reason="compares two ranks with one")
@pytest.mark.parallel
def test_two_ranks_give_the_same_probabilities(shared_tmp_path):
    comm = MPI.COMM_WORLD
    measured = comm.bcast(virtual_test(mass=0.02).noisy())
    if comm.rank == 0:
        write_virtual_case(shared_tmp_path, measured, *PAIRS)
    comm.barrier()
    case = load_case(shared_tmp_path)
    alone, together = (diagnose(case, c) for c in (MPI.COMM_SELF, comm))
    assert together.verdict == alone.verdict
    expected = by_hypothesis(alone)
    assert max(len(keys) for keys in expected) == 2
    # Each solution is that of one rank.
    assert by_hypothesis(together) == pytest.approx(expected, abs=1e-9)
    assert together.after.model_hz == pytest.approx(alone.after.model_hz, rel=1e-9)
    assert together.heldout_after == pytest.approx(alone.heldout_after, rel=1e-9)
    everywhere = comm.allgather(by_hypothesis(together))
    assert all(p == everywhere[0] for p in everywhere)
