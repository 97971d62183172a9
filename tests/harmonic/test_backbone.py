"""Nonlinear modes against closed forms, and against responses at their peak."""

from dataclasses import replace

import numpy as np
import pytest
import ufl
from oscillators import BAND, CUBIC, DAMPING, PUSH, duffing, jenkins, oscillator
from scipy.optimize import brentq
from scipy.special import ellipk

from fenics_joints.harmonic import solve_backbone, solve_constant_response, solve_harmonic
from fenics_joints.interfaces import InterfaceModel
from fenics_joints.joint_laws import Iwan, JointLaw, Segalman


def exact_omega(a):
    """Of Duffing's free motion, by elliptic integral."""
    modulus = CUBIC * a**2 / (2 * (1 + CUBIC * a**2))
    return np.pi * np.sqrt(1 + CUBIC * a**2) / (2 * ellipk(modulus))


def test_duffing_mode_is_the_closed_form():
    """The exact period; mass-proportional damping does not bend it."""
    result = solve_backbone(duffing(), (0.01, 2.0), harmonics=11)
    exact = exact_omega(result.amplitude(measure="peak"))
    assert np.allclose(2 * np.pi * result.frequencies_hz, exact, rtol=1e-8)
    # c = 2 zeta omega, the whole of the damping.
    assert np.allclose(result.damping_ratios, DAMPING / (2 * exact), rtol=1e-7)
    one = solve_backbone(duffing(), (0.01, 2.0), harmonics=1)
    closed = np.sqrt(1 + 0.75 * CUBIC * one.amplitude() ** 2)
    assert np.allclose(2 * np.pi * one.frequencies_hz, closed, rtol=1e-9)


def test_a_frequency_that_grows_a_hundredfold_needs_no_settings():
    """To amplitudes at which the cubic spring is 10,000 times the linear one."""
    result = solve_backbone(duffing(), (1e-3, 100.0), harmonics=15)
    exact = exact_omega(result.amplitude(measure="peak"))
    assert np.allclose(2 * np.pi * result.frequencies_hz, exact, rtol=1e-7)
    assert exact[-1] > 85 and len(result) < 500 and result.end == "reached"


class Couple(JointLaw):
    def element(self, normal, slip, state, p):
        return 0, ufl.as_vector([p["k"] * ufl.sin(slip[0])]), None


def test_a_motion_that_comes_to_a_standstill_says_so():
    """Between unstable equilibria, x + 10 sin x = 0, the period grows without bound, and the
    motion becomes a square wave from one to the other."""
    result = solve_backbone(oscillator(Couple(k=10.0), 0.0), (0.01, 5.0), harmonics=9)
    assert result.end == result.to_dict()["end"] == "stands still"
    edge = brentq(lambda x: x + 10 * np.sin(x), 3.2, 4.0)
    assert result.amplitude()[-1] == pytest.approx(4 / np.pi * edge, rel=0.03)
    assert 0 < result.frequencies_hz[-1] < 0.1 * result.frequencies_hz[0]


def test_a_direction_with_next_to_no_mass_is_no_obstacle():
    """As reduced bases have them."""
    model, one = duffing(), solve_backbone(duffing(), (0.01, 2.0), harmonics=3)
    joint = replace(model.interfaces[0], rows=np.array([[[1.0, 0.0]]]))
    K, C, row = np.eye(2), DAMPING * np.diag([1.0, 0.0]), np.array([1.0, 0.0])
    light = InterfaceModel(np.diag([1.0, 1e-16]), K, (joint,), C, {"push": row}, {"mass": row})
    two = solve_backbone(light, (0.01, 2.0), harmonics=3)
    assert two.frequencies_hz[-1] == pytest.approx(one.frequencies_hz[-1], rel=1e-9)


def test_iwan_damping_grows_by_segalmans_power():
    """Dissipation per cycle of the mode goes with amplitude to the 3 + chi."""
    chi, strength, stiffness = -0.4, 1.0, 1.0
    backbone = Segalman(strength, stiffness, chi, 0.5)
    low, high = 0.003 * backbone.reference, 0.1 * backbone.reference
    law = Iwan(backbone, 40, amplitudes=(0.3 * low, 3 * high))
    mode = solve_backbone(oscillator(law, 0.0), (low, high), samples=256)
    a, work = mode.amplitude(measure="peak"), mode.dissipation()["joint"]
    assert np.polyfit(np.log(a), np.log(work), 1)[0] == pytest.approx(3 + chi, abs=0.02)
    # zeta is that work over 4 pi times the energy, and Masing's loop has it in closed form.
    energy = 0.5 * (2 * np.pi * mode.frequencies_hz * mode.modal_amplitudes) ** 2
    assert np.allclose(mode.damping_ratios, work / (4 * np.pi * energy), rtol=1e-2)
    assert np.abs(np.mean(work / backbone.dissipation(a)) - 1) < 0.01
    assert mode.frequencies_hz[0] > mode.frequencies_hz[-1]  # softening


def test_modes_and_responses_agree_at_the_peak():
    """EPMC, phase resonance, constant force and constant response, each by its own equations."""
    given = dict(harmonics=5, samples=512)
    peak = solve_harmonic(jenkins(), "push", PUSH, BAND, **given).peak
    span = (0.5 * peak.amplitude, 2 * peak.amplitude)
    mode = solve_backbone(jenkins(), span, **given)
    phase = solve_backbone(jenkins(), span, force="push", **given)
    held = solve_constant_response(jenkins(), "push", "mass", peak.amplitude, BAND, **given)
    # Both ways to the same curve: the least force of this response is the force of this peak.
    assert held.force_amplitudes[held.peak.index] == pytest.approx(PUSH, rel=2e-4)
    assert held.peak.frequency_hz == pytest.approx(peak.frequency_hz, rel=5e-3)
    for found in (mode, phase):
        order = np.argsort(found.amplitude())
        a = found.amplitude()[order]
        omega = 2 * np.pi * np.interp(peak.amplitude, a, found.frequencies_hz[order])
        zeta = np.interp(peak.amplitude, a, found.damping_ratios[order])
        # The force that this mode takes at resonance; it is heavily damped, so a per cent.
        assert 2 * zeta * omega**2 * peak.amplitude == pytest.approx(PUSH, rel=0.01)
        assert omega == pytest.approx(2 * np.pi * peak.frequency_hz, rel=0.01)
