"""Least squares with a prior and bounds, against the normal equations."""

from __future__ import annotations

import numpy as np
import pytest

from fenics_joints.measurements.least_squares import LeastSquares

rng = np.random.default_rng(3)
A, y = rng.normal(size=(8, 3)), rng.normal(size=8)
CENTRE, SD = np.array([1.0, -2.0, 0.5]), np.array([0.1, 2.0, 1.0])


def held(x):
    return (x - CENTRE) / SD, np.diag(1 / SD)


class Line(LeastSquares):
    """The same as a subclass."""

    def residual(self, x):
        return np.concatenate([A @ x - y, held(x)[0]])


@pytest.mark.parametrize("jac", [None, lambda x: A, "subclass"])
def test_minimum_and_covariance_are_those_of_the_normal_equations(jac):
    fit = Line() if jac == "subclass" else LeastSquares(lambda x: A @ x - y, jac, held)
    found = fit.solve(np.zeros(3))
    information = A.T @ A + np.diag(SD**-2)
    expected = np.linalg.solve(information, A.T @ y + CENTRE / SD**2)
    np.testing.assert_allclose(found.x, expected, atol=1e-6)
    np.testing.assert_allclose(fit.covariance(found.x), np.linalg.inv(information), rtol=1e-5)


def test_bounds_hold_and_what_is_open_has_no_small_deviation():
    low = LeastSquares(lambda x: A @ x - y, bounds=(0.0, np.inf)).solve(np.ones(3)).x
    gradient = A.T @ (A @ low - y)
    assert np.all(low >= 0) and np.all(gradient > -1e-5) and abs(gradient @ low) < 1e-5
    one = LeastSquares(lambda x: np.array([x[0] + x[1] - 1.0]))
    assert np.all(np.diag(one.covariance(np.zeros(2))) > 1e10)
