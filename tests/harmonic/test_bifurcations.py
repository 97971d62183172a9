"""Floquet multipliers by shooting along a response, with memory too, and bifurcations."""

import numpy as np
import pytest
from oscillators import BAND, VISCOUS, duffing, oscillator
from scipy.integrate import solve_ivp

from fenics_joints.harmonic import (
    find_bifurcations,
    floquet_exponents,
    floquet_multipliers,
    solve_harmonic,
    stable,
)
from fenics_joints.joint_laws import ElasticFriction


def branch():
    return solve_harmonic(duffing(), "push", 0.05, BAND, harmonics=7)


def test_multipliers_of_duffing_are_those_of_hill():
    """Between the folds, where one is outside."""
    result = branch()
    turns = np.flatnonzero(np.diff(np.sign(np.diff(result.omegas))))
    i = int(turns.mean())
    X, omega = result.coefficients[i], result.omegas[i]
    expected = np.exp(floquet_exponents(result.balance, X, omega) * 2 * np.pi / omega)
    values = floquet_multipliers(result.balance, X, omega)
    assert values[0] > 1.1
    assert np.sort(values.real) == pytest.approx(np.sort(expected.real), rel=1e-3)


@pytest.mark.slow
def test_duffings_folds_are_found_and_classified():
    """Where the tangent turns, a multiplier passes 1."""
    result = branch()
    found = find_bifurcations(result)
    assert [b.kind for b in found.bifurcations] == ["fold", "fold"]
    for b in found.bifurcations:
        assert abs(b.multiplier - 1) < 5e-3
    assert np.array_equal(found.stable, stable(result))


def test_multipliers_with_a_slider_are_those_of_its_equations_of_motion():
    """Against finite differences of a period by an ODE solver, sliding and sticking exactly."""
    k, s, push = 1.0, 0.2, 0.4
    model = oscillator(ElasticFriction(k, s), VISCOUS)
    omega = 1.0
    result = solve_harmonic(
        model, "push", push, at=[omega / (2 * np.pi)], harmonics=21, samples=2048
    )

    def flow(t, y):
        x, v, z = y
        pull = k * (x - z)
        slides = abs(pull) >= s and pull * v > 0
        return [v, push * np.cos(omega * t) - VISCOUS * v - x - np.clip(pull, -s, s), v * slides]

    def later(y):
        made = solve_ivp(flow, (0, 2 * np.pi / omega), y, rtol=1e-9, atol=1e-11, max_step=5e-3)
        return made.y[:, -1]

    X, h = result.coefficients[0], np.arange(1, 22)
    z = result.balance.stresses(X, omega)["joint"].state[0, 0, 0]
    y = np.array([X[0, 0] + X[0, 1::2].sum(), omega * X[0, 2::2] @ h, z])
    assert later(y) == pytest.approx(y, abs=0.02)
    steps = np.diag([1e-4, 1e-4, 1e-4])
    J = np.column_stack([(later(y + d) - later(y - d)) / 2e-4 for d in steps])
    expected = np.linalg.eigvals(J)
    expected = expected[np.argsort(-np.abs(expected))]
    values = floquet_multipliers(result.balance, X, omega, steps=4096)
    assert np.abs(values[:2] - expected[:2]).max() < 3e-3
