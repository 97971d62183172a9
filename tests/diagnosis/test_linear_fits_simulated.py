"""P-values of the best of many explanations, from simulated tests."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from linear_forward import linear_fit
from scipy.stats import binomtest

from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.linear_fits import with_simulated

MODES, CAUSES, SD, TESTS = 4, 10, 0.01, 200
SETS = list(combinations(range(CAUSES), 2))


@pytest.fixture
def rng():
    return np.random.default_rng(3)


def p_values(moves: np.ndarray, log_f: np.ndarray) -> tuple[float, float]:
    """Of the best explanation of a test: chi-square's, and that of simulated tests."""
    test = Evidence(np.array([1.0]), log_f[None, :], np.full((1, MODES), SD), 0.0)
    fits = [linear_fit(causes, moves[:, causes], log_f, SD) for causes in SETS]
    score = np.array([f.log_evidence for f in fits])
    best = int(np.argmax(score))
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
