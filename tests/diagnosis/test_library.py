"""Fit, evidence, classes and folds of the diagnosis on models with a closed form."""

from __future__ import annotations

import numpy as np
import pytest
from linear_forward import Linear, shift
from scipy.stats import kstest, multivariate_normal, norm

from fenics_joints.diagnosis import Effect, Prior
from fenics_joints.diagnosis.effects.joint import compliant
from fenics_joints.diagnosis.evidence import fit
from fenics_joints.diagnosis.evidence.classes import (
    APART,
    classes,
    confusable_effects,
    detectable,
    distance,
)
from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.diagnosis.evidence.library import Library
from fenics_joints.diagnosis.evidence.predictions import PointwiseForward, model_of
from fenics_joints.diagnosis.held_out import folds
from fenics_joints.diagnosis.zones.zone import Zone

TORQUES = np.array([5.0, 10.0, 30.0])
RNG_SEED = 7


def evidence_of(log_f, sd=0.01, discrepancy=0.02, torques=TORQUES):
    log_f = np.asarray(log_f)
    return Evidence(torques, log_f, np.full(log_f.shape, sd), discrepancy)


def prior_predictive(forward, effects, evidence):
    """Mean and covariance of the fitted entries under a linear-Gaussian hypothesis."""
    n = len(evidence.conditions)
    spread = np.array([e.priors[0].spread for e in effects])
    medians = np.array([e.priors[0].median for e in effects])
    columns = [int(e.name.split()[1]) for e in effects]
    slopes = np.tile(forward.matrix[:, columns], (n, 1))
    used = evidence.used.ravel()
    mean = 5.0 + slopes @ medians
    J = (slopes * spread)[used]
    return mean[used], evidence.covariance() + J @ J.T, J


def test_evidence_is_the_exact_marginal_density():
    """Nuisance, effects, a missing entry, a held-out mode: a single cell is exact when linear."""
    rng = np.random.default_rng(RNG_SEED)
    forward = Linear(rng.standard_normal((4, 3)) * 0.05)
    effects = (shift(0, 0.3), shift(1, 0.8, median=0.4), shift(2, 1.2))
    log_f = 5.0 + 0.05 * rng.standard_normal((3, 4))
    log_f[1, 2] = np.nan
    held = np.zeros((3, 4), dtype=bool)
    held[:, 3] = True
    evidence = evidence_of(log_f).without(held)
    assert evidence.used.sum() == 8
    got = fit(Hypothesis(effects[1:], effects[:1]), forward, evidence, forward.baseline)
    mean, covariance, J = prior_predictive(forward, effects, evidence)
    data = log_f[evidence.used]
    exact = multivariate_normal(mean, covariance).logpdf(data)
    # A prior ends at five standard deviations.
    assert got.log_evidence == pytest.approx(exact, abs=5e-6)
    precision = J.T @ np.linalg.solve(evidence.covariance(), J) + np.eye(3)
    assert got.covariance == pytest.approx(np.linalg.inv(precision), rel=1e-6)
    gain = np.linalg.solve(covariance, data - mean)
    assert got.z == pytest.approx(J.T @ gain, abs=1e-5)
    # Matrix inversion lemma: the distance of the data under the prior predictive.
    assert got.misfit + got.z @ got.z == pytest.approx((data - mean) @ gain, rel=1e-6)
    again = fit(got.hypothesis, forward, evidence, forward.baseline)
    assert again.log_evidence == got.log_evidence and np.array_equal(again.z, got.z)


