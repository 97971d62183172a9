"""How often a cause outside the library is taken for one of it: on models where that is known."""

from __future__ import annotations

from dataclasses import fields, replace
from types import SimpleNamespace

import numpy as np
import pytest

from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.diagnosis.evidence.library import Library
from fenics_joints.diagnosis.evidence.misattribution import (
    Misattribution,
    answers,
    confusion_matrix,
    simulate,
)
from fenics_joints.diagnosis.shrinkage import Fold, Shrinkage
from fenics_joints.diagnosis.verdict import after_held_out, held_out_factor
from tests.helpers.linear_forward import Linear, shift

SD, MODES = 0.002, 8


def fold(name: str, before: float, after: float, placebo: float) -> Fold:
    nothing = dict.fromkeys([f.name for f in fields(Fold)], 0.0)
    return Fold(**{**nothing, "name": name, "before": before, "after": after, "placebo": placebo})


def weighed(matrix):
    """Library, effects, ln of their odds, and a test of a linear model."""
    forward = Linear(matrix)
    log_f = np.full((1, MODES), 5.0)
    evidence = Evidence(np.array([10.0]), log_f, np.full(log_f.shape, SD), SD)
    library = Library(forward, evidence, forward.baseline, lambda chosen: Hypothesis(tuple(chosen)))
    effects = [shift(i) for i in range(matrix.shape[1])]
    return library, effects, dict.fromkeys([e.key for e in effects], np.log(0.5)), evidence


def rate(matrix) -> float:
    library, effects, odds, evidence = weighed(matrix)
    return simulate(library, effects, odds, 0.25, np.log(0.5), evidence).rate


def test_of_three_effects_two_that_do_the_same_are_taken_for_each_other():
    apart = 0.05 * np.eye(MODES)[:, :3]
    assert rate(apart) < 0.1
    twins = apart.copy()
    twins[:, 1] = twins[:, 0]
    # The third has no twin; a third of the causes each, so that of 100 it is 23 to 43.
    assert rate(twins) == pytest.approx(2 / 3, abs=0.12)
    # Each of three in a plane is what the two others make together.
    plane = apart.copy()
    plane[:, 2] = 0.5 * (apart[:, 0] + apart[:, 1])
    assert rate(plane) > 0.6
    # Of a library with one effect none else can be named.
    assert rate(apart[:, :1]) < 0.1


def test_what_causes_are_taken_for():
    """Three apart are named, but for what is too small; twins are named by turns."""
    matrix = 0.5 * np.eye(MODES)[:, :3]
    library, effects, odds, evidence = weighed(matrix)
    shares = confusion_matrix(library, effects, odds, np.log(1e-6), evidence)
    assert shares.sum(axis=1) == pytest.approx(np.ones(3))
    assert np.all(np.diag(shares) > 0.95)
    matrix[:, 1] = matrix[:, 0]
    library, effects, odds, evidence = weighed(matrix)
    shares = confusion_matrix(library, effects, odds, np.log(1e-6), evidence)
    assert shares[:2, :2] == pytest.approx(np.full((2, 2), 0.5), abs=0.02)
    assert shares[2, 2] > 0.95


@pytest.mark.parametrize("factor, expected", [(1.0, 0.805), (2.0, 0.67)])
def test_how_many_answers_of_80_percent_are_right(factor, expected):
    """Of exact log odds as many as are said; of twice as large ones by the root of the odds."""
    rng = np.random.default_rng(3)
    score = 2.0 * rng.standard_normal((2, 20000))
    cause = (rng.uniform(size=20000) < 1 / (1 + np.exp(score[0] - score[1]))).astype(int)
    count, right = answers(factor * score, cause)
    assert right / count == pytest.approx(expected, abs=0.015)


