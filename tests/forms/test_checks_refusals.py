"""What no law of the forms takes: the message has the key, its value and the range."""

from __future__ import annotations

import pytest
import ufl
from dolfinx import mesh
from mpi4py import MPI

from fenics_joints import forms
from fenics_joints.errors import InputError

U = ufl.SpatialCoordinate(mesh.create_unit_square(MPI.COMM_SELF, 1, 1))


@pytest.mark.parametrize(
    ("law", "given", "said"),
    [
        (forms.elasticity, (U, U, 1.0, 0.5), r"nu = 0\.5.*-1 < nu < 0\.5"),
        (lambda: forms.elasticity(U, U, 1.0, 0.3, stretch=2.0), (), "stretch.*normal"),
        (forms.plane_stress, (1.0, 0.5), r"nu = 0\.5"),
        (forms.isotropic_layer, (U, U, 3.0, 1.0), r"E = 3\.0.*G = 1\.0.*0 < E < 3 G"),
        (forms.coulomb_traction, (U, 1.0, -0.1, 1.0), r"friction = -0\.1.*at least 0"),
        (forms.penalty_pressure, (U[0], -1.0), r"stiffness = -1.*Pa/m"),
        (forms.pressure_cone, (0.0, 1.0, 5e-3, 5e-3), r"r_contact = 0\.005.*r_hole = 0\.005"),
        (forms.combined_roughness, (0.0,), "ra_1"),
        (forms.rough_contact_stiffness, (-1.0, 1e-6, 0.3), "pressure"),
        (lambda: forms.transition_mass(1, 1, 1, thickness=1.0), (), "expected both"),
        (
            lambda: forms.transition_mass(1, 1, 1, thickness=-1.0, meshed=1.0),
            (),
            "thickness = -1.0",
        ),
        (lambda: forms.transition_modulus(0.5, 1, 2, 2, through=0), (), "through = 0"),
        (forms.ring_pressure, (0.01, 10.0, 0.005, 0.02), "force = 10 N"),
    ],
)
def test_what_cannot_be_is_refused_by_its_name(law, given, said):
    with pytest.raises(InputError, match=said):
        law(*given)
