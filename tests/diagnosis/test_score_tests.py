"""Tests of zones and attribution: level, power, a published example, and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from by_hand import Function
from scipy.stats import binom, kstest, multivariate_normal, ncx2

from fenics_joints.diagnosis.effects.joint import interfaces
from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.thresholds import STEP
from fenics_joints.diagnosis.where.score_tests import Place, attribution, holm, score_tests, shares
from fenics_joints.diagnosis.where.zone_sensitivity import compliant_joints, zone_sensitivities
from fenics_joints.diagnosis.zones.zone import Zone

TORQUES = np.array([5.0, 10.0, 20.0, 30.0])
N_MODES = 5
DRAWS = 500


def evidence_of(log_f=None, **kwargs) -> Evidence:
    """Four torques, five modes an octave or less apart, one frequency missing."""
    if log_f is None:
        log_f = np.log(np.tile([100.0, 150.0, 260.0, 420.0, 1000.0], (4, 1)))
        log_f[2, 3] = np.nan
    return Evidence(TORQUES, log_f, np.full(log_f.shape, 0.004), 0.01, **kwargs)


def setting(seed: int = 3):
    """Evidence, sensitivities of four zones of one to three parameters, nuisances."""
    rng = np.random.default_rng(seed)
    evidence = evidence_of()
    n = evidence.data.size
    sizes = {"a": 1, "b": 2, "c": 3, "d": 2}
    zones = {name: 0.03 * rng.standard_normal((n, k)) for name, k in sizes.items()}
    nuisance = 0.02 * rng.standard_normal((n, 2))
    return evidence, zones, nuisance, rng


def zone_tests(r, zones, nuisance, evidence):
    """Tests of zones by name."""
    places = [Place(name, name, "", S) for name, S in zones.items()]
    return score_tests(r, places, nuisance, evidence)


def draws(evidence, nuisance, rng, n: int = DRAWS) -> np.ndarray:
    """Residuals of noise, discrepancy and nuisances alone, from the sums that make them."""
    lower = np.linalg.cholesky(evidence.full_covariance())
    noise = rng.standard_normal((n, evidence.data.size)) @ lower.T
    return noise + rng.standard_normal((n, nuisance.shape[1])) @ nuisance.T


def test_false_alarms_keep_their_level_and_statistics_are_chi_square():
    """Under H0 p is uniform for every zone; any zone significant by Holm in at most 5 %."""
    evidence, zones, nuisance, rng = setting()
    alarms, p, rest_p = 0, [], []
    for r in draws(evidence, nuisance, rng):
        tests = zone_tests(r, zones, nuisance, evidence)
        alarms += any(t.p_adjusted < 0.05 for t in tests)
        p.append([t.p for t in tests])
        rest_p.append(tests[2].rest_p)
    assert alarms <= binom.ppf(0.999, DRAWS, 0.05)
    assert kstest(rest_p, "uniform").pvalue > 1e-3
    for zone in range(4):
        single = np.sum(np.array(p)[:, zone] < 0.05)
        assert binom.ppf(0.001, DRAWS, 0.05) <= single <= binom.ppf(0.999, DRAWS, 0.05)
        assert kstest(np.array(p)[:, zone], "uniform").pvalue > 1e-3


def test_statistic_and_evidence_are_those_of_the_covariance():
    """Rao's statistic from the score and Fisher's information; and the ratio of two densities of
    the normal distribution, with the place's changes in the covariance and without them."""
    evidence, zones, nuisance, rng = setting()
    r = draws(evidence, nuisance, rng, 1)[0] + zones["b"] @ [1.0, -0.5]
    used = evidence.fitted
    C = evidence.covariance() + nuisance[used] @ nuisance[used].T
    for test in zone_tests(r, zones, nuisance, evidence):
        S = zones[test.zone][used]
        score, fisher = S.T @ np.linalg.solve(C, r[used]), S.T @ np.linalg.solve(C, S)
        assert test.statistic == pytest.approx(score @ np.linalg.solve(fisher, score), rel=1e-8)
        with_it = multivariate_normal.logpdf(r[used], cov=C + S @ S.T)
        gain = with_it - multivariate_normal.logpdf(r[used], cov=C)
        assert test.log_evidence == pytest.approx(gain, rel=1e-6, abs=1e-8)
        covariance = np.linalg.inv(np.eye(S.shape[1]) + fisher)
        assert test.change == pytest.approx(covariance @ score, rel=1e-8)
        assert test.change_sd == pytest.approx(np.sqrt(np.diag(covariance)), rel=1e-8)