def test_what_simulated_tests_say_is_found_again():
    """A rate that falls with the gap, and p-values of a known density."""
    rng = np.random.default_rng(4)
    gap = np.exp(rng.uniform(0, 8, 4000))
    named = rng.uniform(size=4000) < 1 / (1 + np.exp(-1.0 + 0.5 * np.log(gap)))
    log_p = np.where(named, np.log(rng.uniform(size=4000)) / 0.6, 0.0)
    found = Misattribution.of(gap, named, log_p, 1.0 - named, 0.25)
    assert found.rate == pytest.approx(named.mean(), abs=0.002)
    assert found.rate_at(1.0) == pytest.approx(1 / (1 + np.exp(-1.0)), abs=0.04)
    assert found.rate_at(np.exp(6.0)) == pytest.approx(1 / (1 + np.exp(2.0)), abs=0.03)
    # Beyond what was simulated nothing is extrapolated.
    assert found.rate_at(1e9) == found.rate_at(gap.max())
    assert found.exponent == pytest.approx(0.6, abs=0.03)


def test_the_rate_and_the_misfit_count_by_bayes_rule():
    known = Misattribution(0.2, float(np.log(0.2 / 0.8)), 0.0, 9.0, 1.0, 50, 0.25)
    assert known.outside(10.0, 0.7) == pytest.approx(0.25 * 0.2 / (0.25 * 0.2 + 0.75))
    worse = Misattribution(0.2, float(np.log(0.2 / 0.8)), 0.0, 9.0, 0.5, 50, 0.25)
    density = 0.5 * 0.04**-0.5
    assert worse.outside(10.0, 0.04) == pytest.approx(0.05 * density / (0.05 * density + 0.75))
    assert worse.outside(10.0, 0.0) > 0.99


def test_without_any_test_to_be_seen_half_are_taken_for_others():
    nothing = Misattribution.of(*np.zeros((4, 0)), 0.25)
    assert nothing.rate_at(5.0) == 0.5 and nothing.exponent == 1.0


@pytest.mark.parametrize(("won", "parts"), [(0, 0), (1, 2), (0, 9), (3, 9), (8, 8)])
def test_parts_held_out_count_by_bayes_rule(won, parts):
    """By summing over how often a right cause wins; more than even is no reason to be surer."""
    often = (np.arange(100_000) + 0.5) / 200_000 + 0.5
    right = np.mean(often**won * (1 - often) ** (parts - won))
    factor = min(right / 0.5**parts, 1.0)
    assert held_out_factor(won, parts) == pytest.approx(factor, rel=1e-6)


def test_a_cause_that_predicts_no_part_held_out_best_is_less_probable():
    fits = [
        SimpleNamespace(hypothesis=SimpleNamespace(effects=[SimpleNamespace(key=k) for k in keys]))
        for keys in (("a",), ("a", "b"), (), ("b",))
    ]
    best = [
        (0.1, 0.02, 0.05),
        (0.1, 0.03, 0.02),
        (0.1, 0.2, np.nan),
        (np.nan, 0.1, 0.1),
        (0.01, 0.02, 0.03),
    ]
    folds = [fold("part", before=b, after=a, placebo=p) for b, a, p in best]
    raw = np.array([0.6, 0.3, 0.08, 0.02])
    found, p = after_held_out(fits, raw, {"a"}, Shrinkage(folds=folds))
    odds = held_out_factor(1, 5) * 0.9 / 0.1
    assert p.sum() == pytest.approx(1.0)
    named = [
        q for f, q in zip(found, p, strict=True) if any(e.key == "a" for e in f.hypothesis.effects)
    ]
    assert sum(named) == pytest.approx(odds / (1 + odds))
    assert named[0] == pytest.approx(2 * named[1])
    # Parts in which the nominal model errs no more than noise say nothing.
    quiet = [replace(part, noise=0.2) for part in folds if np.isfinite(part.before)]
    assert sorted(after_held_out(fits, raw, {"a"}, Shrinkage(folds=quiet))[1]) == pytest.approx(
        sorted(raw)
    )


def test_effects_that_change_nothing_have_no_simulated_tests():
    forward = Linear(np.zeros((MODES, 1)))
    evidence = Evidence(np.array([10.0]), np.full((1, MODES), 5.0), np.full((1, MODES), SD), SD)
    silent = replace(shift(0), apply=None)
    library = Library(forward, evidence, forward.baseline, lambda chosen: Hypothesis(tuple(chosen)))
    found = simulate(library, [silent], {silent.key: 0.0}, 0.25, 0.0, evidence)
    assert found.tests == 0 and found.rate == 0.5
