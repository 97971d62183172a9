"""Several loads at once: superposition where all is linear, and the energy they put in."""

import numpy as np
import pytest
from oscillators import BAND, SLIDE, STICK, Cubic, Jenkins, oscillator

from fenics_joints.errors import InputError
from fenics_joints.harmonic import Load, solve_harmonic

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
