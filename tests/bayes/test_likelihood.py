"""A likelihood with a fitted scatter against a grid."""

from __future__ import annotations

import numpy as np
import pytest
from linear_posterior import MODES, linear, prior
from scipy import stats

from fenics_joints.bayes import FittedLikelihood, Posterior, Settings, sample

pytest.importorskip("arviz")


def test_fitted_likelihood_against_a_grid():
    """Eq. 8 with Weibull, normal and Gumbel frequencies of a nonlinear model."""
    rng = np.random.default_rng(2)
    laws = (stats.weibull_min(40, scale=102), stats.norm(96, 3), stats.gumbel_r(99, 2))
    table = np.column_stack([law.rvs(25, random_state=rng) for law in laws])
    likelihood = FittedLikelihood.from_specimens(MODES, table, ["weibull", "normal", "gumbel"])

    def model(values):
        return linear(values) + 0.3 * np.log(values[:, :1]) ** 2

    posterior = Posterior(prior(0.3), model, likelihood)
    axis = np.linspace(-1.2, 1.2, 241)
    grid = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    values = np.exp(grid)
    # The density by scipy alone.
    logs = sum(
        d.frozen.logpdf(f) for d, f in zip(likelihood.fitted, np.exp(model(values)).T, strict=True)
    )
    logs += stats.norm(0, 0.3).logpdf(grid).sum(axis=1)
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    mean = weights @ grid
    sd = np.sqrt(weights @ (grid - mean) ** 2)
    draws = np.log(sample(posterior, Settings(samples=6000, burn_in=2000)).draws())
    assert np.all(np.abs(draws.mean(axis=0) - mean) < 0.12 * sd)
    np.testing.assert_allclose(draws.std(axis=0), sd, rtol=0.12)
