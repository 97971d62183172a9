"""The error that all modes share because joints are as one in a model, in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.predictions import PointwiseForward, model_of
from fenics_joints.diagnosis.model.bonded import joint_errors

#: What compliance across and along two joints takes off ln f of three modes, in m / Pa.
ACROSS, ALONG = np.array([[3.0, 1.0, 0.2], [0.1, 2.0, 0.4]]) * 1e10
BONDED, EXPECTED = 1e16, 1e12


class Softened(PointwiseForward):
    """ln f that falls in proportion to the joints' compliance."""

    def __init__(self):
        self.model = model_of(("a.E", "a.G", "b.E", "b.G"))
        self.baseline = dict.fromkeys(self.model.parameters, BONDED)

    def __call__(self, values):
        way = np.array([ACROSS, ALONG, ACROSS, ALONG])
        k = np.array([values[name] for name in self.model.parameters])
        return 5.0 - (1 / k - 1 / BONDED) @ way, (way / k[:, None] ** 2).T


def test_joints_that_give_way_a_little_are_within_what_is_stated():
    """Each way moves frequencies by half of what is stated, in its own ratios; a covariance with
    both finds that a test of such joints is likely, and as likely as before what is unlike it."""
    forward = Softened()
    interfaces = {name: {"E": EXPECTED, "G": EXPECTED} for name in "ab"}
    evidence = Evidence(np.array([1.0, 2.0]), np.full((2, 3), 5.0), np.full((2, 3), 1e-3), 0.02)
    change, shapes = joint_errors(forward, evidence, forward.baseline, interfaces)
    assert shapes is None
    for column, way in zip(change.T, (ACROSS, ALONG), strict=True):
        assert column == pytest.approx(-0.01 * way / np.sqrt(np.mean(way**2)), rel=1e-5)
    wider = replace(evidence, joint_f=change)
    both = np.tile(change, (2, 1))
    assert wider.covariance() - evidence.covariance() == pytest.approx(both @ both.T, abs=1e-15)
    soft = 4 * both[:, 0]
    unlike = np.cross(*change.T)
    unlike = np.tile(0.04 * unlike / np.linalg.norm(unlike), 2)
    gains = [
        multivariate_normal.logpdf(off, cov=wider.covariance())
        - multivariate_normal.logpdf(off, cov=evidence.covariance())
        for off in (soft, unlike)
    ]
    assert gains[0] > gains[1] + 1.0


def test_what_moves_no_frequency_is_no_error():
    """A joint that the modes do not strain, and none."""
    forward = Softened()
    forward.baseline["idle.E"] = BONDED
    evidence = Evidence(np.array([1.0]), np.full((1, 3), 5.0), np.full((1, 3), 1e-3), 0.02)
    assert joint_errors(forward, evidence, forward.baseline, {}) is None
    assert joint_errors(forward, evidence, forward.baseline, {"idle": {"E": EXPECTED}}) is None
