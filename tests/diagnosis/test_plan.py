"""Plans before any data: separations against simulated classifications, and on a case."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from scipy.stats import norm
from typer.testing import CliRunner

from fenics_joints.case import load_case
from fenics_joints.cli import app
from fenics_joints.diagnosis import Effect, Prior
from fenics_joints.diagnosis.effects.damping import has_ratios
from fenics_joints.diagnosis.effects.rig import MISSCALED
from fenics_joints.diagnosis.evidence import fit
from fenics_joints.diagnosis.evidence.evidence import evidence_of
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.diagnosis.model.prepared import prepare
from fenics_joints.diagnosis.plan.added import measured_by
from fenics_joints.diagnosis.plan.study import Measurement, Study, combination, few_sensors, groups
from fenics_joints.errors import InputError
from fenics_joints.progress import Progress

TOY_SD = 0.01


def shift(index, spread, log=False):
    """An effect that adds a normal amount to parameter ``index``, or multiplies its exponential."""

    def apply(values, theta, condition):
        values[f"p{index}"] += np.log(theta["d"]) if log else theta["d"]

    prior = Prior("d", 1.0 if log else 0.0, spread, log=log)
    return Effect(f"effect {index}", "", (prior,), apply)


def toy(matrix, nuisances=(), curve=0.0):
    """y = A p + curve (A p)^2, white noise; every parameter of a hypothesis adds to some p."""
    matrix = np.asarray(matrix, dtype=float)
    names = [f"p{i}" for i in range(matrix.shape[1])]

    def predict(hypothesis, z, baseline):
        def at(z):
            values = hypothesis.values(z, 1.0, dict(baseline))
            y = matrix @ [values[name] for name in names]
            return y + curve * y**2

        steps = 1e-6 * np.eye(len(z))
        columns = [(at(z + s) - at(z - s)) / 2e-6 for s in steps]
        return at(z), np.array(columns).reshape(len(z), len(matrix)).T

    bare = Hypothesis((), tuple(nuisances), conditions=(1.0,))
    return Measurement(bare, predict, TOY_SD**2 * np.eye(len(matrix))), dict.fromkeys(names, 0.0)


@pytest.mark.parametrize("angle_deg", [15.0, 30.0])
def test_confusion_is_how_often_data_are_taken_for_the_other(angle_deg):
    """Phi(-D) against 400 000 tests: whichever of the two, refitted with the nuisance, is nearer.

    Refitting both moves D from d sin(alpha) / 2 to d sin(alpha / 2), 1 % here and 3 % there.
    """
    a = np.radians(angle_deg)
    matrix = np.array([[1.0, np.cos(a), 0.3], [0.0, np.sin(a), -0.4], [0.0, 0.0, 0.8]])
    size = 0.05 if angle_deg > 20 else 0.1
    effects = [shift(0, size), shift(1, 10.0)]
    test, baseline = toy(matrix, nuisances=[shift(2, 0.02)])
    study = Study(test, effects, baseline)
    D = study.distances[0, 1]
    blurred = test.covariance + 0.02**2 * np.outer(matrix[:, 2], matrix[:, 2])
    lower = np.linalg.cholesky(blurred)
    one, other = np.linalg.solve(lower, matrix[:, :2]).T
    # The effect is one standard deviation long: that is its expected size.
    assert study.expected[0].d == pytest.approx(size * np.linalg.norm(one), rel=1e-3)
    foot = size * (one - other * (one @ other) / (other @ other))
    assert pytest.approx(np.linalg.norm(foot) / 2, rel=1e-2) == D
    data = size * one + np.random.default_rng(1).standard_normal((400_000, 3))
    explained = [(data @ s) ** 2 / (s @ s) for s in (one, other)]
    assert norm.cdf(-D) == pytest.approx(np.mean(explained[1] > explained[0]), rel=0.12)
    # Taken for the nearest prediction itself, not for any on its line: no approximation at all.
    nearest = size * one - foot
    taken = np.sum((data - nearest) ** 2, axis=1) < np.sum((data - size * one) ** 2, axis=1)
    assert norm.cdf(-D) == pytest.approx(np.mean(taken), rel=0.05)


def test_nearest_prediction_is_found_on_a_curve():
    """Against a search over all values of the rival's parameter."""
    matrix = np.array([[1.0, 0.6], [0.2, 0.5], [-0.4, 0.3]])
    test, baseline = toy(matrix, curve=1.5)
    effects = [shift(0, 0.4), shift(1, 0.5)]
    study = Study(test, effects, baseline)
    truth = study.expected[0]
    z = np.linspace(-5, 5, 20001)
    y = np.outer(z * 0.5, matrix[:, 1])
    y = y + 1.5 * y**2
    cost = np.sum(((y - truth.predicted) / TOY_SD) ** 2, axis=1) + z**2
    best = int(np.argmin(cost))
    misfit = cost[best] - z[best] ** 2 + max(z[best] ** 2 - 1.0, 0.0)
    assert study.distances[0, 1] == pytest.approx(np.sqrt(misfit) / 2, rel=1e-3)


