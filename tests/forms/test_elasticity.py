"""Elasticity and mass against beams, waves in plates, and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg as sla
import scipy.optimize as so
import scipy.sparse as sp
import scipy.sparse.linalg as spla
import ufl
from dolfinx import fem, mesh
from form_bodies import (
    DIMENSION,
    NU,
    E,
    assembled_vector,
    box,
    element_of,
    gathered,
    interpolated,
    rigid_modes,
    tagged,
    values,
)

from fenics_joints import forms


def cantilever_deflection(name, n, length=2.0):
    """Work-conjugate tip deflection of a deep cantilever (depth 1) under unit end load.

    Loaded on its whole surface by the tractions of Timoshenko and Goodier, Theory of Elasticity,
    art. 21 (end load at x = 0), so that the end conditions leave no singularity.
    """
    cell = name.split("-")[0]
    d = DIMENSION[cell]
    lengths, counts = [length, 1.0, 0.25], [int(n * length), n, 1]
    msh = box(cell, counts[:d], lengths[:d])
    V = fem.functionspace(msh, element_of(name))
    nu = NU if d == 2 else 0.0
    K = gathered(forms.elasticity(ufl.TrialFunction(V), ufl.TestFunction(V), E, nu))
    x = ufl.SpatialCoordinate(msh)
    y = x[1] - 0.5
    bending, shear = -12 * x[0] * y, -6 * (0.25 - y**2)
    rows = [[0.0] * d for _ in range(d)]
    rows[0][0], rows[0][1], rows[1][0] = bending, shear, shear
    f = assembled_vector(
        ufl.dot(ufl.as_matrix(rows) * ufl.FacetNormal(msh), ufl.TestFunction(V)) * ufl.ds
    )
    Z = sp.csr_matrix(rigid_modes(V))
    system = sp.bmat([[K, Z], [Z.T, None]]).tocsc()
    u = spla.spsolve(system, np.append(f, np.zeros(Z.shape[1])))[: len(f)]
    return f @ u / (1.0 if d == 2 else lengths[2])


RATES = {
    "tri-P1": (8, 16, 32),
    "quad-P1": (4, 8, 16),
    "tri-P2": (4, 8, 16),
    "quad-P2": (2, 4, 8),
    "quad-S2": (2, 4, 8),
    "tet-P2": (4, 8),
    "hex-P1": (4, 8, 16),
    "hex-S2": (1, 2, 4),
}


@pytest.mark.parallel
@pytest.mark.parametrize("name", RATES)
def test_cantilever_converges_to_timoshenko(name):
    """P L^3/(3 E I) + P L/(k G A), k = 5/6: order 2 p in the deflection, and from below."""
    nu = NU if DIMENSION[name.split("-")[0]] == 2 else 0.0
    L, inertia = 2.0, 1 / 12
    exact = L**3 / (3 * E / (1 - nu**2) * inertia) + L / (5 / 6 * E / (2 * (1 + nu)))
    errors = np.array([1 - cantilever_deflection(name, n) / exact for n in RATES[name]])
    order = -np.polyfit(np.log(RATES[name]), np.log(errors), 1)[0]
    assert order > 2 * int(name[-1]) - 0.1, (order, errors)
    assert errors[-1] < 0.02


def diaphragm_frequencies(n, length, rho):
    """First bending frequencies, rad/s, of a beam with sliding ends held across; depth 1."""
    msh = box("quad", [int(n * length), n], [length, 1.0])
    V = fem.functionspace(msh, element_of("quad-S2"))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    K, M = gathered(forms.elasticity(u, v, E, NU)), gathered(forms.mass(u, v, rho))
    ends = mesh.locate_entities_boundary(msh, 1, lambda x: (x[0] < 1e-10) | (x[0] > length - 1e-10))
    mark = fem.Function(V)
    mark.x.array.reshape(-1, 2)[fem.locate_dofs_topological(V, 1, ends), 1] = 1
    mark.x.scatter_forward()
    free = values(mark) < 0.5
    K, M = K[free][:, free].toarray(), M[free][:, free].toarray()
    return np.sqrt(sla.eigh(K, M, subset_by_index=[0, 2], eigvals_only=True)[1:])


def timoshenko_frequencies(k, stiffness, G, rho):
    """Lower root of Timoshenko's frequency equation of a supported beam of unit depth.

    Kaneko's shear coefficient (J. Phys. D 8, 1975), 5 (1 + nu)/(6 + 5 nu), for plane strain.
    """
    shear = (k * k * stiffness) / (5 / (6 - NU) * G)
    b = 1 + k * k / 12 + shear / 12
    return np.sqrt(
        stiffness * k**4 / 12 * 2 / (b + np.sqrt(b * b - 4 * shear / 12 * k * k / 12)) / rho
    )


def rayleigh_lamb_frequency(k, guess, rho):
    """Lowest flexural frequency of an elastic layer of unit depth at wave number ``k``.

    Antisymmetric Rayleigh-Lamb equation (Graff, Wave Motion in Elastic Solids, ch. 8).
    """
    lmbda, mu = E * NU / ((1 + NU) * (1 - 2 * NU)), E / (2 * (1 + NU))

    def residual(w):
        p2, q2 = k * k - w * w * rho / (lmbda + 2 * mu), k * k - w * w * rho / mu
        p, q = np.sqrt(p2), np.sqrt(q2)
        return 4 * k * k * p * q * np.tanh(q / 2) - (k * k + q2) ** 2 * np.tanh(p / 2)

    return so.brentq(residual, 0.9 * guess, 1.1 * guess, xtol=1e-14, rtol=1e-13)


def test_bending_frequencies():
    """Stiffness and mass against the exact frequencies (order 2 p), and those near Timoshenko's."""
    rho, length = 2.3, 10.0
    k = np.pi * np.arange(1, 3) / length
    beam = timoshenko_frequencies(k, E / (1 - NU**2), E / (2 * (1 + NU)), rho)
    exact = np.array([rayleigh_lamb_frequency(*pair, rho) for pair in zip(k, beam, strict=True)])
    np.testing.assert_allclose(beam, exact, rtol=1e-4)
    sizes = (1, 2, 4)
    errors = [diaphragm_frequencies(n, length, rho)[0] / exact[0] - 1 for n in sizes]
    assert -np.polyfit(np.log(sizes), np.log(errors), 1)[0] > 3.9, errors
    np.testing.assert_allclose(diaphragm_frequencies(4, length, rho), exact, rtol=1e-4)


