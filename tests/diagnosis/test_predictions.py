"""Derivatives of all that is predicted, against differences of the predictions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from one_by_one import one_by_one

from fenics_joints.diagnosis import Effect, Prior
from fenics_joints.diagnosis.effects.damping import micro_slip
from fenics_joints.diagnosis.effects.part import temperature
from fenics_joints.diagnosis.effects.rig import misplaced_sensor, misscaled_sensor, swapped_modes
from fenics_joints.diagnosis.evidence.entries import FREQUENCY
from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.diagnosis.evidence.predictions import ManyPredictions
from fenics_joints.diagnosis.zones.zone import Zone
from fenics_joints.errors import InputError
from fenics_joints.reduction import ArrayModel, BatchPrediction, ModalPrediction
from fenics_joints.reduction.affine import AffinePencil, RegionTerm, spring_term
from fenics_joints.structure import Parameter, Sensors
from fenics_joints.structure.laws import LAYER_LAWS

N, SENSORS = 14, (0, 4, 7, 9, 13)
NAMES = ("a.E", "a.G", "a.rho", "ground.E")
BASELINE = {"a.E": 1.0, "a.G": 3e6, "a.rho": 1.2, "ground.E": 4e6}
MODES = ("one", "two", "three")
TORQUES = (5.0, 20.0)


@pytest.fixture(scope="module")
def forward():
    """A grounded chain of uneven springs; sensors on five of its masses."""
    law = LAYER_LAWS["uncoupled"]
    stiffness = np.zeros((4, N, N))
    for i in range(N - 1):
        rod = np.zeros(N)
        rod[i : i + 2] = -1.0, 1.0
        stiffness[1] += (1 + 0.1 * i) * np.outer(rod, rod)
    properties = {"E": "a.E", "G": "a.G", "rho": "a.rho", "stretch": 1.0}
    inertia = np.diag(1 + 0.5 * np.cos(np.arange(N)))
    parameters = {name: Parameter(name, BASELINE[name]) for name in NAMES}
    pencil = AffinePencil(
        parameters,
        [RegionTerm("a", law, properties, stiffness, inertia, 1.0)],
        [spring_term("ground", "ground.E", 1.0, np.eye(N)[3])],
    )
    rows = np.eye(N)[list(SENSORS)]
    shifts = np.stack(
        [(np.roll(np.eye(N), way, axis=1) - np.eye(N))[list(SENSORS)] for way in (1, -3)]
    )
    points = np.column_stack([SENSORS, np.zeros(5), np.zeros(5)]).astype(float)
    model = ArrayModel(pencil, 100.0, rows, shifts)
    return ModalPrediction(model, Sensors(points, [0.0, 0.0, 1.0]), 3, 12)


def stiffer(depends: bool) -> Effect:
    """Grows with the torque; dissipates nothing."""

    def apply(values, theta, torque):
        values["a.G"] *= theta["factor"] * (torque / 20.0) ** theta["power"]

    priors = (Prior("factor", 1.0, 0.3), Prior("power", 0.3, 0.2, log=False))
    return Effect("stiffer", "", priors, apply, depends_on_condition=depends)


def lighter() -> Effect:
    def apply(values, theta, torque):
        values["a.rho"] *= theta["factor"]

    return Effect("lighter", "", (Prior("factor", 1.0, 0.1),), apply)


def evidence_for(forward, damped: bool, torques=TORQUES) -> Evidence:
    """Without shapes if the torques are not the usual ones."""
    rng, n = np.random.default_rng(5), len(torques)
    shapes = forward.pairing(BASELINE).shapes + 0.1 * rng.standard_normal((5, 3))
    shapes[3, 1] = np.nan
    seen = dict(shapes=shapes, shape_row=1, near=np.eye(5)) if torques == TORQUES else {}
    log_damping = np.full((n, 3), np.log(0.01)) if damped else None
    log_f, sd = np.tile(forward(BASELINE)[0], (n, 1)), np.full((n, 3), 0.01)
    return Evidence(np.array(torques), log_f, sd, 0.01, log_damping=log_damping, **seen)


def one_with(*effects: Effect, scatter=0.2, conditions=TORQUES, **more) -> Hypothesis:
    """These effects, and a density that is not known."""
    known = {"scatter": scatter, "conditions": conditions, "modes": MODES}
    return Hypothesis(effects, (lighter(),), **known, **more)


def drawn(hypothesis: Hypothesis, *shape: int) -> np.ndarray:
    return 0.5 * np.random.default_rng(7).standard_normal((*shape, len(hypothesis.priors)))


EFFECTS = {
    "structure": (),
    "drift": (temperature(["ground"], TORQUES, drifts=True),),
    "gain": (misscaled_sensor(2, 1.0),),
    "shift": (misplaced_sensor(1, 10.0, 1.0),),
    "both": (misscaled_sensor(1, 1.0), misplaced_sensor(1, 10.0, 1.0, ways=2)),
    "swapped": (swapped_modes(1, MODES),),
    "swapped and gain": (swapped_modes(0, MODES), misscaled_sensor(0, 1.0)),
}


@pytest.mark.parametrize("damped", [False, True], ids=["", "damped"])
@pytest.mark.parametrize("kind", list(EFFECTS))
def test_derivatives_are_differences(forward, kind, damped):
    hypothesis = one_with(stiffer(depends=True), *EFFECTS[kind], damped=damped)
    evidence = evidence_for(forward, damped)
    z = 1.2 * drawn(hypothesis)

    def at(z):
        return one_by_one(hypothesis, forward, evidence, z, BASELINE)

    got, slopes = ManyPredictions(hypothesis, forward, evidence, BASELINE).at(z)
    assert got.shape == evidence.data.shape and slopes.shape == (len(got), len(z))
    there = np.isfinite(evidence.data)
    step = 1e-4
    numeric = [(at(z + s) - at(z - s)) / (2 * step) for s in step * np.eye(len(z))]
    assert slopes[there] == pytest.approx(np.array(numeric).T[there], rel=1e-4, abs=1e-6)
    # Each free number moves something, or it would not be free; a tightening only its own row.
    assert np.all(np.abs(slopes[there]).max(axis=0) > 2e-5)
    first = hypothesis.places["tightenings"].start
    assert not slopes[evidence.entries.row == 1, first].any()


def test_drift_of_the_temperature_is_seen_where_nothing_depends_on_the_torque(forward):
    """It changes from row to row by their order, and is no effect of the torque."""
    drifting = temperature(["ground"], TORQUES, drifts=True)
    hypothesis = one_with(drifting, scatter=0.0)
    evidence = evidence_for(forward, damped=False)
    z = np.array([0.3, -0.5, 0.8])
    step = np.array([0.0, 0.0, 1e-4])
    many = ManyPredictions(hypothesis, forward, evidence, BASELINE)
    up, down = (many.at(z + s)[0] for s in (step, -step))
    slope = many.at(z)[1][:, 2]
    assert np.abs(slope[:3]).max() == 0.0
    found, exact = slope[3:6], (up - down)[3:6] / 2e-4
    # One mode hardly feels the ground: there is nothing but round-off in its difference.
    assert found == pytest.approx(exact, rel=1e-4, abs=1e-5 * np.abs(found).max())


@pytest.mark.parametrize("kind", ["structure", "both", "swapped and gain"])
def test_shapes_alone_are_those_with_derivatives(forward, kind):
    """From the lowest modes as from all, which derivatives are made of."""
    hypothesis = Hypothesis((stiffer(True), *EFFECTS[kind]), (lighter(),), modes=MODES)
    evidence = evidence_for(forward, damped=False)
    z = np.linspace(-0.4, 0.5, len(hypothesis.priors))
    many = ManyPredictions(hypothesis, forward, evidence, BASELINE)
    found, none = many.at(z, slopes=False)
    assert none.shape == (len(found), 0)
    for exact in (many.at(z)[0], one_by_one(hypothesis, forward, evidence, z, BASELINE)):
        assert found == pytest.approx(exact, rel=1e-8, abs=1e-10)


def joint_loss() -> Effect:
    """Of the chain's stiffness, more at higher torque and frequency."""

    def loss(theta, torque, hz):
        return {"a.G": theta["eta"] * hz * torque**0.1, "": 0.1 * theta["eta"]}

    return Effect("lossy", "", (Prior("eta", 1e-3, 0.4),), None, loss=loss)


