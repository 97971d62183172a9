"""Smaller models for a few parameters, and many values at a time, against what they are made of."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from one_by_one import one_by_one

from fenics_joints.beams import Beam, BeamStructure, GenericJoint, LumpedMass
from fenics_joints.diagnosis import Effect, Prior
from fenics_joints.diagnosis.evidence import fit
from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.diagnosis.evidence.library import Library
from fenics_joints.diagnosis.evidence.predictions import ManyPredictions
from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.modal import solve_modes
from fenics_joints.reduction import ArrayModel, BatchPrediction, ModalPrediction, freeze, narrow
from fenics_joints.reduction.affine import AffinePencil, RegionTerm, mass_term, spring_term
from fenics_joints.reduction.batch_modes import change
from fenics_joints.structure import Parameter, Sensors, Spring
from fenics_joints.structure.laws import LAYER_LAWS

VALUES = {
    "E": 208e9,
    "rho": 7860.0,
    "k1": 1763.0,
    "k2": 37400.0,
    "cord": 2e3,
    "mass": 0.05,
    "place": 0.01,
}
SENSORS = Sensors(np.outer(np.linspace(0, 0.55, 9), [1.0, 0, 0]), [0.0, 0, 1])


@pytest.fixture(scope="module")
def model():
    beams = [Beam(n, 0.3, 0.02, 0.01, 10, "E", 0.3, "rho") for n in "ab"]
    structure = BeamStructure(
        beams,
        [GenericJoint("lap", 0.05, 5, "k1", "k2")],
        [Parameter(name, value, log=name != "place") for name, value in VALUES.items()],
        masses=[LumpedMass("m", "mass", (0.1, 0, 0), 0.01, "place", (-0.05, 0.05))],
        springs=[Spring("cord", "cord", (0.0, 0.0, 0.0))],
    )
    return structure.arrays(SENSORS)


def test_frozen_model_is_the_model(model):
    """Of the fewest terms: beams that differ by their modulus alone are one matrix each, in and
    beside the lap; masses need no stiffness that varies."""
    elsewhere = {"E": 1.9e11, "mass": 0.08, "place": -0.02, "cord": 4e3}
    few = {("k1",): 1, ("E",): 4, ("mass", "place"): 0}
    for free in (*few, ("E", "cord", "place"), tuple(VALUES)):
        small = freeze(model, list(free), elsewhere)
        n_terms = len(small.pencil.terms[0])
        assert n_terms == few.get(free, n_terms) < len(model.pencil.terms[0])
        assert list(small.parameters) == list(free)
        change = {name: 1.07 * small.values()[name] for name in free}
        full = {**elsewhere, **change}
        for key in ("stiffness", "mass"):
            exact = getattr(model, key)(full)
            off = np.abs(getattr(small, key)(change) - exact).max()
            assert off < 1e-12 * np.abs(exact).max()
        assert small.total_mass(change) == pytest.approx(model.total_mass(full))
        modes = solve_modes(model, full, n_modes=6)
        columns = [list(model.parameters).index(name) for name in free]
        gradients = small.pencil_gradients(modes.shapes, modes.eigenvalues, change)
        exact = modes.gradients(range(6))[:, columns]
        np.testing.assert_allclose(gradients, exact, rtol=1e-8, atol=1e-9 * np.abs(exact).max())


def test_narrow_model_keeps_its_word(model):
    """Within 0.01 % at 50 random points; gradients too."""
    ranges = {"k1": (900.0, 3500.0), "k2": (15e3, 80e3)}
    small = narrow(model, ranges, 10, tolerance=1e-4)
    assert small.error <= 1e-4
    assert small.model.n_dofs < model.n_dofs / 3
    rng = np.random.default_rng(5)
    exact, quick = (ModalPrediction(m, SENSORS, 5, 10) for m in (model, small.model))
    for _ in range(50):
        point = {k: float(np.exp(rng.uniform(*np.log(pair)))) for k, pair in ranges.items()}
        log_f, slopes = exact({**model.values(), **point})
        near, near_slopes = quick(point)
        assert np.abs(near - log_f).max() < 1e-4
        columns = [list(VALUES).index(name) for name in ranges]
        scale = np.abs(slopes[:, columns]).max(axis=0)
        assert np.all(np.abs(near_slopes - slopes[:, columns]) < 2e-2 * scale)
    better = narrow(model, ranges, 10, tolerance=1e-8)
    assert better.error <= 1e-8
    assert better.model.n_dofs > small.model.n_dofs


def test_bad_input_is_said(model):
    with pytest.raises(InputError, match="expected some of: E, rho"):
        freeze(model, ["k3"])
    with pytest.raises(InputError, match="range of k1"):
        narrow(model, {"k1": (0.0, 5.0)}, 8)
    with pytest.raises(ConvergenceError, match="narrower ranges"):
        narrow(model, {"k1": (1e3, 2e3)}, 8, tolerance=1e-18)


# -- many values at a time -----------------------------------------------------------------------

N = 40
BASELINE = {"left.G": 1e9, "right.G": 1e9, "rho": 1.0, "tip": 2.0, "place": 0.5, "k": 2e8}


def chain(N: int = N) -> ModalPrediction:
    """Of a free chain of masses in two halves; a spring inside, a moving mass at the end."""
    bars = np.zeros((2, N, N))
    for i in range(N - 1):
        rod = np.zeros(N)
        rod[i : i + 2] = -1.0, 1.0
        bars[int(i >= N // 2)] += np.outer(rod, rod)
    law = LAYER_LAWS["uncoupled"]
    regions = []
    for half, name in enumerate(("left", "right")):
        stiffness = np.zeros((4, N, N))
        stiffness[1] = bars[half]
        inertia = np.diag((np.arange(N) >= N // 2) == half).astype(float)
        properties = {"E": 1.0, "G": f"{name}.G", "rho": "rho", "stretch": 1.0}
        regions.append(RegionTerm(name, law, properties, stiffness, inertia, N / 2))
    stations = np.linspace(0, 1, 5)
    rows = np.zeros((5, 1, N))
    rows[:, 0, -2], rows[:, 0, -1] = 1 - stations, stations
    link = np.eye(N)[N // 2 - 1] - np.eye(N)[N // 2]
    parameters = {name: Parameter(name, value) for name, value in BASELINE.items()}
    pencil = AffinePencil(
        parameters,
        regions,
        [spring_term("k", "k", 1.0, link), mass_term("tip", "tip", "place", 1.0, stations, rows)],
    )
    points = np.zeros((N, 3))
    points[:, 0] = np.arange(N)
    model = ArrayModel(pencil, 1e4, np.eye(N), np.zeros((1, N, N)))
    forward = ModalPrediction(model, Sensors(points, [1.0, 0.0, 0.0]), 4, 8)
    forward.track(BASELINE)
    return forward


def table_of(values: list[dict[str, float]]) -> dict[str, np.ndarray]:
    return {name: np.array([v[name] for v in values]) for name in BASELINE}


def exact_frequencies(model, values) -> np.ndarray:
    """Of the first elastic modes, by LAPACK."""
    K, M = model.stiffness(values), model.mass(values)
    return np.sqrt(scipy.linalg.eigh(K, M, eigvals_only=True)[1:5]) / (2 * np.pi)


def some_values(count: int) -> list[dict[str, float]]:
    rng = np.random.default_rng(1)
    return [
        {k: v * np.exp(0.5 * rng.uniform(-1, 1)) for k, v in BASELINE.items()} for _ in range(count)
    ]


def test_many_solutions_at_a_time_are_the_single_ones():
    """On any complete basis: frequencies, pairing, and derivatives by the values."""
    forward = chain()
    model = forward.model
    rotation = np.linalg.qr(np.random.default_rng(2).standard_normal((N, N)))[0]
    lean = BatchPrediction(forward, model.on(rotation))
    values = some_values(7)
    together = lean.log_f_at(values)
    for got, value in zip(together, values, strict=True):
        log_f, by_values = forward(value)
        assert got == pytest.approx(log_f, abs=1e-9)
        assert lean(value)[1] == pytest.approx(by_values, rel=1e-6, abs=1e-14)
        assert np.exp(np.sort(got)) == pytest.approx(exact_frequencies(model, value), rel=1e-8)


def test_lowest_modes_alone_are_those_of_all():
    """Frequencies and their derivatives; all modes where the test's are not among the lowest."""
    forward, table = chain(120), table_of(some_values(3))
    model = forward.model
    lean = BatchPrediction(forward, model)
    every, lowest = lean.batch(table), lean.batch(table, every=False)
    assert (every.vectors.shape[2], lowest.vectors.shape[2]) == (120, 8)
    assert lowest.log_f == pytest.approx(every.log_f, rel=1e-9)
    low, high = ({**table, "rho": table["rho"] * (1 + s)} for s in (-1e-5, 1e-5))
    along = change(model, low, high, 2e-5)
    assert lowest.slopes(along) == pytest.approx(every.slopes(along), rel=1e-6)
    few = forward.of(model, 4)  # the rigid-body mode and three more
    found = BatchPrediction(few, model).batch(table, every=False)
    assert found.good.all() and found.log_f == pytest.approx(every.log_f, rel=1e-9)


