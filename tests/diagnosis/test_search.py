"""The search over effects and pairs, on models where every pair can be fitted to compare."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest
from mpi4py import MPI
from scipy.special import logsumexp
from scipy.stats import multivariate_normal, norm

from fenics_joints.diagnosis import Effect, Prior
from fenics_joints.diagnosis.evidence import fit
from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.diagnosis.evidence.linear_fits import near_best, near_listed
from fenics_joints.diagnosis.evidence.predictions import PointwiseForward, model_of
from fenics_joints.diagnosis.search import Search
from fenics_joints.progress import Progress

TORQUES = np.array([5.0, 10.0, 20.0])
COUNT, M = 17, 8


class Bent(PointwiseForward):
    """ln f = 5 + A tanh(b p) / b: linear in p for b = 0, and saturating."""

    def __init__(self, matrix, bend):
        self.matrix, self.bend, self.calls = np.asarray(matrix), bend, 0
        names = [f"p{i}" for i in range(self.matrix.shape[1])]
        self.model = model_of(names)
        self.baseline = dict.fromkeys(names, 0.0)

    def __call__(self, values):
        self.calls += 1
        p = np.array([values[name] for name in self.model.parameters])
        if not self.bend:
            return 5.0 + self.matrix @ p, self.matrix
        bent = np.tanh(self.bend * p)
        return 5.0 + self.matrix @ bent / self.bend, self.matrix * (1 - bent**2)


def effect(i, family=""):
    """Parameter i rises with the torque by a power of its own."""

    def apply(values, theta, torque):
        values[f"p{i}"] += theta["d"] * (torque / 20.0) ** (0.1 * (i % 4))

    return Effect(
        f"effect {i}",
        "",
        (Prior("d", 0.0, 1.0, log=False),),
        apply,
        family=family,
        depends_on_condition=True,
    )


def problem(bend, truth, seed=3, most=2, families=None):
    """What `Search` asks of a prepared diagnosis, with data of a truth {effect: z}."""
    rng = np.random.default_rng(seed)
    forward = Bent(0.03 * rng.standard_normal((M, COUNT + 1)), bend)
    effects = [effect(i, (families or {}).get(i, "")) for i in range(COUNT)]
    stock = Prior("d", 0.0, 0.3, log=False)
    known = (
        Effect("stock", "", (stock,), lambda v, theta, _: v.update({f"p{COUNT}": theta["d"]})),
    )
    rows = []
    for torque in TORQUES:
        values = dict(forward.baseline)
        for i, z in truth.items():
            effects[i].apply(values, {"d": z}, torque)
        rows.append(forward(values)[0])
    log_f = np.array(rows) + 0.002 * rng.standard_normal((len(TORQUES), M))
    evidence = Evidence(TORQUES, log_f, np.full(log_f.shape, 0.002), 0.002)
    checked = []

    def errors(points):
        checked.extend(points)
        return np.zeros(len(points))

    surrogate = SimpleNamespace(errors=errors, checking="checking", n_samples=0)
    surrogate.quick = surrogate
    return SimpleNamespace(
        comm=MPI.COMM_SELF,
        effects=tuple(effects),
        evidence=evidence,
        baseline=forward.baseline,
        forward=forward,
        checked=checked,
        surrogate=surrogate,
        not_nominal=None,
        case=SimpleNamespace(diagnose=SimpleNamespace(max_effects=most, outside=0.25)),
        hypothesis=lambda chosen, **kwargs: Hypothesis(tuple(chosen), known, **kwargs),
    )


def searched(model):
    search = Search(model, Progress(silent=True))
    fits = search.run()
    return search, fits, search.probabilities(fits)


@pytest.fixture(scope="module")
def two():
    """Two effects at work, and what is found of them."""
    model = problem(0.0, {4: 1.4, 11: -1.1})
    return model, searched(model)


def keys(found):
    if found.hypothesis.unknown:
        return frozenset({"unknown"})
    return frozenset(e.name for e in found.hypothesis.effects)


@pytest.mark.parametrize("bend", [0.0, 0.8])
def test_the_screen_loses_no_pair_that_matters(bend, two):
    """136 pairs: what of all pairs fitted in full has any weight is among those it fits."""
    model, found = two
    if bend:
        model = problem(bend, {4: 1.4, 11: -1.1})
        found = searched(model)
    search, fits, probability = found
    pairs = [f for f in fits if len(f.hypothesis.effects) == 2]
    assert COUNT * (COUNT - 1) // 2 > 120 and 1 <= len(pairs) <= 30
    found = {keys(f): p for f, p in zip(fits, probability, strict=True)}
    assert len(found) == len(fits)
    both = frozenset({"effect 4", "effect 11"})
    assert found[both] == max(found.values()) > 0.5
    every = [
        fit(model.hypothesis(chosen), model.forward, model.evidence, model.baseline)
        for chosen in combinations(model.effects, 2)
    ]
    weights = search.probabilities([*fits[: COUNT + 2], *every])[COUNT + 2 :]
    missed = [p for f, p in zip(every, weights, strict=True) if keys(f) not in found]
    assert sum(missed) < 0.01
    for f, p in zip(every, weights, strict=True):
        assert found.get(keys(f), 0.0) == pytest.approx(p, abs=0.01)


def test_the_true_pair_is_found_where_neither_leads_alone():
    """Whatever the signatures: two effects that cancel each other in half of the modes."""
    lead = []
    for seed in range(3):
        model = problem(0.5, {0: 1.3, 13: 1.3}, seed=seed)
        _, fits, probability = searched(model)
        lead.append(keys(fits[int(np.argmax(probability))]))
    assert lead == [frozenset({"effect 0", "effect 13"})] * 3


def test_what_is_a_part_is_found_where_an_unknown_cause_leads():
    """Three at work and two at most allowed: the best pair, though far behind the unknown."""
    model = problem(0.0, {2: 2.0, 7: -2.0, 12: 2.0})
    _, fits, _ = searched(model)
    unknown = next(f for f in fits if f.hypothesis.unknown)
    best = max((f for f in fits if len(f.hypothesis.effects) == 2), key=lambda f: f.log_evidence)
    args = model.forward, model.evidence, model.baseline
    every = [fit(model.hypothesis(pair), *args) for pair in combinations(model.effects, 2)]
    assert best.log_evidence == pytest.approx(max(f.log_evidence for f in every), abs=0.1)
    assert best.log_evidence < unknown.log_evidence - 20


def test_effects_of_a_family_are_never_together():
    families = {4: "joint", 11: "joint"}
    model = problem(0.0, {4: 1.4, 11: -1.1}, families=families)
    _, fits, _ = searched(model)
    assert not any({"effect 4", "effect 11"} <= keys(f) for f in fits)


def test_leading_ones_are_checked_on_the_full_model(two):
    """At the lowest torque at least, at which joints are softest."""
    model, (_, fits, probability) = two
    best = fits[int(np.argmax(probability))]
    values = best.hypothesis.values(best.z, TORQUES[0], model.baseline, 0)
    assert any(values == pytest.approx(point, abs=0.01) for point in model.checked)


def test_what_is_left_for_a_cause_outside_the_library(two):
    """By the leader alone, and in the same share from all that is listed."""
    model, (search, fits, probability) = two
    unknown = next(i for i, f in enumerate(fits) if f.hypothesis.unknown)
    listed = [i for i in range(len(fits)) if i != unknown]
    score = np.array([f.log_evidence for f in fits])
    score += search.log_prior([f.hypothesis for f in fits])
    leader = fits[max(listed, key=lambda i: score[i])]
    assert probability.sum() == pytest.approx(1.0)
    gap = leader.log_evidence - next(f for f in fits if f.hypothesis.name == "no gap").log_evidence
    left = search.misattribution.outside(gap, leader.p_value)
    assert 0 < left < 0.25 and probability[unknown] == pytest.approx(left, abs=1e-6)
    fine = [i for i in listed if fits[i].p_value > 0.01]
    weights = np.exp(score[fine] - score[fine].max())
    assert probability[fine] / probability[fine].max() == pytest.approx(weights, abs=1e-9)
    # It has no model of its own: the check of the reduced model is for others.
    assert model.baseline not in model.checked[-2:]


def test_what_is_far_behind_an_unknown_cause_stands_in_the_order_of_its_evidence():
    """Probabilities of exp(-2000) are all nought, which is no order."""
    search, fits, _ = searched(problem(0.0, {4: 1.4}))
    far = [
        f if f.hypothesis.unknown else replace(f, log_evidence=-3000.0 + 10 * i)
        for i, f in enumerate(fits[:12])
    ]
    order, probability = search.ranked(far)
    assert far[order[0]].hypothesis.unknown and probability[2] == 0.0
    assert [far[i].log_evidence for i in order[1:]] == sorted(
        (f.log_evidence for f in far if not f.hypothesis.unknown), reverse=True
    )


def test_three_together():
    """Put beside the leading pairs; those must not be hopeless beside the unknown."""
    truth = {1: 0.2, 5: -0.2, 16: 0.2}
    model = problem(0.0, truth, seed=2, most=3)
    _, fits, probability = searched(model)
    best = fits[int(np.argmax(probability))]
    assert keys(best) == {f"effect {i}" for i in truth}
    sizes = [truth[int(e.name.split()[1])] for e in best.hypothesis.effects]
    assert best.z[1:] == pytest.approx(sizes, abs=0.1)


def test_odds_of_all_effects_together_do_not_depend_on_their_number():
    """Ten places of one cause are no ten causes."""
    model = problem(0.0, {})
    search = Search(model, Progress(silent=True))
    singles = [model.hypothesis((e,)) for e in model.effects]
    total = np.exp(search.log_prior(singles)).sum()
    model.effects = model.effects[:3]
    search = Search(model, Progress(silent=True))
    assert np.exp(search.log_prior(singles[:3])).sum() == pytest.approx(total)


def test_near_best_by_hand():
    values = np.array([1.0, 5.0, 4.5, 4.5, -np.inf, 3.0])
    assert near_best(values, 1.0, 9).tolist() == [1, 2, 3]
    assert near_best(values, np.inf, 4).tolist() == [1, 2, 3, 5]
    assert near_best(np.zeros(0), 1.0, 3).tolist() == []


class Spiral(Bent):
    """What parameter 0 does to ln f turns and grows with it, so that a second valley is wrong."""

    def __call__(self, values):
        self.calls += 1
        p = np.array([values[name] for name in self.model.parameters])
        d, (u, v) = p[0], self.matrix[:, :2].T
        turn = np.cos(2.5 * d) * u + np.sin(2.5 * d) * v
        across = np.cos(2.5 * d) * v - np.sin(2.5 * d) * u
        slope = self.matrix.copy()
        slope[:, 0] = 0.3 * turn + 2.5 * (1 + 0.3 * d) * across
        return 5.0 + (1 + 0.3 * d) * turn - u + self.matrix[:, 1:] @ p[1:], slope


def test_the_best_explanations_are_near_though_an_unknown_cause_is_far_ahead():
    values = np.array([-1450.0, -5440.0, -3618.0, -3620.0, -3700.0])
    unknown = np.arange(5) == 0
    assert near_listed(values, unknown, 6.0, 6).tolist() == [0, 2, 3]
    assert near_listed(values, unknown, 6.0, 1).tolist() == [0, 2]
    # Where one of them is near as it is, that is all.
    values[4] = -1449.0
    assert near_listed(values, unknown, 6.0, 6).tolist() == near_best(values, 6.0, 6).tolist()
    assert near_best(values, 6.0, 6).tolist() == [4, 0]


def test_an_effect_is_not_lost_in_the_wrong_valley():
    """Downhill from nothing leads away from a large effect; and the evidence is that of a grid."""
    model = problem(0.0, {})
    model.forward = Spiral(model.forward.matrix, 0.0)
    model.effects = model.effects[:1]
    values = dict(model.baseline)
    model.effects[0].apply(values, {"d": 1.5}, 20.0)
    log_f = np.tile(model.forward(values)[0], (len(TORQUES), 1))
    model.evidence = Evidence(TORQUES, log_f, np.full(log_f.shape, 0.002), 0.002)
    alone = fit(model.hypothesis(model.effects), model.forward, model.evidence, model.baseline)
    _, fits, _ = searched(model)
    best = max(fits, key=lambda f: f.log_evidence)
    for found in (alone, best):
        assert found.z[1] == pytest.approx(1.5, abs=0.02)
    d = np.linspace(-5, 5, 20001)
    rows = np.array([model.forward({**model.baseline, "p0": at})[0] for at in d])
    # The stock's factor is linear: it widens the covariance.
    stock = 0.3 * np.tile(model.forward.matrix[:, COUNT], len(TORQUES))
    covariance = model.evidence.covariance() + np.outer(stock, stock)
    density = multivariate_normal(model.evidence.data, covariance)
    exact = logsumexp(density.logpdf(np.tile(rows, len(TORQUES))) + norm.logpdf(d), b=d[1] - d[0])
    assert alone.log_evidence == pytest.approx(exact, abs=0.1)
    assert best.log_evidence == pytest.approx(exact, abs=0.1)
