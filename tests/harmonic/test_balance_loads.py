"""Several loads at once: superposition where all is linear, and the energy they put in."""

import numpy as np
import pytest
from oscillators import BAND, SLIDE, STICK, TURN, Cubic, Jenkins, oscillator, start_of

from fenics_joints.errors import InputError
from fenics_joints.harmonic import Load, solve_harmonic
from fenics_joints.interfaces import InterfaceModel, InterfacePoints
from fenics_joints.transient import solve_transient, steady_harmonics

MORE = (Load("push", 0.3, 3, 0.4), Load("push", 0.1, 1, -1.1))


def test_loads_of_harmonics_and_phases_superpose():
    """The receptance at each harmonic times its load."""
    linear = oscillator(Cubic(k=0.0), 0.1)
    found = solve_harmonic(linear, "push", 0.2, at=[0.2], more=MORE)
    omega, c = found.omegas[0], found.sensor_coefficients("mass")[0]
    for h, force in ((1, 0.2 + 0.1 * np.exp(-1.1j)), (3, 0.3 * np.exp(0.4j))):
        x = force / (1 + 0.1j * h * omega - (h * omega) ** 2)
        assert c[2 * h - 1] - 1j * c[2 * h] == pytest.approx(x, rel=1e-9)
    with pytest.raises(InputError, match="load.harmonic = 7"):
        solve_harmonic(linear, "push", 0.2, at=[0.2], more=[Load("push", 1.0, 7)])


def test_what_loads_put_in_friction_and_damping_take():
    """Along a branch with sliding."""
    model = oscillator(Jenkins(k=STICK, s=SLIDE), 0.05)
    found = solve_harmonic(model, "push", 0.2, BAND, more=MORE)
    i, h = found.peak.index, np.arange(1, 6)
    X = found.coefficients[i, 0]
    viscous = 0.05 * found.omegas[i] * np.pi * (h**2 @ (X[1::2] ** 2 + X[2::2] ** 2))
    taken = found.dissipation([i])["joint"][0] + viscous
    assert found.force_work()[i] == pytest.approx(taken, rel=1e-6)


def test_loads_that_grow_with_the_frequency_follow_their_branch():
    """An unbalance on Duffing's spring, by one harmonic in closed form, through the fold."""
    m, c = 0.05, 0.05
    found = solve_harmonic(
        oscillator(Cubic(k=1.0), c), "push", m, BAND, power=2, harmonics=1, direction="up"
    )
    a, w2 = found.amplitude(), found.omegas**2
    left = ((1 - w2 + 0.75 * a**2) ** 2 + c**2 * w2) * a**2
    assert np.allclose(left, (m * w2) ** 2, rtol=1e-7)
    assert (np.diff(found.omegas) < 0).any()
    work = np.pi * c * found.omegas * a**2
    assert np.allclose(found.force_work(), work, rtol=1e-7)
    # Of a higher harmonic too, as of a base that moves so.
    linear = oscillator(Cubic(k=0.0), c)
    two = solve_harmonic(linear, "push", 0.1, at=[0.2], more=[Load("push", 0.3, 3, 0.4, 2)])
    omega, x = 3 * two.omegas[0], two.sensor_coefficients("mass")[0][5:7] @ [1, -1j]
    exact = 0.3 * omega**2 * np.exp(0.4j) / (1 + 1j * c * omega - omega**2)
    assert x == pytest.approx(exact, rel=1e-9)


def test_two_places_with_a_phase_between_them_are_those_of_time_integration():
    """Two masses on cubic springs, pushed a quarter of a cycle apart, the second at twice it."""
    one = np.eye(2)
    spring = InterfacePoints("spring", Cubic(k=0.4), one[0].reshape(1, 1, 2), np.ones(1))
    K = np.array([[2.0, -1.0], [-1.0, 2.0]])
    model = InterfaceModel(
        one, K, (spring,), 0.1 * K, {"a": one[0], "b": one[1]}, {"a": one[0], "b": one[1]}
    )
    w = 0.8
    more = [Load("b", 0.5, 1, np.pi / 2), Load("b", 0.4, 2, 0.3)]
    found = solve_harmonic(model, "a", 0.5, at=[w / TURN], harmonics=7, more=more)
    loads = {
        "a": lambda t: 0.5 * np.cos(w * t),
        "b": lambda t: 0.5 * np.cos(w * t + np.pi / 2) + 0.4 * np.cos(2 * w * t + 0.3),
    }
    # From the motion found, so that it is steady soon; what is off in it is left behind.
    start = (*np.split(start_of(found.coefficients[0], w), 2), None)
    run = solve_transient(model, step=TURN / w / 400, n_steps=400 * 9, loads=loads, initial=start)
    for place in ("a", "b"):
        steady = steady_harmonics(run.times, run.displacements[place], w / TURN, 3)
        c = found.sensor_coefficients(place)[0][:7]
        assert np.abs(c - steady).max() < 1e-3 * np.abs(steady).max()
