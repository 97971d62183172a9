"""A Gaussian process with known hyperparameters is scikit-learn's."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI
from sklearn.gaussian_process import GaussianProcessRegressor, kernels

from fenics_joints.database.process import JITTER, Process

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="about one process")


@pytest.mark.parametrize("trend", ["constant", "linear"])
@pytest.mark.parametrize("kernel", ["gaussian", "matern 5/2"])
@pytest.mark.parametrize("inputs", [1, 3])
def test_mean_deviation_and_covariance_are_those_of_scikit_learn(kernel, trend, inputs):
    random = np.random.default_rng(7)
    z, asked = random.normal(size=(9, inputs)), random.normal(size=(20, inputs))
    y = 3 + np.sin(z).sum(axis=1)
    lengths = random.uniform(0.5, 2, inputs)
    same = kernels.RBF(lengths) if kernel == "gaussian" else kernels.Matern(lengths, nu=2.5)
    same = 1.7 * same
    if trend == "linear":
        same += 0.3 * kernels.DotProduct(0.8)
    same += kernels.WhiteKernel(1e-3)
    other = GaussianProcessRegressor(same, alpha=JITTER, optimizer=None, normalize_y=True).fit(z, y)
    own = Process(kernel, trend, same.theta, z, y)
    np.testing.assert_allclose(own.predict(asked), other.predict(asked, return_std=True), rtol=1e-9)
    np.testing.assert_allclose(own.covariance, same(z), rtol=1e-12)


def test_hyperparameters_of_something_else_are_refused():
    z = np.arange(6.0)[:, None]
    with pytest.raises(ValueError, match="3 hyperparameters of 1 inputs, linear trend"):
        Process("gaussian", "linear", [0.0, 0.0, -5.0], z, z[:, 0])