def test_scanned_evidence_is_the_marginal_density():
    """Of a parameter that acts in steps the evidence is a sum over the steps, in closed form."""
    rng = np.random.default_rng(RNG_SEED)
    forward = Linear(rng.standard_normal((4, 2)) * 0.05)
    steps = np.array([-0.6, 0.1, 0.7])

    def apply(values, theta, condition):
        values["p1"] += 0.4 * np.sum(theta["d"] > steps)

    stepped = Effect("steps", "", (Prior("d", 0.0, 1.0, log=False, scan=2001),), apply)
    nuisance = shift(0, 0.3)
    evidence = evidence_of(5.0 + 0.05 * rng.standard_normal((3, 4)))
    got = fit(Hypothesis((stepped,), (nuisance,)), forward, evidence, forward.baseline)
    mean, covariance, _ = prior_predictive(forward, (nuisance,), evidence)
    edges = norm.cdf([-np.inf, *steps, np.inf])
    moved = [mean + np.tile(forward.matrix[:, 1], 3) * 0.4 * k for k in range(4)]
    density = [multivariate_normal(m, covariance).pdf(evidence.log_f.ravel()) for m in moved]
    assert got.log_evidence == pytest.approx(np.log(np.diff(edges) @ density), abs=5e-3)


def test_a_scan_sees_a_peak_between_its_steps():
    """A parameter told to a thousandth of a step of its grid, whose evidence is in closed form."""
    rng = np.random.default_rng(RNG_SEED)
    forward = Linear(rng.standard_normal((4, 2)))

    def apply(values, theta, condition):
        values["p1"] += theta["d"]

    scanned = Effect("p 1", "", (Prior("d", 0.0, 1.0, log=False, scan=60),), apply)
    nuisance = shift(0, 0.3)
    truth = 5.0 + np.tile(forward.matrix @ [0.1, 0.777], (3, 1))
    evidence = evidence_of(truth + 1e-4 * rng.standard_normal((3, 4)), 1e-4, 1e-4)
    got = fit(Hypothesis((scanned,), (nuisance,)), forward, evidence, forward.baseline)
    mean, covariance, _ = prior_predictive(forward, (nuisance, shift(1)), evidence)
    exact = multivariate_normal(mean, covariance).logpdf(evidence.log_f.ravel())
    assert got.log_evidence == pytest.approx(exact, abs=0.02)


def test_p_value_is_uniform_when_the_hypothesis_is_right():
    rng = np.random.default_rng(RNG_SEED)
    forward = Linear(rng.standard_normal((3, 2)) * 0.05)
    effects = (shift(0, 0.3), shift(1, 0.5))
    blank = evidence_of(np.zeros((3, 3)))
    mean, covariance, _ = prior_predictive(forward, effects, blank)
    # By Cholesky's factor, which is the same on every machine; singular vectors are not.
    draws = mean + rng.standard_normal((200, len(mean))) @ np.linalg.cholesky(covariance).T
    hypothesis = Hypothesis(effects)
    p = [
        fit(hypothesis, forward, evidence_of(d.reshape(3, 3)), forward.baseline).p_value
        for d in draws
    ]
    assert kstest(p, "uniform").pvalue > 0.01


def test_slopes_hold_through_torque_and_tightening():
    """Derivatives of all predictions by z against differences of the predictions."""
    effect = compliant("c", "joint", [Zone("joint", thickness=5e-4)], reference=30.0)

    class Layer(PointwiseForward):
        model = model_of(["joint.E", "joint.G"])

        def __call__(self, values):
            E, G = values["joint.E"], values["joint.G"]
            s = E / (E + 1e9), G / (G + 2e8)
            slope = [[1e9 / (E + 1e9) ** 2, 0.0], [0.0, 2e8 / (G + 2e8) ** 2]]
            return 5.0 + np.array(s), np.array(slope)

    baseline = {"joint.E": 1e11, "joint.G": 4e10}
    hypothesis = Hypothesis((effect,), scatter=0.2, conditions=tuple(TORQUES))
    assert [p.name for _, p in hypothesis.priors[:4]] == ["k_n", "beta_n", "k_t", "beta_t"]
    assert len(hypothesis.priors) == 4 + len(TORQUES)
    log_f = np.array([[5.2, 5.5], [5.3, 5.6], [5.4, 5.7]])
    got = fit(hypothesis, Layer(), evidence_of(log_f), baseline)

    def predict(z):
        rows = enumerate(TORQUES)
        return np.array([Layer()(hypothesis.values(z, c, baseline, i))[0] for i, c in rows]).ravel()

    h = 1e-5
    steps = h * np.eye(len(got.z))
    numeric = np.array([(predict(got.z + s) - predict(got.z - s)) / (2 * h) for s in steps]).T
    assert got.jacobian == pytest.approx(numeric, rel=1e-5, abs=1e-8)