@pytest.mark.parametrize("damped", [False, True], ids=["", "damped"])
@pytest.mark.parametrize("kind", list(EFFECTS))
def test_many_at_once_are_as_one_by_one(forward, kind, damped):
    """On another basis too; and a point alone is as among others, with its derivatives."""
    effects = (stiffer(depends=True), *EFFECTS[kind], *([joint_loss()] if damped else []))
    hypothesis = one_with(*effects, damped=damped)
    evidence = evidence_for(forward, damped)
    z = drawn(hypothesis, 4)
    rotation = np.linalg.qr(np.random.default_rng(9).standard_normal((N, N)))[0]
    lean = BatchPrediction(forward, forward.model.on(rotation))
    many = ManyPredictions(hypothesis, lean, evidence, BASELINE)
    got, slopes = many(z, range(z.shape[1]))
    for i, point in enumerate(z):
        one = one_by_one(hypothesis, forward, evidence, point, BASELINE)
        assert got[i] == pytest.approx(one, rel=1e-6, abs=1e-8)
        alone, by_all = many.at(point)
        assert alone == pytest.approx(one, rel=1e-6, abs=1e-8)
        assert by_all == pytest.approx(slopes[i], rel=1e-4, abs=1e-6)


def test_modes_that_change_places_along_the_torque_are_followed():
    """Two masses on springs of their own, which the one sensor cannot tell apart."""
    law, unit = LAYER_LAWS["uncoupled"], np.eye(2)
    stiffness = np.zeros((4, 2, 2))
    stiffness[1] = np.outer(unit[1], unit[1])
    properties = {"E": "a.E", "G": "a.G", "rho": "a.rho", "stretch": 1.0}
    pencil = AffinePencil(
        {name: Parameter(name, BASELINE[name]) for name in NAMES},
        [RegionTerm("a", law, properties, stiffness, unit, 1.0)],
        [spring_term("ground", "ground.E", 1.0, unit[0])],
    )
    model = ArrayModel(pencil, 100.0, np.array([[1.0, 0.9]]), np.zeros((1, 1, 2)))
    one = ModalPrediction(model, Sensors([[0.0, 0.0, 0.0]], [0.0, 0.0, 1.0]), 2, 2)
    hypothesis = Hypothesis((stiffer(depends=True),), (), conditions=TORQUES, modes=MODES[:2])
    z = np.array([3.0, 1.0])  # at 20 Nm the second is the stiffer one, at 5 Nm by half
    G = 3e6 * np.exp(0.9)
    exact = 0.5 * np.log(np.array([[4e6, G * 0.25**0.5], [4e6, G]]) / 1.2) - np.log(2 * np.pi)
    evidence = Evidence(
        np.array(TORQUES),
        exact,
        np.full((2, 2), 0.01),
        0.01,
        shapes=np.ones((1, 2)),
        shape_row=1,
        near=np.eye(1),
    )
    found, _ = ManyPredictions(hypothesis, one, evidence, BASELINE).at(z)
    assert exact[0, 1] < exact[0, 0] < exact[1, 1]
    assert found[:4] == pytest.approx(exact.ravel(), rel=1e-9)


