"""Plane stress through the forms of plane strain, against Hooke's law."""

import numpy as np
import pytest
import ufl
from dolfinx import fem
from form_bodies import box

from fenics_joints import forms
from fenics_joints.errors import InputError


@pytest.mark.parametrize("nu", [-0.2, 0.0, 0.3, 0.49])
def test_a_thin_plate_has_hookes_energy(nu):
    """Pulled along x: free to contract, with sides held, and sheared."""
    E = 3.0
    msh = box("quad", (2, 3), (2.0, 1.0))
    x = ufl.SpatialCoordinate(msh)
    moduli = forms.plane_stress(E, nu)
    for u, energy in (
        (ufl.as_vector([x[0], -nu * x[1]]), E),
        (ufl.as_vector([x[0], 0 * x[1]]), E / (1 - nu**2)),
        (ufl.as_vector([x[1], 0 * x[0]]), E / (2 * (1 + nu))),
    ):
        form = fem.form(forms.elasticity(u, u, *moduli, ufl.dx(msh)))
        found = msh.comm.allreduce(fem.assemble_scalar(form))
        assert found / 2.0 == pytest.approx(energy, rel=1e-12)


def test_what_is_no_solid_is_refused():
    with pytest.raises(InputError, match=r"nu = 0\.5"):
        forms.plane_stress(1.0, 0.5)
    assert np.allclose(forms.plane_stress(2.0, 0.0), (2.0, 0.0))