def test_compliances_act_in_series():
    """Springs in series: k_ref (T/T_ref)^beta over the layer's own E / h."""
    thickness = {"near": 1e-3, "away": 2e-3}
    zones = [Zone(name, thickness=h) for name, h in thickness.items()]
    effect = compliant("c", "joint", zones, "n", 20.0)
    values = {"near.E": 3e9, "away.E": 3e9, "near.G": 1e9, "away.G": 1e9}
    effect.apply(values, {"k_n": 1e12, "beta_n": 0.5}, 5.0)
    for zone, h in thickness.items():
        in_series = 1 / (h / 3e9 + 1 / (1e12 * 0.5))
        assert values[f"{zone}.E"] / h == pytest.approx(in_series)
        assert values[f"{zone}.G"] == 1e9


def test_more_torques_do_not_average_the_discrepancy_out():
    """The mean of a mode is never known better than what all torques share of the discrepancy."""

    def sd_of_mean(torques):
        evidence = evidence_of(np.zeros((len(torques), 2)), sd=0.01, torques=np.asarray(torques))
        covariance = evidence.covariance()
        assert np.linalg.eigvalsh(covariance).min() > 0
        of_first = covariance[::2, ::2]
        assert not covariance[::2, 1::2].any()
        return np.sum(np.linalg.inv(of_first)) ** -0.5

    one = np.hypot(0.01, 0.02)
    assert sd_of_mean([10.0]) == pytest.approx(one)
    # The same torque again and again: noise averages out, the discrepancy does not.
    assert sd_of_mean([10.0] * 4) == pytest.approx(np.hypot(0.01 / 2, 0.02))
    assert sd_of_mean([10.0] * 100) == pytest.approx(np.hypot(0.01 / 10, 0.02))
    assert sd_of_mean(np.geomspace(1.0, 1e3, 12)) > 0.02 / np.sqrt(2)


def flat(n_modes, angle_deg, torques=(10.0,)):
    """Three signatures: 0 and 1 at an angle, 2 square to both; white noise of 0.01."""
    a = np.radians(angle_deg)
    matrix = np.zeros((n_modes, 3))
    matrix[0], matrix[1], matrix[2, 2] = (1.0, np.cos(a), 0.0), (0.0, np.sin(a), 0.0), 1.0
    return Linear(matrix)


@pytest.mark.parametrize("angle_deg", [10.0, 40.0, 90.0])
def test_distance_is_that_of_the_angle(angle_deg):
    """With wide priors the nearest prediction is the projection: D = d sin(alpha) / 2."""
    forward = flat(3, angle_deg)
    size, sd = 0.1, 0.01
    truth = 5.0 + forward.matrix @ [size, 0.0, 0.0]
    evidence = evidence_of(truth[None], sd=sd, discrepancy=0.0, torques=np.array([10.0]))
    a, b = (
        fit(Hypothesis((shift(i, 100.0),)), forward, evidence, forward.baseline) for i in (0, 1)
    )
    # a's prediction to b's line; b's own is the foot of that, cos(alpha) as long.
    expected = size / sd * np.sin(np.radians(angle_deg)) / 2
    assert distance(a, b, evidence) == pytest.approx(expected, rel=1e-3)
    assert distance(a, b, evidence) == pytest.approx(distance(b, a, evidence))


def all_fits(forward, evidence, odds=0.2):
    """No effect, singles and pairs with their probabilities, as the diagnosis weighs them."""
    effects = [shift(i, 0.1) for i in range(3)]
    sets = [
        (),
        *[(e,) for e in effects],
        *[(effects[i], effects[j]) for i in range(3) for j in range(i)],
    ]
    fits = [fit(Hypothesis(s), forward, evidence, forward.baseline) for s in sets]
    score = np.array(
        [f.log_evidence + len(s) * np.log(odds) for f, s in zip(fits, sets, strict=True)]
    )
    weight = np.exp(score - score.max())
    return fits, weight / weight.sum()


