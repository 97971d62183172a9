"""Thin-layer joint materials (seed 001, eqs. 5 to 8) in any direction of the layer's normal.

What thin elements do, and how far to trust them (``tests/test_forms.py`` proves it for aspect
ratios, in-plane size over thickness, from 10 to 1000):

- `uncoupled_layer` neither locks nor loses accuracy: for constant E/h and G/h it tends to a
  zero-thickness spring with k_n = E/h and k_t = G/h, and frequencies change with h only as the
  geometry does.
- `isotropic_layer` resists in-plane strain too. Where its moduli are far below the parts', as in
  a joint, that is negligible; its normal stiffness is the constrained modulus lambda + 2G, not E.
  As nu tends to 0.5 (E to 3G) that modulus is unbounded and the layer locks in the normal
  direction, at any thickness.
- Round-off: the layer's condition number grows as the square of the aspect ratio; up to 1000
  the loss stays below 1e-6 of a frequency. Beyond, use `spring_interface`.
"""

from __future__ import annotations

import ufl

from fenics_joints.forms.elasticity import isotropic_stress, lame_from_moduli
from fenics_joints.forms.kinematics import layer_strain, strain, stretched_gradient

__all__ = ["constrained_layer", "isotropic_layer", "uncoupled_layer", "uncoupled_layer_stress"]


def uncoupled_layer_stress(eps_n, gamma_t, E_n, G_t):
    """Normal and tangential stress, Pa, of the uncoupled layer (seed 001, eq. 5).

    Args:
        eps_n: Normal strain, scalar.
        gamma_t: Engineering shear strain in the tangent plane, shape (gdim,).
        E_n: Normal modulus, Pa.
        G_t: Tangential modulus, Pa.
    """
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
