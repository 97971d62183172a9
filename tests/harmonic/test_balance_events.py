"""Laws without memory: stops against exact motion between contacts, rates against closed forms."""

import numpy as np
import pytest
import scipy.linalg
from oscillators import oscillator, start_of
from scipy.optimize import brentq, fsolve

from fenics_joints.harmonic import Balance, solve_harmonic
from fenics_joints.interfaces import InterfaceModel, InterfacePoints
from fenics_joints.joint_laws import CubicSpring, RateDamping, UnilateralSpring
from fenics_joints.transient import solve_transient, steady_harmonics

GAP, DAMPING, PUSH = 1.0, 0.03, 0.1
BOTH = RateDamping(c1=0.1, c3=0.2, strength=0.3, smoothing=0.5)
BAND = (0.5 / (2 * np.pi), 0.8 / (2 * np.pi))


def two_masses(k):
    """NLvib's example 03: two unit masses, the first with a stop of stiffness k."""
    K = np.array([[1.0, -1.0], [-1.0, 2.0]])
    law = UnilateralSpring(k, GAP) if k else CubicSpring(0.0, 0.0)
    stop = InterfacePoints("stop", law, np.array([[[1.0, 0.0]]]), np.ones(1))
    first, second = np.eye(2)
    return InterfaceModel(
        np.eye(2), K, (stop,), DAMPING * K, {"push": second}, {"first": first, "second": second}
    )


def test_harmonics_of_a_stop_are_the_closed_form():
    """Of max(cos - cos c, 0): its mean, and its harmonics by products of cosines."""
    k, c, h = 3.0, 0.7, np.arange(2, 8)
    balance = Balance(oscillator(UnilateralSpring(stiffness=k, gap=2 * np.cos(c)), 0.1), 7)
    X = np.zeros(balance.shape)
    X[0, 1] = 2.0
    F = balance.interface_force(X)[0][0]
    mean = (np.sin(c) - c * np.cos(c)) / np.pi
    first = (c - np.sin(c) * np.cos(c)) / np.pi
    high = 2 * (np.sin(h * c) * np.cos(c) - h * np.cos(h * c) * np.sin(c))
    high /= np.pi * h * (h**2 - 1)
    expected = 2 * k * np.array([mean, first, *high])
    assert np.allclose(F[[0, *range(1, 15, 2)]], expected, rtol=0, atol=1e-9)
    assert np.abs(F[2::2]).max() < 1e-9


def test_a_touch_between_two_samples_is_seen():
    """A motion that is beyond the gap for a hundredth of a sample's step, and its Jacobian."""
    balance = Balance(oscillator(UnilateralSpring(stiffness=1.0, gap=1.0), 0.1), 2)
    step = 2 * np.pi / balance.fourier.samples
    c, X = 0.005 * step, np.zeros(balance.shape)
    X[0, 1:3] = np.array([np.cos(0.4 * step), np.sin(0.4 * step)]) / np.cos(c)
    F = balance.interface_force(X)[0][0]
    expected = (np.sin(c) - c * np.cos(c)) / (np.pi * np.cos(c))
    assert F[0] == pytest.approx(expected, rel=1e-3) and F[0] > 0


def linear_flow(k, omega):
    """State (x, v, cos, sin, 1) over time, in and out of contact, as matrices of its rate."""
    m = two_masses(k)
    found = []
    for touching in (False, True):
        K = m.K + np.diag([k * touching, 0.0])
        A = np.zeros((7, 7))
        A[:2, 2:4], A[2:4, :2], A[2:4, 2:4] = np.eye(2), -K, -m.C
        A[3, 4], A[2, 6] = PUSH, k * touching * GAP
        A[4, 5], A[5, 4] = -omega, omega
        found.append(A)
    return found


def crossing(A, state, longest):
    """When the first mass is at the stop."""
    return brentq(lambda t: (scipy.linalg.expm(t * A) @ state)[0] - GAP, 0.0, longest, xtol=1e-15)


