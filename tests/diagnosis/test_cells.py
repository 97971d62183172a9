"""Evidence as a sum over cells, against closed forms and grids."""

from __future__ import annotations

import numpy as np
import pytest
from linear_forward import Linear, shift
from scipy.integrate import trapezoid
from scipy.special import logsumexp
from scipy.stats import multivariate_normal, norm

from fenics_joints.diagnosis import Prior
from fenics_joints.diagnosis.evidence import fit
from fenics_joints.diagnosis.evidence.cells import PriorCells, prior_cells, sampled_evidence, weigh
from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis

TORQUES = np.array([5.0, 10.0, 30.0])


def evidence_of(log_f, sd=0.01, discrepancy=0.01):
    log_f = np.asarray(log_f)
    return Evidence(TORQUES[: len(log_f)], log_f, np.full(log_f.shape, sd), discrepancy)


def test_a_cell_too_steep_for_round_off_is_left_out():
    """Two parallel slopes of 1e9 standard deviations have no Hessian that can be solved for."""
    data, used = np.zeros(3), np.ones(3, dtype=bool)
    slopes = np.array([np.eye(3)[:, :2], 1e9 * np.ones((3, 2))])
    zero, both = np.zeros((2, 2)), np.tile([-np.inf, np.inf], (2, 1))
    cells = PriorCells(zero, np.ones((2, 2)), np.log([0.5, 0.5]), zero, np.zeros((2, 3)), slopes)
    found = weigh(cells, data, used, np.eye(3), both).log_evidence
    by_hand = multivariate_normal.logpdf(data, cov=np.eye(3) + slopes[0] @ slopes[0].T)
    assert found[0] == pytest.approx(by_hand + np.log(0.5)) and found[1] == -np.inf


@pytest.mark.parametrize("count", [1, 2, 3])
def test_cells_are_the_prior_far_out_too(count):
    """What asks for an unexpectedly large change pays what the prior says, not what its cells'
    ends do."""
    mean, width, log_share = prior_cells([Prior(str(i), 0.0, 1.0, log=False) for i in range(count)])
    for distance in (0.0, 1.5, 3.0, 4.0):
        point = distance * np.eye(count)[0]
        density = logsumexp(log_share + norm.logpdf(point, mean, width).sum(axis=1))
        assert density == pytest.approx(norm.logpdf(point).sum(), abs=0.1 if distance < 4 else 0.5)


@pytest.mark.parametrize(
    "priors",
    [
        [Prior("a", 0.0, 1.0, log=False)],
        [Prior("a", 0.0, 1.0, log=False), Prior("b", 2.0, 0.5)],
        [Prior("a", 0.0, 1.0, log=False, scan=41)],
        [Prior("a", 0.0, 1.0, log=False, scan=41), Prior("b", 2.0, 0.5)],
    ],
)
def test_cells_together_are_the_prior(priors):
    """Their shares sum to one, their mixture has its mean and covariance."""
    mean, width, log_share = prior_cells(priors)
    share = np.exp(log_share)
    assert share.sum() == pytest.approx(1.0, abs=1e-5)
    middle = share @ mean
    assert middle == pytest.approx(np.zeros(len(priors)), abs=0.1)
    second = np.einsum("n,np,nq->pq", share, mean, mean) + np.diag(share @ width**2)
    assert second == pytest.approx(np.eye(len(priors)), abs=0.2)


@pytest.mark.parametrize("narrow", [1.0, 1e-3])
def test_one_parameter_is_enough(narrow):
    """As of a wrong modulus: the closed form, however sharp the test is against the prior."""
    rng = np.random.default_rng(4)
    forward = Linear(rng.standard_normal((4, 2)) * 0.05)
    log_f = 5.0 + 0.03 * narrow * rng.standard_normal((3, 4)) + forward.matrix @ [0.9, 0.0]
    evidence = evidence_of(log_f, sd=0.01 * narrow, discrepancy=0.01 * narrow)
    hypothesis = Hypothesis((shift(0, 0.8),), (shift(1, 0.6 * narrow),))
    found = fit(hypothesis, forward, evidence, forward.baseline)
    J = np.tile(forward.matrix, (3, 1)) * [0.8, 0.6 * narrow]
    covariance = evidence.covariance() + J @ J.T
    exact = multivariate_normal(np.full(12, 5.0), covariance).logpdf(log_f.ravel())
    assert found.log_evidence == pytest.approx(exact, abs=1e-3)
    gain = J.T @ np.linalg.solve(covariance, log_f.ravel() - 5.0)
    own = hypothesis.own
    sd = np.sqrt(np.diag(found.covariance))[own]
    assert found.z[own] == pytest.approx(gain[:1], abs=0.02 * sd[0])


