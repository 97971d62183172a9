"""How much of a stated error there is: inferred, against sums of exact Gaussian evidences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from linear_forward import Linear, shift
from scipy.special import logsumexp
from scipy.stats import chi2, multivariate_normal

from fenics_joints.diagnosis.evidence import fit
from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.diagnosis.evidence.linear_fits import moved
from fenics_joints.diagnosis.evidence.scales import ERRORS, Scales

TORQUES = np.array([5.0, 10.0, 30.0])
STATED, NOISE = 0.02, 0.002


def setting(true: float):
    """A linear model of two parameters and four modes, and a test of it that it errs by so much."""
    rng = np.random.default_rng(5)
    forward = Linear(rng.standard_normal((4, 2)) * 0.05)
    own = true * rng.standard_normal(4) + NOISE * rng.standard_normal((3, 4))
    log_f = 5.0 + forward.matrix @ [0.8, -0.5] + own
    evidence = Evidence(TORQUES, log_f, np.full((3, 4), NOISE), STATED, scales=ERRORS.expected(1))
    return forward, evidence, Hypothesis((shift(0), shift(1)))


def exact(evidence: Evidence, forward: Linear) -> float:
    """ln of the evidence, summed over how much of the stated error there is."""
    slopes = np.tile(forward.matrix, (3, 1))[evidence.used.ravel()]
    logs = []
    for scales, weight in ERRORS.expected(1).tried():
        plain = replace(evidence, scales=None, discrepancy=STATED * scales.values[0])
        covariance = plain.covariance() + slopes @ slopes.T
        mean = np.full(len(slopes), 5.0)
        density = multivariate_normal(mean, covariance)
        logs.append(weight + density.logpdf(evidence.log_f[evidence.used]))
    return float(logsumexp(logs))


@pytest.mark.smoke
def test_evidence_is_summed_over_how_much_of_the_stated_error_there_is():
    """Exact where the model is linear; little is called for where it errs little, all where it errs
    by more than is stated, and that is held against the explanation."""
    found = {}
    for true in (0.2 * STATED, 3 * STATED):
        forward, evidence, hypothesis = setting(true)
        found[true] = fit(hypothesis, forward, evidence, forward.baseline)
        assert found[true].log_evidence == pytest.approx(exact(evidence, forward), abs=5e-6)
    little, much = found.values()
    least = np.exp(min(ERRORS.grids[0]) * ERRORS.spread)
    assert little.scales.values == pytest.approx((least,)) and least < 0.7
    assert much.scales.values == (1.0,) and much.scales.squares == 0.0 < little.scales.squares
    # A misfit is what all that is stated cannot explain.
    for true, got in found.items():
        _, evidence, _ = setting(true)
        covariance = replace(evidence, scales=None).covariance()
        slopes = np.tile(forward.matrix, (3, 1))
        r = evidence.data - 5.0
        square = r @ np.linalg.solve(covariance + slopes @ slopes.T, r)
        assert got.p_value == pytest.approx(chi2.sf(square, 12), abs=1e-6)
    assert much.p_value < 0.05 < little.p_value


def test_less_data_are_weighed_as_if_fitted_anew():
    """What is linear about a fit to all, with the scales that are left to the fewer data."""
    forward, evidence, hypothesis = setting(0.2 * STATED)
    whole = fit(hypothesis, forward, evidence, forward.baseline)
    fewer = evidence.without(np.arange(4) == np.array([[3]] * 3))
    near, anew = moved(whole, fewer), fit(hypothesis, forward, fewer, forward.baseline)
    assert near is not None and near.scales == anew.scales
    assert near.z == pytest.approx(anew.z, abs=1e-5)
    assert near.log_evidence == pytest.approx(exact(fewer, forward), abs=1e-6)
    assert near.log_evidence == pytest.approx(anew.log_evidence, abs=5e-6)


def test_scales_are_of_what_is_stated_and_not_of_how_close_modes_turn():
    """Octaves apart all of a shape's error scales; a hundredth apart the turn stays."""
    rng = np.random.default_rng(2)
    shapes = rng.standard_normal((6, 3))
    shapes /= np.sqrt(np.mean(shapes**2, axis=0))
    scales = Scales(ERRORS, (0.8, 0.63))
    for hertz, alike in (([100.0, 200.0, 400.0], True), ([100.0, 101.0, 400.0], False)):
        given = Evidence(
            TORQUES,
            np.log(np.tile(hertz, (3, 1))),
            np.full((3, 3), NOISE),
            STATED,
            shapes=shapes,
            shape_error=0.08,
            near=np.eye(6),
            scales=scales,
        )
        less = replace(given, scales=None, discrepancy=0.8 * STATED, shape_error=0.63 * 0.08)
        same = given.full_covariance() - less.full_covariance()
        assert np.allclose(same[:9, :9], 0.0, atol=1e-18)
        assert np.allclose(same, 0.0, atol=1e-18) == alike
        stated = replace(given, scales=None)
        turn = stated.full_covariance() - given.at(ERRORS.expected(2)).full_covariance()
        assert np.allclose(turn, 0.0, atol=1e-18)
