"""Floquet multipliers, bifurcations and the branches that leave there, by integration in time."""

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
from shooting import later, shot_multipliers

from fenics_joints.errors import InputError
from fenics_joints.harmonic import (
    find_bifurcations,
    floquet_multipliers,
    hill_multipliers,
    solve_harmonic,
    switch_branch,
)
from fenics_joints.joint_laws import CubicSpring, ElasticFriction


@pytest.fixture(scope="module")
def folded():
    """Duffing's branch with its two folds."""
    result = solve_harmonic(duffing(), "push", 0.05, BAND, harmonics=7)
    return result, find_bifurcations(result)


UEDA = oscillator(CubicSpring(0.0, 1.0), 0.1)


@pytest.fixture(scope="module")
def symmetric():
    """Ueda's Duffing oscillator in its second superharmonic range."""
    result = solve_harmonic(UEDA, "push", 2.0, (0.7 / TURN, 1.2 / TURN), harmonics=15)
    return result, find_bifurcations(result).bifurcations


@pytest.fixture(scope="module")
def escaping():
    """Thompson's escape from a well (1989)."""
    result = solve_harmonic(
        escape(), "push", 0.06, (0.65 / TURN, 0.9 / TURN), harmonics=11, direction="down"
    )
    return result, find_bifurcations(result).bifurcations


def test_multipliers_of_duffing_are_those_of_hill(folded):
    """Between the folds, where one is outside."""
    result, _ = folded
    i = int(np.flatnonzero(np.diff(np.sign(np.diff(result.omegas)))).mean())
    X, omega = result.coefficients[i], result.omegas[i]
    expected = hill_multipliers(result.balance, X, omega)
    values = floquet_multipliers(result.balance, X, omega)
    assert values[0] > 1.1
    assert np.sort(values.real) == pytest.approx(np.sort(expected.real), rel=1e-3)


def test_duffings_folds_are_found_and_classified(folded):
    """Where the tangent turns, a multiplier passes 1."""
    result, found = folded
    by_hill = find_bifurcations(result, method="hill")
    for each in (found, by_hill):
        assert [b.kind for b in each.bifurcations] == ["fold", "fold"]
    for b in found.bifurcations:
        assert abs(b.multiplier - 1) < 5e-3
    assert np.array_equal(found.stable, by_hill.stable)


def test_multipliers_with_a_slider_are_those_of_its_equations_of_motion():
    """Against finite differences of a period by an ODE solver, sliding and sticking exactly."""
    k, s, push, omega = 1.0, 0.2, 0.4, 1.0
    result = solve_harmonic(
        oscillator(ElasticFriction(k, s), VISCOUS),
        "push",
        push,
        at=[omega / TURN],
        harmonics=21,
        samples=2048,
    )

    def flow(t, y):
        x, v, z = y
        pull = k * (x - z)
        slides = abs(pull) >= s and pull * v > 0
        return [v, push * np.cos(omega * t) - VISCOUS * v - x - np.clip(pull, -s, s), v * slides]

    def end(y):
        made = solve_ivp(flow, (0, TURN / omega), y, rtol=1e-9, atol=1e-11, max_step=5e-3)
        return made.y[:, -1]

    X = result.coefficients[0]
    z = result.balance.stresses(X, omega)["joint"].state[0, 0, 0]
    y = np.append(start_of(X, omega), z)
    assert end(y) == pytest.approx(y, abs=0.02)
    J = np.column_stack([(end(y + d) - end(y - d)) / 2e-4 for d in 1e-4 * np.eye(3)])
    expected = np.linalg.eigvals(J)
    expected = expected[np.argsort(-np.abs(expected))]
    values = floquet_multipliers(result.balance, X, omega, steps=4096)
    assert np.abs(values[:2] - expected[:2]).max() < 3e-3


def test_hills_multipliers_with_linearised_sliders_are_near_those_of_shooting():
    """Beside a slider that slides, a few percent off."""
    result = solve_harmonic(jenkins(), "push", 0.2, at=[0.14, 0.17], harmonics=9)
    for X, omega in zip(result.coefficients, result.omegas, strict=True):
        hill = hill_multipliers(result.balance, X, omega)
        shot = floquet_multipliers(result.balance, X, omega)
        assert abs(hill[0]) == pytest.approx(abs(shot[0]), abs=0.1)