@pytest.mark.parametrize("limit", [np.inf, 0.5])
def test_two_modes_and_a_bend_against_a_grid(limit):
    """p0^2 is what the data see: two bent modes on both sides, or limits of a prior that no
    prediction reaches the data within: there what is bent has a residual that it acts on."""
    forward = Linear([[0.0, 0.05], [0.0, 0.0]], bend=[0.05, 0.04])
    span = (-limit, limit)
    effects = (shift(0, 1.0, span=span), shift(1, 1.0))
    evidence = evidence_of([[5.02, 5.03]], sd=0.004, discrepancy=0.003)
    found = fit(Hypothesis(effects), forward, evidence, forward.baseline)
    x, y = np.linspace(max(-5, -limit), min(5, limit), 1201), np.linspace(-5, 5, 801)
    X, Y = np.meshgrid(x, y, indexing="ij")
    predicted = np.stack([5 + 0.05 * Y + 0.05 * X**2, 5 + 0.04 * X**2], axis=-1)
    density = multivariate_normal(evidence.data, evidence.covariance()).pdf(predicted)
    density *= norm.pdf(X) * norm.pdf(Y) / (2 * norm.cdf(min(limit, 5)) - 1)
    exact = np.log(trapezoid(trapezoid(density, y), x))
    assert found.log_evidence == pytest.approx(exact, abs=0.1 if limit > 5 else 0.25)
    if limit > 5:
        moment = np.log(trapezoid(trapezoid(density * X**2, y), x)) - exact
        assert found.covariance[0, 0] == pytest.approx(np.exp(moment), rel=0.15)


@pytest.mark.parametrize("size", [0.0, 0.4, 2.0])
def test_limits_of_a_prior_cut_off_what_is_beyond(size):
    """Linear between limits: inside, at one and far beyond one, as many of a grid."""
    forward = Linear([[0.05], [0.04]])
    effect = shift(0, 1.0, span=(-0.5, 0.5))
    evidence = evidence_of(5.0 + size * forward.matrix.T, sd=0.004, discrepancy=0.002)
    x = np.linspace(-0.5, 0.5, 2001)
    density = multivariate_normal(evidence.data, evidence.covariance())
    values = density.logpdf(5.0 + np.outer(x, forward.matrix[:, 0])) + norm.logpdf(x)
    exact = np.log(trapezoid(np.exp(values - values.max()), x)) + values.max()
    exact -= np.log(norm.cdf(0.5) - norm.cdf(-0.5))
    found = fit(Hypothesis((effect,)), forward, evidence, forward.baseline)
    assert found.log_evidence == pytest.approx(exact, abs=0.01)
    assert abs(found.z[0]) <= 0.5 and (found.at_bound != ()) is (size > 1)


def test_evidence_of_a_banana_with_a_nuisance_is_that_of_a_grid():
    """Three parameters; all torques have the same data, so that two numbers say all."""
    forward = Linear([[0.0, 0.05, 0.03], [0.0, 0.0, 0.02]], bend=[0.05, 0.04])
    both = np.array([5.02, 5.03])
    evidence = evidence_of([both] * 3, sd=0.004, discrepancy=0.003)
    hypothesis = Hypothesis((shift(0), shift(1)), (shift(2, 0.3),))
    found = fit(hypothesis, forward, evidence, forward.baseline)
    same = np.tile(np.eye(2), (3, 1))
    precision = same.T @ np.linalg.solve(evidence.covariance(), same)
    x, y = np.linspace(-5, 5, 501), np.linspace(-5, 5, 81)
    prior = norm.pdf(x)[:, None] * norm.pdf(y)

    def over_two(bent):
        p = np.stack(np.broadcast_arrays(bent, x[:, None], 0.3 * y), axis=-1)
        left = 5.0 + p @ forward.matrix.T + forward.bend * bent**2 - both
        density = prior * np.exp(-0.5 * np.sum(left @ precision * left, axis=-1))
        return trapezoid(trapezoid(density, y), x)

    exact = np.log(trapezoid([norm.pdf(bent) * over_two(bent) for bent in x], x))
    exact += multivariate_normal(cov=evidence.covariance()).logpdf(np.zeros(6))
    assert found.log_evidence == pytest.approx(exact, abs=0.2)


@pytest.mark.parametrize(
    ("mean", "variances", "bias"), [((0.0, 0.5), (0.8, 1.5), 0.08), ((0.8, 0.6), (0.2, 0.3), 0.15)]
)
def test_sampled_evidence_of_a_banana(mean, variances, bias):
    """From one Gaussian that fits it badly, or that misses half of it, against a grid."""
    x, y = np.linspace(-6, 6, 1201), np.linspace(-20, 20, 2001)

    def log_density(x, y):
        return norm.logpdf(x) + norm.logpdf(y - x**2, scale=0.5)

    grid = np.exp(log_density(x[:, None], y[None] + 0.3))
    exact = np.log(trapezoid(trapezoid(grid, y), x))
    found = [
        sampled_evidence(
            np.array([mean]),
            np.diag(variances)[None],
            np.ones(1),
            lambda z, _: log_density(*(z + [0.0, 0.3]).T),
            seed,
        )
        for seed in range(20)
    ]
    assert np.mean(found) == pytest.approx(exact, abs=bias)
    assert np.std(found) < 0.16
