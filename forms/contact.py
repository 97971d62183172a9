"""Contact and friction laws as pure functions: from a displacement jump to tractions, Pa.

One convention of signs throughout. An interface has a lower and an upper side; the unit normal
points from the lower to the upper; a jump is upper minus lower. The gap is positive where the sides
are apart; a pressure is positive in compression; a friction traction points along the slip, as the
force that has to be applied to make the interface slip (and as in `spring_interface`).

On interior facets between discontinuous functions the normal ``n = ufl.FacetNormal(msh)("+")``
points out of the "+" side, so that "+" is the lower side: take ``u("-") - u("+")``, which is
``-ufl.jump(u)``. When the two sides change names, normal and jump both change sign, and gap and
residual stay as they are.

A residual with contact in it is nonlinear; its tangent is ``ufl.derivative(residual, u)``, which is
the consistent one of each law: symmetric but in sliding, where the friction follows the pressure.
"""

from __future__ import annotations

import ufl

from fenics_joints.forms.checks import check, unit_vector


def contact_gap(jump, normal, initial_gap=0.0):
    """Gap, m: the one without displacement plus the jump along the normal.

    Args:
        jump: Displacement of the upper minus that of the lower side, shape (gdim,), m.
        normal: Unit normal from the lower to the upper side, shape (gdim,).
        initial_gap: Gap without displacement, m; negative is an interference fit.
    """
    check("initial_gap", initial_gap, "m")
    return initial_gap + ufl.dot(jump, unit_vector("normal", normal, jump.ufl_shape[0]))


def contact_slip(jump, normal):
    """Slip, m, shape (gdim,): the part of the jump in the plane of the interface."""
    normal = unit_vector("normal", normal, jump.ufl_shape[0])
    return jump - ufl.dot(jump, normal) * normal


def penalty_pressure(gap, stiffness):
    """Pressure, Pa, of a one-sided spring of ``stiffness`` (Pa/m): stiffness * max(0, -gap)."""
    check("stiffness", stiffness, "Pa/m", least=0)
    return stiffness * ufl.max_value(0.0, -gap)


def augmented_pressure(multiplier, gap, stiffness):
    """Pressure, Pa, of the augmented Lagrangian: max(0, multiplier - stiffness * gap).

    (Alart and Curnier, Comput. Methods Appl. Mech. Eng. 92, 1991, eq. 3.1, signs as here.) The
    pressure is the next multiplier of an Uzawa iteration; at its end, multiplier = pressure and the
    sides touch without penetration, whatever the stiffness.

    Args:
        multiplier: Contact pressure so far, Pa, positive in compression.
        gap: Gap, m.
        stiffness: Stiffness per area of the augmentation, Pa/m.
    """
    check("stiffness", stiffness, "Pa/m", least=0)
    return ufl.max_value(0.0, multiplier - stiffness * gap)


def coulomb_traction(slip, pressure, friction, stiffness):
    """Friction traction, Pa, shape (gdim,): elastic sticking, capped by Coulomb's law.

    stiffness * slip while that is shorter than friction * pressure, and of that length beyond. It
    is linear about zero slip, and zero with a zero tangent where there is no pressure, so that
    ``ufl.derivative`` is finite everywhere.

    For a history of loads pass slip - slid, where slid, of shape (gdim,), is what has slid until
    the last step; after the step it is slip - traction / stiffness, with the slip since the
    beginning (Simo and Hughes, Computational Inelasticity, 1998, sec. 1.2: the same return).

    Args:
        slip: Slip, shape (gdim,), m.
        pressure: Contact pressure, Pa, >= 0.
        friction: Coefficient of friction, >= 0.
        stiffness: Tangential stiffness per area while sticking, Pa/m.
    """
    check("stiffness", stiffness, "Pa/m", least=0)
    check("friction", friction, least=0)
    limit = friction * pressure
    square = ufl.dot(slip, slip)
    # The root has no derivative at zero slip, which can only be chosen there without pressure.
    length = ufl.sqrt(ufl.conditional(ufl.gt(square, 0.0), square, 1.0))
    sticks = ufl.lt(stiffness**2 * square, limit**2)
    return ufl.conditional(sticks, stiffness, limit / length) * slip


def contact_interface(jump_v, normal, pressure, traction, dS):
    """Residual form of an interface: virtual work, N m, of pressure and friction on the jump.

    To be added to the virtual work of the stresses in the parts, so that at rest both together
    equal that of the loads.

    Args:
        jump_v: Test function of the upper minus that of the lower side, shape (gdim,).
        normal: Unit normal from the lower to the upper side, shape (gdim,).
        pressure: Contact pressure, Pa, positive in compression.
        traction: Friction traction along the slip, shape (gdim,), Pa; None without friction.
        dS: Measure over the interface. In parallel the mesh needs ``GhostMode.shared_facet``.
    """
    normal = unit_vector("normal", normal, jump_v.ufl_shape[0])
    residual = -pressure * ufl.dot(normal, jump_v)
    if traction is not None:
        residual += ufl.dot(traction, jump_v)
    return residual * dS