def test_an_effect_that_takes_one_condition_at_a_time(forward):
    """Such as one of a user's that asks whether the torque is above some value."""

    def apply(values, theta, torque):
        values["a.G"] *= theta["factor"] if torque > 10.0 else 1.0

    own = Effect("own", "", (Prior("factor", 1.0, 0.5),), apply, depends_on_condition=True)
    hypothesis = one_with(own)
    evidence, z = evidence_for(forward, damped=False), np.array([0.2, 0.7, 0.1, -0.2])
    one, up, down = (
        one_by_one(hypothesis, forward, evidence, z + s, BASELINE)
        for s in np.outer([0.0, 1e-4, -1e-4], np.eye(4)[0])
    )
    many = ManyPredictions(hypothesis, forward, evidence, BASELINE)
    got, slopes = many.at(z)
    assert got == pytest.approx(one, rel=1e-6) and np.ptp(got[[0, 3]]) > 0.1
    assert slopes[:, 0] == pytest.approx((up - down) / 2e-4, rel=1e-4, abs=1e-6)
    both, _ = many(np.array([z, 0 * z]))
    assert both[0] == pytest.approx(one, rel=1e-6)


def test_an_effect_that_takes_no_arrays_is_put_in_one_by_one(forward):
    """And points beyond a law's limit are said to be impossible, the others not."""

    def apply(values, theta, torque):
        values["a.G"] *= theta["factor"] if theta["factor"] > 0.5 else -1.0

    own = Effect("own", "", (Prior("factor", 1.0, 0.5),), apply)
    hypothesis = one_with(own, scatter=0.0)
    evidence = evidence_for(forward, damped=False)
    z = np.array([[0.2, 0.3], [0.1, -2.0], [0.4, -0.4]])
    many = ManyPredictions(hypothesis, forward, evidence, BASELINE)
    got, _ = many(z)
    there = np.isfinite(evidence.data)
    assert np.isfinite(got[:, there]).all(axis=1).tolist() == [True, False, True]
    one = one_by_one(hypothesis, forward, evidence, z[2], BASELINE)
    assert got[2, there] == pytest.approx(one[there], rel=1e-6)
    with pytest.raises(InputError, match="G"):
        many.at(z[1])


