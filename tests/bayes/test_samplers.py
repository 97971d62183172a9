"""Chains against closed forms; those that are kept, prolonged, or not converged."""

from __future__ import annotations

import numpy as np
import pytest
from linear_posterior import MODES, SLOPE, NoLaws, gaussian, linear, prior
from mpi4py import MPI

from fenics_joints.bayes import (
    GaussianLikelihood,
    Posterior,
    PriorDensity,
    Settings,
    sample,
    samplers,
)
from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.updating.coordinates import LogScale

pytest.importorskip("arviz")


@pytest.mark.parametrize("kind", ["metropolis", "emcee"])
def test_conjugate_posterior(kind):
    """A linear model, normal in the logarithms: mean and covariance in closed form."""
    likelihood = gaussian()
    weight = np.linalg.inv(likelihood.covariance)
    covariance = np.linalg.inv(SLOPE.T @ weight @ SLOPE + np.eye(2) / 0.25)
    mean = covariance @ SLOPE.T @ weight @ (likelihood.log_f - np.log(100))
    settings = Settings(kind, 6000 if kind == "metropolis" else 16000, 2000, 4)
    found = sample(Posterior(prior(), linear, likelihood), settings)
    logs = np.log(found.draws())
    sd, n = np.sqrt(np.diag(covariance)), min(c["ess_bulk"] for c in found.convergence.values())
    assert np.all(np.abs(logs.mean(axis=0) - mean) < 4.5 * sd / np.sqrt(n))
    np.testing.assert_allclose(np.cov(logs.T), covariance, atol=0.15 * sd.max() ** 2)


def test_proposals_from_the_prior_are_the_same_posterior():
    """The paper's chain, on a posterior that is not far narrower than its prior."""
    wide = GaussianLikelihood(MODES, gaussian().log_f, 0.01 * np.eye(3))
    posterior = Posterior(prior(), linear, wide)
    found = {
        kind: np.log(sample(posterior, Settings(kind, 8000, 1000, 4)).draws())
        for kind in ("metropolis", "prior_metropolis")
    }
    for moment in (np.mean, np.std):
        one, other = (moment(draws, axis=0) for draws in found.values())
        np.testing.assert_allclose(one, other, atol=0.04)


def test_chains_that_did_not_converge_are_not_used():
    found = sample(Posterior(prior(), linear, gaussian()), Settings(samples=120, burn_in=20))
    assert not found.converged
    with pytest.raises(ConvergenceError, match="did not converge"):
        found.draws()
    # Two maxima that chains cannot leave.
    at = np.array([[[0.0]], [[5.0]]]) + np.random.default_rng(0).standard_normal((2, 2000, 1))
    apart = found.__class__(("a",), at, np.zeros((2, 2000)), np.ones(2), "by hand")
    assert "the chains disagree" in apart.problems[0]


@pytest.mark.parallel
@pytest.mark.parametrize("kind", ["metropolis", "prior_metropolis", "emcee"])
def test_chains_are_kept_and_prolonged(kind, tmp_path_factory, monkeypatch):
    """Stopped in the burn-in, in the draws, and not converged: the chains of a single run."""
    comm = MPI.COMM_WORLD
    folder = comm.bcast(tmp_path_factory.mktemp("chains") if comm.rank == 0 else None)
    posterior, file = Posterior(prior(), linear, gaussian()), folder / "chains.nc"
    # Writings fall on the same steps, so that the random numbers do.
    monkeypatch.setattr(samplers, "CHUNK", 50)
    monkeypatch.setattr(samplers, "EVERY", 0.0)
    walkers = 8 if kind == "emcee" else 1
    short, long = (Settings(kind, n * walkers, 100 * walkers, 3) for n in (200, 300))

    def stop_at(share):
        def told(done):
            if done >= share:
                raise KeyboardInterrupt

        return told

    for share in (0.25, 0.5):  # of what is left: within the burn-in, and within the draws
        with pytest.raises(KeyboardInterrupt):
            sample(posterior, short, comm, keep=file, told=stop_at(share))
    begun = sample(posterior, short, comm, keep=file)
    assert begun.info["steps"] == 200 and not begun.converged
    again = sample(posterior, short, comm, keep=file)
    assert again.info["steps"] == 300 and again.info["burn_in"] == 100
    alone = sample(posterior, long)
    np.testing.assert_array_equal(begun.values, again.values[:, : begun.values.shape[1]])
    np.testing.assert_allclose(again.values, alone.values, rtol=1e-9)


@pytest.mark.parallel
def test_chains_of_another_task_are_refused(tmp_path_factory):
    """And it is said what differs."""
    comm = MPI.COMM_WORLD
    folder = comm.bcast(tmp_path_factory.mktemp("chains") if comm.rank == 0 else None)
    file, settings = folder / "chains.nc", Settings(samples=60, burn_in=20)
    sample(Posterior(prior(), linear, gaussian()), settings, comm, keep=file)

    def shifted(values):
        return linear(values) + 1e-3

    for posterior, words in (
        (Posterior(prior(), linear, gaussian(1e-5)), "chains with other data"),
        (Posterior(prior(0.4), linear, gaussian()), "chains with another prior"),
        (Posterior(prior(), shifted, gaussian()), "chains with another model"),
    ):
        with pytest.raises(InputError, match=words):
            sample(posterior, settings, comm, keep=file)
    with pytest.raises(InputError, match="seed = 1, not 2"):
        sample(Posterior(prior(), linear, gaussian()), Settings(seed=2), comm, keep=file)
    other = prior()
    one = PriorDensity(other.parameters[:1], other.densities[:1], LogScale("a", NoLaws()))
    posterior = Posterior(one, lambda v: np.log(v) @ SLOPE[:, :1].T, gaussian(-np.log(100)))
    with pytest.raises(InputError, match="holds chains of a, b; expected a"):
        sample(posterior, settings, comm, keep=file)


def test_file_is_arviz(tmp_path):
    import arviz

    file = tmp_path / "chains.nc"
    posterior, settings = Posterior(prior(), linear, gaussian()), Settings(samples=900, burn_in=300)
    found = sample(posterior, settings, keep=file)
    tree = arviz.from_netcdf(str(file))
    np.testing.assert_array_equal(tree["posterior"]["a"].values, found.values[:, :, 0])
    file.write_text("nothing")
    with pytest.raises(InputError, match="not a file of chains"):
        sample(posterior, settings, keep=file)
