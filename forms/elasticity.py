"""Isotropic linear elasticity and inertia, as pure functions that return UFL.

Use degree 2 (serendipity is enough) for plates and beams: cells of degree 1 lock in bending. A
plate of thickness t, n quadrilaterals of length l through it, is too stiff in bending by
1 + (1 - nu)/2 (l/t)^2 + ((1 - nu)^2/(1 - 2 nu) - 1)/n^2 (plane strain; hexahedra with nu = 0 have
the first term alone), and the first term does not shrink with more cells through the thickness.
Linear triangles and tetrahedra are worse: 4 times too stiff at l = t, n = 1. On 8 mm lapped plates
with 10 mm cells, one through each plate, the frequencies come out 28 to 32 % high in linear
quadrilaterals and about twice as high as they should in linear triangles; quadratic cells represent
pure bending exactly (``tests/forms/test_thin_layer_limits.py``).
"""

from __future__ import annotations

from numbers import Real

import ufl

from fenics_joints.errors import InputError
from fenics_joints.forms.checks import check
from fenics_joints.forms.kinematics import strain, stretched_gradient


def lame_parameters(E, nu):
    """Lamé parameters (lambda, mu), Pa, from Young's modulus ``E`` (Pa) and Poisson's ratio.

    Raises:
        InputError: ``E`` is a number that is not above 0, or ``nu`` one outside -1 < nu < 0.5.
    """
    check("E", E, "Pa", above=0)
    check("nu", nu)
    if isinstance(nu, Real) and not -1 < nu < 0.5:
        raise InputError(f"nu = {nu}: an isotropic solid needs -1 < nu < 0.5")
    return E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu))


def lame_from_moduli(E, G):
    """Lamé parameters (lambda, mu), Pa, from Young's modulus and shear modulus, Pa.

    Tian et al. 2021, eq. 7, whose denominator is printed ``E - 3G``: that has the wrong sign; it is
    ``3G - E``. Positive definite for 0 < E < 3G.

    Raises:
        InputError: ``E`` and ``G`` are numbers outside that range.
    """
    check("E", E, "Pa", above=0)
    check("G", G, "Pa", above=0)
    if isinstance(E, Real) and isinstance(G, Real) and not 0 < E < 3 * G:
        raise InputError(f"E = {E} Pa with G = {G} Pa: an isotropic solid needs 0 < E < 3 G")
    return G * (E - 2 * G) / (3 * G - E), G


def plane_stress(E, nu):
    """Moduli (E, nu) with which two-dimensional forms, of plane strain, are those of plane stress.

    E (1 + 2 nu) / (1 + nu)^2 and nu / (1 + nu) (Timoshenko and Goodier, Theory of Elasticity, 1970,
    art. 16). Forces are per unit of thickness; a part that is t thick has t times this E and rho.

    Args:
        E: Young's modulus, Pa.
        nu: Poisson's ratio.

    Raises:
        InputError: As `lame_parameters`.
    """
    lame_parameters(E, nu)
    return E * (1 + 2 * nu) / (1 + nu) ** 2, nu / (1 + nu)


def isotropic_stress(eps, lmbda, mu):
    """Cauchy stress, Pa, of the strain tensor ``eps``; plane strain when that is 2 x 2."""
    check("lmbda", lmbda, "Pa")
    check("mu", mu, "Pa", least=0)
    return lmbda * ufl.tr(eps) * ufl.Identity(eps.ufl_shape[0]) + 2 * mu * eps


def elasticity(u, v, E, nu, dx=ufl.dx, *, normal=None, stretch=None, across=None, width=None):
    """Stiffness form of an isotropic solid.

    Args:
        u: Trial function or displacement, shape (gdim,), m.
        v: Test function, shape (gdim,).
        E: Young's modulus, Pa.
        nu: Poisson's ratio, -1 < nu < 0.5.
        dx: Cell measure, with subdomain and quadrature degree.
        normal: Direction of a thickness stretch, unit vector.
        stretch: Actual over meshed thickness; None is 1.
        across: Direction of a stretch of the width, unit vector at right angles to ``normal``.
        width: Actual over meshed width; None is 1.

    Returns:
        Bilinear (or, for given functions, scalar) UFL form, N m for displacements.
    """
    eps_u = strain(stretched_gradient(u, normal, stretch, across, width))
    eps_v = strain(stretched_gradient(v, normal, stretch, across, width))
    jacobian = (1 if stretch is None else stretch) * (1 if width is None else width)
    return jacobian * ufl.inner(isotropic_stress(eps_u, *lame_parameters(E, nu)), eps_v) * dx


def mass(u, v, rho, dx=ufl.dx, *, stretch=None, width=None):
    """Consistent mass form for density ``rho``, kg/m3, and stretches as of `elasticity`."""
    check("rho", rho, "kg/m3", least=0)
    for name, ratio in (("stretch", stretch), ("width", width)):
        if ratio is not None:
            check(name, ratio, above=0)
    factor = rho if stretch is None else rho * stretch
    factor = factor if width is None else factor * width
    return factor * ufl.inner(u, v) * dx


def attached_mass(u, v, m, area, ds):
    """A mass ``m`` (kg) spread evenly over the facets of ``ds``, whose total area is ``area`` (m2).

    The form for a sensor or a bolt head on a patch of facets. A mass at a point that need not be
    a node is no UFL form: see `fenics_joints.structure.PointMass`.
    """
    check("m", m, "kg", least=0)
    check("area", area, "m2", above=0)
    return (m / area) * ufl.inner(u, v) * ds
