"""How far thin elements can be trusted: what `forms.thin_layer` says of them, measured.

The structure is Tian et al. 2021's: two 8 mm plates, 200 mm long, lapped over 80 mm, free, the
layer without mass. Its frequencies are compared with those of a spring interface of no thickness on
the same plate cells, so that the cells' own error cancels and only the layer's remains.
"""

from __future__ import annotations

import basix.ufl
import numpy as np
import pytest
import scipy.linalg as sla
import ufl
from dolfinx import default_scalar_type, fem, mesh
from form_bodies import DIMENSION, assembled_vector, box, element_of, gathered, tagged

from fenics_joints import forms

E, NU, RHO = 69e9, 0.283, 2750.0
THICKNESS, WIDTH, LENGTH, LAP = 8e-3, 0.04, 0.32, (0.12, 0.20)
K_N, K_T = 1e12, 4e11


class Lap:
    """Grid of the lapped plates' side view (or plates), its last axis across the joint.

    The grid is a full box; the two empty corners are left out of every form.
    """

    def __init__(self, name, cells, gap):
        cell = name.split("-")[0]
        self.d = d = DIMENSION[cell]
        self.name, self.gap = name, gap
        slabs = [0, THICKNESS, THICKNESS + gap, 2 * THICKNESS + gap]
        heights = np.unique(slabs)
        lengths = [LENGTH, WIDTH, 1.0] if d == 3 else [LENGTH, 1.0]
        counts = [cells, 2, len(heights) - 1] if d == 3 else [cells, len(heights) - 1]
        self.msh = msh = box(cell, counts, lengths)
        z = msh.geometry.x[:, d - 1]
        z[:] = np.interp(z, np.linspace(0, 1, len(heights)), heights)
        self.lower = self.inside(d, 0, LAP[1], slabs[0], slabs[1])
        self.upper = self.inside(d, LAP[0], LENGTH, slabs[2], slabs[3])
        self.joint = self.inside(d if gap else d - 1, *LAP, slabs[1], slabs[2])

    def inside(self, dim, x0, x1, z0, z1):
        """Entities of that dimension with all vertices in the rectangle."""
        last, tol = self.d - 1, 1e-12

        def within(x):
            across = (x[last] > z0 - tol) & (x[last] < z1 + tol)
            return across & (x[0] > x0 - tol) & (x[0] < x1 + tol)

        return mesh.locate_entities(self.msh, dim, within)

    def constant(self, value):
        return fem.Constant(self.msh, default_scalar_type(value))


def layered_lap(name, cells, aspect, law="uncoupled", k_n=K_N, k_t=K_T):
    """Stiffness and mass with a layer of in-plane size over thickness ``aspect``.

    For the isotropic laws ``k_n`` is E/h and ``k_t`` G/h.
    """
    h = LENGTH / cells / aspect
    lap = Lap(name, cells, h)
    V, c = fem.functionspace(lap.msh, element_of(name)), lap.constant
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    plates = np.concatenate([lap.lower, lap.upper])
    dx = ufl.Measure("dx", lap.msh, subdomain_data=tagged(lap.msh, lap.d, [plates, lap.joint]))
    normal = ufl.unit_vector(lap.d - 1, lap.d)
    moduli = c(k_n * h), c(k_t * h)
    if law == "isotropic":
        layer = forms.isotropic_layer(u, v, *moduli, dx(1))
    else:
        layer_form = {"uncoupled": forms.uncoupled_layer, "constrained": forms.constrained_layer}
        layer = layer_form[law](u, v, normal, *moduli, dx(1))
    K = gathered(forms.elasticity(u, v, c(E), c(NU), dx(0)) + layer)
    return K, gathered(forms.mass(u, v, c(RHO), dx(0)))


def sprung_lap(name, cells, k_n=K_N, k_t=K_T, rule=None):
    """Stiffness and mass with a spring interface of no thickness, a function for each plate."""
    lap = Lap(name, cells, 0.0)
    c, e = lap.constant, element_of(name)
    W = fem.functionspace(lap.msh, basix.ufl.mixed_element([e, e]))
    (u1, u2), (v1, v2) = ufl.TrialFunctions(W), ufl.TestFunctions(W)
    dx = ufl.Measure("dx", lap.msh, subdomain_data=tagged(lap.msh, lap.d, [lap.lower, lap.upper]))
    facets = tagged(lap.msh, lap.d - 1, [lap.joint])
    metadata = {"quadrature_rule": rule, "quadrature_degree": 1} if rule else {}
    dS = ufl.Measure("dS", lap.msh, subdomain_data=facets, metadata=metadata)
    jumps = u1("+") - u2("+"), v1("+") - v2("+")
    normal = ufl.FacetNormal(lap.msh)("+")
    a = forms.elasticity(u1, v1, c(E), c(NU), dx(0)) + forms.elasticity(u2, v2, c(E), c(NU), dx(1))
    K = gathered(a + forms.spring_interface(*jumps, normal, c(k_n), c(k_t), dS(0)))
    return K, gathered(forms.mass(u1, v1, c(RHO), dx(0)) + forms.mass(u2, v2, c(RHO), dx(1)))