def test_shares_split_the_misfit():
    """Made by two zones, it goes to these, the larger first; all and the rest make one."""
    evidence, zones, nuisance, rng = setting()
    r = zones["b"] @ [9.0, -6.0] + zones["d"] @ [3.0, 2.0] + draws(evidence, nuisance, rng, 1)[0]
    found = shares(r, [Place(n, n, "", S) for n, S in zones.items()], nuisance, evidence)
    assert [row.region for row in found[:2]] == ["b", "d"] and found[-1].region == "unexplained"
    assert sum(row.share for row in found) == pytest.approx(1.0)
    assert found[0].share + found[1].share > 0.9 and all(row.share >= 0 for row in found)


def test_power_for_a_known_zone():
    """The share of alarms is that of the non-central chi-square with S~ change's length."""
    evidence, zones, nuisance, rng = setting()
    change = np.array([0.12, -0.1])
    p = [
        zone_tests(r + zones["b"] @ change, zones, nuisance, evidence)[1].p
        for r in draws(evidence, nuisance, rng)
    ]
    used = evidence.fitted
    C = evidence.covariance() + nuisance[used] @ nuisance[used].T
    signal = (zones["b"] @ change)[used]
    power = ncx2.sf(5.991465, 2, signal @ np.linalg.solve(C, signal))
    assert 0.2 < power < 0.95
    low, high = binom.ppf([0.001, 0.999], DRAWS, power)
    assert low <= np.sum(np.array(p) < 0.05) <= high


def test_turned_and_doubled_columns_change_nothing():
    """A zone is its columns' span; two parameters that do the same are one degree of freedom."""
    evidence, zones, nuisance, rng = setting()
    r = draws(evidence, nuisance, rng, 1)[0] + zones["c"] @ [1.0, 1.0, 0.0]
    first = zone_tests(r, zones, nuisance, evidence)
    turn, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    same = {
        "a": 1e3 * zones["a"],
        "b": zones["b"] @ [[3.0, 1.0], [0.0, 1.0]],
        "d": zones["d"],
        "c": np.hstack([zones["c"] @ turn, zones["c"] @ [[1.0], [2.0], [0.5]]]),
    }
    other = {t.zone: t for t in zone_tests(r, same, nuisance, evidence)}
    for t in first:
        assert other[t.zone].dof == t.dof
        assert other[t.zone].statistic == pytest.approx(t.statistic, rel=1e-9)
    nearly = zones | {"b": zones["b"][:, [0, 0]] + 1e-5 * zones["b"]}
    test = zone_tests(r, nearly, nuisance, evidence)[1]
    assert test.dof == 1 and test.change[0] == pytest.approx(test.change[1], abs=1e-3)


def test_the_change_that_was_made_is_found():
    """Without noise it is the mean, but for what the prior takes off, and the zone explains all."""
    evidence, zones, nuisance, _ = setting()
    test = zone_tests(zones["c"] @ [0.5, -2.0, 1.0], zones, nuisance, evidence)[2]
    assert test.change == pytest.approx((0.5, -2.0, 1.0), rel=0.2, abs=0.1)
    assert test.share == pytest.approx(1.0) and test.rest_p == pytest.approx(1.0)


