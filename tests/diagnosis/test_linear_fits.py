"""P-values of the best of many explanations, and of all effects at once."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from linear_forward import linear_fit
from scipy.stats import binomtest, kstest

from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.linear_fits import all_at_once, with_simulated

MODES, CAUSES, SD, TESTS = 4, 10, 0.01, 200
#: Of tests that all effects at once are fitted to.
MANY, FEW = 12, 5
SETS = list(combinations(range(CAUSES), 2))


@pytest.fixture
def rng():
    return np.random.default_rng(3)


def explained(moves: np.ndarray, log_f: np.ndarray):
    """A test with the fits of all pairs of causes, ln of the evidence of each, and the best one."""
    test = Evidence(np.array([1.0]), log_f[None, :], np.full((1, MODES), SD), 0.0)
    fits = [linear_fit(causes, moves[:, causes], log_f, SD) for causes in SETS]
    score = np.array([f.log_evidence for f in fits])
    return test, fits, score, int(np.argmax(score))


def p_values(moves: np.ndarray, log_f: np.ndarray) -> tuple[float, float]:
    """Of the best explanation of a test: chi-square's, and that of simulated tests."""
    test, fits, score, best = explained(moves, log_f)
    return fits[best].p_value, with_simulated(fits, score, test, count=199)[best].p_value


def found(moves: np.ndarray, true: np.ndarray, rng, level: float) -> np.ndarray:
    """Tests of two causes each, by their ``true`` moves, with a p-value below a level: by both."""
    p = []
    for i in range(TESTS):
        made = true[:, SETS[i % len(SETS)]] @ rng.standard_normal(2)
        p.append(p_values(moves, made + SD * rng.standard_normal(MODES)))
    return np.sum(np.array(p) < level, axis=0)


def test_of_the_best_of_many_explanations_p_is_even(rng):
    """Of tests that the library makes a tenth are below 0.1; by chi-square, which knows nothing of
    the choice, hardly any."""
    moves = 0.015 * rng.standard_normal((MODES, CAUSES))
    chi_square, simulated = found(moves, moves, rng, 0.1)
    assert binomtest(int(simulated), TESTS, 0.1).pvalue > 0.01, simulated
    assert binomtest(int(chi_square), TESTS, 0.1).pvalue < 0.01, chi_square


def test_what_the_library_lacks_is_found_more_often(rng):
    """Of causes that move frequencies otherwise, by little more than noise."""
    moves, true = 0.015 * rng.standard_normal((2, MODES, CAUSES))
    chi_square, simulated = found(moves, true, rng, 0.05)
    assert simulated > 1.2 * chi_square, (chi_square, simulated)


def test_round_off_and_order_leave_p_as_it_is(rng):
    """Of reduced models on one and two ranks ln of the evidence differs by 0.02."""
    moves = 0.015 * rng.standard_normal((MODES, CAUSES))
    test, fits, score, best = explained(moves, moves[:, :2] @ [1.0, -1.0] + SD * np.ones(MODES))
    p = with_simulated(fits, score, test)[best].p_value
    order = rng.permutation(len(fits))
    again = with_simulated(
        [fits[i] for i in order], (score + 0.02 * rng.standard_normal(len(fits)))[order], test
    )
    assert 0.02 < p < 0.98
    assert again[list(order).index(best)].p_value == pytest.approx(p, abs=0.005)


def test_every_p_is_the_share_of_many_tests_that_are_fitted_one_by_one(rng):
    """In the tail too, as pairs that explain nothing have it: by densities of 100,000 tests."""
    moves, count = 0.015 * rng.standard_normal((MODES, CAUSES)), 100_000
    test, fits, score, _ = explained(moves, moves[:, :2] @ [0.7, -0.7] + SD * np.ones(MODES))
    probability = np.exp(score - score.max())
    causes = rng.choice(len(SETS), count, p=probability / probability.sum())
    spans = np.array([moves[:, pair] for pair in SETS])
    made = np.einsum("nmc,nc->nm", spans[causes], rng.standard_normal((count, 2)))
    made += SD * rng.standard_normal(made.shape)
    covariance = SD**2 * np.eye(MODES) + spans @ spans.transpose(0, 2, 1)
    squares = np.einsum("nm,pmk,nk->pn", made, np.linalg.inv(covariance), made, optimize=True)
    density = -0.5 * (squares + np.linalg.slogdet(covariance)[1][:, None])
    left = squares[np.argmax(density, axis=0), np.arange(count)]
    share = np.array([np.mean(left > f.square) for f in fits])
    assert np.any((share > 1e-3) & (share < 0.02))
    p = np.array([f.p_value for f in with_simulated(fits, score, test)])
    assert p == pytest.approx(share, abs=0.02)
    tail = share > 2e-3
    assert p[tail] == pytest.approx(share[tail], rel=0.4)


# -- all effects at once ---------------------------------------------------------------------------


def p_alone_and_at_once(made: np.ndarray, moves: np.ndarray, rng) -> np.ndarray:
    """Of tests, (n, m), by the best single effect and by all at once, (n, 2)."""
    found = []
    for log_f in made + SD * rng.standard_normal(made.shape):
        test = Evidence(np.array([1.0]), log_f[None, :], np.full((1, MANY), SD), 0.0)
        fits = [linear_fit((i,), moves[:, [i]], log_f, SD) for i in range(FEW)]
        best = max(fits, key=lambda f: f.log_evidence)
        found.append((best.p_value, all_at_once(fits, best, test)))
    return np.array(found)


def test_of_several_effects_that_no_one_explains_p_is_even():
    rng = np.random.default_rng(5)
    moves = 0.05 * rng.standard_normal((MANY, FEW))
    made = rng.standard_normal((TESTS, FEW)) @ moves.T
    alone, at_once = p_alone_and_at_once(made, moves, rng).T
    assert np.mean(alone < 0.01) > 0.9
    assert kstest(at_once, "uniform").pvalue > 0.01


def test_what_is_outside_the_span_of_all_is_found():
    """Also beside effects that are in it; what is inside is not found, however large."""
    rng = np.random.default_rng(5)
    moves = 0.05 * rng.standard_normal((MANY, FEW))
    outside = np.linalg.svd(moves)[0][:, FEW:] @ rng.standard_normal(MANY - FEW)
    outside *= 0.1 / np.linalg.norm(outside)
    made = rng.standard_normal((TESTS, FEW)) @ moves.T
    assert np.mean(p_alone_and_at_once(made + outside, moves, rng)[:, 1] < 0.01) > 0.99
    inside = moves @ np.ones(FEW)
    inside *= 0.1 / np.linalg.norm(inside)
    assert np.mean(p_alone_and_at_once(made + inside, moves, rng)[:, 1] < 0.01) < 0.05
