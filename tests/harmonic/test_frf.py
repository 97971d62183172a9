"""Responses at constant force against closed forms and time integration."""

import json
from dataclasses import replace

import numpy as np
import pytest
from oscillators import (
    BAND,
    FORCE,
    PUSH,
    SLIDE,
    STICK,
    TURN,
    VISCOUS,
    Cubic,
    Jenkins,
    block,
    duffing,
    jenkins,
    oscillator,
    start_of,
)
from scipy.optimize import brentq, fsolve, minimize_scalar
from shooting import later, motion, slider_motion, steady_run

from fenics_joints.errors import ConvergenceError
from fenics_joints.harmonic import find_bifurcations, solve_constant_response, solve_harmonic


def duffing_amplitude(omega, start):
    """Amplitude of the periodic motion through shooting, by integration to 1e-11."""
    exact = {"rtol": 1e-11, "atol": 1e-12}
    found = fsolve(lambda y: later(duffing(), FORCE, omega, y, **exact) - y, start, xtol=1e-11)
    orbit = motion(duffing(), FORCE, omega, found, dense_output=True, **exact).sol
    return np.abs(orbit(np.linspace(0, TURN / omega, 20001))[0]).max()


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
    times = TURN / omega * np.linspace(periods - 1, periods, 4000)
    x = slider_motion(lambda t: PUSH * np.cos(omega * t), times, STICK, SLIDE, VISCOUS)
    return 0.5 * np.ptp(x)


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
    loads = {"x": lambda t: 0.3 * np.cos(TURN * frequency * t), "static": lambda t: 1.0}
    pressed = replace(model, forces={**model.forces, "static": load})
    _, steady = steady_run(pressed, result, loads, periods=30, steps=300)
    for sensor in ("x", "y", "z"):
        c = result.sensor_coefficients(sensor)[0]
        assert np.abs(c[:7] - steady[sensor]).max() < 1e-3 * np.abs(steady["x"][1:]).max()


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
