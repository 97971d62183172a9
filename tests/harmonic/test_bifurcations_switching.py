"""Branches of broken symmetry and of twice the period, against time integration."""

import numpy as np
import pytest
from oscillators import TURN, duffing, escape, oscillator, start_of
from scipy.integrate import solve_ivp

from fenics_joints.errors import InputError
from fenics_joints.harmonic import find_bifurcations, solve_harmonic, switch_branch
from fenics_joints.joint_laws import CubicSpring


def state_of(result, i):
    return start_of(result.coefficients[i], result.omegas[i], result.balance.fourier.periods)


def later(result, i, state, spring, damping, push, periods):
    """The state some periods of the force later, by time integration."""
    omega = result.omegas[i]

    def rate(t, y):
        return [y[1], push * np.cos(omega * t) - damping * y[1] - y[0] - spring(y[0])]

    end = periods * TURN / omega
    return solve_ivp(rate, (0, end), state, method="DOP853", rtol=1e-9, atol=1e-10).y[:, -1]


def test_motions_of_broken_symmetry_attract():
    """Both sides leave the symmetric branch, mirror images, and end at its other branch point."""
    model = oscillator(CubicSpring(0.0, 1.0), 0.1)
    result = solve_harmonic(model, "push", 2.0, (0.7 / TURN, 1.2 / TURN), harmonics=15)
    first, second = find_bifurcations(result).bifurcations
    ends = []
    for side in (1, -1):
        branch = switch_branch(result, first, side=side)
        assert branch.frequencies_hz[-1] == pytest.approx(second.frequency_hz, rel=5e-3)
        i = int(np.argmax(np.abs(branch.coefficients[:, 0, 0])))
        assert find_bifurcations(branch).stable[i]
        state = state_of(branch, i)
        found = later(branch, i, 1.02 * state, lambda x: x**3, 0.1, 2.0, 40)
        assert found == pytest.approx(state, abs=2e-3)
        ends.append(branch.coefficients[i, 0, 0])
    assert ends[0] * ends[1] < 0 and min(np.abs(ends)) > 0.15


def test_a_doubled_period_attracts_and_doubles_again():
    """Thompson's escape: a motion of two periods of the force, and then of four."""
    result = solve_harmonic(
        escape(), "push", 0.06, (0.65 / TURN, 0.9 / TURN), harmonics=11, direction="down"
    )
    (at,) = find_bifurcations(result).bifurcations
    branch = switch_branch(result, at)
    stability = find_bifurcations(branch)
    i = int(np.argmin(np.abs(stability.multipliers)))
    assert branch.balance.fourier.periods == 2 and branch.omegas[i] < TURN * at.frequency_hz
    state = state_of(branch, i)
    once, twice, many = (
        later(branch, i, factor * state, lambda x: -(x**2), 0.1, 0.06, n)
        for n, factor in ((1, 1.0), (2, 1.0), (40, 1.001))
    )
    assert np.abs(once - state).max() > 0.05
    assert twice == pytest.approx(state, abs=1e-6)
    assert many == pytest.approx(state, abs=1e-6)
    # The force's first harmonic is the amplitude; work and losses of a period of the force agree.
    h = np.arange(1, branch.coefficients.shape[2] // 2 + 1) / 2
    X = branch.coefficients[i, 0]
    assert branch.amplitude()[i] == pytest.approx(np.hypot(X[3], X[4]))
    lost = 0.1 * branch.omegas[i] * np.pi * (h**2 @ (X[1::2] ** 2 + X[2::2] ** 2))
    assert branch.force_work()[i] == pytest.approx(lost, rel=1e-6)
    (again,) = stability.bifurcations
    assert again.kind == "period doubling" and again.frequency_hz < at.frequency_hz
    four = switch_branch(branch, again)
    assert four.balance.fourier.periods == 4
    state = state_of(four, 2)
    assert later(four, 2, state, lambda x: -(x**2), 0.1, 0.06, 4) == pytest.approx(state, abs=1e-4)


def test_nothing_leaves_at_a_fold():
    result = solve_harmonic(duffing(), "push", 0.05, (0.15, 0.3), harmonics=3)
    fold = find_bifurcations(result).bifurcations[0]
    with pytest.raises(InputError, match="expected one of: branch point, period doubling"):
        switch_branch(result, fold)
