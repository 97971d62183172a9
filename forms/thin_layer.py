"""Thin-layer joint materials (Tian et al. 2021, eqs. 5 to 8) in any direction of the normal.

What thin elements do, and how far to trust them. ``tests/forms/test_thin_layer_limits.py`` proves
each line on lapped plates, for aspect ratios (in-plane size over thickness) from 10 to 1000 and
more:

- `uncoupled_layer` neither locks nor loses accuracy. For constant E/h and G/h it tends to a
  zero-thickness spring, k_n = E/h and k_t = G/h, on the same cells: in quadrilaterals and
  hexahedra of any degree exactly, and in linear triangles and tetrahedra exactly the spring
  integrated at the nodes. What is left is the change of the section by h, in proportion to h
  (relative change of a frequency at most 0.2 h over the plate's thickness).
- Quadratic triangles and tetrahedra have a thin limit of their own, slightly stiffer than that
  spring. The difference is one of in-plane size, not of aspect, and vanishes with it: at most
  0.07 % of a frequency for 10 mm triangles on 8 mm plates, 0.01 % for 5 mm; tetrahedra of 20 mm
  0.4 %. Prefer quadrilaterals or hexahedra in the layer.
- `isotropic_layer` resists in-plane strain too. Where its moduli are far below the parts', as in
  a joint, that is negligible: it is a spring with k_n = (lambda + 2G)/h, not E/h, and k_t = G/h.
  As nu tends to 0.5 (E to 3G) that k_n is unbounded and the layer is rigid in the normal
  direction, at any thickness (the ratio to E/h is (1 - nu)/((1 + nu)(1 - 2 nu)): 1.3 at nu = 0.3,
  167 at 0.499). Linear cells lock on top of that when they are thick: 3 to 6 % of a frequency at
  nu = 0.49999 and aspect 10, below 0.02 % at aspect 1000; quadratic cells do not.
- Round-off: for constant E/h the condition number does not depend on the aspect ratio; for
  constant E it grows in proportion to it. At an aspect of 100 000 the loss is below 1e-8 of a
  frequency.
- The parts around the layer matter more than the layer: of degree 1 they lock in bending, see
  `fenics_joints.forms.elasticity`.
"""

from __future__ import annotations

import ufl

from fenics_joints.forms.checks import check
from fenics_joints.forms.elasticity import isotropic_stress, lame_from_moduli
from fenics_joints.forms.kinematics import layer_strain, strain, stretched_gradient


def uncoupled_layer_stress(eps_n, gamma_t, E_n, G_t):
    """Normal and tangential stress, Pa, of the uncoupled layer (Tian et al. 2021, eq. 5).

    Args:
        eps_n: Normal strain, scalar.
        gamma_t: Engineering shear strain in the tangent plane, shape (gdim,).
        E_n: Normal modulus, Pa.
        G_t: Tangential modulus, Pa.

    Raises:
        InputError: A modulus is a number that is negative or not finite.
    """
    check("E_n", E_n, "Pa", least=0)
    check("G_t", G_t, "Pa", least=0)
    return E_n * eps_n, G_t * gamma_t


def uncoupled_layer(u, v, normal, E_n, G_t, dx=ufl.dx, *, stretch=None):
    """Stiffness form of the thin layer with independent normal and shear response (eq. 5).

    Args:
        u: Trial function or displacement, shape (gdim,), m.
        v: Test function, shape (gdim,).
        normal: Unit normal of the layer, shape (gdim,); its sign does not matter.
        E_n: Normal modulus, Pa; a spring k_n (Pa/m) across a layer of thickness h is E_n = k_n h.
        G_t: Tangential modulus, Pa; likewise G_t = k_t h.
        dx: Cell measure over the layer.
        stretch: Actual over meshed thickness of the layer; None is 1.
    """
    eps_u, gamma_u = layer_strain(stretched_gradient(u, normal, stretch), normal)
    eps_v, gamma_v = layer_strain(stretched_gradient(v, normal, stretch), normal)
    sigma, tau = uncoupled_layer_stress(eps_u, gamma_u, E_n, G_t)
    jacobian = 1 if stretch is None else stretch
    return jacobian * (sigma * eps_v + ufl.dot(tau, gamma_v)) * dx


def isotropic_layer(u, v, E, G, dx=ufl.dx, *, normal=None, stretch=None):
    """Stiffness form of the isotropic thin layer with all six strains (eqs. 6 and 7).

    ``E`` and ``G`` in Pa, 0 < E < 3 G; other arguments as in `uncoupled_layer`. The normal is
    needed for a stretch only.
    """
    eps_u = strain(stretched_gradient(u, normal, stretch))
    eps_v = strain(stretched_gradient(v, normal, stretch))
    jacobian = 1 if stretch is None else stretch
    return jacobian * ufl.inner(isotropic_stress(eps_u, *lame_from_moduli(E, G)), eps_v) * dx


def constrained_layer(u, v, normal, E, G, dx=ufl.dx, *, stretch=None):
    """Isotropic thin layer without its in-plane strains (eq. 8): lambda + 2G normal, G in shear."""
    lmbda, mu = lame_from_moduli(E, G)
    return uncoupled_layer(u, v, normal, lmbda + 2 * mu, mu, dx, stretch=stretch)
