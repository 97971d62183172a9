"""Strains, in the geometry of the mesh or in one stretched along a direction.

A stretch maps the mesh to a body whose extent along ``normal`` is ``stretch`` times the mesh's, so
that a plate's or a layer's thickness becomes a parameter of the form, with an exact derivative and
no new mesh. With F = I + (stretch - 1) n n^T: grad_x u = grad_X u F^-1 and dx = stretch dX. A width
along a direction at right angles to ``normal`` is a second factor of the same kind.
"""

from __future__ import annotations

import ufl

from fenics_joints.errors import InputError
from fenics_joints.forms.checks import check, unit_vector


def stretched_gradient(u, normal=None, stretch=None, across=None, width=None):
    """Displacement gradient in the geometry stretched along one or two directions.

    Args:
        u: Displacement, shape (gdim,), m.
        normal: Unit direction of the stretch, shape (gdim,); not needed without a stretch.
        stretch: Ratio of actual to meshed extent along ``normal``, scalar > 0; None is 1.
        across: Unit direction of a second stretch, at right angles to ``normal``, shape (gdim,).
        width: Ratio of actual to meshed extent along ``across``, scalar > 0; None is 1.

    Returns:
        UFL expression of shape (gdim, gdim), row i the gradient of component i.

    Raises:
        InputError: A stretch without its direction, a direction of zero, or a stretch that is not
            above 0.
    """
    gradient = ufl.grad(u)
    if stretch is not None and normal is None:
        raise InputError("stretch is given without normal: it needs the direction of the stretch")
    if width is not None and across is None:
        raise InputError("width is given without across: it needs the direction of the width")
    stretched = gradient
    if stretch is not None:
        check("stretch", stretch, above=0)
        normal = unit_vector("normal", normal, gradient.ufl_shape[1])
        stretched += (1 / stretch - 1) * ufl.outer(gradient * normal, normal)
    if width is not None:
        check("width", width, above=0)
        across = unit_vector("across", across, gradient.ufl_shape[1])
        stretched += (1 / width - 1) * ufl.outer(gradient * across, across)
    return stretched


def strain(gradient):
    """Small-strain tensor, shape (gdim, gdim), of a displacement gradient of that shape."""
    return ufl.sym(gradient)


def layer_strain(gradient, normal):
    """Normal and tangential strain of a thin layer (Tian et al. 2021, before eq. 5).

    The in-plane strains are left out, as the paper does; the in-plane gradient of the normal
    displacement stays in the shear strain, since without it a rigid rotation would strain the
    layer.

    Args:
        gradient: Displacement gradient, shape (gdim, gdim).
        normal: Unit normal of the layer, shape (gdim,).

    Returns:
        (eps_n, gamma_t): scalar normal strain, and the engineering shear strain as a vector in
        the tangent plane, shape (gdim,). Both are unchanged when ``normal`` changes sign, but for
        the sign of ``gamma_t``.

    Raises:
        InputError: The normal is no direction.
    """
    normal = unit_vector("normal", normal, gradient.ufl_shape[1])
    eps_n = ufl.dot(normal, gradient * normal)
    shear = gradient * normal + ufl.transpose(gradient) * normal
    gamma_t = shear - ufl.dot(shear, normal) * normal
    return eps_n, gamma_t