@pytest.mark.parametrize(("angle_deg", "together"), [(5.0, True), (60.0, False)])
def test_classes_hold_what_stands_for_each_other(angle_deg, together):
    forward = flat(4, angle_deg)
    truth = 5.0 + forward.matrix @ [0.1, 0.0, 0.0]
    evidence = evidence_of(truth[None], sd=0.005, discrepancy=0.0, torques=np.array([10.0]))
    fits, p = all_fits(forward, evidence)
    alike = confusable_effects(fits, p, evidence)
    found = classes(fits, p, alike)
    assert (found["effect 0"] == found["effect 1"]) == together
    # Idle beside the cause, as the other stand-in is: that makes no class.
    assert found["effect 2"] == "effect 2"
    if together:
        # What is far less probable is no member, and stands for the others all the same.
        rare = np.where(["effect 1" in f.hypothesis.label_of_keys for f in fits], 1e-3 * p, p)
        left = classes(fits, rare, alike)
        assert left["effect 0"] == "effect 0" and alike["effect 0"] == {"effect 0", "effect 1"}


@pytest.mark.parametrize("sd", [0.005, 0.032])
def test_two_causes_are_two_classes(sd):
    """Both are in the leader, and neither can stand for the other."""
    forward = flat(4, 5.0)
    truth = 5.0 + forward.matrix @ [0.1, 0.0, 0.1]
    evidence = evidence_of(truth[None], sd=sd, discrepancy=0.0, torques=np.array([10.0]))
    fits, p = all_fits(forward, evidence)
    found = classes(fits, p, confusable_effects(fits, p, evidence))
    assert found["effect 0"] == found["effect 1"] != found["effect 2"]
    # An unknown cause may be more probable than each: alone the two are near each other by now.
    unknown = fit(Hypothesis((), unknown=True), forward, evidence, forward.baseline)
    fits, p = [*fits, unknown], [*p, 1.5 * max(p)]
    assert classes(fits, p, confusable_effects(fits, p, evidence)) == found
    back = fits[::-1], p[::-1]
    assert classes(*back, confusable_effects(*back, evidence)) == found


def test_detectable_only_when_the_change_outgrows_the_noise():
    """2 APART standard deviations, less what a nuisance along the same line blurs: none here."""
    forward = flat(3, 90.0)
    evidence = evidence_of(np.full((1, 3), 5.0), 0.01, 0.0, np.array([10.0]))
    for size, seen in ((1.9 * APART, False), (2.1 * APART, True)):
        effect = shift(0, size * 0.01)
        library = Library(forward, evidence, forward.baseline, Hypothesis)
        found = detectable([effect], library.expected, library.nominal, evidence)
        assert found == {effect.key: seen}
    # A mode that the model loses only one standard deviation further shows as well.
    nominal = library.nominal
    lost = detectable([effect], lambda _, z: np.where(z > 0, np.nan, nominal), nominal, evidence)
    assert lost == {effect.key: True}


def test_folds_hold_out_every_entry_once_by_mode_and_once_by_torque():
    found = folds(np.arange(1.0, 8.0), ["a", "b", "c"], ("torque", "N·m"))
    modes = [mask for name, mask in found if name.startswith("mode")]
    blocks = [mask for name, mask in found if name.startswith("torque")]
    assert len(modes) == 3 and len(blocks) == 3
    for masks in (modes, blocks):
        assert np.array_equal(np.sum(masks, axis=0), np.ones((7, 3)))
    # Neighbours: a block is one run of torques, so that the outer ones extrapolate.
    for mask in blocks:
        assert np.sum(np.diff(mask[:, 0].astype(int)) != 0) <= 2
    assert folds(np.array([3.0]), ["a"], ("torque", "N·m")) == []
    # Of more modes the highest go together.
    named = [name for name, _ in folds(np.array([5.0, 10.0, 20.0, 40.0]), "abcde", ("T", "N·m"))]
    assert named[5:] == ["top band, d to e", "T 5 to 10 N·m", "T 20 N·m", "T 40 N·m"]
