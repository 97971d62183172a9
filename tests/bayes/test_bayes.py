"""Posteriors against closed forms and grids; distributions, convergence, files of chains."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI
from scipy import stats

from fenics_joints.bayes import (
    FittedLikelihood,
    GaussianLikelihood,
    Posterior,
    Prior,
    Settings,
    sample,
    samplers,
)
from fenics_joints.bayes.calibration import calibrate, rank
from fenics_joints.bayes.conflict import check_prior
from fenics_joints.bayes.densities import log_pdf
from fenics_joints.bayes.distributions import choose
from fenics_joints.bayes.predictive import check_predictive, outside
from fenics_joints.bayes.priors import density
from fenics_joints.bayes.walks import RandomWalk, generator
from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.structure.components import Parameter
from fenics_joints.updating.coordinates import LogScale

pytest.importorskip("arviz")

SLOPE = np.array([[0.3, 0.1], [0.1, 0.4], [0.2, 0.2]])
MODES = ("first", "second", "third")


class NoLaws:
    regions = ()


def prior(log_sd=0.5, **bounds):
    parameters = tuple(Parameter(name, 1.0, **bounds) for name in "ab")
    given = {"median": 1.0, "log_sd": log_sd}
    densities = tuple(density(name, "lognormal", given) for name in "ab")
    return Prior(parameters, densities, LogScale("ab", NoLaws()))


def linear(values):
    """ln f of a model that is linear in the logarithms."""
    return np.log(100.0) + np.log(values) @ SLOPE.T


def gaussian(shift=0.0):
    covariance = 1e-4 * np.array([[4.0, 2, 1], [2, 9, 3], [1, 3, 4]])
    return GaussianLikelihood(MODES, np.log(100) + SLOPE @ [0.1, -0.2] + shift, covariance)


@pytest.mark.parametrize("kind", ["metropolis", "emcee"])
def test_conjugate_posterior(kind):
    """A linear model, normal in the logarithms: mean and covariance in closed form."""
    likelihood = gaussian()
    weight = np.linalg.inv(likelihood.covariance)
    covariance = np.linalg.inv(SLOPE.T @ weight @ SLOPE + np.eye(2) / 0.25)
    mean = covariance @ SLOPE.T @ weight @ (likelihood.log_f - np.log(100))
    found = sample(
        Posterior(prior(), linear, likelihood),
        Settings(kind, 6000 if kind == "metropolis" else 10000, 2000, 4),
    )
    logs = np.log(found.draws())
    sd, n = np.sqrt(np.diag(covariance)), min(c["ess_bulk"] for c in found.convergence.values())
    assert np.all(np.abs(logs.mean(axis=0) - mean) < 4.5 * sd / np.sqrt(n))
    np.testing.assert_allclose(np.cov(logs.T), covariance, atol=0.15 * sd.max() ** 2)


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
        d.frozen.logpdf(f)
        for d, f in zip(likelihood.fitted, np.exp(model(values)).T, strict=True)
    )
    logs += stats.norm(0, 0.3).logpdf(grid).sum(axis=1)
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    mean = weights @ grid
    sd = np.sqrt(weights @ (grid - mean) ** 2)
    draws = np.log(sample(posterior, Settings(samples=6000, burn_in=2000)).draws())
    assert np.all(np.abs(draws.mean(axis=0) - mean) < 0.12 * sd)
    np.testing.assert_allclose(draws.std(axis=0), sd, rtol=0.12)


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
    narrow = points.mean(axis=1, keepdims=True) + 0.5 * (
        points - points.mean(axis=1, keepdims=True)
    )
    ranks = np.array([rank(truths[k, 0], narrow[k, :, 0], 39) for k in range(n)])
    assert calibrate(ranks, 39).p_value < 1e-3


def test_densities_in_closed_form():
    shapes = {
        "norm": (), "lognorm": (0.3,), "uniform": (), "loguniform": (0.5, 3.0), "gamma": (4.0,),
        "truncnorm": (-1.0, 2.0), "weibull_min": (8.0,), "beta": (2.0, 3.0), "gumbel_r": (),
        "gumbel_l": (), "logistic": (),
    }  # fmt: skip
    for name, args in shapes.items():
        frozen = getattr(stats, name)(*args, 1.5, 2.0)
        x = np.append(frozen.rvs(40, random_state=1), [-30.0, 0.0, 1.5, 300.0])
        closed = log_pdf(frozen)
        assert closed.__name__ == "closed"
        np.testing.assert_allclose(closed(x), frozen.logpdf(x), rtol=1e-9, atol=1e-12)
    assert log_pdf(stats.pareto(3.0))(np.array([2.0])) == stats.pareto(3.0).logpdf(2.0)


def test_distributions_of_figure_7_are_found():
    """Seed 002, Figure 7: a Weibull of shape 819 is found, and not taken for a normal."""
    x = stats.weibull_min(819.5, scale=2035.08).rvs(400, random_state=3)
    found = choose("mode 5", x, ["normal", "weibull", "gumbel"])
    shape, scale = found.frozen.args[0], found.frozen.kwds["scale"]
    assert found.family == "weibull" and found.p_value > 0.05
    # Where the likelihood is greatest, by its derivatives.
    z = x / scale
    assert np.mean(z**shape) == pytest.approx(1, abs=1e-6)
    assert 1 / shape + np.mean(np.log(z)) == pytest.approx(np.mean(z**shape * np.log(z)), abs=1e-6)
    assert scale == pytest.approx(2035.08, rel=5e-4) and shape == pytest.approx(819.5, rel=0.15)


def test_what_does_not_fit_is_refused():
    rng = np.random.default_rng(4)
    two_kinds = np.concatenate([rng.normal(100, 0.1, 20), rng.normal(110, 0.1, 20)])
    with pytest.raises(InputError, match="first: no distribution fits its 40 frequencies"):
        choose("first", two_kinds, ["normal"])
    accepted = choose("first", two_kinds, ["normal"], accept_misfit=True)
    assert accepted.doubtful and "fits badly" in accepted.words("first")
    for bad, words in (
        ([1.0, 2.0], "at least 5"), ([1.0, -2, 3, 4, 5], "positive"), ([5.0] * 9, "some scatter"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=words):
            choose("first", np.array(bad))


def test_chains_that_did_not_converge_are_not_used():
    found = sample(Posterior(prior(), linear, gaussian()), Settings(samples=120, burn_in=20))
    assert not found.converged
    with pytest.raises(ConvergenceError, match="did not converge"):
        found.draws()
    # Two maxima that chains cannot leave.
    apart = found.__class__(
        ("a",), np.repeat([[[0.0]], [[5.0]]], 2000, axis=1)
        + np.random.default_rng(0).standard_normal((2, 2000, 1)),
        np.zeros((2, 2000)), np.ones(2), "by hand",
    )  # fmt: skip
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
    one = Prior(other.parameters[:1], other.densities[:1], LogScale("a", NoLaws()))
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


def test_priors_keep_to_bounds_and_laws():
    """The Jacobian: draws of a chain without data have the prior's moments."""
    known = prior(0.5, lower=0.5, upper=3.0)
    silent = Posterior(known, linear, lambda log_f: np.zeros(len(log_f)))
    draws = sample(silent, Settings(samples=8000, burn_in=1000)).draws()
    exact = stats.truncnorm(np.log(0.5) / 0.5, np.log(3.0) / 0.5, 0, 0.5)
    assert np.log(draws).mean() == pytest.approx(exact.mean(), abs=0.03)
    assert np.log(draws).std() == pytest.approx(exact.std(), rel=0.05)
    drawn = known.values(known.sample(4000, np.random.default_rng(0)))
    assert np.log(drawn).mean() == pytest.approx(exact.mean(), abs=0.02)