@pytest.mark.parallel
@pytest.mark.smoke
@pytest.mark.parametrize("name", ["tri-P1", "quad-S2", "tet-P2", "hex-S2"])
def test_mass(name):
    """Total mass and moment of inertia of a stretched box; an attached mass is all there."""
    cell = name.split("-")[0]
    d = DIMENSION[cell]
    rho, m, stretch, sides = 2.75, 0.02, 1.5, np.array([2.0, 1.0, 0.5])[:d]
    msh = box(cell, [2] * d, sides)
    V = fem.functionspace(msh, element_of(name))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    top = mesh.locate_entities_boundary(msh, d - 1, lambda x: x[0] > sides[0] - 1e-10)
    ds = ufl.Measure("ds", msh, subdomain_data=tagged(msh, d - 1, [top]))
    body = gathered(forms.mass(u, v, rho, stretch=stretch))
    patch = gathered(forms.attached_mass(u, v, m, np.prod(sides[1:]), ds(0)))
    ones = interpolated(V, lambda x: np.ones((d, x.shape[1])))
    turn = interpolated(V, lambda x: np.vstack([-x[1], x[0], 0 * x[0]])[:d])
    volume = np.prod(sides)
    inertia = rho * stretch * volume * (sides[0] ** 2 + sides[1] ** 2) / 3
    assert ones @ body @ ones == pytest.approx(d * rho * stretch * volume, rel=1e-13)
    assert turn @ body @ turn == pytest.approx(inertia, rel=1e-13)
    assert ones @ patch @ ones == pytest.approx(d * m, rel=1e-13)
    assert turn @ patch @ turn == pytest.approx(m * (sides[0] ** 2 + sides[1] ** 2 / 3), rel=1e-13)


def test_lame_parameters_from_both_pairs_agree():
    """Eq. 7 with ``3G - E``; the printed ``E - 3G`` would make lambda negative."""
    nu = np.array([-0.4, 0.0, 0.283, 0.49])
    G = E / (2 * (1 + nu))
    by_nu = np.array([forms.lame_parameters(E, x) for x in nu])
    by_moduli = np.array([forms.lame_from_moduli(E, x) for x in G])
    np.testing.assert_allclose(by_moduli, by_nu, rtol=1e-12, atol=1e-15)
    assert by_nu[2, 0] > 0 > G[2] * (E - 2 * G[2]) / (E - 3 * G[2])


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
