"""Zero-thickness spring interface on interior facets (Tian et al. 2021, eq. 1; Goodman)."""

from __future__ import annotations

import ufl

from fenics_joints.forms.checks import check, unit_vector


def spring_traction(jump, normal, k_n, k_t):
    """Traction, Pa, that a displacement jump, m, meets (Tian et al. 2021, eq. 1).

    Args:
        jump: Displacement jump across the interface, shape (gdim,).
        normal: Unit normal, shape (gdim,); its sign does not matter.
        k_n: Normal stiffness per area, Pa/m.
        k_t: Tangential stiffness per area, Pa/m.

    Raises:
        InputError: A stiffness is a number that is negative or not finite; the normal is no
            direction.
    """
    check("k_n", k_n, "Pa/m", least=0)
    check("k_t", k_t, "Pa/m", least=0)
    normal = unit_vector("normal", normal, jump.ufl_shape[0])
    normal_jump = ufl.dot(jump, normal) * normal
    return k_n * normal_jump + k_t * (jump - normal_jump)


def spring_interface(jump_u, jump_v, normal, k_n, k_t, dS):
    """Stiffness form of linear springs between the two sides of an interface.

    The displacement must be able to jump there: a discontinuous space, or one function for each
    side. Both jumps are taken the same way round (``ufl.jump(u)``, or ``u1("+") - u2("-")`` for
    two functions); which side is "+" does not matter, since the form is quadratic.

    Args:
        jump_u: Jump of the trial function or displacement, shape (gdim,), m.
        jump_v: Jump of the test function, shape (gdim,).
        normal: Unit normal, ``ufl.FacetNormal(msh)("+")`` or a constant, shape (gdim,).
        k_n: Normal stiffness per area, Pa/m.
        k_t: Tangential stiffness per area, Pa/m.
        dS: Interior-facet measure over the interface. In parallel the mesh needs
            ``GhostMode.shared_facet``.
    """
    return ufl.dot(spring_traction(jump_u, normal, k_n, k_t), jump_v) * dS