def multipliers_at(found, model, push):
    """By shooting."""
    omega = TURN * found.frequency_hz
    return shot_multipliers(model, push, omega, start_of(found.coefficients, omega))


def test_symmetry_breaks_where_shooting_says(symmetric):
    """+1, without a fold."""
    _, found = symmetric
    assert [b.kind for b in found] == ["branch point", "branch point"]
    for b in found:
        assert np.abs(multipliers_at(b, UEDA, 2.0) - 1).min() < 2e-3


def test_a_period_doubles_where_shooting_says(escaping):
    """-1, before the motion leaves the well."""
    _, (found,) = escaping
    assert found.kind == "period doubling"
    assert np.abs(multipliers_at(found, escape(), 0.06) + 1).min() < 2e-3


def test_a_torus_is_born_where_shooting_says():
    """The nonlinear absorber of Detroux et al. 2015: a pair leaves the unit circle and returns."""
    model = absorber()
    result = solve_harmonic(model, "push", 0.12, (1.05 / TURN, 1.23 / TURN), harmonics=5)
    found = find_bifurcations(result).bifurcations
    assert [b.kind for b in found] == ["Neimark-Sacker", "Neimark-Sacker"]
    for b in found:
        values = multipliers_at(b, model, 0.12)
        pair = values[np.argmax(np.abs(values.imag) * (np.abs(values) > 0.9))]
        assert abs(pair) == pytest.approx(1, abs=2e-3) and abs(pair.imag) > 0.1


def state_of(result, i):
    return start_of(result.coefficients[i], result.omegas[i], result.balance.fourier.periods)


def test_motions_of_broken_symmetry_attract(symmetric):
    """Both sides leave the symmetric branch, mirror images, and end at its other branch point."""
    result, (first, second) = symmetric
    ends = []
    for side in (1, -1):
        branch = switch_branch(result, first, side=side)
        assert branch.frequencies_hz[-1] == pytest.approx(second.frequency_hz, rel=5e-3)
        i = int(np.argmax(np.abs(branch.coefficients[:, 0, 0])))
        omega, state = branch.omegas[i], state_of(branch, i)
        assert np.abs(floquet_multipliers(branch.balance, branch.coefficients[i], omega)[0]) < 1
        found = later(UEDA, 2.0, omega, 1.02 * state, 40)
        assert found == pytest.approx(state, abs=2e-3)
        ends.append(branch.coefficients[i, 0, 0])
    assert ends[0] * ends[1] < 0 and min(np.abs(ends)) > 0.15


def test_a_doubled_period_attracts_and_doubles_again(escaping):
    """A motion of two periods of the force, and then of four."""
    result, (at,) = escaping
    branch = switch_branch(result, at)
    stability = find_bifurcations(branch)
    i = int(np.argmin(np.abs(stability.multipliers)))
    omega, state = branch.omegas[i], state_of(branch, i)
    assert branch.balance.fourier.periods == 2 and omega < TURN * at.frequency_hz
    assert np.abs(later(escape(), 0.06, omega, state) - state).max() > 0.05
    assert later(escape(), 0.06, omega, state, 2) == pytest.approx(state, abs=1e-6)
    assert later(escape(), 0.06, omega, 1.001 * state, 40) == pytest.approx(state, abs=1e-6)
    # The force's first harmonic is the amplitude; work and losses of a period of the force agree.
    h = np.arange(1, branch.coefficients.shape[2] // 2 + 1) / 2
    X = branch.coefficients[i, 0]
    assert branch.amplitude()[i] == pytest.approx(np.hypot(X[3], X[4]))
    lost = 0.1 * omega * np.pi * (h**2 @ (X[1::2] ** 2 + X[2::2] ** 2))
    assert branch.force_work()[i] == pytest.approx(lost, rel=1e-6)
    (again,) = stability.bifurcations
    assert again.kind == "period doubling" and again.frequency_hz < at.frequency_hz
    four = switch_branch(branch, again)
    assert four.balance.fourier.periods == 4
    state = state_of(four, 2)
    assert later(escape(), 0.06, four.omegas[2], state, 4) == pytest.approx(state, abs=1e-4)


def test_nothing_leaves_at_a_fold(folded):
    result, found = folded
    with pytest.raises(InputError, match="expected one of: branch point, period doubling"):
        switch_branch(result, found.bifurcations[0])
