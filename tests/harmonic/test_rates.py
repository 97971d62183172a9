"""Laws with the rate of strain, against closed forms, finite differences and time integration."""

import numpy as np
import pytest
from oscillators import oscillator

from fenics_joints.harmonic import Balance, solve_harmonic
from fenics_joints.joint_laws import RateDamping
from fenics_joints.transient import solve_transient, steady_harmonics

BOTH = RateDamping(c1=0.1, c3=0.2, strength=0.3, smoothing=0.5)


def test_energy_of_cubic_damping_is_the_closed_form():
    """3 pi c3 w^3 a^4 / 4 in a cycle, and pi c1 w a^2 of the viscous part."""
    a, omega, c1, c3 = 0.7, 1.3, 0.1, 0.4
    balance = Balance(oscillator(RateDamping(c1, c3), 0.0), 3)
    X = np.zeros(balance.shape)
    X[0, 1] = a
    F = balance.interface_force(X, omega)[0][0]
    energy = -np.pi * a * F[2]
    expected = np.pi * c1 * omega * a**2 + 0.75 * np.pi * c3 * omega**3 * a**4
    assert energy == pytest.approx(expected, rel=1e-12)
    # sin^3 = (3 sin - sin 3) / 4.
    assert F[6] == pytest.approx(c3 * (omega * a) ** 3 / 4, rel=1e-12)


def test_jacobians_by_motion_and_frequency():
    """Against central differences."""
    balance = Balance(oscillator(BOTH, 0.05), 4)
    X, omega, h = np.random.default_rng(0).standard_normal(balance.shape), 1.1, 1e-6

    def residual(X, omega):
        return balance.evaluate(X, omega, jacobian=False)[0].ravel()

    J = balance.evaluate(X, omega)[1]
    for i, e in enumerate(np.eye(balance.size)):
        e = h * e.reshape(balance.shape)
        slope = (residual(X + e, omega) - residual(X - e, omega)) / (2 * h)
        assert np.allclose(J[:, i], slope, atol=1e-7)
    slope = (residual(X, omega + h) - residual(X, omega - h)) / (2 * h)
    assert np.allclose(balance.by_omega(X, omega).ravel(), slope, atol=1e-7)


def test_response_is_that_of_time_integration():
    """Viscous, cubic and smoothed friction together, off resonance and at it; and its energy."""
    model, frequency = oscillator(BOTH, 0.02), 1 / (2 * np.pi)
    result = solve_harmonic(model, "push", 1.0, at=[frequency], harmonics=9)
    run = solve_transient(
        model, step=2 * np.pi / 400, n_steps=400 * 12,
        loads={"push": lambda t: np.cos(t)},
    )  # fmt: skip
    steady = steady_harmonics(run.times, run.displacements["mass"], frequency, 3)
    found = result.sensor_coefficients("mass")[0]
    assert np.abs(found[:7] - steady).max() < 1e-3 * np.abs(steady).max()
    viscous = 0.02 * np.pi * (np.arange(1, 10) ** 2 @ (found[1::2] ** 2 + found[2::2] ** 2))
    taken = result.dissipation()["joint"][0]
    assert taken + viscous == pytest.approx(result.force_work()[0], rel=1e-6)
    last = run.joint_work["joint"]
    assert last[-1] - last[-401] == pytest.approx(taken, rel=2e-3)
