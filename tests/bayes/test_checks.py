"""Checks: priors that the data contradict, new specimens beside measured ones, calibration."""

from __future__ import annotations

import numpy as np
import pytest
from linear_posterior import MODES, SLOPE, gaussian, linear, prior
from scipy import stats

from fenics_joints.bayes import GaussianLikelihood, calibrate, check_predictive, check_prior, rank
from fenics_joints.bayes.checks import outside
from fenics_joints.bayes.walks import RandomWalk, generator
from fenics_joints.errors import InputError

pytest.importorskip("arviz")


def test_mean_of_few_specimens_is_known_no_better():
    """A covariance found of seven: 90 % intervals hold 90 % of the truths, by the exact theory."""
    rng, slope, n = np.random.default_rng(0), np.array([0.3, 0.1, 0.2]), 7
    spread = np.array([[5.0, 0, 0], [4, 2, 0], [3, 1, 1]]) * 1e-3
    off, held = np.linspace(-0.1, 0.1, 401), {"t": 0, "normal": 0}
    for _ in range(600):
        logs = rng.standard_normal((n, 3)) @ spread.T
        found = GaussianLikelihood.from_specimens(MODES, np.exp(logs), n_parameters=1)
        known = GaussianLikelihood(MODES, found.log_f, found.covariance)
        for key, likelihood in (("t", found), ("normal", known)):
            lp = likelihood(off[:, None] * slope)
            shares = np.cumsum(np.exp(lp - lp.max()))
            held[key] += 0.05 < shares[200] / shares[-1] < 0.95
    assert abs(held["t"] / 600 - 0.9) < 0.04 and held["normal"] / 600 < 0.75


def test_what_is_measured_outside_of_the_prediction():
    rng = np.random.default_rng(1)
    draws = np.exp(np.log([100.0, 200.0, 300.0]) + 1e-3 * rng.standard_normal((4000, 3)))
    measured = np.array([100.1, 205.0, np.nan])
    (line,) = outside(MODES, measured, draws)
    assert line.startswith("second: predicted 2.4 % below the measured 205.00 Hz, 25 standard")
    assert outside(MODES, measured, draws, 0.01) == []


def test_sets_of_the_size_of_the_measured_one():
    """Specimens with gaps are left out: new sets are as small, and scatter from set to set so."""
    rng = np.random.default_rng(3)
    table = np.exp(1e-3 * rng.standard_normal((30, 2)))
    table[5:, 1] = np.nan
    sets = 1e-3 * rng.standard_normal((4000, 30, 2))
    check = check_predictive(MODES[:2], table, sets)
    low, high = 1e-3 * np.sqrt(stats.chi2(4).ppf([0.05, 0.95]) / 4)
    np.testing.assert_allclose(check.sd_low, low, rtol=0.06)
    np.testing.assert_allclose(check.sd_high, high, rtol=0.03)
    table[4:, 1] = np.nan
    with pytest.raises(InputError, match="at least 5 specimens"):
        check_predictive(MODES[:2], table, sets)


def test_prior_that_excludes_the_data():
    """What no value within four standard deviations of the prior brings near is refused."""
    known, sd = prior(0.1), np.full(3, 0.01)
    near = np.log(100) + SLOPE @ [0.3, -0.3]
    assert check_prior(known, linear, MODES, near, sd) == []
    far = np.log(100) + SLOPE @ [0.0, 1.5]
    # Along b alone, as far as its fourth standard deviation.
    left = 100 * np.expm1(np.max(np.abs(SLOPE[:, 1])) * (1.5 - 0.4))
    with pytest.raises(InputError, match="prior of .*b: excludes the data") as error:
        check_prior(known, linear, MODES, far, sd)
    found = float(str(error.value).split(" %")[0].split()[-1])
    assert 0.5 * left < found < left
    # Not the prior's fault: no parameter moves the modes apart so.
    odd = np.log(100) + np.array([0.1, 0.1, -0.1])
    words = check_prior(prior(2.0), linear, MODES, odd, np.full(3, 0.003))
    assert words and "third" in words[-1] and "give it a discrepancy" in words[-1]


def test_intervals_hold_the_truth():
    """Simulation-based calibration of the random walk: a chain for each set of data."""
    rng, n = np.random.default_rng(8), 200
    truths = 0.5 * rng.standard_normal((n, 2))
    likelihood = gaussian()
    lower = np.linalg.cholesky(likelihood.covariance)
    data = truths @ SLOPE.T + rng.standard_normal((n, 3)) @ lower.T
    weight, known = np.linalg.inv(likelihood.covariance), prior()

    def log_density(x):
        off = data - x @ SLOPE.T
        return known.log_density(x) - 0.5 * np.einsum("ni,ij,nj->n", off, weight, off)

    rngs = [generator(3, c) for c in range(n)]
    walk = RandomWalk(log_density, np.zeros((n, 2)), 0.1 * np.eye(2), rngs, 1000)
    walk.advance(1000)
    points, _, _ = walk.advance(3000)
    for i in range(2):
        ranks = np.array([rank(truths[k, i], points[k, :, i], 39) for k in range(n)])
        assert calibrate(ranks, 39).p_value > 0.01
        assert 0.83 < calibrate(ranks, 39).covered < 0.97
    # A posterior that is too narrow is found out.
    mean = points.mean(axis=1, keepdims=True)
    narrow = mean + 0.5 * (points - mean)
    ranks = np.array([rank(truths[k, 0], narrow[k, :, 0], 39) for k in range(n)])
    assert calibrate(ranks, 39).p_value < 1e-3
