"""All effects at once, of which no one explains a test."""

from __future__ import annotations

import numpy as np
import pytest
from linear_forward import linear_fit
from scipy.stats import kstest

from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.linear_fits import all_at_once

MODES, CAUSES, SD, TESTS = 12, 5, 0.01, 200


@pytest.fixture
def rng():
    return np.random.default_rng(5)


def p_values(made: np.ndarray, moves: np.ndarray, rng) -> np.ndarray:
    """Of tests, (n, m), by the best single effect and by all at once, (n, 2)."""
    found = []
    for log_f in made + SD * rng.standard_normal(made.shape):
        test = Evidence(np.array([1.0]), log_f[None, :], np.full((1, MODES), SD), 0.0)
        fits = [linear_fit((i,), moves[:, [i]], log_f, SD) for i in range(CAUSES)]
        best = max(fits, key=lambda f: f.log_evidence)
        found.append((best.p_value, all_at_once(fits, best, test)))
    return np.array(found)


def test_of_several_effects_that_no_one_explains_p_is_even(rng):
    moves = 0.05 * rng.standard_normal((MODES, CAUSES))
    made = rng.standard_normal((TESTS, CAUSES)) @ moves.T
    alone, at_once = p_values(made, moves, rng).T
    assert np.mean(alone < 0.01) > 0.9
    assert kstest(at_once, "uniform").pvalue > 0.01


def test_what_is_outside_the_span_of_all_is_found(rng):
    """Also beside effects that are in it; what is inside is not found, however large."""
    moves = 0.05 * rng.standard_normal((MODES, CAUSES))
    outside = np.linalg.svd(moves)[0][:, CAUSES:] @ rng.standard_normal(MODES - CAUSES)
    outside *= 0.1 / np.linalg.norm(outside)
    made = rng.standard_normal((TESTS, CAUSES)) @ moves.T
    assert np.mean(p_values(made + outside, moves, rng)[:, 1] < 0.01) > 0.99
    inside = moves @ np.ones(CAUSES)
    inside *= 0.1 / np.linalg.norm(inside)
    assert np.mean(p_values(made + inside, moves, rng)[:, 1] < 0.01) < 0.05
