"""Stiffness per area of rough faces."""

import numpy as np
import pytest

from fenics_joints.errors import InputError
from fenics_joints.forms import combined_roughness, pressure_cone, rough_contact_stiffness


def test_a_bolt_s_stiffness_knows_no_radius():
    """Summed over a cone of pressure it is F / (gamma h_rms), however far the cone reaches."""
    force, h_rms, hole = 12e3, 2.5e-6, 4e-3
    for reach in (8e-3, 20e-3):
        r = np.linspace(hole, reach, 20_001)
        middle = 0.5 * (r[1:] + r[:-1])
        pressure = np.array(
            [float(pressure_cone(x, force, hole, reach, open_hole=True)) for x in middle]
        )
        k_n, k_t = rough_contact_stiffness(pressure, h_rms, 0.3)
        area = np.pi * np.diff(r**2)
        assert (k_n * area).sum() == pytest.approx(force / (0.5 * h_rms), rel=1e-6)
        # Mindlin, 1949: a round spot is softer along its plane by (2 - nu) / (2 - 2 nu).
        assert k_n / k_t == pytest.approx(1.7 / 1.4, rel=1e-12)


def test_roughness_of_two_faces():
    """Heights of a Gaussian face, drawn: Rq = 1.2533 Ra, and squares add."""
    z = np.random.default_rng(1).standard_normal((2, 1_000_000)) * [[1e-6], [2e-6]]
    ra = np.abs(z).mean(axis=1)
    assert combined_roughness(*ra) == pytest.approx((z[0] + z[1]).std(), rel=3e-3)
    assert combined_roughness(ra[0]) == pytest.approx(np.sqrt(2) * z[0].std(), rel=3e-3)
    with pytest.raises(InputError, match="ra_1"):
        combined_roughness(0.0)
    with pytest.raises(InputError, match="pressure"):
        rough_contact_stiffness(-1.0, 1e-6, 0.3)
