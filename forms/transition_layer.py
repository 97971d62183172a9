"""Transition-interface material of a bolted joint in 3-D (Machines 2022, sections 2 and 4).

The joint of one bolt is a ring of material, R_nei < r < R_wai and h thick (Figure 3c), fixed to
both bodies: displacement and traction are continuous there (eqs. 2, 3), so that nothing but the
material makes it a joint. Its law is isotropic elasticity with all six strains, E and mu uniform
(eqs. 7, 8); its density is the average of the bodies' or zero (eq. 9 and what follows it).

The thickness is a number of the form, like E and mu. The mesh has a layer ``meshed`` = h0 thick;
the map x_n -> x_n h / h0 of the layer alone has F = I + (h/h0 - 1) n n^T, and with
grad_x u = grad_X u F^-1 and dx = (h/h0) dX the form is that of a layer h thick. The two bodies move
apart by h - h0 as they are. That changes none of their matrices, since these hold gradients and
volumes but no positions, and so the mapped model is the remeshed one, exactly: if the layer's sides
are upright, and if nothing but layers of the same h joins the bodies, so that they can move apart.
Rings of several h between the same two faces fit no geometry; h is then the thickness of each
ring's own material. Springs, masses and supports move with the body that has them.

The graded form, which the paper calls right and replaces by the uniform one, is E and mu as UFL
expressions of the place in the same forms. The paper says of it that the properties follow the
contact pressure (eqs. 7 to 9) and "shall change smoothly through its thickness as a gradient way",
and gives no law. The one here is a choice, `transition_modulus`: along the radius a power of the
contact pressure over its mean, so that E is that of a ring under its mean pressure; through the
thickness from the joint's value at the middle to the bodies' own at the faces, by a power of the
distance from the middle, ln E and mu being interpolated. Between bodies much stiffer than the
joint the exponent m sets how much of the thickness is joint; m to infinity is the uniform ring.
"""

from __future__ import annotations

from numbers import Real

import ufl

from fenics_joints.errors import InputError
from fenics_joints.forms.checks import check
from fenics_joints.forms.elasticity import elasticity, mass
from fenics_joints.forms.pressure import pressure_cone


def _stretch(thickness, meshed):
    """Actual over meshed thickness; None for the layer as it is meshed."""
    if thickness is None and meshed is None:
        return None
    if thickness is None or meshed is None:
        raise InputError("thickness and meshed: expected both, in metres, or neither")
    for name, value in (("thickness", thickness), ("meshed", meshed)):
        check(name, value, "m", above=0)
    return thickness / meshed


def transition_layer(u, v, E, mu, dx=ufl.dx, *, normal=None, thickness=None, meshed=None):
    """Stiffness form of the transition-interface material.

    Args:
        u: Trial function or displacement, shape (gdim,), m.
        v: Test function, shape (gdim,).
        E: Young's modulus, Pa: a number, or an expression of the place.
        mu: Poisson's ratio, -1 < mu < 0.5, likewise.
        dx: Cell measure over the ring. That of a graded ring needs a quadrature degree of its own:
            `transition_modulus` is no polynomial.
        normal: Unit normal of the layer, shape (gdim,); needed with a thickness only.
        thickness: Thickness h, m; None for the mesh's.
        meshed: Thickness h0 of the layer in the mesh, m.

    Returns:
        Bilinear (or, for given functions, scalar) UFL form.

    Raises:
        InputError: A number is out of range, or one of the thicknesses is missing.
    """
    stretch = _stretch(thickness, meshed)
    return elasticity(u, v, E, mu, dx, normal=normal, stretch=stretch)


def transition_mass(u, v, rho, dx=ufl.dx, *, thickness=None, meshed=None):
    """Consistent mass form of the layer.

    ``rho`` in kg/m3 is `average_density` or zero: the paper takes the average of the connected
    bodies (section 2, end), and allows zero, "because the density of the connecting bodies is
    assumed to unchanged" (after eq. 9), which fits where the layer is thin or its volume is counted
    in the bodies. Thicknesses as in `transition_layer`.
    """
    return mass(u, v, rho, dx, stretch=_stretch(thickness, meshed))


def average_density(rho_1, rho_2):
    """Density of the layer, kg/m3: the mean of the bodies' (Machines 2022, section 2, end)."""
    check("rho_1", rho_1, "kg/m3", least=0)
    check("rho_2", rho_2, "kg/m3", least=0)
    return 0.5 * (rho_1 + rho_2)