def test_a_place_that_is_not_seen_costs_the_others_nothing():
    evidence, zones, _, rng = setting()
    r = 0.01 * rng.standard_normal(evidence.data.size)
    found = zone_tests(r, zones | {"faint": 1e-7 * zones["c"]}, None, evidence)
    faint = found[-1]
    assert (faint.dof, faint.p, faint.p_adjusted, faint.significant) == (0, 1.0, 1.0, False)
    smallest = min(found, key=lambda t: t.p)
    assert smallest.p_adjusted == pytest.approx(min(1.0, 4 * smallest.p))


def test_holm_by_hand():
    """The usual textbook example, p = .01, .04, .03, .005: in order .005 * 4, .01 * 3, .03 * 2,
    and .04 * 1 raised to the .06 before it; rejected at 5 %: the first and the last."""
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.9, 0.8]) == pytest.approx([1.0, 1.0])
    # By weights .01 / 2, .01 / 1 and .04 / 1, times 4, 2 and 1.
    assert holm([0.01, 0.04, 0.01], [2, 1, 1]) == pytest.approx([0.02, 0.04, 0.02])
    assert len(holm([])) == 0


@pytest.mark.parametrize("by", ["mode", "band", "condition", "kind"])
def test_attribution_is_an_exact_split(by):
    """The sums are r^T C^-1 r, and the first k groups are the same without the others."""
    rng = np.random.default_rng(11)
    log_f = evidence_of().log_f
    shapes = rng.standard_normal((6, N_MODES))
    shapes[2, 1] = np.nan
    evidence = evidence_of(
        log_f,
        log_damping=np.log(np.full(log_f.shape, 0.003)),
        damping_scatter=0.2,
        shapes=shapes,
        near=0.5 * np.eye(6) + 0.5,
    )
    nuisance = 0.02 * rng.standard_normal((evidence.data.size, 3))
    r = 0.02 * rng.standard_normal(evidence.data.size)
    parts = attribution(r, evidence, by, nuisance=nuisance)
    used = evidence.fitted
    C = evidence.covariance() + nuisance[used] @ nuisance[used].T
    assert sum(part.chi2 for part in parts) == pytest.approx(r[used] @ np.linalg.solve(C, r[used]))
    assert sum(part.expected for part in parts) == used.sum()
    e = evidence.entries
    first = {
        "mode": e.mode < 2,
        "condition": e.row < 2,
        "kind": e.kind < 2,
        "band": np.exp(np.nanmean(log_f, axis=0))[e.mode] < 400.0,
    }[by]
    keep = first[used]
    alone = r[used][keep] @ np.linalg.solve(C[np.ix_(keep, keep)], r[used][keep])
    assert sum(part.chi2 for part in parts[:2]) == pytest.approx(alone)


def test_attribution_names_what_was_put_in():
    """A residual in one mode at one torque is that mode's and that torque's; octaves are named."""
    evidence = evidence_of()
    r = np.zeros((4, N_MODES))
    r[0, 4] = 0.1
    by_mode = attribution(r.ravel(), evidence, names=["first", "2", "3", "4", "last"])
    assert by_mode[-1].label == "last" and by_mode[-1].p < 1e-6
    assert [part.chi2 for part in by_mode[:-1]] == pytest.approx([0.0] * 4)
    by_torque = attribution(r.ravel(), evidence, "condition")
    assert by_torque[0].label == "5" and by_torque[0].p < 1e-6
    labels = [part.label for part in attribution(r.ravel(), evidence, "band")]
    assert labels == ["100 to 200 Hz", "200 to 400 Hz", "400 to 800 Hz", "800 to 1600 Hz"]


def by_differences(log_f, names) -> Function:
    """A forward model of ln f with its derivatives."""

    def forward(values):
        slope = []
        for n in names:
            up, down = (log_f(values | {n: values[n] * (1 + d)}) for d in (1e-6, -1e-6))
            slope.append((up - down) / (2e-6 * values[n]))
        return log_f(values), np.array(slope).T

    return Function(forward, names)


