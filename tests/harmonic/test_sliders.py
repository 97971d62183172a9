"""Iwan's sliders against the amplitudes that a response meets."""

import pytest
from oscillators import BAND, oscillator

from fenics_joints.harmonic import fitted_sliders, slider_ranges, solve_harmonic
from fenics_joints.joint_laws import Iwan, RichardAbbott

CURVE = RichardAbbott(E_e=2.0, E_p=0.1, S_y=0.5, n=1.2)


def test_sliders_for_other_amplitudes_are_told_and_moved():
    """Below the range that sliders are for, their dissipation is not Masing's; moved, it is."""
    model = oscillator(Iwan(CURVE, 12), 0.02)
    band = (1.4 / 6.2832, 1.8 / 6.2832)
    low = solve_harmonic(model, "push", 2e-4, band, harmonics=1, samples=1024)
    (found,) = slider_ranges(low)
    reach = low.amplitude(measure="peak")[low.peak.index]
    assert found.met == pytest.approx((reach, reach), rel=1e-4)
    assert found.met[1] < 0.1 * CURVE.reference == pytest.approx(found.fitted[0])
    # The loop that harmonic balance made, against Masing's closed form.
    loop = low.dissipation([low.peak.index])["joint"][0]
    exact = float(CURVE.dissipation(reach))
    assert found.error == pytest.approx(loop / exact - 1, abs=2e-3)
    assert abs(found.error) > 0.05 and "expected amplitudes" in found.note
    moved = fitted_sliders(low)
    again = solve_harmonic(moved, "push", 2e-4, band, harmonics=1, samples=1024)
    (better,) = slider_ranges(again)
    assert abs(better.error) < 0.01 and better.note is None
    high = solve_harmonic(model, "push", 0.03, BAND, harmonics=1)
    assert slider_ranges(high)[0].note is None
