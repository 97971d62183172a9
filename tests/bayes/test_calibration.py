"""Intervals hold the truth as often as they say."""

from __future__ import annotations

import numpy as np
import pytest
from linear_posterior import SLOPE, gaussian, prior

from fenics_joints.bayes import calibrate, rank
from fenics_joints.bayes.walks import RandomWalk, generator

pytest.importorskip("arviz")


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
