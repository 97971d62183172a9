"""Pressure under a bolt and the layer graded by it (Tian et al. 2021, eqs. 19 to 25)."""

from __future__ import annotations

from numbers import Real

import ufl

from fenics_joints.errors import InputError
from fenics_joints.forms.checks import check


def radius(x, centre, normal):
    """Distance, m, of the point ``x`` from the bolt's axis through ``centre`` along ``normal``."""
    offset = x - centre
    offset = offset - ufl.dot(offset, normal) * normal
    # The tiny term keeps the derivative of the root finite on the axis.
    return ufl.sqrt(ufl.dot(offset, offset) + 1e-24)


def contact_radius(head_radius, thickness, cone_angle):
    """Largest radius r_m, m, that the bolt presses (eq. 21): r_b + h tan(alpha), alpha in rad."""
    check("head_radius", head_radius, "m", above=0)
    check("thickness", thickness, "m", least=0)
    check("cone_angle", cone_angle, "rad", least=0, most=1.57)
    return head_radius + thickness * ufl.tan(cone_angle)


def peak_pressure(force, r_hole, r_contact, *, open_hole=False):
    """Peak pressure P_max, Pa, of the linear cone that carries the bolt force (eq. 19).

    Eq. 19 is the volume of a full frustum: it counts the pressure P_max over the hole as well,
    in line with the paper's model, which has no hole. With ``open_hole`` the pressure acts on the
    ring r_hole < r < r_contact alone and the force is balanced by that.

    Args:
        force: Bolt force F_b, N.
        r_hole: Radius of the hole r_i, m.
        r_contact: Contact radius r_m, m, from `contact_radius`.
        open_hole: Whether the hole is meshed as a hole.

    Raises:
        InputError: The radii are numbers and the hole is not the smaller one.
    """
    check("force", force, "N", least=0)
    check("r_hole", r_hole, "m", least=0)
    check("r_contact", r_contact, "m", above=0)
    if isinstance(r_hole, Real) and isinstance(r_contact, Real) and not 0 <= r_hole < r_contact:
        raise InputError(
            f"r_contact = {r_contact} m with r_hole = {r_hole} m: expected 0 <= r_hole < r_contact"
        )
    square = r_contact**2 + r_contact * r_hole
    square = square - 2 * r_hole**2 if open_hole else square + r_hole**2
    return 3 * force / (ufl.pi * square)


def pressure_cone(r, force, r_hole, r_contact, *, open_hole=False):
    """Contact pressure P(r), Pa, falling linearly from P_max at the hole to 0 at r_m (eq. 20).

    Inside the hole's radius it is P_max (the hole is not meshed) or, with ``open_hole``, 0.
    Its integral over the plane is ``force``. Arguments as in `peak_pressure`; ``r`` in m.
    """
    peak = peak_pressure(force, r_hole, r_contact, open_hole=open_hole)
    slope = peak * (r_contact - r) / (r_contact - r_hole)
    inside = 0.0 if open_hole else peak
    outer = ufl.conditional(ufl.lt(r, r_contact), slope, 0.0)
    return ufl.conditional(ufl.lt(r, r_hole), inside, outer)


def graded_modulus(pressure, alpha, beta, thickness, floor=0.0):
    """Layer modulus, Pa, graded by the pressure (eqs. 22 to 25).

    E(r) = alpha_n P^beta_n h, and G(r) likewise with alpha_t, beta_t: the stiffness per area
    K = alpha P^beta, Pa/m, spread over the layer's thickness h.

    Args:
        pressure: Contact pressure, Pa, >= 0.
        alpha: Stiffness per area at unit pressure, (Pa/m)/Pa^beta.
        beta: Exponent, > 0.
        thickness: Thickness h of the layer, m.
        floor: Modulus, Pa, that remains without pressure; 0 leaves the layer open there.
    """
    check("pressure", pressure, "Pa", least=0)
    check("alpha", alpha, "(Pa/m)/Pa^beta", least=0)
    check("beta", beta, above=0)
    check("thickness", thickness, "m", above=0)
    check("floor", floor, "Pa", least=0)
    # P**beta has no derivative at P = 0: the conditional keeps that point out.
    safe = ufl.conditional(ufl.gt(pressure, 0.0), pressure, 1.0)
    stiffness = ufl.conditional(ufl.gt(pressure, 0.0), alpha * safe**beta, 0.0)
    return stiffness * thickness + floor