@pytest.mark.parametrize(
    ("kind", "numbers", "words"),
    [
        ("nomral", {"mean": 1, "sd": 0.1}, "expected one of: normal"),
        ("normal", {"mean": 1}, "expected mean, sd"),
        ("normal", {"mean": 1, "sd": -0.1}, "finite number above 0"),
        ("normal", {"mean": 1, "sd": 0.9}, "negative values"),
        ("normal", {"mean": -5, "sd": 1}, "positive number"),
        ("uniform", {"low": 3, "high": 2}, "0 <= low < high"),
        ("lognormal", {"median": 0, "log_sd": 1}, "positive number"),
    ],
)
def test_bad_priors_are_named(kind, numbers, words):
    with pytest.raises(InputError, match=f"prior of lap.k1: .*{words}"):
        density("lap.k1", kind, numbers)


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


def test_prior_beside_its_bounds_is_named():
    far = (Parameter("a", 30.0, lower=20.0),)
    with pytest.raises(InputError, match="prior of a: has .* of its probability"):
        Prior(far, prior().densities[:1], LogScale("a", NoLaws()))


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


def test_priors_in_words():
    """Units, and the range that bounds leave."""
    given = {"mean": 2e9, "sd": 1e8}
    p = Parameter("lap.E", 2e9, unit="Pa", upper=2e9)
    (words,) = Prior((p,), (density("lap.E", "normal", given),), LogScale(["lap.E"], NoLaws())
                     ).describe()  # fmt: skip
    assert words == "lap.E: normal, 95 % in 1.78 to 2.00 GPa"