def stiffer(name: str, spread: float) -> Effect:
    def apply(values, theta, condition):
        values[name] *= theta["factor"]

    return Effect(name, "", (Prior("factor", 1.0, spread),), apply)


def test_evidence_on_few_vectors_is_that_of_all():
    """A fraction of the size, for frequencies, damping, and shapes that a sensor misreads."""
    forward, sds = chain(120), np.full((1, 4), 0.003)
    shapes = forward.reference / np.sqrt(np.mean(forward.reference**2, axis=0))
    shapes = shapes + 0.02 * np.random.default_rng(2).standard_normal(shapes.shape)
    shapes[40] *= 0.4
    more = {"shapes": shapes, "near": np.eye(len(shapes))}
    more["log_damping"] = np.log([[0.004, 0.006, 0.005, 0.004]])
    log_f = forward(BASELINE)[0][None] + 0.002 * np.array([1.0, -1.0, 0.5, -0.3])
    evidence = Evidence(np.ones(1), log_f, sds, 0.003, **more)

    def misread(sensing, theta):
        sensing.gains[40] = theta["gain"]

    def loss(theta, condition, hz):
        return {"right.G": theta["eta"]}

    effects = (
        stiffer("right.G", 0.5),
        Effect("mis-scaled", "", (Prior("gain", 1.0, 0.5),), None, sensing=misread),
        Effect("loss", "", (Prior("eta", 0.01, 0.5),), None, loss=loss),
    )

    def make(effects):
        nuisance = (stiffer("rho", 0.01),)
        return Hypothesis(tuple(effects), nuisance, modes=tuple("abcd"), damped=True)

    few = Library(forward, evidence, BASELINE, make, lean=True)
    found = few.sampled(few.of(make(effects), evidence), evidence).fit
    assert max(b.model.n_dofs for b in few.bases.values()) < 60 < forward.model.n_dofs
    alone = fit(make(effects), forward, evidence, BASELINE)
    assert found.log_evidence == pytest.approx(alone.log_evidence, abs=0.05)
    assert found.z == pytest.approx(alone.z, abs=0.05)
    said, _ = ManyPredictions(make(effects), forward, evidence, BASELINE).at(found.z)
    assert found.predicted == pytest.approx(said, abs=1e-3)


