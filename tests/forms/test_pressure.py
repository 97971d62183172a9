"""The pressure below a bolt's head, moduli graded by it, and the stiffness of rough faces."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import default_scalar_type, fem, mesh
from form_bodies import FORCE, R_HEAD, R_HOLE, box, rotate, rotation, total
from mpi4py import MPI

from fenics_joints import forms


@pytest.mark.parallel
@pytest.mark.parametrize("open_hole", [False, True])
def test_pressure_cone_carries_the_bolt_force(open_hole):
    """The pressure over the plane sums to the force; radially to round-off, in the plane by size.

    The radial mesh has nodes at the kinks, so that its quadrature is exact.
    """
    r_m = forms.contact_radius(R_HEAD, 8e-3, np.pi / 6)
    assert float(r_m) == pytest.approx(R_HEAD + 8e-3 * np.tan(np.pi / 6))
    radii = np.array([0.0, R_HOLE, float(r_m), 2 * float(r_m)])
    line = mesh.create_interval(MPI.COMM_WORLD, 9, [0.0, 9.0])
    line.geometry.x[:, 0] = np.interp(line.geometry.x[:, 0], [0, 3, 6, 9], radii)
    r = ufl.SpatialCoordinate(line)[0]
    P = forms.pressure_cone(r, FORCE, R_HOLE, r_m, open_hole=open_hole)
    dx = ufl.dx(metadata={"quadrature_degree": 4})
    assert total(P * 2 * np.pi * r * dx, line.comm) == pytest.approx(FORCE, rel=1e-12)

    # A turned plane in space, its bolt off the nodes; `radius` measures along the plane.
    R, centre = rotation(3), np.array([0.031, 0.027, 0.4])
    plane = box("hex", [40, 40, 1], [0.06, 0.06, 0.01])
    rotate(plane, R)
    x = ufl.SpatialCoordinate(plane)
    r = forms.radius(x, ufl.as_vector(R @ centre), ufl.as_vector(R[:, 2]))
    P = forms.pressure_cone(r, FORCE, R_HOLE, r_m, open_hole=open_hole)
    force = total(P / 0.01 * ufl.dx(metadata={"quadrature_degree": 4}), plane.comm)
    assert force == pytest.approx(FORCE, rel=3e-3)


def test_graded_modulus_at_hole_rim_and_beyond():
    """E = alpha P_max^beta h at the hole, falling to the floor at and beyond r_m (eqs. 22, 24)."""
    r_m, alpha, beta, h, floor = 14e-3, 2.2e8, 0.6, 2e-4, 1e5
    line = mesh.create_unit_interval(MPI.COMM_SELF, 1)
    r = fem.Constant(line, default_scalar_type(0))

    def modulus(radius):
        r.value = radius
        P = forms.pressure_cone(r, FORCE, R_HOLE, r_m)
        return total(forms.graded_modulus(P, alpha, beta, h, floor) * ufl.dx(line), line.comm)

    peak = 3 * FORCE / (np.pi * (r_m**2 + r_m * R_HOLE + R_HOLE**2))
    full = alpha * peak**beta * h
    assert modulus(0.0) == pytest.approx(full + floor, rel=1e-12)
    assert modulus(R_HOLE) == pytest.approx(full + floor, rel=1e-12)
    middle = (R_HOLE + r_m) / 2
    assert modulus(middle) == pytest.approx(full * 0.5**beta + floor, rel=1e-12)
    assert modulus(r_m) == modulus(2 * r_m) == floor


def test_graded_modulus_derivatives():
    """Derivatives to alpha and beta by UFL pass a Taylor test, with P = 0 in the domain."""
    line = mesh.create_unit_interval(MPI.COMM_WORLD, 16)
    r = 0.03 * ufl.SpatialCoordinate(line)[0]
    P = forms.pressure_cone(r, FORCE, R_HOLE, 14e-3)
    alpha, beta = (fem.Constant(line, default_scalar_type(c)) for c in (2.2e8, 0.6))
    var = {"alpha": ufl.variable(alpha), "beta": ufl.variable(beta)}
    modulus = forms.graded_modulus(P, var["alpha"], var["beta"], 2e-4)
    dx = ufl.dx(metadata={"quadrature_degree": 6})
    functional = fem.form(modulus * dx)
    comm = line.comm

    def J():
        return comm.allreduce(fem.assemble_scalar(functional), op=MPI.SUM)

    base = J()
    by_alpha, by_beta = (total(ufl.diff(modulus, var[k]) * dx, comm) for k in ("alpha", "beta"))
    # Linear in alpha: J = alpha dJ/dalpha.
    assert by_alpha * 2.2e8 == pytest.approx(base, rel=1e-13)
    steps = 0.01 * 0.5 ** np.arange(4)
    remainders = []
    for step in steps:
        beta.value = 0.6 + step
        remainders.append(abs(J() - base - step * by_beta))
    assert np.polyfit(np.log(steps), np.log(remainders), 1)[0] == pytest.approx(2, abs=0.1)
    beyond = ufl.conditional(ufl.gt(r, 14e-3), ufl.diff(modulus, var["beta"]), 0.0)
    assert total(beyond * dx, comm) == 0.0


# -- rough faces ----------------------------------------------------------------------------------


def test_a_bolt_s_stiffness_knows_no_radius():
    """Summed over a cone of pressure it is F / (gamma h_rms), however far the cone reaches."""
    force, h_rms, hole = 12e3, 2.5e-6, 4e-3
    for reach in (8e-3, 20e-3):
        r = np.linspace(hole, reach, 2_001)
        middle = 0.5 * (r[1:] + r[:-1])
        pressure = np.array(
            [float(forms.pressure_cone(x, force, hole, reach, open_hole=True)) for x in middle]
        )
        k_n, k_t = forms.rough_contact_stiffness(pressure, h_rms, 0.3)
        area = np.pi * np.diff(r**2)
        assert (k_n * area).sum() == pytest.approx(force / (0.5 * h_rms), rel=1e-6)
        # Mindlin, 1949: a round spot is softer along its plane by (2 - nu) / (2 - 2 nu).
        assert k_n / k_t == pytest.approx(1.7 / 1.4, rel=1e-12)


def test_roughness_of_two_faces():
    """Heights of a Gaussian face, drawn: Rq = 1.2533 Ra, and squares add."""
    z = np.random.default_rng(1).standard_normal((2, 1_000_000)) * [[1e-6], [2e-6]]
    ra = np.abs(z).mean(axis=1)
    assert forms.combined_roughness(*ra) == pytest.approx((z[0] + z[1]).std(), rel=3e-3)
    assert forms.combined_roughness(ra[0]) == pytest.approx(np.sqrt(2) * z[0].std(), rel=3e-3)
