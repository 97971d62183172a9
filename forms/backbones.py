"""Backbones of joints: stress, Pa, of the first loading by strain (or slip, m, or a force by it).

All work on numbers, NumPy arrays and UFL alike, and are odd in the strain. How a joint unloads is
a matter of its sliders: `fenics_joints.joint_laws.iwan` makes them of any backbone.
"""

from __future__ import annotations

import numpy as np
import ufl
from ufl.core.expr import Expr

from fenics_joints.forms.checks import check


def richard_abbott(strain, E_e, E_p, S_y, n):
    """Stress, Pa, of Richard and Abbott's curve (Iranzad and Ahmadian 2012, eq. 4).

    (E_p + (E_e - E_p) (1 + |(E_e - E_p) e / S_y|^n)^(-1/n)) e: the slope falls from E_e to E_p,
    and the asymptote meets the axis of stress at S_y.

    Args:
        strain: Strain, scalar or array.
        E_e: Slope at rest, Pa.
        E_p: Slope at large strain, Pa.
        S_y: Yield stress, Pa.
        n: Sharpness of the knee, > 0. For derivatives at rest by UFL it has to be above 1.
    """
    _check_knee(E_e, E_p, S_y)
    check("n", n, above=0)
    x = _size((E_e - E_p) * strain / S_y)
    return (E_p + (E_e - E_p) * (1 + x**n) ** (-1 / n)) * strain


def richard_abbott_slope(strain, E_e, E_p, S_y, n):
    """Slope, Pa, of `richard_abbott`, whose arguments it takes."""
    _check_knee(E_e, E_p, S_y)
    check("n", n, above=0)
    x = _size((E_e - E_p) * strain / S_y)
    return E_p + (E_e - E_p) * (1 + x**n) ** (-1 / n - 1)


def segalman_limits(F_S, K_T, chi, beta):
    """Slip of macroslip and density of sliders of the four-parameter Iwan joint.

    Returns:
        (phi_max, R): the slip, m, at which all of the joint slides; R phi^chi below it is the
        density of its sliders (Segalman, J. Appl. Mech. 72, 2005).
    """
    for name, size in (("F_S", F_S), ("K_T", K_T)):
        check(name, size, above=0)
    check("chi", chi, above=-1)
    check("beta", beta, least=0)
    share = beta + (chi + 1) / (chi + 2)
    phi_max = F_S * (1 + beta) / (K_T * share)
    return phi_max, F_S * (chi + 1) / (phi_max ** (chi + 2) * share)


def segalman(slip, F_S, K_T, chi, beta):
    """Force, N, of the four-parameter Iwan joint (Segalman, J. Appl. Mech. 72, 2005).

    Args:
        slip: Relative displacement, m, scalar or array.
        F_S: Force of macroslip, N.
        K_T: Stiffness at rest, N/m.
        chi: Exponent > -1: dissipation grows with amplitude to the power 3 + chi, of metals' joints
            with one between 2 and 3. At -1 the sliders that slip at once would be infinitely stiff.
        beta: Ratio of the stiffness that goes at macroslip to that which went before, >= 0.
    """
    phi_max, R = segalman_limits(F_S, K_T, chi, beta)
    lower = ufl.min_value if _is_ufl(slip, F_S, K_T, chi, beta) else np.minimum
    reached = lower(_size(slip), phi_max)
    force = K_T * reached - R * reached ** (chi + 2) / ((chi + 1) * (chi + 2))
    return _sign(slip) * force


def segalman_slope(slip, F_S, K_T, chi, beta):
    """Slope, N/m, of `segalman`; zero beyond phi_max, the one before it at phi_max itself."""
    phi_max, R = segalman_limits(F_S, K_T, chi, beta)
    slope = K_T - R * _size(slip) ** (chi + 1) / (chi + 1)
    return _where(_size(slip), phi_max, slope, 0.0)


def bilinear(strain, E_e, E_p, S_y):
    """Stress, Pa, of slope E_e up to the yield stress S_y, and E_p, Pa, beyond."""
    _check_knee(E_e, E_p, S_y)
    yielded = S_y / E_e
    return _where(
        _size(strain), yielded, E_e * strain, E_p * strain + _sign(strain) * (E_e - E_p) * yielded
    )


def bilinear_slope(strain, E_e, E_p, S_y):
    """Slope, Pa, of `bilinear`; E_e at the knee itself."""
    _check_knee(E_e, E_p, S_y)
    return _where(_size(strain), S_y / E_e, E_e, E_p)


def _check_knee(E_e, E_p, S_y) -> None:
    check("E_e", E_e, "Pa", above=0)
    check("E_p", E_p, "Pa")
    check("S_y", S_y, "Pa", above=0)


def _is_ufl(*values) -> bool:
    return any(isinstance(value, Expr) for value in values)


def _size(value):
    # UFL's derivative of abs holds a real part, which not all of its compilers know.
    return ufl.conditional(ufl.lt(value, 0), -value, value) if _is_ufl(value) else np.abs(value)


def _sign(value):
    return ufl.sign(value) if _is_ufl(value) else np.sign(value)


def _where(value, limit, below, above):
    """``below`` where value <= limit, else ``above``."""
    if _is_ufl(value, limit):
        return ufl.conditional(ufl.le(value, limit), below, above)
    return np.where(value <= limit, below, above)[()]
