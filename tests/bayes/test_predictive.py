"""New specimens against measured ones."""

from __future__ import annotations

import numpy as np
import pytest
from linear_posterior import MODES
from scipy import stats

from fenics_joints.bayes import GaussianLikelihood, check_predictive
from fenics_joints.bayes.predictive import outside
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