@pytest.mark.parametrize("driven", [(1,), (1, 2)], ids=["one", "two"])
def test_modes_of_one_level_have_no_amplitude_of_their_own(forward, driven):
    """And the level is the first driven mode's own, whichever that is."""
    measured = evidence_for(forward, damped=True)
    there = np.isin(range(3), driven) | (np.arange(2) == 0)[:, None]
    log_f = np.where(there, measured.log_f, np.nan)
    evidence = replace(measured, log_f=log_f, log_damping=log_f - 4, used=None)
    assert evidence.driven == driven
    slips = micro_slip([Zone("a")], 20.0)
    hypothesis = one_with(slips, scatter=0.0, damped=True, driven=evidence.driven)
    assert [p.name for p in hypothesis.amplitudes] == ["three over two"][: len(driven) - 1]
    z = drawn(hypothesis, 2)
    many = ManyPredictions(hypothesis, forward, evidence, BASELINE)
    got, slopes = many.at(z[0])
    there, step = np.isfinite(evidence.data), 1e-4
    moved = [
        [one_by_one(hypothesis, forward, evidence, z[0] + x, BASELINE) for x in (s, -s)]
        for s in step * np.eye(len(z[0]))
    ]
    numeric = np.array([(high - low) / (2 * step) for high, low in moved]).T
    entries = evidence.entries
    is_f = there & (entries.kind == FREQUENCY)
    assert slopes[is_f] == pytest.approx(numeric[is_f], rel=1e-4, abs=1e-6)
    if len(driven) == 2:
        at = hypothesis.places["amplitudes"].start
        assert np.unique(entries.mode[slopes[:, at] != 0]).tolist() == [2]
    together = many(z, range(len(z[0])))
    assert together[0][0, there] == pytest.approx(got[there], rel=1e-6, abs=1e-8)
    assert together[1][0, there] == pytest.approx(slopes[there], rel=1e-4, abs=1e-6)


@pytest.mark.parametrize("damped", [False, True], ids=["", "damped"])
def test_many_torques_lie_between_few(forward, damped):
    """Each torque solved for by itself says the same of all of them, and so do derivatives."""
    torques = tuple(np.linspace(2.0, 22.0, 11).tolist())
    evidence = evidence_for(forward, damped, torques)
    hypothesis = one_with(stiffer(depends=True), conditions=torques, damped=damped)
    z = drawn(hypothesis, 4)
    few, each = (
        ManyPredictions(hypothesis, forward, evidence, BASELINE, between=between)
        for between in (True, False)
    )
    assert few.between and not each.between
    for ours, theirs in zip(few(z, range(z.shape[1])), each(z, range(z.shape[1])), strict=True):
        assert np.abs(theirs).max() > 1e-2
        np.testing.assert_allclose(ours, theirs, atol=2e-4)
