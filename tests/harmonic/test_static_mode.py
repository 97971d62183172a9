"""Quasi-static modal analysis against closed forms, and beside the extended periodic motion."""

import numpy as np
import pytest
from oscillators import block, oscillator

from fenics_joints.errors import InputError
from fenics_joints.harmonic import solve_backbone, solve_static_backbone
from fenics_joints.interfaces import InterfaceModel, InterfacePoints
from fenics_joints.joint_laws import ElasticFriction, Iwan, Segalman

CURVE = Segalman(F_S=1.0, K_T=1.0, chi=-0.4, beta=0.5)
SPAN = (0.01 * CURVE.reference, 0.3 * CURVE.reference)
VISCOUS = 0.02


def iwan(sliders=40):
    return Iwan(CURVE, sliders, amplitudes=(0.3 * SPAN[0], 3 * SPAN[1]))


@pytest.mark.parametrize("loop_steps", [0, 40])
def test_secant_and_loops_of_one_mass_are_the_closed_forms(loop_steps):
    """By Masing's rule, and by loops that the load goes through."""
    found = solve_static_backbone(
        oscillator(iwan(), VISCOUS), SPAN, loop_steps=loop_steps, per_decade=6
    )
    a = found.amplitude()
    omega = np.sqrt(1 + CURVE.secant(a))
    assert found.end == "reached" and a[0] <= SPAN[0] * 1.5 and a[-1] >= SPAN[1]
    assert np.allclose(2 * np.pi * found.frequencies_hz, omega, rtol=2e-4)
    assert np.allclose(found.energies, CURVE.dissipation(a), rtol=0.015)
    zeta = CURVE.dissipation(a) / (2 * np.pi * (omega * a) ** 2) + VISCOUS / (2 * omega)
    assert np.allclose(found.damping_ratios, zeta, rtol=0.01)


def chain():
    """Three masses with a joint between the last two, without an internal resonance."""
    K = np.array([[2.6, -1.0, 0.0], [-1.0, 1.5, -0.5], [0.0, -0.5, 0.5]])
    joint = InterfacePoints("joint", iwan(), np.array([[[0.0, -1.0, 1.0]]]), np.ones(1))
    one = np.eye(3)
    return InterfaceModel(one, K, (joint,), 0.01 * K, {"tip": one[2]}, {"tip": one[2]})


@pytest.mark.parametrize(("near", "span"), [(None, (0.5, 4.0)), (0.2, (0.02, 0.12))])
def test_beside_the_extended_periodic_motion(near, span):
    """Of two modes of a chain: one table for both, and the same small print."""
    static = solve_static_backbone(chain(), span, near=near)
    epmc = solve_backbone(chain(), span, near=near, samples=256)
    assert set(epmc.to_dict()) > {"method", "frequency_hz", "damping_ratio", "modal_amplitude"}
    assert set(static.to_dict()) > {"method", "frequency_hz", "damping_ratio", "modal_amplitude"}
    a = static.amplitude()
    hz = np.interp(a, epmc.amplitude(), epmc.frequencies_hz)
    zeta = np.interp(a, epmc.amplitude(), epmc.damping_ratios)
    assert np.ptp(hz) > 1e-3 * hz.max() and zeta.max() > 1.3 * zeta.min()
    assert np.allclose(static.frequencies_hz, hz, rtol=0.01)
    # The third harmonic stretches the joint too: static loads have none.
    assert np.allclose(static.damping_ratios, zeta, rtol=0.08)


def test_where_the_pressure_changes_loops_are_right_and_masing_is_not():
    """A block on frictional points under a static press."""
    model, press = block(pressure=0.0), np.array([-3.0, 0.0, 0.0])
    span = (0.03, 0.6)
    epmc = solve_backbone(model, span, sensor="x", static=press, samples=512, harmonics=7, cycles=3)
    given = dict(sensor="x", static=press, per_decade=8)
    looped, masing = (
        solve_static_backbone(model, span, loop_steps=steps, **given) for steps in (40, 0)
    )
    # Further on the load of the mode at rest is no longer the motion's.
    near = looped.amplitude() < 0.1
    zeta = np.interp(looped.amplitude(), epmc.amplitude(), epmc.damping_ratios)
    assert near.sum() > 3 and np.all(np.abs(np.log(looped.damping_ratios / zeta)[near]) < 0.12)
    at = [np.interp(0.28, each.amplitude(), each.damping_ratios) for each in (looped, masing)]
    assert abs(np.log(at[0] / at[1])) > 0.3


def test_a_joint_that_carries_no_more_says_so():
    """A mass that only a slider holds: no static load above its strength."""
    one = np.ones((1, 1))
    joint = InterfacePoints("joint", ElasticFriction(1.0, 0.3), one[None], np.ones(1))
    model = InterfaceModel(one, 0 * one, (joint,), None, {"push": one[0]}, {"mass": one[0]})
    found = solve_static_backbone(model, (0.01, 10.0))
    assert found.end == "gives way"
    assert found.loads[-1] <= 0.3 * (1 + 1e-8) and found.loads[-1] > 0.29
    with pytest.raises(InputError, match="low < high"):
        solve_static_backbone(model, (1.0, 0.5))
