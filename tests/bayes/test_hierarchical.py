"""Scatter of specimens and lack of knowledge, told apart; what independent frequencies hide."""

from __future__ import annotations

import numpy as np
import pytest
from linear_posterior import prior
from mpi4py import MPI
from scipy import stats

from fenics_joints.bayes import (
    FittedLikelihood,
    Gibbs,
    Level,
    Posterior,
    Settings,
    Specimens,
    calibrate,
    check_predictive,
    rank,
    replicate,
    sample,
    sample_hierarchy,
)
from fenics_joints.bayes.gibbs import Straight, curvature
from fenics_joints.bayes.simulated import Truth, anchored, simulate
from fenics_joints.bayes.walks import generator
from fenics_joints.errors import InputError

pytest.importorskip("arviz")

MODES = tuple("12345")
#: Of the bolted beams, nearly: the first and fourth frequency feel the second parameter alone.
SLOPE = np.array([[0.0, 0.12], [0.01, 0.05], [0.015, 0.04], [0.01, 0.08], [0.04, 0.02]])
TRUTH = Truth(np.array([1.02, 0.97]), np.diag([0.03, 0.04]) ** 2, 2e-4)


def model(values):
    """ln f, with a little curvature."""
    logs = np.log(values)
    return np.log([158.0, 443, 861, 1383, 2046]) + logs @ SLOPE.T - 0.5 * logs**2 @ SLOPE.T


PRIOR = prior(0.2)


@pytest.fixture(scope="module")
def specimens():
    return simulate(model, TRUTH, 25, seed=1)


@pytest.fixture(scope="module")
def hierarchy(specimens):
    data = Specimens(MODES, specimens, noise=3e-4)
    return sample_hierarchy(data, PRIOR, model, Settings(samples=2500, burn_in=500))


def test_scatter_and_mean_are_recovered(hierarchy):
    rows = {row["name"]: row for row in hierarchy.chains.require_converged().table()}
    truth = {"a": 1.02, "b": 0.97, "scatter a": 0.03, "scatter b": 0.04}
    truth |= {"noise": 2e-4, "correlation a, b": 0.0}
    for name, value in truth.items():
        assert abs(rows[name]["mean"] - value) < 3.3 * rows[name]["sd"], name
    # The mean of n specimens is known to their scatter over the root of n, and no better.
    for name in "ab":
        assert rows[name]["sd"] == pytest.approx(rows[f"scatter {name}"]["mean"] / 5, rel=0.2)


def test_new_specimens_correlate_as_the_measured_ones_do(hierarchy, specimens):
    """The product of fitted distributions under-states both scatter and correlation."""
    check = check_predictive(MODES, specimens, hierarchy.replicate(model))
    assert 0.025 < check.p_correlation < 0.975 and 0.025 < check.p_sd < 0.975
    likelihood = FittedLikelihood.from_specimens(MODES, specimens)
    found = sample(Posterior(PRIOR, model, likelihood), Settings(samples=8000, burn_in=2000))
    theirs = check_predictive(MODES, specimens, replicate(found, model, 25))
    assert theirs.p_sd < 0.025 and "under-stated" in theirs.words()[0]
    assert theirs.mean_correlation[1] < check.mean_correlation[1]
    # Nor is their posterior the knowledge of the mean, which 25 specimens make five times better.
    theirs_sd, ours = found.draws()[:, 1].std(), hierarchy.chains.by_name()["b"].std()
    assert theirs_sd > 1.8 * ours


def test_intervals_of_the_two_levels_hold_the_truth():
    """Simulation-based calibration: truths from the priors, all sets of data in one walk."""
    rng, n, S = np.random.default_rng(12), 80, 6
    sd, scatter, noise, off = 0.2, 0.03, 2e-3, 5e-2
    slope = np.array([[0.3, 0.1], [0.1, 0.4], [0.2, 0.2]])

    def g(x):
        return x @ slope.T - 0.5 * x**2 @ slope.T + 0.02 * x[:, [0, 1, 0]] * x[:, [0, 1, 1]]

    mu = rng.normal(0, sd, (n, 2))
    aux = stats.invgamma(0.5, scale=1 / scatter**2).rvs((n, 2), random_state=rng)
    sigma = np.array([stats.invwishart(3, 4 * np.diag(1 / a)).rvs(random_state=rng) for a in aux])
    tau = np.abs(stats.cauchy(0, noise).rvs(n, random_state=rng))
    b = rng.normal(0, off, (n, 3))
    x = mu[:, None] + np.einsum(
        "npq,nsq->nsp", np.linalg.cholesky(sigma), rng.standard_normal((n, S, 2))
    )
    data = g(x.reshape(-1, 2)).reshape(n, S, 3) + b[:, None]
    data += tau[:, None, None] * rng.standard_normal(data.shape)
    two, wide = np.zeros(2), np.full(2, sd)
    bend = curvature(g, two)

    def log_prior(m):
        return -0.5 * np.sum(m**2, axis=1) / sd**2

    level = Level(
        log_prior, g, two, slope, np.zeros(3), two, wide, scatter, noise, False, off, bend
    )
    walk = Gibbs(level, data, [generator(1, c) for c in range(n)])
    walk.advance(150)
    points, _, _ = walk.advance(500)
    truths = np.column_stack([mu, sigma[:, 0, 0], sigma[:, 0, 1], sigma[:, 1, 1], tau, b])
    p_values = []
    for i, truth in enumerate(truths.T):
        ranks = np.array([rank(truth[k], points[k, :, i], 39) for k in range(n)])
        p_values.append(calibrate(ranks, 39).p_value)
    # Nine tests at once.
    assert min(p_values) > 0.002