def test_many_values_at_a_time_leave_untold_what_one_does():
    """One of the test's modes is not to be told, and two stand in the other order."""
    forward = chain(120)
    forward.reference = forward.reference[:, [0, 1, 3, 2]] * [1.0, np.nan, 1.0, 1.0]
    values = [{**BASELINE, "k": k} for k in np.geomspace(1e5, 1e10, 9)]
    together = BatchPrediction(forward, forward.model).batch(table_of(values))
    alone = [forward.solve(v)[1].index.tolist() for v in values]
    assert together.index.tolist() == alone == 9 * [[1, 2, 4, 3]] and together.good.all()


def test_all_kinds_of_data_are_as_predicted_one_by_one():
    """Frequencies, damping and shapes at two levels of a lossy effect, on a complete basis."""
    forward = chain()
    lossy = Effect(
        "lossy",
        "",
        (Prior("factor", 1.0, 0.5), Prior("eta", 0.01, 0.5)),
        lambda values, theta, level: values.update({"right.G": 1e9 * theta["factor"] * level}),
        loss=lambda theta, level, hz: {"right.G": theta["eta"] * level},
    )
    hypothesis = Hypothesis((lossy,), conditions=(1.0, 2.0), modes=tuple("abcd"), damped=True)
    measured = forward.reference / np.sqrt(np.mean(forward.reference**2, axis=0))
    evidence = Evidence(
        np.array([1.0, 2.0]),
        np.zeros((2, 4)),
        np.full((2, 4), 0.003),
        0.003,
        log_damping=np.full((2, 4), np.log(0.003)),
        shapes=measured,
        near=np.eye(N),
        shape_row=1,
    )
    d = len(hypothesis.priors)
    z = list(0.5 * np.random.default_rng(4).standard_normal((3, d)))
    lean = BatchPrediction(forward, forward.model.on(np.eye(N)))
    many = ManyPredictions(hypothesis, lean, evidence, BASELINE)
    for got, point in zip(many(np.array(z))[0], z, strict=True):
        expected = one_by_one(hypothesis, forward, evidence, point, BASELINE)
        assert len(expected) == 8 + 8 + 4 * N
        assert got == pytest.approx(expected, abs=1e-6)


def test_constant_mass_is_taken_out():
    """What the mass does not depend on needs no generalised problem; the same frequencies."""
    whole = chain()
    stiff = freeze(whole.model, ["left.G", "right.G", "k"], BASELINE)
    forward = ModalPrediction(stiff, whole.sensors, 4, 8, whole.reference)
    lean = BatchPrediction(forward, stiff)
    assert lean.model.mass() == pytest.approx(np.eye(N), abs=1e-12)
    values = [{name: v[name] for name in stiff.parameters} for v in some_values(5)]
    found = lean.log_f_at(values)
    for got, value in zip(found, values, strict=True):
        exact = exact_frequencies(whole.model, {**BASELINE, **value})
        assert np.exp(np.sort(got)) == pytest.approx(exact, rel=1e-8)
        assert lean(value)[1] == pytest.approx(forward(value)[1], rel=1e-6, abs=1e-14)
    # Values of parameters that it does not have are left aside.
    assert lean({**BASELINE, **values[0]})[0] == pytest.approx(found[0], abs=1e-9)
