"""Responses at constant force against closed forms and time integration."""

import json
from dataclasses import replace

import numpy as np
import pytest
from oscillators import (
    BAND,
    CUBIC,
    DAMPING,
    FORCE,
    PUSH,
    SLIDE,
    STICK,
    VISCOUS,
    Cubic,
    Jenkins,
    block,
    duffing,
    jenkins,
    oscillator,
    start_of,
)
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, fsolve, minimize_scalar

from fenics_joints.errors import ConvergenceError
from fenics_joints.harmonic import find_bifurcations, solve_constant_response, solve_harmonic
from fenics_joints.interfaces import static_state
from fenics_joints.transient import solve_transient, steady_harmonics


def duffing_amplitude(omega, start):
    """Amplitude of the periodic motion through shooting, by integration to 1e-11."""

    def flow(state, dense=False):
        def rate(t, y):
            return [y[1], FORCE * np.cos(omega * t) - DAMPING * y[1] - y[0] - CUBIC * y[0] ** 3]

        period = 2 * np.pi / omega
        return solve_ivp(
            rate, (0, period), state, method="DOP853", rtol=1e-11, atol=1e-12, dense_output=dense
        )

    def gap(state):
        return flow(state).y[:, -1] - state

    found = fsolve(gap, start, xtol=1e-11)
    orbit = flow(found, dense=True).sol
    times = np.linspace(0, 2 * np.pi / omega, 20001)
    return np.abs(orbit(times)[0]).max()


def test_duffing_peak_is_that_of_time_integration():
    """Past the first turning point; also the amplitudes of the lower branch, and stability."""
    result = solve_harmonic(duffing(), "push", FORCE, BAND, harmonics=9, measure="peak")
    peak, omega = result.peak, 2 * np.pi * result.peak.frequency_hz

    def at(omega):
        i = int(np.argmin(np.abs(result.omegas[: peak.index + 1] - omega)))
        return duffing_amplitude(omega, start_of(result.coefficients[i], result.omegas[i]))

    assert peak.amplitude == pytest.approx(at(omega), rel=1e-5)
    assert at(0.999 * omega) < peak.amplitude
    # Two turning points; only the branch between them is unstable.
    steps = np.diff(result.omegas)
    back = np.flatnonzero(steps < 0)
    assert len(back) > 5 and np.all(np.diff(back) == 1)
    held = find_bifurcations(result).stable
    assert not held[back[2:-1]].any()
    assert held[: back[0]].all() and held[back[-1] + 3 :].all()


def test_duffing_converges_with_harmonics():
    """Every second harmonic brings more than a decade."""
    peaks = [
        solve_harmonic(duffing(), "push", FORCE, BAND, harmonics=h, measure="peak").peak.amplitude
        for h in (1, 3, 5, 11)
    ]
    errors = np.abs(np.array(peaks[:-1]) / peaks[-1] - 1)
    assert np.all(errors[1:] < 0.1 * errors[:-1])


def jenkins_amplitude(omega, periods=25):
    """Half of peak to peak once steady, sticking and sliding integrated between their events."""

    def rate(t, y, mode):
        traction = STICK * (y[0] - y[2]) if mode == 0 else mode * SLIDE
        acceleration = PUSH * np.cos(omega * t) - VISCOUS * y[1] - y[0] - traction
        return [y[1], acceleration, 0.0 if mode == 0 else y[1]]

    def event(mode):
        def sliding_begins(t, y, _):
            return SLIDE - abs(STICK * (y[0] - y[2]))

        def sliding_ends(t, y, _):
            return mode * y[1]

        made = sliding_begins if mode == 0 else sliding_ends
        made.terminal, made.direction = True, -1
        return made

    t, y, mode, end = 0.0, np.zeros(3), 0, periods * 2 * np.pi / omega
    extremes = [0.0, 0.0]
    while t < end:
        run = solve_ivp(
            rate,
            (t, end),
            y,
            method="DOP853",
            rtol=1e-10,
            atol=1e-11,
            args=(mode,),
            events=event(mode),
            dense_output=True,
        )
        late = np.linspace(max(t, end - 2 * np.pi / omega), run.t[-1], 2000)
        if run.t[-1] > end - 2 * np.pi / omega:
            x = run.sol(late)[0]
            extremes = [min(extremes[0], x.min()), max(extremes[1], x.max())]
        t, y = run.t[-1], run.y[:, -1].copy()
        mode = int(np.sign(y[0] - y[2])) if mode == 0 else 0
        if mode == 0:  # just inside, so that the next event is not this one
            y[2] = y[0] - np.sign(y[0] - y[2]) * SLIDE / STICK * (1 - 1e-12)
    return 0.5 * (extremes[1] - extremes[0])


def test_jenkins_peak_is_that_of_time_integration():
    """Within 0.1 %, with the samples of default."""
    result = solve_harmonic(jenkins(), "push", PUSH, BAND, harmonics=9, measure="peak")
    omega = 2 * np.pi * result.peak.frequency_hz
    there = jenkins_amplitude(omega)
    assert result.peak.amplitude == pytest.approx(there, rel=1e-3)
    assert max(jenkins_amplitude(f * omega) for f in (0.97, 1.03)) < 1.0005 * there


def jenkins_first_harmonic(amplitude):
    """In-phase and quadrature force of a Jenkins element in sinusoidal motion."""
    slip = SLIDE / STICK
    if amplitude <= slip:
        return STICK * amplitude, 0.0
    angle = np.arccos(1 - 2 * slip / amplitude)
    quadrature = 4 * SLIDE * (amplitude - slip) / (np.pi * amplitude)
    return STICK * amplitude / np.pi * (angle - 0.5 * np.sin(2 * angle)), quadrature