def test_steps_in_straight_coordinates():
    """Equal steps of u change a model that is straight in u alike; volumes by differences."""
    rng, centre = np.random.default_rng(5), np.array([0.2, -0.1])
    bend = -np.array([[[1.0, 0.1], [0.1, 0.2]], [[0.3, 0.0], [0.0, 0.8]]])
    straight = Straight(centre, bend)

    def g(x):
        return straight(x) @ np.array([[0.3, 0.1, 0.2], [0.1, 0.4, 0.2]])

    # W H with W a generalised inverse of the slope finds the bend again.
    slope = np.array([[0.3, 0.1], [0.1, 0.4], [0.2, 0.2]])
    found = np.einsum("pm,mij->pij", np.linalg.pinv(slope), curvature(g, centre))
    np.testing.assert_allclose(found, bend, atol=1e-6)
    x, step = centre + 0.1 * rng.standard_normal((6, 2)), np.array([0.08, -0.05])
    there, volume, good = straight.moved(x, step)
    assert good.all() and np.ptp(g(there) - g(x), axis=0).max() < 1e-12
    for k in range(6):
        columns = [
            (straight.moved(x[k] + e, step)[0] - straight.moved(x[k] - e, step)[0]) / 2e-6
            for e in 1e-6 * np.eye(2)
        ]
        assert volume[k] == pytest.approx(np.log(np.linalg.det(columns)), abs=1e-6)
    # Beyond the fold there is nothing.
    assert not straight.moved(x, np.array([5.0, 0.0]))[2].any()


@pytest.mark.parallel
def test_two_levels_on_ranks(specimens, tmp_path_factory):
    """Also with a discrepancy of the model, and gaps; kept and read again."""
    comm = MPI.COMM_WORLD
    folder = comm.bcast(tmp_path_factory.mktemp("levels") if comm.rank == 0 else None)
    table = specimens.copy()
    table[3, 1] = np.nan
    data = Specimens(MODES, table, noise=3e-4, discrepancy=1e-3)
    settings = Settings(samples=120, burn_in=40, chains=3)
    found = sample_hierarchy(data, PRIOR, model, settings, comm, keep=folder / "levels.nc")
    alone = sample_hierarchy(data, PRIOR, model, settings)
    np.testing.assert_allclose(found.chains.values, alone.chains.values, rtol=1e-6, atol=1e-12)
    # Kept, read again, and prolonged, since so few have not converged.
    again = sample_hierarchy(data, PRIOR, model, settings, comm, keep=folder / "levels.nc")
    np.testing.assert_array_equal(again.chains.values[:, :80], found.chains.values)
    assert again.chains.values.shape[1] == 160
    assert len(found.chains.names) == 2 + 2 + 1 + 1 + 5


def test_anchored_truth_scatters_as_stated():
    truth = anchored(SLOPE, [1.0, 1.0], 0, 0.00395, noise=2e-4)
    f = simulate(model, truth, 20000, seed=2)
    assert (f[:, 0].std() / f[:, 0].mean()) == pytest.approx(0.00395, rel=0.03)
    with pytest.raises(InputError, match="more than the noise"):
        anchored(SLOPE, [1.0, 1.0], 0, 1e-4, noise=2e-4)


@pytest.mark.parametrize(
    ("change", "given", "words"),
    [
        (lambda table: table[:4], {}, "4 specimens: expected at least 5"),
        (lambda table: table * [1, 1, -1, 1, 1], {}, "3: a specimen's frequency is -"),
        (lambda table: table, {"noise": 0.0}, "noise = 0"),
        (lambda table: table[:, :4], {}, "5 columns"),
    ],
)
def test_bad_specimens_are_named(specimens, change, given, words):
    with pytest.raises(InputError, match=words):
        Specimens(MODES, change(specimens), **given)