def test_classes_and_what_cancels():
    """Two effects along one line, one square to them, one too small to be seen."""
    matrix = np.array([[1.0, 2.0, 0.0, 0.0], [0.5, 1.0, 0.0, 0.0], [0, 0, 1, 0], [0, 0, 0, 1]])
    test, baseline = toy(matrix)
    study = Study(test, [shift(0, 0.2), shift(1, 0.2), shift(2, 0.2), shift(3, 0.02)], baseline)
    seen = [s.d / 2 > 2.33 for s in study.expected]
    assert seen == [True, True, True, False]
    assert groups(study.distances, seen) == [[0, 1], [2]]
    pair = combination([study.whitened(s) for s in study.expected[:2]])
    assert pair.index > 1e3 and pair.left < 1e-2
    # Half of the one's size, twice as strong, undoes the other's.
    sizes = [s.own[0] for s in study.expected[:2]]
    assert pair.factors[0] * sizes[0] == pytest.approx(-2 * pair.factors[1] * sizes[1])
    square = combination([study.whitened(study.expected[i]) for i in (0, 2)])
    assert square.index == pytest.approx(1.0, abs=1e-6)


# -- a case ----------------------------------------------------------------------------------------

MEASURED = """frequencies = "frequencies.csv"
damping = "damping.csv"
condition = "torque"
modes = ["bending 1", "bending 2", "bending 3", "bending 4"]
resolution = ["12.5 Hz", "12.5 Hz", "0 Hz", "0 Hz"]
"""
PLANNED = """[test.planned]
condition = "torque [N·m]"
conditions = [20, 5]
modes = ["bending 1", "bending 2", "bending 3", "bending 4"]

[test.sees]"""
VALIDATION = """[test.validation]
frequencies = "frequencies_28Nm.csv"
"""
UPDATE = """at = 20
parameters = ["near.E", "near.G", "away.E", "away.G"]
start = { "near.E" = "3 GPa" }
hold_out = [4, 8, 12]
"""


@pytest.fixture
def planned(write_case):
    """A function that puts the lap plates with a planned test, and no data, into a folder."""

    def write(folder, *edits):
        write_case(
            folder,
            (MEASURED, ""),
            (VALIDATION, ""),
            ("[test.sees]", PLANNED),
            (UPDATE, 'parameters = ["near.E"]\n'),
            *edits,
        )
        for table in folder.glob("*.csv"):
            table.unlink()
        return folder

    return write


def test_planned_test_needs_no_data(tmp_path, planned):
    """As the page on case files has it, ``damping = true`` is all that has to be said of it."""
    damped = ("conditions = [20, 5]", "conditions = [20, 5]\ndamping = true")
    (tmp_path / "damped").mkdir()
    case, spoken = load_case(planned(tmp_path)), load_case(planned(tmp_path / "damped", damped))
    layout = case.planned()
    assert layout.conditions.tolist() == [5.0, 20.0] and layout.condition_unit == "N·m"
    assert len(layout.mode_names) == 4 and layout.sensors is not None and not layout.by_level
    with pytest.raises(InputError, match=r"test\.frequencies is missing.*--plan"):
        case.measurements()
    assert has_ratios(spoken.planned()) and not has_ratios(layout)
    assert spoken.planned().damping_noise == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[20, 5]", "[20, 20]", ["test.planned", "each value once"]),
        ('"torque [N·m]"', '"torque [N·m"', ["condition = 'torque [N·m'", "NAME [UNIT]"]),
        ("[test.planned]", "[test.plan]", ["test.plan", "planned"]),
        ('["bending 1", "bending 2", "bending 3", "bending 4"]', "0", ["test.planned.modes"]),
    ],
)
def test_planned_test_says_what_is_wrong(tmp_path, planned, old, new, said):
    with pytest.raises(InputError) as error:
        load_case(planned(tmp_path, (old, new)))
    for fragment in said:
        assert fragment in str(error.value)


# -- the lap plates --------------------------------------------------------------------------------

FEW = """[diagnose]
mesh_error = false
discrepancy = "0.2 %"
samples = 4
effects = ["modulus error", "density error", "thickness error", "joint tangential compliance"]
"""
MATERIAL = {"modulus error (plates)", "density error (plates)", "thickness error (plates)"}
serial = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="about one process")


