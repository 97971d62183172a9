"""Effects of the library put into a finer model of another mesh: named, and the right one."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI
from virtual_lap import beyond, loose, virtual_lap, write_virtual_lap

from fenics_joints.case import load_case
from fenics_joints.diagnosis.model.prepared import prepare
from fenics_joints.diagnosis.search import Search
from fenics_joints.progress import Progress

STIFFER = "joint stiffer than given"
AREA = "contact area smaller than modelled"
LOST = "contact lost at low pressure"
#: What could be taken for one another here.
MODULI = ("shear modulus error", "modulus error")
LIBRARY = ("loose bolt", "two loose bolts", STIFFER, LOST, AREA, *MODULI)


@pytest.fixture(scope="module")
def searched(tmp_path_factory):
    """A function from a virtual test to the probability of each set of effects, and the model.

    The reduced model is made once.
    """
    models = tmp_path_factory.mktemp("models")

    def run(**truth):
        lines = f"effects = {list(LIBRARY)}".replace("'", '"')
        folder = write_virtual_lap(tmp_path_factory.mktemp("lap"), *virtual_lap(**truth), lines)
        silent = Progress(silent=True)
        model = prepare(load_case(folder), MPI.COMM_SELF, silent)
        model.reduce(silent, models)
        search = Search(model, silent)
        fits = search.run()
        order = np.argsort(-search.probabilities(fits))
        known = [fits[i] for i in order if not fits[i].hypothesis.unknown]
        return {f.hypothesis.label_of_keys: f for f in known}, model

    return run


def test_two_loose_bolts_are_both_named(searched):
    """Of four, any two: not one of them, and not all."""
    fits, _ = searched(factor=loose(1, 4))
    first, second, *_ = fits
    assert first == "two loose bolts (bolt 1, bolt 4)"
    assert fits[first].log_evidence > fits[second].log_evidence + 50
    # The fitted stiffness is the true one, 1e10 Pa/m, within a factor of 1.6.
    rows = fits[first].hypothesis.table(fits[first].z, fits[first].covariance)
    (k,) = (row["value"] for row in rows if row["name"] == "k")
    assert abs(np.log(k / 1e10)) < 0.5


@pytest.mark.parametrize(
    ("truth", "cause"),
    [
        ({"shear": 0.92}, "shear modulus error"),
        pytest.param({"factor": beyond(0.0141, 60.0)}, STIFFER, marks=pytest.mark.slow),
        pytest.param({"factor": beyond(0.016, 1e-6)}, LOST, marks=pytest.mark.slow),
        pytest.param({}, "no gap", marks=pytest.mark.slow),
    ],
)
def test_one_effect_is_named_and_not_its_look_alikes(searched, truth, cause):
    fits, model = searched(**truth)
    assert next(iter(fits)).startswith(cause), list(fits)[:3]
    # At one torque a smaller area and one that follows the pressure are the same: counted once.
    assert AREA not in {e.name for e in model.effects}
    words = next(e.describe for e in model.effects if e.name == LOST)
    assert words.endswith(f"In this test it is equivalent to {AREA} (joint).")
