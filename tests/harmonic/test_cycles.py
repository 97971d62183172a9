"""Hysteresis of harmonic balance against time integration and closed forms, wherever it starts."""

import numpy as np
import pytest
from oscillators import oscillator

from fenics_joints.harmonic import Balance, solve_harmonic
from fenics_joints.interfaces import InterfaceModel, InterfacePoints
from fenics_joints.joint_laws import (
    BoucWen,
    CoulombStick,
    ElasticFriction,
    Iwan,
    RichardAbbott,
    Segalman,
    Valanis,
)

BAND = (0.12, 0.3)


def integrated(hz, force=0.15, strength=0.2, damping=0.03, steps=4000, periods=30):
    """First harmonic of a unit mass on a unit spring and Jenkins' element: Runge and Kutta."""
    h, load = 1 / hz / steps, force * np.cos(np.pi * np.arange(2 * steps + 1) / steps)
    x = v = z = 0.0

    def rate(x, v, f):
        return v, f - damping * v - x - min(max(x - z, -strength), strength)

    path = np.empty(steps)
    for _ in range(periods):
        for i in range(steps):
            a = rate(x, v, load[2 * i])
            b = rate(x + h / 2 * a[0], v + h / 2 * a[1], load[2 * i + 1])
            c = rate(x + h / 2 * b[0], v + h / 2 * b[1], load[2 * i + 1])
            d = rate(x + h * c[0], v + h * c[1], load[2 * i + 2])
            x += h / 6 * (a[0] + 2 * b[0] + 2 * c[0] + d[0])
            v += h / 6 * (a[1] + 2 * b[1] + 2 * c[1] + d[1])
            z = min(max(z, x - strength), x + strength)
            path[i] = x
    turn = 2j * np.pi * (np.arange(steps) + 1) / steps
    return abs(2 / steps * path @ np.exp(turn))


def test_peak_of_jenkins_is_that_of_time_integration():
    """The same up and down, at any number of samples; the peak's frequency and amplitude."""
    model = oscillator(ElasticFriction(1.0, 0.2), 0.03)
    peaks = [
        solve_harmonic(
            model, "push", 0.15, BAND, harmonics=15, direction=direction, samples=samples
        ).peak
        for direction, samples in (("up", None), ("down", None), ("up", 512), ("down", 512))
    ]
    hz, amplitude = peaks[0].frequency_hz, peaks[0].amplitude
    assert hz == pytest.approx(0.19251, abs=1e-5)
    for peak in peaks:
        assert peak.frequency_hz == pytest.approx(hz, rel=1e-7)
        assert peak.amplitude == pytest.approx(amplitude, rel=1e-8)
    assert amplitude == pytest.approx(integrated(hz), rel=2e-5)


@pytest.mark.parametrize(
    "law, normal, samples",
    [
        (Iwan(RichardAbbott(1.0, 0.05, 0.2, 1.5)), False, None),
        (Iwan(Segalman(0.3, 1.0, -0.5, 0.2)), False, None),
        (BoucWen(1.0, 0.1, 2.0, 1.0), False, 512),  # whose own steps are of second order
        (Valanis(1.0, 0.1, 4.0), False, 512),
        (CoulombStick(5.0, 1.0, 0.2, 1.0), True, None),
    ],
    ids=["richard_abbott", "segalman", "bouc_wen", "valanis", "coulomb"],
)
def test_peak_does_not_depend_on_the_direction_of_the_sweep(law, normal, samples):
    """At a flat top the amplitude says more than the frequency."""
    if not normal:
        model = oscillator(law, 0.03)
    else:  # a mass that is pressed on a spring beside
        one, rows = np.ones((1, 1)), np.array([[[0.0], [1.0]]])
        joint = InterfacePoints("joint", law, rows, np.ones(1), normal=True)
        model = InterfaceModel(
            one, one, (joint,), 0.03 * one, {"push": one[0]}, {"mass": one[0]}
        )
    up, down = (
        solve_harmonic(
            model, "push", 0.15, BAND, harmonics=5, samples=samples, direction=d
        ).peak
        for d in ("up", "down")
    )
    assert up.frequency_hz == pytest.approx(down.frequency_hz, rel=1e-5)
    assert up.amplitude == pytest.approx(down.amplitude, rel=1e-6)


def test_loop_of_jenkins_has_its_area_and_a_sticking_one_none():
    """4 S (a - S / k) of Jenkins' loop, whatever the phase; exactly zero where nothing slides."""
    k, strength, a = 1.0, 0.2, 0.47
    balance = Balance(oscillator(ElasticFriction(k, strength), 0.0), 5)
    for phase in np.linspace(0, 2 * np.pi / 128, 7):
        X = np.zeros((1, 11))
        X[0, 1:3] = a * np.cos(phase), a * np.sin(phase)
        made = balance.stresses(X)["joint"]
        F = made.coefficients[0, 0]
        energy = np.pi * (F[2] * X[0, 1] - F[1] * X[0, 2])
        assert abs(energy) == pytest.approx(4 * strength * (a - strength / k), rel=1e-7)
    stuck = solve_harmonic(
        oscillator(ElasticFriction(k, 1e6), 0.03), "push", 0.15, at=[0.2, 0.22], harmonics=5
    )
    assert not stuck.dissipation()["joint"].any()


def test_dissipation_of_segalmans_law_is_a_power_of_the_amplitude():
    """D is as a^(3 + chi) where the sliders are: Segalman, J. Appl. Mech. 72, 2005."""
    curve = Segalman(1.0, 1.0, -0.5, 0.2)
    law = Iwan(curve, 48, amplitudes=(1e-4 * curve.reference, 0.1 * curve.reference))
    balance = Balance(oscillator(law, 0.0), 3)
    a, made = curve.reference * np.geomspace(2e-4, 0.05, 25), []
    for size in a:
        X = np.zeros((1, 7))
        X[0, 1] = size
        made.append(np.pi * size * balance.stresses(X)["joint"].coefficients[0, 0, 2])
    made = np.abs(made)
    assert np.allclose(made, curve.dissipation(a), rtol=0.05)
    assert np.polyfit(np.log(a), np.log(made), 1)[0] == pytest.approx(2.5, abs=0.02)