def dense(K, M):
    """Dense matrices without the rows that no form touches."""
    used = np.asarray(abs(K).sum(axis=1)).ravel() > 0
    return K[used][:, used].toarray(), M[used][:, used].toarray()


def frequencies(matrices, rigid=3, count=4):
    """First elastic frequencies, Hz, of the free structure, by a shift below zero."""
    K, M = dense(*matrices)
    shift = (2 * np.pi * 50.0) ** 2
    last = [len(K) - rigid - count, len(K) - 1]
    shifted = sla.eigh(M, K + shift * M, subset_by_index=last, eigvals_only=True)[::-1]
    squared = 1 / shifted - shift
    assert abs(squared[:rigid]).max() < (2 * np.pi) ** 2
    return np.sqrt(squared[rigid:]) / (2 * np.pi)


# In the limit, linear simplices take the jump at the nodes: a spring with the vertex rule.
LIMITS = [
    ("quad-P1", 32, None),
    ("quad-P2", 32, None),
    ("quad-S2", 32, None),
    ("tri-P1", 32, "vertex"),
    ("hex-P1", 8, None),
    ("hex-S2", 8, None),
    ("tet-P1", 8, "vertex"),
]


@pytest.mark.parallel
@pytest.mark.parametrize("name, cells, rule", LIMITS)
def test_thin_layer_tends_to_the_spring_interface(name, cells, rule):
    """E = k_n h, G = k_t h: the difference is the thickness's own, of first order, at any aspect.

    Locking would leave a difference that does not vanish with h, round-off one that grows.
    """
    rigid = 3 if DIMENSION[name.split("-")[0]] == 2 else 6
    spring = frequencies(sprung_lap(name, cells, rule=rule), rigid)
    aspects = np.array([10, 100, 1000])
    layer = [frequencies(layered_lap(name, cells, r), rigid) for r in aspects]
    change = np.array(layer) / spring - 1
    biggest = abs(change[-1]).argmax()
    order = -np.polyfit(np.log(aspects[1:]), np.log(abs(change[1:, biggest])), 1)[0]
    assert order == pytest.approx(1, abs=0.03), change
    # In units of h over the plates' thickness, which is the change of the section.
    h = LENGTH / cells / aspects
    assert (abs(change).max(axis=1) < 0.2 * h / THICKNESS).all(), change


def test_quadratic_triangles_converge_in_the_plane():
    """Their thin limit is no spring on the same cells; the difference falls with the cells."""
    sizes = (16, 32, 64)
    change = [
        abs(frequencies(layered_lap("tri-P2", n, 1000)) / frequencies(sprung_lap("tri-P2", n)) - 1)
        for n in sizes
    ]
    worst = np.max(change, axis=1)
    assert 1e-4 < worst[1] < 1e-3, worst
    assert -np.polyfit(np.log(sizes), np.log(worst), 1)[0] > 2, worst


def test_round_off_does_not_grow_with_the_aspect_ratio():
    """At fixed E/h the condition number stays; at fixed E it grows in proportion to the aspect."""
    aspects = np.array([1e2, 1e3, 1e4, 1e5])

    def condition(aspect, **stiffness):
        eigenvalues = sla.eigvalsh(dense(*layered_lap("quad-S2", 16, aspect, **stiffness))[0])
        return eigenvalues[-1] / eigenvalues[3]

    fixed_spring = [condition(r) for r in aspects]
    assert max(fixed_spring) < 1.05 * min(fixed_spring)
    fixed_modulus = [condition(r, k_n=K_N * r / 10, k_t=K_T * r / 10) for r in aspects[1:]]
    slope = np.polyfit(np.log(aspects[1:]), np.log(fixed_modulus), 1)[0]
    assert slope == pytest.approx(1, abs=0.1), fixed_modulus
    # The change is c h to first order: what breaks that at 1e5 is round-off.
    spring = frequencies(sprung_lap("quad-S2", 16))
    change = {r: frequencies(layered_lap("quad-S2", 16, r)) / spring - 1 for r in (1e4, 1e5)}
    assert abs(change[1e5] - change[1e4] / 10).max() < 1e-8