@serial
def test_plan_of_the_lap_plates(tmp_path, planned, models, capfd, keeps_rules):
    """On the command line, without a data file.

    Bending frequencies see the plates' thickness, modulus and density as one; torsion and in-plane
    motion do not grow with the thickness, and a known mass, or a scale, tells modulus from density.
    """
    folder = planned(tmp_path, ("[diagnose]\n", FEW), ('noise = "0.3 %"', 'noise = "0.1 %"'))
    out, page = tmp_path / "plan.json", tmp_path / "plan.html"
    arguments = ["--json", str(out), "--report", str(page), "--keep", str(models)]
    done = CliRunner().invoke(app, ["diagnose", "--plan", str(folder), *arguments])
    assert done.exit_code == 0, done.output
    content = json.loads(out.read_text())
    assert [set(c["members"]) for c in content["classes"]] == [MATERIAL]
    assert content["apart"] == 2 and all(e["seen"] for e in content["effects"])
    assert content["classes"][0]["collinearity"] > 20
    assert content["distance"]["modulus error (plates)"]["joint tangential compliance (joint)"] > 3
    # Those of a class are taken for each other, and the joint for itself.
    for key, shares in content["confusion"].items():
        assert sum(shares.values()) == pytest.approx(1.0)
        among = MATERIAL if key in MATERIAL else {key}
        assert sum(shares[k] for k in (*among, "no gap")) > 0.9
        assert sum(shares[k] for k in among) > 0.5
    gained = {a["measurement"]: a for a in content["additions"]}
    best = content["additions"][0]
    assert "sensors miss" in best["measurement"] and best["apart"] == 3
    assert best["measurement"] in content["summary"] and best["measurement"] in page.read_text()
    keeps_rules(page.read_text())
    mass, rope = (
        next(a["mean_gain"] for name, a in gained.items() if what in name)
        for what in ("known mass", "softer rope")
    )
    assert mass > 0.3 > abs(rope)
    # And a scale.
    weighed = gained["the mass of the whole structure, to 0.5 %"]
    assert weighed["mean_gain"] > 0.3
    assert CliRunner().invoke(app, ["diagnose", str(folder)]).exit_code == 1
    assert "test.frequencies is missing" in capfd.readouterr().err


@serial
def test_virtual_tests_are_confused_as_often_as_planned(tmp_path, planned, models):
    """Data of a plate that is too thick, with noise, model error and tolerances drawn, fitted."""
    case = load_case(planned(tmp_path, ("[diagnose]\n", FEW)))
    model = prepare(case, MPI.COMM_SELF, Progress(silent=True), data=case.planned())
    model.reduce(Progress(silent=True), models)
    hz = np.exp(model.forward(model.baseline)[0])
    evidence = evidence_of(
        replace(model.data, frequencies_hz=np.tile(hz, (2, 1))), case.diagnose.discrepancy
    )
    test = measured_by(model, evidence)
    effects = {e.name: e for e in model.effects}
    study = Study(test, [effects["thickness error"], effects["modulus error"]], model.baseline)
    rng, truth, n = np.random.default_rng(5), test.hypothesis(study.effects[0]), 40
    lower = np.linalg.cholesky(evidence.covariance())
    taken = np.zeros(2)
    for _ in range(n):
        z = rng.standard_normal(len(truth.priors))
        z[-1] = study.expected[0].own[0]
        data = test.predict(truth, z, model.baseline)[0] + lower @ rng.standard_normal(8)
        seen = replace(evidence, log_f=data.reshape(2, 4))
        fits = [fit(test.hypothesis(e), model.forward, seen, model.baseline) for e in study.effects]
        taken[int(np.argmin([f.misfit + f.z @ f.z for f in fits]))] += 1
    p = norm.cdf(-study.distances[0, 1])
    assert 0.02 < p < 0.45
    assert abs(taken[1] / n - p) < 3 * np.sqrt(p * (1 - p) / n)


def test_of_many_sensors_four_are_looked_at():
    """The best seen, the least, and two between; other effects and few sensors stay as they are."""
    lengths = np.array([3.0, 9.0, 1.0, 7.0, 4.0, 8.0, 2.0])
    test, baseline = toy(np.diag(lengths))
    sensors = [replace(shift(i, 0.05), name=MISSCALED, region=f"sensor {i + 1}") for i in range(7)]
    other = shift(3, 0.05)
    kept, silent = few_sensors(test, [*sensors, other], baseline)
    assert [e.region for e in kept] == ["sensor 1", "sensor 2", "sensor 3", "sensor 4", ""]
    (line,) = silent
    assert line.effect == MISSCALED and line.reason.startswith("3 of 7 sensors are left out")
    assert f"{0.5 * 0.05 / TOY_SD:.2g} to {0.5 * 9 * 0.05 / TOY_SD:.2g}" in line.reason
    assert few_sensors(test, [*sensors[:4], other], baseline) == ((*sensors[:4], other), ())
