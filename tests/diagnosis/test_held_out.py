"""How far the gap shrinks: stated intervals against repetition, S* where the answer is known."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from linear_forward import Linear, shift
from scipy.stats import binom

from fenics_joints.diagnosis import Effect, Prior, held_out
from fenics_joints.diagnosis.evidence import fit
from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.diagnosis.evidence.library import Library
from fenics_joints.diagnosis.evidence.linear_fits import moved
from fenics_joints.diagnosis.held_out import blinded, cross_validate, folds, forecast
from fenics_joints.diagnosis.verdict import confirm, confirmed, unproved

TORQUES = np.array([5.0, 10.0, 20.0, 40.0])
MODES = ["a", "b", "c", "d", "e"]
SD, DISCREPANCY = 0.003, 0.004
MASKS = folds(TORQUES, MODES, ("torque", "N·m"))


#: Three signatures, none like another, of about 10 %.
FORWARD = Linear(
    [
        [-0.10, 0.12, -0.02],
        [-0.08, -0.10, 0.11],
        [-0.09, 0.09, 0.10],
        [-0.11, -0.12, -0.12],
        [-0.10, 0.10, -0.09],
    ]
)


def draw(rng, truth, shape=(4, 5)):
    """A test of the model with p = truth, its noise and its discrepancy."""
    blank = Evidence(TORQUES, np.zeros(shape), np.full(shape, SD), DISCREPANCY)
    # By Cholesky's factor, which is the same on every machine; singular vectors are not.
    error = np.linalg.cholesky(blank.full_covariance()) @ rng.standard_normal(blank.data.size)
    log_f = 5.0 + FORWARD.matrix @ truth + error.reshape(shape)
    return Evidence(TORQUES, log_f, np.full(shape, SD), DISCREPANCY)


def fitted(evidence, *effects, forward=FORWARD):
    return fit(
        Hypothesis(effects, name="" if effects else "none"), forward, evidence, FORWARD.baseline
    )


def candidates(evidence):
    return [fitted(evidence), *(fitted(evidence, shift(i)) for i in range(3))]


def library(evidence):
    return Library(FORWARD, evidence, FORWARD.baseline, lambda effects: Hypothesis(tuple(effects)))


def validate(evidence, wrong, masks=MASKS, fits=None, log_odds=None, **more):
    fits = candidates(evidence) if fits is None else fits
    odds = np.zeros(len(fits)) if log_odds is None else log_odds
    return cross_validate(fits, odds, wrong, library(evidence), masks, **more)


def holds(name):
    return lambda f: any(e.name == name for e in f.hypothesis.effects)


def test_stated_intervals_hold_as_often_as_they_say():
    """The truth is drawn from the prior: nine of ten folds show what was stated, of each kind."""
    rng = np.random.default_rng(11)
    covered, sized, entries = [], [], []
    for i in range(100):
        truth = np.zeros(3)
        kind = rng.integers(4)
        if kind:
            truth[kind - 1] = rng.standard_normal()
        found = validate(draw(rng, truth), lambda f: False, [MASKS[i % len(MASKS)]]).folds[0]
        covered.append(found.covered)
        if found.shrink_covered is not None:
            sized.append(found.shrink_covered)
        entries.append(found.entries_covered)
    for hits in (covered, sized):
        low, high = binom.ppf([0.0005, 0.9995], len(hits), 0.9) / len(hits)
        # S* is stated wider than need be: in 1,138 such folds 95 % held.
        assert low <= np.mean(hits) <= (1.0 if hits is sized else high)
    # Entries of a fold move together: their share's own scatter says how near 0.9 it must be.
    assert abs(np.mean(entries) - 0.9) < 3.3 * np.std(entries) / np.sqrt(len(entries))


def test_the_right_effect_shrinks_what_a_wrong_one_cannot():
    evidence = draw(np.random.default_rng(5), [0.9, 0.0, 0.0])

    def wrong(f):
        return bool(f.hypothesis.effects) and f.hypothesis.effects[0].name != "effect 0"

    found = validate(evidence, wrong)
    assert {f.chosen for f in found.folds} == {"effect 0"}
    assert found.shrink > 0.9 and found.placebo_shrink < 0.3
    assert found.claimed and found.excess_interval[0] > 0.5
    assert found.noise == pytest.approx(SD)
    all_ = np.concatenate([evidence.log_f[mask] for _, mask in MASKS])
    assert found.before == pytest.approx(np.sqrt(np.mean(np.expm1(5.0 - all_) ** 2)))
    assert json.loads(json.dumps(found.to_json()))["folds"][0]["n"] == 4

    # Where nothing but a wrong effect can be chosen nothing is claimed.
    others = [f for f in candidates(evidence) if wrong(f)]
    lost = validate(evidence, lambda f: True, fits=others)
    assert lost.shrink < 0.3 and lost.excess == 0.0 and not lost.claimed


def test_a_wrong_effect_that_predicts_the_same_is_no_rival():
    """It made "likely" of a cause that takes 8.5 % to 0.14 %, since its like left 0.16 %."""
    evidence = draw(np.random.default_rng(5), [0.9, 0.0, 0.0])

    def apply(values, theta, condition):
        values["p0"] += (1 + 1e-7) * theta["d"]

    twin = Effect("twin", "", (Prior("d", 0.0, 1.0, log=False),), apply)
    fits, odds = [*candidates(evidence), fitted(evidence, twin)], [0.0, 0.0, 0.0, 0.0, -1.0]
    found = validate(evidence, holds("twin"), fits=fits, log_odds=odds)
    assert not any(f.placebo_chosen for f in found.folds)
    assert found.placebo == found.before and found.claimed and confirmed(found)


def test_modes_that_the_nominal_model_lacks_are_held_out_too():
    """Its error is that of the others alone; all else is scored on all modes, as if it had them."""
    evidence = draw(np.random.default_rng(5), [0.9, 0.0, 0.0])
    causes = {"it": holds("effect 0")}
    lacks = np.array([True, False, True, True, True])
    found, whole = (
        validate(evidence, holds("effect 1"), causes=causes, not_nominal=mask)
        for mask in (lacks, None)
    )
    own = np.expm1(5.0 - evidence.log_f[:, 1])
    assert found.before == pytest.approx(np.sqrt(np.mean(own**2)))
    for name in ("after", "placebo", "noise", "coverage", "entries_coverage", "gains"):
        assert getattr(found, name) == getattr(whole, name), name
    assert [np.isfinite(f.before) for f in found.folds] == [(m & ~lacks).any() for _, m in MASKS]
    assert found.claimed and confirmed(found)


def test_modes_without_levels_are_held_out_by_mode_alone():
    """Conditions are held out of the modes that were measured at several."""
    measured = np.array([[False, True, True], [True, False, False], [True, False, False]])
    found = dict(folds(np.array([0.5, 5.0, 20.0]), "abc", ("level", "m/s2"), measured=measured))
    assert list(found) == ["mode a", "mode b", "mode c", "level 5 m/s2", "level 20 m/s2"]
    assert np.array_equal(np.argwhere(found["level 20 m/s2"]), [[2, 0]])


def test_what_is_held_out_is_not_in_what_states_the_forecast(monkeypatch):
    """Other values there, the same forecast; and the blinded test holds none of them.

    Each is from the library: a fit that is linear about the fit to all data starts from other
    values, and whether it serves hangs on round-off here.
    """
    monkeypatch.setattr(held_out, "moved", lambda *_: None)
    evidence = draw(np.random.default_rng(2), [0.0, 0.7, 0.0])
    mask = dict(MASKS)["top band, d to e"]
    assert mask[:, 3:].all() and not mask[:, :3].any()
    blind = blinded(evidence, mask)
    assert np.isnan(blind.log_f[mask]).all() and np.isfinite(blind.log_f[~mask]).all()
    stated = []
    for apart in (0.0, 0.3):
        other = Evidence(TORQUES, evidence.log_f + apart * mask, evidence.log_sd, DISCREPANCY)
        f = validate(other, lambda f: False, [("band", mask)]).folds[0]
        stated.append([*f.predicted_after, *f.predicted_shrink, *f.weights.values()])
        assert f.covered == (apart == 0.0)
    assert stated[0] == pytest.approx(stated[1], rel=1e-9, abs=1e-12)


def test_a_fit_to_a_part_is_linear_about_that_to_all_where_little_moves():
    evidence = draw(np.random.default_rng(7), [0.4, 0.0, 0.0])
    whole = fitted(evidence, shift(0), shift(1))
    mask = dict(MASKS)["mode c"]
    blind = blinded(evidence, mask)
    near = moved(whole, blind)
    best = fitted(blind, shift(0), shift(1))
    assert near.z == pytest.approx(best.z, abs=1e-4)
    assert near.log_evidence == pytest.approx(best.log_evidence, abs=1e-4)
    assert near.predicted == pytest.approx(best.predicted, abs=1e-6) and near.n_data < whole.n_data
    # Half of the data elsewhere is too far.
    far = replace(blind, log_f=blind.log_f + 0.2 * (np.arange(4) < 2)[:, None])
    assert moved(whole, far) is None


def test_forecast_is_the_conditional_normal_when_linear(monkeypatch):
    """Intervals of single entries against the joint normal of all data under the hypothesis, where
    all that is stated of the model is there."""
    monkeypatch.setattr(held_out, "share_of_stated", lambda *_: (1.0, np.inf))
    evidence = draw(np.random.default_rng(4), [0.5, 0.0, 0.0])
    mask = dict(MASKS)["torque 40 N·m"]
    blind = blinded(evidence, mask)
    refit = fitted(blind, shift(0))
    held = mask.ravel()
    stated = forecast([refit], np.ones(1), refit, np.full(5, 5.0), blind, held, SD, count=40000)
    slope = np.tile(FORWARD.matrix[:, :1], (4, 1))
    joint = evidence.full_covariance() + slope @ slope.T
    gain = joint[np.ix_(held, ~held)] @ np.linalg.inv(joint[np.ix_(~held, ~held)])
    mean = 5.0 + gain @ (evidence.data[~held] - 5.0)
    sd = np.sqrt(np.diag(joint[np.ix_(held, held)] - gain @ joint[np.ix_(~held, held)]))
    assert stated.low == pytest.approx(mean - 1.645 * sd, abs=0.03 * sd.max())
    assert stated.high == pytest.approx(mean + 1.645 * sd, abs=0.03 * sd.max())


@pytest.mark.parametrize("stated", [1.0, 3.0])
def test_intervals_hold_though_less_than_is_stated_is_wrong(stated):
    """Of 5 modes, and of 12: what those fitted call for is stated of the one that is held out. With
    all that is stated the intervals would be 3 times too wide."""
    rng, blank = np.random.default_rng(3), np.full((1, 12), SD)
    one = Linear(rng.uniform(-0.1, 0.1, (12, 1)))
    for m, low, high, widest in ((5, 0.7, 0.98, 2.4), (12, 0.82, 0.96, 1.5)):
        held_, above, ends = [], [], []
        for _ in range(150):
            error = rng.standard_normal((2, 1, 12))
            log_f = 5.0 + DISCREPANCY * error[0] + 0.1 * SD * error[1]
            evidence = Evidence(
                np.ones(1), log_f, 0.1 * blank, stated * DISCREPANCY, used=np.arange(12)[None] < m
            )
            mask = np.arange(12)[None] == 0
            blind = blinded(evidence, mask)
            refit = fitted(blind, forward=one)
            found = forecast([refit], np.ones(1), refit, np.full(1, 5.0), blind, mask[0], SD)
            value = abs(np.expm1(5.0 - log_f[0, 0]))
            held_.append(found.after[0] <= value <= found.after[1])
            above.append(value > found.after[1])
            ends.append(found.after[1] / (1.96 * DISCREPANCY))
        assert low < np.mean(held_) < high and np.mean(above) < 0.1
        assert np.median(ends) < widest


@pytest.mark.parametrize("between", [False, True])
def test_all_that_is_stated_is_there_where_it_is(between):
    """Of tests drawn from what is stated, of modes' means and between torques: chi-square."""
    squares = []
    for seed in range(200):
        evidence = draw(np.random.default_rng(seed), np.zeros(3))
        refit = fitted(evidence)
        mean, known = held_out.share_of_stated(refit, evidence, between)
        prior = known - (15 if between else 5)  # modes that it is worth, each as stated
        squares.append(mean * known - prior)
    assert np.mean(squares) / (known - prior) == pytest.approx(1.0, abs=0.1)
    assert np.var(squares) == pytest.approx(2 * (known - prior), rel=0.4)
    # Where nothing changes between the torques little of it is there.
    still = np.broadcast_to(evidence.log_f[:1], (4, 5))
    calm = Evidence(TORQUES, still, np.full((4, 5), SD), DISCREPANCY)
    assert held_out.share_of_stated(fitted(calm), calm, True)[0] < 0.2


def test_each_of_several_causes_has_to_make_held_out_data_more_probable():
    """Two are at work, the third is called a cause too: held-out data bear out the two alone.

    Of 30 such tests one bears out the third, as often as odds of 20 to 1 may.
    """
    evidence = draw(np.random.default_rng(0), np.array([1.0, 0.8, 0.0]))
    chosen = [c for n in range(4) for c in combinations(map(shift, range(3)), n)]
    fits = [fitted(evidence, *c) for c in chosen]
    causes = {f"effect {i}": holds(f"effect {i}") for i in range(3)}
    found = validate(evidence, lambda f: not causes["effect 0"](f), fits=fits, causes=causes)
    assert found.gains["effect 0"] > 20 and found.gains["effect 1"] > 20
    assert found.gains["effect 2"] < 1
    assert unproved(found) == ["effect 2"] and confirmed(found)
    none = replace(found, gains={"effect 2": found.gains["effect 2"]})
    verdict, summary = confirm("cause", "A cause.", none)
    assert verdict == "likely"
    assert "they are not surely more probable with effect 2 than without" in summary
