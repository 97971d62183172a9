"""Posteriors of models by forms of one's own."""

from __future__ import annotations

import numpy as np
import pytest
from clamped_strip import strip
from scipy import stats

from fenics_joints.bayes import GaussianLikelihood, Posterior, PriorDensity, Settings, sample
from fenics_joints.bayes.model import narrow_frequencies
from fenics_joints.measurements import Target
from fenics_joints.modal import solve_modes
from fenics_joints.reduction import ModalPrediction, reduce
from fenics_joints.structure import Parameter
from fenics_joints.updating import update
from fenics_joints.updating.coordinates import LogScale


def test_posterior_of_a_model_by_forms_is_that_of_the_least_squares():
    """Wide priors and small noise: the mean and covariance of `update` on the full model."""
    model, noise = strip(), 1e-3
    samples = [{"E": e, "k": k} for e in (6e10, 8e10) for k in (2e10, 3e11)]
    small = reduce(model, samples, 10)
    hz = solve_modes(model, {"E": 68e9, "k": 6e10}, n_modes=8).frequencies_hz
    unknown = Parameter("E", 7e10, "Pa", 3e10, 2e11), Parameter("k", 1e11, "Pa/m", 1e9, 1e13)
    wide = stats.lognorm(1.0, scale=7e10), stats.lognorm(3.0, scale=1e11)
    prior = PriorDensity(unknown, wide, LogScale(["E", "k"], small))
    forward = ModalPrediction(small.arrays(), None, 8, 10, None)
    likelihood = GaussianLikelihood(("",) * 8, np.log(hz), noise**2 * np.eye(8))
    model_of = narrow_frequencies(forward, prior, model.values())
    chains = sample(
        Posterior(prior, model_of, likelihood), Settings(samples=6000, burn_in=1000, chains=2)
    ).require_converged()
    fit = update(model, unknown, Target(hz, noise), {"E": 7e10, "k": 1e11})
    draws = chains.values.reshape(-1, 2)
    assert fit.values == pytest.approx([68e9, 6e10], rel=1e-5)
    spread = np.sqrt(np.diag(fit.covariance))
    assert np.all(np.abs(draws.mean(axis=0) - fit.values) < 0.3 * spread)
    assert np.std(draws, axis=0) == pytest.approx(spread, rel=0.15)