def period_later(y, k, omega, samples=400):
    """The state a period later, exact between contacts, and the amplitude of the second mass."""
    flows = linear_flow(k, omega)
    step = 2 * np.pi / omega / samples
    steps = [scipy.linalg.expm(step * A) for A in flows]
    state, coefficient = np.concatenate([y, [1.0, 0.0, 1.0]]), 0.0
    for _ in range(samples):
        left, touching = step, bool(state[0] > GAP)
        after = steps[touching] @ state
        while (after[0] > GAP) != touching and left > 1e-13:
            t = crossing(flows[touching], state, left)
            state, left = scipy.linalg.expm(t * flows[touching]) @ state, left - t
            touching = not touching
            after = scipy.linalg.expm(left * flows[touching]) @ state
        state = after
        coefficient += state[1] * (state[4] - 1j * state[5]) * 2 / samples
    return state[:4], abs(coefficient)


def first_touch():
    """Angular frequency at which the linear motion reaches the stop."""
    linear = two_masses(0.0)

    def reach(omega):
        S = linear.K + 1j * omega * linear.C - omega**2 * linear.M
        return abs(np.linalg.solve(S, [0.0, PUSH])[0]) - GAP

    return brentq(reach, 0.63, 0.8)


@pytest.mark.parametrize("k", [1e4, pytest.param(1e8, marks=pytest.mark.slow)])
def test_stiff_stops_go_through_by_default(k):
    """With two folds, the second beyond that of a softer stop."""
    result = solve_harmonic(
        two_masses(k), "push", PUSH, BAND, harmonics=21, sensor="second", direction="down"
    )
    turns = np.flatnonzero(np.diff(np.sign(np.diff(result.omegas)))) + 1
    assert len(turns) == 2
    assert result.omegas[turns[0]] == pytest.approx(first_touch(), rel=5e-4)
    assert 0.7570 < result.omegas[turns[1]] < 0.7575  # 0.7556 at k = 100


@pytest.mark.parametrize("k", [1.0, 100.0])
def test_a_stop_with_a_gap_goes_through_with_the_folds_of_the_physics(k):
    """NLvib's example 03 with what it asks for (k = 100, H = 21), by default.

    Two folds: where the stop is first met, and where the branch gives way, which is that of
    the motion by exact steps from contact to contact.
    """
    result = solve_harmonic(
        two_masses(k), "push", PUSH, BAND, harmonics=21, sensor="second", direction="down"
    )
    turns = np.flatnonzero(np.diff(np.sign(np.diff(result.omegas)))) + 1
    assert len(turns) == 2 and len(result) < 150
    assert result.omegas[turns[0]] == pytest.approx(first_touch(), rel=5e-4)
    for i in (turns[1] - 3, turns[1], turns[1] + 3):
        omega, X = result.omegas[i], result.coefficients[i]
        start = start_of(X, omega)
        found, _, flag, words = fsolve(
            lambda y, w=omega: period_later(y, k, w)[0] - y, start, full_output=True
        )
        if i != turns[1]:
            assert flag == 1, words
        amplitude = period_later(found, k, omega)[1]
        assert result.amplitude()[i] == pytest.approx(amplitude, rel=2e-3)


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
    start = (*np.split(start_of(result.coefficients[0], 1.0), 2), None)
    run = solve_transient(
        model, step=2 * np.pi / 400, n_steps=400 * 6, loads={"push": np.cos}, initial=start
    )
    steady = steady_harmonics(run.times, run.displacements["mass"], frequency, 3)
    found = result.sensor_coefficients("mass")[0]
    assert np.abs(found[:7] - steady).max() < 1e-3 * np.abs(steady).max()
    viscous = 0.02 * np.pi * (np.arange(1, 10) ** 2 @ (found[1::2] ** 2 + found[2::2] ** 2))
    taken = result.dissipation()["joint"][0]
    assert taken + viscous == pytest.approx(result.force_work()[0], rel=1e-6)
    last = run.joint_work["joint"]
    assert last[-1] - last[-401] == pytest.approx(taken, rel=2e-3)