def layer_position(x, middle, normal, meshed):
    """Place through the layer: -1 at its lower face, 0 at the middle, 1 where ``normal`` points.

    The same for any thickness h, since the map takes faces to faces.

    Args:
        x: Point of the mesh, ``ufl.SpatialCoordinate(msh)``, shape (gdim,).
        middle: A point of the layer's middle plane in the mesh, shape (gdim,), m.
        normal: Unit normal of the layer, shape (gdim,).
        meshed: Thickness h0 of the layer in the mesh, m.
    """
    check("meshed", meshed, "m", above=0)
    return 2 * ufl.dot(x - middle, normal) / meshed


def ring_pressure(r, force, r_nei, r_wai, limit=1e6):
    """Contact pressure, Pa, on a ring: linear from its peak at R_nei to ``limit`` at R_wai.

    R_wai is by definition where the pressure falls to P_lim (eq. 10), 1 MPa in the paper; that it
    falls linearly is the simplest shape with that end that carries the bolt's force. 0 elsewhere.

    Args:
        r: Distance from the bolt's axis, m, from `fenics_joints.forms.radius`.
        force: Tightening force, N.
        r_nei: Inner radius of the ring, m.
        r_wai: Outer radius of the ring, m.
        limit: Pressure P_lim at the outer radius, Pa.

    Raises:
        InputError: A number is out of range; or all are numbers, and the force is less than the
            limit on all of the ring.
    """
    _check_ring(force, r_nei, r_wai)
    check("limit", limit, "Pa", least=0)
    area = ufl.pi * (r_wai**2 - r_nei**2)
    rest = force - limit * area
    if isinstance(rest, Real) and rest < 0:
        raise InputError(
            f"force = {force:g} N: expected at least {limit * area:g} N, the limit of {limit:g} Pa "
            f"on the ring from {r_nei:g} to {r_wai:g} m"
        )
    inside = ufl.And(ufl.ge(r, r_nei), ufl.le(r, r_wai))
    cone = pressure_cone(r, rest, r_nei, r_wai, open_hole=True)
    return ufl.conditional(inside, limit + cone, 0.0)


def _check_ring(force, r_nei, r_wai) -> None:
    check("force", force, "N", least=0)
    check("r_nei", r_nei, "m", least=0)
    check("r_wai", r_wai, "m", above=0)
    if isinstance(r_nei, Real) and isinstance(r_wai, Real) and not r_nei < r_wai:
        raise InputError(f"r_wai = {r_wai} m with r_nei = {r_nei} m: expected r_nei < r_wai")


def transition_modulus(position, E, E_lower, E_upper, *, through=2, load=1, along=1):
    """Young's modulus, Pa, graded through the thickness and along the radius.

    E(zeta, r) = (E (P / P_mean)^beta)^(1 - w) E_body^w with w = |zeta|^m: the body's own modulus at
    each face, the joint's at the middle, ln E interpolated between them.

    Args:
        position: zeta from `layer_position`, -1 to 1.
        E: Modulus of the joint at the middle, under the mean pressure, Pa.
        E_lower: Modulus of the body at zeta = -1, Pa.
        E_upper: Modulus of the body at zeta = 1, Pa.
        through: Exponent m > 0; 2 is smooth.
        load: Contact pressure over its mean, P(r) / P_mean, > 0; 1 is even.
        along: Exponent beta; 1 as for the stiffness of rough faces under light loads, and then the
            mean of E over the ring is ``E``.

    Raises:
        InputError: A modulus, ``through`` or ``load`` is a number that is not above 0.
    """
    for name, modulus in (("E", E), ("E_lower", E_lower), ("E_upper", E_upper)):
        check(name, modulus, "Pa", above=0)
    check("load", load, above=0)
    check("along", along)
    middle = E * load**along if _counts(load, along) else E
    w = _blend(position, through)
    body = ufl.conditional(ufl.lt(position, 0), E_lower, E_upper)
    return ufl.exp((1 - w) * ufl.ln(middle) + w * ufl.ln(body))


def transition_poisson(position, mu, mu_lower, mu_upper, *, through=2):
    """Poisson's ratio (or a density) graded through the thickness: (1 - w) mu + w mu_body.

    Arguments as in `transition_modulus`.
    """
    for name, ratio in (("mu", mu), ("mu_lower", mu_lower), ("mu_upper", mu_upper)):
        check(name, ratio, above=-1)
    w = _blend(position, through)
    return (1 - w) * mu + w * ufl.conditional(ufl.lt(position, 0), mu_lower, mu_upper)


def _counts(load, along) -> bool:
    even = isinstance(load, Real) and load == 1
    return not even and not (isinstance(along, Real) and along == 0)


def _blend(position, through):
    """Share of the body, |zeta|^m: 0 at the middle, 1 at the faces."""
    check("through", through, above=0)
    # The square root keeps the derivative finite at the middle.
    return (position**2 + 1e-24) ** (0.5 * through)
