"""Stiffness per area of nominally flat, rough faces that are pressed together."""

from __future__ import annotations

import math

from fenics_joints.forms.checks import check

#: u_0 / h_rms of randomly rough elastic faces, whose separation falls with the logarithm of the
#: pressure: 0.4 to 0.5 (B. N. J. Persson, Phys. Rev. Lett. 99 (2007) 125502; S. Akarapu, T. Sharp,
#: M. O. Robbins, Phys. Rev. Lett. 106 (2011) 204301, molecular dynamics and continuum).
_GAMMA = 0.5


def combined_roughness(ra_1: float, ra_2: float | None = None) -> float:
    """Root mean square height, m, of the gap between two faces by the Ra that drawings give.

    Heights are taken to be Gaussian, Rq = sqrt(pi / 2) Ra, and independent: their squares add.

    Args:
        ra_1: Ra of one face, m.
        ra_2: Of the other, m; None: the same.

    Raises:
        InputError: A roughness is not above 0.
    """
    check("ra_1", ra_1, "m", above=0)
    ra_2 = ra_1 if ra_2 is None else ra_2
    check("ra_2", ra_2, "m", above=0)
    return math.sqrt(math.pi / 2) * math.hypot(ra_1, ra_2)


def rough_contact_stiffness(pressure, h_rms, nu):
    """Normal and tangential stiffness per area, Pa/m, of rough faces under a pressure.

    k_n = p / (gamma h_rms) with gamma = 0.5, in proportion to the pressure, as any theory has it in
    which asperities that touch are few (J. A. Greenwood, J. B. P. Williamson, Proc. R. Soc. A 295
    (1966) 300, with exponential heights; Persson 2007); L. Pastewka et al., Phys. Rev. E 87 (2013)
    062809, confirm it over decades of pressure. k_t = k_n 2 (1 - nu) / (2 - nu), as of one round
    spot (R. D. Mindlin, J. Appl. Mech. 16 (1949) 259) and of random ones (C. Campana, B. N. J.
    Persson, M. H. Mueser, J. Phys. Condens. Matter 23 (2011) 085001). Faces are taken to be flat
    but for roughness, metallic and clean, and to stick. It is where to start from, within a factor
    of three or so, not a measurement.

    Args:
        pressure: Mean pressure, Pa; or a UFL expression.
        h_rms: Root mean square height of the gap, m, from `combined_roughness`.
        nu: Poisson's ratio of the bodies.

    Raises:
        InputError: A value is out of range.
    """
    check("pressure", pressure, "Pa", least=0)
    check("h_rms", h_rms, "m", above=0)
    check("nu", nu, "", least=0, most=0.5)
    k_n = pressure / (_GAMMA * h_rms)
    return k_n, k_n * 2 * (1 - nu) / (2 - nu)