def modulus_ratio(nu):
    """Constrained modulus lambda + 2G over E."""
    return (1 - nu) / ((1 + nu) * (1 - 2 * nu))


def test_isotropic_layer_is_a_spring_of_the_constrained_modulus():
    """k_n = (lambda + 2G)/h, not E/h, within the change that the thickness itself makes."""
    nu = 0.3
    E_h = 2 * (1 + nu) * K_T
    right = frequencies(sprung_lap("quad-S2", 32, k_n=modulus_ratio(nu) * E_h))
    wrong = frequencies(sprung_lap("quad-S2", 32, k_n=E_h))
    layer = frequencies(layered_lap("quad-S2", 32, 1000, "isotropic", k_n=E_h))
    assert abs(layer / right - 1).max() < 2e-4
    assert abs(layer / wrong - 1).max() > 2e-3


def test_isotropic_layer_near_incompressibility():
    """The law stiffens without bound as nu tends to 0.5; linear cells lock on top of that."""
    nu = 0.49999
    E_h = 2 * (1 + nu) * K_T

    def excess(name, aspect):
        isotropic = frequencies(layered_lap(name, 32, aspect, "isotropic", k_n=E_h))
        constrained = frequencies(layered_lap(name, 32, aspect, "constrained", k_n=E_h))
        return abs(isotropic / constrained - 1).max()

    assert modulus_ratio(nu) > 1e4
    for aspect in (10, 1000):
        rigid_normal = frequencies(sprung_lap("quad-S2", 32, k_n=1e4 * K_N))
        layer = frequencies(layered_lap("quad-S2", 32, aspect, "isotropic", k_n=E_h))
        h = LENGTH / 32 / aspect
        assert abs(layer / rigid_normal - 1).max() < 0.2 * h / THICKNESS
    assert excess("quad-S2", 10) < 2e-3
    assert excess("quad-P1", 10) > 3e-2
    assert excess("quad-P1", 1000) < 2e-4


def bending_stiffness_ratio(name, size, through, nu):
    """Stiffness of a bar of unit depth in pure bending over the exact one.

    ``size`` is the cells' length over the depth, ``through`` their number through it.
    """
    cell, count = name.split("-")[0], 8
    d = DIMENSION[cell]
    msh = box(cell, [count, through, 1][:d], [count * size, 1.0, 1.0][:d])
    V = fem.functionspace(msh, element_of(name))
    v = ufl.TestFunction(V)
    K = gathered(forms.elasticity(ufl.TrialFunction(V), v, 1.0, nu))
    y = ufl.SpatialCoordinate(msh)[1] - 0.5
    f = assembled_vector(12 * y * ufl.FacetNormal(msh)[0] * v[0] * ufl.ds)
    # The load is in balance, so any stiffness added to the rigid motions leaves the work as it is.
    K = K.toarray()
    rigid = sla.eigh(K, subset_by_index=[0, d * (d + 1) // 2 - 1])[1]
    work = f @ sla.solve(K + rigid @ rigid.T, f, assume_a="pos")
    exact = 12 * count * size * (1 - nu**2 if d == 2 else 1)
    return exact / work


@pytest.mark.parametrize("size", [0.5, 2.0])
@pytest.mark.parametrize("through", [1, 2])
def test_linear_parts_lock_in_bending(size, through):
    """The ratio is 1 + (1 - nu)/2 (l/t)^2 + ((1 - nu)^2/(1 - 2 nu) - 1)/n^2 for quadrilaterals.

    The first term is the shear that a straight-edged cell of length l must take in a plate of
    thickness t, whatever the number n of cells through it; the second the Poisson strain that it
    cannot take. Quadratic cells are exact.
    """
    expected = 1 + (1 - NU) / 2 * size**2 + ((1 - NU) ** 2 / (1 - 2 * NU) - 1) / through**2
    assert bending_stiffness_ratio("quad-P1", size, through, NU) == pytest.approx(expected, 1e-3)
    plain = bending_stiffness_ratio("hex-P1", size, through, 0.0)
    assert plain == pytest.approx(1 + size**2 / 2, 1e-3)
    for name in ("tri-P1", "tet-P1"):
        assert bending_stiffness_ratio(name, size, through, 0.0) > 1.3 * plain
    for name in ("quad-S2", "tri-P2", "hex-S2", "tet-P2"):
        assert bending_stiffness_ratio(name, size, through, NU) == pytest.approx(1, abs=1e-9)
