"""Two tests of one structure, before and after a known change, as one diagnosis."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("dolfinx")

from mpi4py import MPI
from virtual_strip import NOISE, measured, strip, write_strip

from fenics_joints.case import load_case
from fenics_joints.diagnosis import diagnose
from fenics_joints.diagnosis.evidence.evidence import evidence_of
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.diagnosis.evidence.predictions import ManyPredictions
from fenics_joints.diagnosis.held_out import folds
from fenics_joints.diagnosis.model.prepared import prepare
from fenics_joints.errors import InputError
from fenics_joints.measurements import TestData
from fenics_joints.progress import Progress
from fenics_joints.structure import PointMass

KG, CORNER = 0.03, (0.4, 0.06, 0.0)
CHANGED = f"""
[test.changed.weight]
frequencies = "weight.csv"
mass = "{1e3 * KG:g} g"
points = [["400 mm", "60 mm", "0 mm"]]
"""


def case_of(folder, soft: float, changed: bool = True):
    """A plate whose modulus is off by a factor, alone and with a mass on a corner."""
    everywhere = (-1.0, 1.0, soft)
    before = measured(strip(soft=everywhere))
    after, _ = measured(strip(soft=everywhere, masses=[PointMass("m", KG, CORNER)]))
    effects = 'effects = ["modulus error", "density error"]'
    write_strip(folder, *before, effects)
    noise = np.exp(NOISE * np.random.default_rng(9).standard_normal(len(after)))
    head = ",".join(f"mode {i + 1} [Hz]" for i in range(len(after)))
    row = ",".join(f"{f:.9g}" for f in after * noise)
    (folder / "weight.csv").write_text(f"{head}\n{row}\n")
    path = folder / "case.toml"
    path.write_text(path.read_text() + (CHANGED if changed else ""))
    return load_case(path)


def test_a_known_mass_tells_modulus_from_density(tmp_path):
    """Frequencies alone go by their ratio; the mass that is put on weighs more on a light plate."""
    shares = {}
    for changed in (False, True):
        folder = tmp_path / str(changed)
        folder.mkdir()
        found = diagnose(case_of(folder, 0.9, changed), MPI.COMM_SELF)
        shares[changed] = {e.name: e.probability for e in found.effects}
        classes = {e.name: e.class_name for e in found.effects}
        same = classes["modulus error"] == classes["density error"]
        assert same is not changed
    assert shares[False]["density error"] > 0.2
    assert shares[True]["modulus error"] > 0.55 and shares[True]["density error"] < 0.05
    # Both rows are there, and the second is held out by itself.
    assert len(found.before.conditions) == 2 and found.after.rms < 0.005
    assert [fold.name for fold in found.shrinkage.folds][-1] == "weight"


def test_what_is_known_is_known_at_its_row_alone(tmp_path):
    """Single predictions equal those of all rows together; derivatives equal differences."""
    model = prepare(case_of(tmp_path, 0.95), MPI.COMM_SELF, Progress(silent=True))
    model.reduce(Progress(silent=True))
    evidence, forward = model.evidence, model.forward
    hypothesis = model.hypothesis(model.effects[:1])
    z = 0.3 * np.ones(len(hypothesis.priors))
    loaded = hypothesis.values(z, 1.0, model.baseline, 1)
    bare = hypothesis.values(z, 1.0, model.baseline, 0)
    assert bare["weight.mass"] == 0.0 and loaded == bare | {"weight.mass": KG}
    many, m = ManyPredictions(hypothesis, forward, evidence, model.baseline), evidence.shape[1]
    together, slopes = many.at(z)
    rows = [forward(values)[0] for values in (bare, loaded)]
    assert together[: 2 * m] == pytest.approx(np.concatenate(rows), rel=1e-9)
    assert np.all(rows[1] < rows[0])
    for j, s in enumerate(1e-4 * np.eye(len(z))):
        up, down = (many.at(z + d)[0][: 2 * m] for d in (s, -s))
        assert slopes[: 2 * m, j] == pytest.approx((up - down) / 2e-4, rel=1e-4, abs=1e-7)
    # The nominal prediction differs by row too; data without the changed row have no known mass.
    nominal = model.nominal_log_f()
    assert np.all(nominal[1] < nominal[0])
    assert evidence.as_it_is.shape == (1, m) and model.data.as_it_is.known == ()


def test_a_shift_by_a_change_is_known_better_than_either_frequency():
    """The model's error is the same before and after, but for a twentieth of it."""
    data = TestData([5.0, 20.0], [[99.0, 198.0], [100.0, 200.0]], ("a", "b"), "torque", "N·m")
    data = data.again("weight", np.array([97.0, np.nan]), {"weight.mass": 0.1})
    evidence = evidence_of(data, 0.01)
    assert evidence.as_row == (0, 1, 1) and data.conditions.tolist() == [5.0, 20.0, 20.0]
    C = evidence.covariance()
    shift = np.array([0.0, 0.0, -1.0, 0.0, 1.0])  # a at 20 N·m, with the weight less without
    noise = 2e-6  # of a test that states neither noise nor resolution
    assert shift @ C @ shift == pytest.approx(0.0025 * 0.01**2 + noise, rel=1e-6)
    # One tightening for both rows at 20 N·m; the row is no block of torques.
    rows = {"conditions": tuple(data.conditions), "known": data.known, "as_row": evidence.as_row}
    hypothesis = Hypothesis((), scatter=0.2, **rows)
    assert hypothesis.tightening(np.arange(3)).tolist() == [0, 1, 1]
    there = {"measured": np.isfinite(data.frequencies_hz), "names": data.row_names}
    held = folds(data.conditions, ("a", "b"), ("torque", "N·m"), **there)
    names = ["mode a", "mode b", "torque 5 N·m", "torque 20 N·m", "weight"]
    assert [name for name, _ in held] == names
    assert held[-1][1].tolist() == [[False, False], [False, False], [True, False]]


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        ('frequencies = "frequencies.csv"', "what is otherwise than before"),
        ('frequencies = "frequencies.csv"\nmass = "3 g"', "mass and points"),
        ('frequencies = "none.csv"\nwithout = ["m"]', "no such file"),
        ('frequencies = "frequencies.csv"\nwithout = ["m"]', "masses and springs: none"),
        ('frequencies = "frequencies.csv"\nwithout = ["m"]\nat = 3', "was not measured"),
    ],
)
def test_bad_input_is_named(tmp_path, lines, expected):
    write_strip(tmp_path, *measured(strip()))
    path = tmp_path / "case.toml"
    path.write_text(path.read_text() + f"\n[test.changed.weight]\n{lines}\n")
    with pytest.raises(InputError, match=expected):
        load_case(path)
    by_level = TestData([1.0, 2.0], [[99.0], [98.0]], ("a",), "force", "N")
    with pytest.raises(InputError, match="no levels"):
        by_level.again("weight", np.array([97.0]), {"weight.mass": 0.1})