def test_jenkins_of_one_harmonic_is_the_closed_form():
    """Peak of the describing function's response, and force at constant response."""

    def force(amplitude, omega):
        elastic, friction = jenkins_first_harmonic(amplitude)
        along = (1 - omega**2) * amplitude + elastic
        return np.hypot(along, VISCOUS * omega * amplitude + friction)

    def least(amplitude):
        return minimize_scalar(lambda w: force(amplitude, w), (0.9, 1.4), tol=1e-10).fun - PUSH

    exact = brentq(least, 0.25, 2.0, xtol=1e-12)
    result = solve_harmonic(jenkins(), "push", PUSH, BAND, harmonics=1, samples=4096)
    assert result.peak.amplitude == pytest.approx(exact, rel=2e-6)
    held = solve_constant_response(jenkins(), "push", "mass", 0.5, BAND, harmonics=1, samples=4096)
    assert np.allclose(held.amplitude(), 0.5, rtol=1e-9)
    expected = [force(0.5, omega) for omega in held.omegas]
    assert np.allclose(held.force_amplitudes, expected, rtol=2e-6)


def test_jenkins_converges_with_samples():
    """The square of the step: reversals are missed by that much."""
    at, samples = [0.17], np.array([32, 64, 128, 256, 512])
    found = [
        solve_harmonic(jenkins(), "push", PUSH, at=at, harmonics=3, samples=int(n)).amplitude()[0]
        for n in (*samples, 8192)
    ]
    errors = np.abs(np.array(found[:-1]) / found[-1] - 1)
    slope = np.polyfit(np.log(samples), np.log(errors), 1)[0]
    assert -3.0 < slope < -1.6 and errors[2] < 1e-3


def test_energy_of_loops_is_the_work_of_the_force():
    """Friction and viscous damping take what the force puts in; the loops are closed."""
    result = solve_harmonic(jenkins(), "push", PUSH, BAND, samples=256)
    i = result.peak.index
    loops = result.loops(i)["joint"]
    strain, stress = loops.strain[0, :, 0], loops.stress[0, :, 0]
    # The loop's area by the polygon of its samples.
    area = 0.5 * np.sum(stress * (np.roll(strain, -1) - np.roll(strain, 1)))
    X, h = result.coefficients[i, 0], np.arange(1, 6)
    viscous = VISCOUS * result.omegas[i] * np.pi * (h**2 @ (X[1::2] ** 2 + X[2::2] ** 2))
    assert result.closure(i) < 1e-12
    assert area == pytest.approx(loops.energy, rel=1e-3)
    assert loops.energy + viscous == pytest.approx(result.force_work()[i], rel=1e-6)
    assert loops.slip_amplitude[0] == pytest.approx(result.amplitude(measure="peak")[i], rel=1e-3)


def test_preloaded_friction_is_that_of_time_integration():
    """Static harmonic, opening and sliding together, against generalised alpha in small steps."""
    model, load = block(), np.array([-1.0, 0.0, 0.0])
    frequency = 0.23
    result = solve_harmonic(
        model, "x", 0.3, at=[frequency], harmonics=9, samples=512, static=load, cycles=4
    )
    assert max(v[0] for v in result.dissipation().values()) > 0.01
    # Time integration knows forces only: the preload is brought in by the state of rest.
    pressed = replace(model, forces={**model.forces, "static": load})
    history = steady(pressed, frequency)
    for sensor in ("x", "y", "z"):
        c = result.sensor_coefficients(sensor)[0]
        scale = np.abs(history["x"][1:]).max()
        assert np.abs(c[:7] - history[sensor]).max() < 1e-3 * scale


def steady(model, frequency, periods=60, steps=300):
    u, states = static_state(model, model.forces["static"])
    omega = 2 * np.pi * frequency

    def push(t):
        return 0.3 * np.cos(omega * t)

    def rest(t):
        return 1.0

    run = solve_transient(
        model,
        step=1 / frequency / steps,
        n_steps=periods * steps,
        loads={"x": push, "static": rest},
        initial=(u, np.zeros(3), None),
    )
    return {
        key: steady_harmonics(run.times, run.displacements[key], frequency, 3)
        for key in model.sensors
    }


def test_results_for_people():
    """JSON holds what the result says."""
    result = solve_harmonic(jenkins(), "push", PUSH, BAND, harmonics=1)
    read = json.loads(json.dumps(result.to_dict()))
    assert read["peaks"][0]["frequency_hz"] == result.peak.frequency_hz
    assert np.allclose(read["sensors"]["mass"]["amplitude_m"], result.amplitude("mass"))
    assert np.allclose(
        result.frf("mass", "acceleration"), -(result.omegas**2) * result.frf("mass"), rtol=1e-12
    )


@pytest.mark.parametrize("law", [Cubic(k=0.0), Jenkins(k=STICK, s=SLIDE)], ids=["linear", "slides"])
def test_a_resonance_without_bound_is_named(law):
    """No damping at all; or a force above 4/pi of the friction, which is all that takes energy."""
    with pytest.raises(ConvergenceError, match=r"resonance at 0\.159\d* Hz has no bound"):
        solve_harmonic(oscillator(law, 0.0), "push", 0.3, BAND, harmonics=1)
    found = solve_harmonic(jenkins(), "push", 0.3, BAND, harmonics=1)
    assert found.peak.amplitude < 10