def test_zone_sensitivities_are_changes_of_the_prediction():
    """A bar of a part, a bonded layer and a spring in series: f by hand from the flexibilities."""
    h, area = 1e-3, 1e-4
    baseline = {"bar.E": 70e9, "bar.rho": 2700.0, "bar.nu": 0.3, "layer.E": 1e11, "layer.G": 4e10}

    def log_f(values):
        rho = values["bar.rho"]
        one = 0.1 / (values["bar.E"] * area) + h / (values["layer.E"] * area)
        two = 0.3 / (values["bar.E"] * area) + h / (values["layer.G"] * area)
        return -0.5 * np.log([one * rho, two * rho])

    evidence = Evidence(TORQUES, np.tile(log_f(baseline), (4, 1)), np.full((4, 2), 0.003), 0.005)
    zones = zone_sensitivities(
        by_differences(log_f, list(baseline)),
        evidence,
        baseline,
        ["bar", "layer"],
        interfaces=interfaces([Zone("layer", thickness=h)], baseline),
        by_torque=True,
    )
    assert zones["bar"].shape == (8, 2) and zones["layer"].shape == (8, 4)
    share = (0.1 / 70e9) / (0.1 / 70e9 + h / 1e11)
    assert zones["bar"][0] == pytest.approx([0.15 * 0.5 * share, -0.05], rel=1e-5)
    softer = log_f(baseline | {"layer.E": 1 / (1e-11 + 1 / (1e12 * h))}) - log_f(baseline)
    x = np.log(TORQUES) - np.log(TORQUES).mean()
    assert zones["layer"][0::2, 0] == pytest.approx(np.full(4, softer[0]), rel=1e-9)
    assert zones["layer"][0::2, 1] == pytest.approx(0.5 * x * softer[0], rel=1e-9)
    assert zones["layer"][1::2, 0] == pytest.approx(np.zeros(4), abs=1e-12)
    assert np.all(zones["layer"][1::2, 2] < -1e-4)


def test_zones_of_joints_share_what_the_joints_do_together():
    """Two layers in series, of which one holds both modes and one the first only: their parts sum
    to the change by both, and the first mode's is split as their compliances, 1 to 3."""
    h, baseline = 1e-3, dict.fromkeys(("one.E", "one.G", "two.E", "two.G"), 1e11)

    def log_f(values):
        own = 1e-12 + h / values["one.E"]
        return -0.5 * np.log([own + 3 * h / values["two.E"], own])

    evidence = Evidence(np.ones(1), log_f(baseline)[None], np.full((1, 2), 0.003), 0.005)
    zones = zone_sensitivities(
        by_differences(log_f, list(baseline)),
        evidence,
        baseline,
        ["one", "two"],
        interfaces=interfaces([Zone(name, thickness=h) for name in ("one", "two")], baseline),
    )
    soft = 1 / (1 / 1e11 + 1 / (1e12 * h))
    both = log_f(baseline | {"one.E": soft, "two.E": soft}) - log_f(baseline)
    assert zones["one"][:, 0] + zones["two"][:, 0] == pytest.approx(both, rel=1e-9)
    assert zones["two"][0, 0] == pytest.approx(3 * zones["one"][0, 0], rel=1e-4)
    assert zones["two"][1, 0] == pytest.approx(0.0, abs=1e-9)
    assert zones["one"][:, 1] == pytest.approx(np.zeros(2), abs=1e-9)


def test_a_thin_layer_keeps_a_positive_stiffness_where_differences_are_taken():
    """On either side of little compliance beside a film of 6 um, which is bonded."""
    effect = compliant_joints("film", ["film"], {"film": {"E": 1e7}}, "E")
    for root in 1e-3 + np.array([-STEP, STEP]):
        values = {"film.E": 1e16}
        effect.apply(values, {"root": root}, 1.0)
        assert 0 < values["film.E"] < 1e16
