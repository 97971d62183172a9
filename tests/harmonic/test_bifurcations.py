"""Floquet multipliers by shooting along a response, with memory too, and bifurcations."""

import numpy as np
import pytest
from oscillators import (
    BAND,
    TURN,
    VISCOUS,
    absorber,
    duffing,
    escape,
    jenkins,
    oscillator,
    start_of,
)
from scipy.integrate import solve_ivp

from fenics_joints.harmonic import (
    find_bifurcations,
    floquet_multipliers,
    hill_multipliers,
    solve_harmonic,
)
from fenics_joints.joint_laws import CubicSpring, ElasticFriction


def branch():
    return solve_harmonic(duffing(), "push", 0.05, BAND, harmonics=7)


def test_multipliers_of_duffing_are_those_of_hill():
    """Between the folds, where one is outside."""
    result = branch()
    turns = np.flatnonzero(np.diff(np.sign(np.diff(result.omegas))))
    i = int(turns.mean())
    X, omega = result.coefficients[i], result.omegas[i]
    expected = hill_multipliers(result.balance, X, omega)
    values = floquet_multipliers(result.balance, X, omega)
    assert values[0] > 1.1
    assert np.sort(values.real) == pytest.approx(np.sort(expected.real), rel=1e-3)


def test_duffings_folds_are_found_and_classified():
    """Where the tangent turns, a multiplier passes 1."""
    result = branch()
    found = find_bifurcations(result)
    assert [b.kind for b in found.bifurcations] == ["fold", "fold"]
    for b in found.bifurcations:
        assert abs(b.multiplier - 1) < 5e-3
    assert np.array_equal(found.stable, find_bifurcations(result, method="hill").stable)


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

    X = result.coefficients[0]
    z = result.balance.stresses(X, omega)["joint"].state[0, 0, 0]
    y = np.append(start_of(X, omega), z)
    assert later(y) == pytest.approx(y, abs=0.02)
    steps = np.diag([1e-4, 1e-4, 1e-4])
    J = np.column_stack([(later(y + d) - later(y - d)) / 2e-4 for d in steps])
    expected = np.linalg.eigvals(J)
    expected = expected[np.argsort(-np.abs(expected))]
    values = floquet_multipliers(result.balance, X, omega, steps=4096)
    assert np.abs(values[:2] - expected[:2]).max() < 3e-3


def test_hills_multipliers_with_linearised_sliders_are_near_those_of_shooting():
    """As many folds of the same branch; beside a slider that slides, a few percent off."""
    found = find_bifurcations(branch(), method="hill")
    assert [b.kind for b in found.bifurcations] == ["fold", "fold"]
    result = solve_harmonic(jenkins(), "push", 0.2, at=[0.14, 0.17], harmonics=9)
    for X, omega in zip(result.coefficients, result.omegas, strict=True):
        hill = hill_multipliers(result.balance, X, omega)
        shot = floquet_multipliers(result.balance, X, omega)
        assert abs(hill[0]) == pytest.approx(abs(shot[0]), abs=0.1)


def shot_multipliers(model, force, omega, state, stiffness, push):
    """Multipliers of the periodic motion near a state, by shooting with its variational equation.

    Args:
        model: Of it only M, C and K are used.
        force: Of the displacements, (n,): the nonlinear force.
        omega: rad/s.
        state: Displacements and velocities at the start of a period, (2 n,).
        stiffness: Derivative of `force`, (n, n), by the displacements.
        push: Amplitude of the force at the first mass.
    """
    n, inverse = model.n_dofs, np.linalg.inv(model.M)

    def rate(t, y):
        u, v, W = y[:n], y[n : 2 * n], y[2 * n :].reshape(2 * n, 2 * n)
        load = push * np.cos(omega * t) * np.eye(n)[0]
        a = inverse @ (load - model.C @ v - model.K @ u - force(u))
        A = np.zeros((2 * n, 2 * n))
        A[:n, n:] = np.eye(n)
        A[n:] = -inverse @ np.hstack([model.K + stiffness(u), model.C])
        return np.concatenate([v, a, (A @ W).ravel()])

    for _ in range(3):
        y = np.concatenate([state, np.eye(2 * n).ravel()])
        end = solve_ivp(rate, (0, TURN / omega), y, method="DOP853", rtol=1e-9, atol=1e-11).y[:, -1]
        W = end[2 * n :].reshape(2 * n, 2 * n)
        # The null direction of a branch point is not that of the start's error.
        state = state + np.linalg.lstsq(np.eye(2 * n) - W, end[: 2 * n] - state, rcond=1e-3)[0]
    return np.linalg.eigvals(W)


def test_symmetry_breaks_where_shooting_says():
    """Ueda's Duffing oscillator in its second superharmonic range: +1, without a fold."""
    model = oscillator(CubicSpring(0.0, 1.0), 0.1)
    result = solve_harmonic(model, "push", 2.0, (0.7 / TURN, 1.2 / TURN), harmonics=15)
    found = find_bifurcations(result).bifurcations
    assert [b.kind for b in found] == ["branch point", "branch point"]
    for b in found:
        omega = TURN * b.frequency_hz
        values = shot_multipliers(
            model,
            lambda u: u**3,
            omega,
            start_of(b.coefficients, omega),
            lambda u: np.diag(3 * u**2),
            2.0,
        )
        assert np.abs(values - 1).min() < 2e-3


def test_a_period_doubles_where_shooting_says():
    """Thompson's escape from a well (1989): -1 before the motion leaves it."""
    result = solve_harmonic(
        escape(), "push", 0.06, (0.65 / TURN, 0.9 / TURN), harmonics=11, direction="down"
    )
    (found,) = find_bifurcations(result).bifurcations
    assert found.kind == "period doubling"
    omega = TURN * found.frequency_hz
    values = shot_multipliers(
        escape(),
        lambda u: -(u**2),
        omega,
        start_of(found.coefficients, omega),
        lambda u: np.diag(-2 * u),
        0.06,
    )
    assert np.abs(values + 1).min() < 2e-3


def test_a_torus_is_born_where_shooting_says():
    """The nonlinear absorber of Detroux et al. 2015: a pair leaves the unit circle and returns."""
    model = absorber()
    result = solve_harmonic(model, "push", 0.12, (1.05 / TURN, 1.23 / TURN), harmonics=5)
    found = find_bifurcations(result).bifurcations
    assert [b.kind for b in found] == ["Neimark-Sacker", "Neimark-Sacker"]
    joints = [(p.rows[0, 0], p.law.parameters["k3"][()]) for p in model.interfaces]
    for b in found:
        omega = TURN * b.frequency_hz
        values = shot_multipliers(
            model,
            lambda u: sum(k * (r @ u) ** 3 * r for r, k in joints),
            omega,
            start_of(b.coefficients, omega),
            lambda u: sum(3 * k * (r @ u) ** 2 * np.outer(r, r) for r, k in joints),
            0.12,
        )
        pair = values[np.argmax(np.abs(values.imag) * (np.abs(values) > 0.9))]
        assert abs(pair) == pytest.approx(1, abs=2e-3) and abs(pair.imag) > 0.1
