"""Isotropic solids of revolution under loads of the same symmetry, as pure functions.

The mesh is the half section: r = x[0] >= 0 and z = x[1], with displacement (u_r, u_z) and no twist.
Tensors are 3 x 3 in the order (r, z, theta). Forms are integrals over the whole ring, 2 pi r dr dz,
so that energies, forces and masses are those of the body.

The hoop strain u_r/r needs no regularisation on the axis: the points of a Gauss rule lie inside
the cells, never at r = 0. (A rule with points at the vertices, such as Gauss-Lobatto's, would
divide by zero.) Hold u_r = 0 on the axis, as the solution does: a hoop strain left free there is
finite only because of the quadrature.
"""

from __future__ import annotations

import ufl

from fenics_joints.forms.checks import check
from fenics_joints.forms.elasticity import isotropic_stress, lame_parameters, mass
from fenics_joints.forms.kinematics import strain, stretched_gradient


def circumference(radius):
    """Weight 2 pi r, m, of an integral over the half section."""
    check("radius", radius, "m", least=0)
    return 2 * ufl.pi * radius


def axisymmetric_strain(u, radius, normal=None, stretch=None):
    """Small-strain tensor, shape (3, 3), in the order (r, z, theta).

    Args:
        u: Displacement (u_r, u_z), shape (2,), m.
        radius: Distance from the axis, ``ufl.SpatialCoordinate(msh)[0]``, m.
        normal: Direction of a thickness stretch, which must be the axis: ``(0, 1)``.
        stretch: Actual over meshed extent along the axis; None is 1.
    """
    plane = strain(stretched_gradient(u, normal, stretch))
    return ufl.as_matrix(
        [[plane[0, 0], plane[0, 1], 0], [plane[1, 0], plane[1, 1], 0], [0, 0, u[0] / radius]]
    )


def axisymmetric_elasticity(u, v, E, nu, dx=ufl.dx, *, radius, normal=None, stretch=None):
    """Stiffness form of an isotropic solid of revolution.

    Args:
        u: Trial function or displacement (u_r, u_z), shape (2,), m.
        v: Test function, shape (2,).
        E: Young's modulus, Pa.
        nu: Poisson's ratio, -1 < nu < 0.5.
        dx: Cell measure over the half section.
        radius: Distance from the axis, m.
        normal: Direction of a thickness stretch, which must be the axis.
        stretch: Actual over meshed extent along the axis; None is 1.

    Returns:
        Bilinear (or, for given functions, scalar) UFL form, N m for displacements.
    """
    eps_u = axisymmetric_strain(u, radius, normal, stretch)
    eps_v = axisymmetric_strain(v, radius, normal, stretch)
    weight = circumference(radius) if stretch is None else stretch * circumference(radius)
    return weight * ufl.inner(isotropic_stress(eps_u, *lame_parameters(E, nu)), eps_v) * dx


def axisymmetric_mass(u, v, rho, dx=ufl.dx, *, radius, stretch=None):
    """Consistent mass form for density ``rho``, kg/m3; other arguments as for the stiffness."""
    check("rho", rho, "kg/m3", least=0)
    return mass(u, v, circumference(radius) * rho, dx, stretch=stretch)
