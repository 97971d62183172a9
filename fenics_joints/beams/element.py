"""Offset Timoshenko beam and generic joint element (Jalali et al. 2019), as sums of matrices.

Two nodes with (u, w, theta) each: displacement along the reference line, across it, and rotation,
theta = dw/dx. The neutral axis lies a distance q above the reference line, where the axial
displacement is u - q theta; q = h/2 for the upper beam and -h/2 for the lower one, so that both
have their nodes on the interface.

With extension v = (u2 - u1) - q (theta2 - theta1), bending t = theta2 - theta1 and
g = theta1 + theta2 - 2 (w2 - w1) / L the energies of eqs. 1 and 2 are half of

    beam:   E A / L v^2 + E I / L t^2 + 3 E I / ((1 + phi) L) g^2,
    joint:  2 k_A (u2 - u1)^2 + k2 t^2 + k1 g^2,

so a joint that does not slip has k2 = E I / L and k1 = 3 E I / ((1 + phi) L) of the two beams as
one; k1 (slap) and k2 (slip) are in N m.

Misprints of the paper, each found by the symmetry and the rigid-body modes of the matrix, or by
integrating the shape functions (tests/beams/test_structure.py has A2 to A7 as they should be):

* eq. 1, entry (4, 4): ``k`` is k_A; entries (4, 6) and (6, 4): ``k_A q`` is -k_A q. As printed, a
  rotation about a point of the reference line is resisted by the force 2 k_A q theta.
* eq. 2, entries (5, 2) and (6, 2), missing: -4 k1 and 2 L k1, with (5, 3) the -2 L k1 printed.
* eq. 2, entries (1, 1), (1, 4), (4, 1), (4, 4): 2 k_A is 2 L^2 k_A, for the factor 1 / L^2 before
  the matrix and k_A = E A / L. As printed it is of another unit, and 1e4 times as large at the
  paper's L = 10 mm: no frequency of Table 1 but the eighth, which then is 3.3 % higher and off,
  notices.
* A6: 1/150 is 1/105 (Przemieniecki, Theory of Matrix Structural Analysis, 1968, eq. 11.83).
* "The effect of offsetting on the mass matrix is negligible" (below eq. 1): without it the rotary
  inertia per length is that about the reference line of a body whose centre is there, but an axial
  displacement u of the reference line moves the centre by u - q theta. In the paper's structure
  the offset's share of the mass moves modes 2 to 8 by 0.6 to 1.7 %; so it is an option here.

A beam is one region with its stiffness and the first of its mass terms, and one region without
stiffness for each further mass term: a region of `reduction.affine` has a single scalar of
mass, and that of a Timoshenko beam depends on Poisson's ratio and on the height in nine.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fenics_joints.errors import InputError
from fenics_joints.preload.beam import bending_mass, bending_rows, bending_shapes
from fenics_joints.reduction.files import register
from fenics_joints.structure.laws import Law

#: Of (u1, w1, theta1, u2, w2, theta2) those that move across and turn.
_ACROSS = np.array([1, 2, 4, 5])


def bending_number(nu, height, length, shear):
    """phi = 12 E I alpha / (G A L^2), eq. 1, of a rectangular section.

    Args:
        nu: Poisson's ratio.
        height: Height h of the section, m.
        length: Length L of the element, m.
        shear: Shear area coefficient alpha, 1.2 for a rectangle.
    """
    return 2 * (1 + nu) * shear * (height / length) ** 2


# -- matrices ----------------------------------------------------------------------------------


def _rows(length: float) -> np.ndarray:
    """Rows over (u1, w1, theta1, u2, w2, theta2): extension at q = 0, t and g."""
    rows = np.zeros((3, 6))
    rows[0, [0, 3]] = -1.0, 1.0
    rows[1:, _ACROSS] = bending_rows(length)
    return rows


def stiffness_matrices(length: float) -> np.ndarray:
    """Matrices of eq. 1, shape (4, 6, 6).

    Their factors are E A, E A q, E A q^2 + E I and E I / (1 + phi).

    Args:
        length: Length L of the element, m.
    """
    extension, bending, _ = _rows(length)
    mixed = np.outer(extension, bending)
    slap, slip, axial = joint_matrices(length)
    return np.array([axial, -mixed - mixed.T, slip, 3 * slap]) / length


def joint_matrices(length: float) -> np.ndarray:
    """Matrices of eq. 2, shape (3, 6, 6); their factors: k1, k2 (N m), the axial 2 k_A (N/m).

    That of eq. 3, whose factor is c, N m s, is k2's: slip alone is damped.
    """
    extension, bending, sway = _rows(length)
    return np.array([np.outer(row, row) for row in (sway, bending, extension)])


def mass_matrices(length: float) -> np.ndarray:
    """Matrices of A1, shape (9, 6, 6), and of the offset.

    Their factors are rho A times 1, q, q^2 (what moves along), then times 1, phi, phi^2 and r^2,
    r^2 phi, r^2 phi^2 over (1 + phi)^2 (what moves across), with r the radius of gyration, m.

    Args:
        length: Length L of the element, m.
    """
    along = length / 6 * np.array([[2, 1], [1, 2]])
    u, theta = np.eye(6)[[0, 3]], np.eye(6)[[2, 5]]
    mixed = u.T @ along @ theta
    across = np.zeros((6, 6, 6))
    across[:, _ACROSS[:, None], _ACROSS] = bending_mass(length).reshape(6, 4, 4)
    return np.array([u.T @ along @ u, -mixed - mixed.T, theta.T @ along @ theta, *across])


def shape_functions(t: float, length: float, phi: float) -> tuple[np.ndarray, np.ndarray]:
    """Rows of u, w, theta at x = t L of an element, and of their slopes by x; each (3, 6).

    Those of a Timoshenko beam that is loaded at its ends only: A1 is their mass matrix. Axial
    displacements are linear between the nodes.

    Args:
        t: Place in the element, from 0 to 1.
        length: Its length, m.
        phi: See `bending_number`.
    """
    shapes = bending_shapes(t, length)
    w, slope, turn, bend = (shapes[:, 0] + phi * shapes[:, 1]) / (1 + phi)
    rows = np.zeros((2, 3, 6))
    rows[:, 0, 0], rows[:, 0, 3] = (1 - t, -1 / length), (t, 1 / length)
    rows[:, 1:, _ACROSS] = [[w, turn], [slope, bend]]
    return rows[0], rows[1]


# -- their factors, as laws of regions ---------------------------------------------------------

#: Properties of a beam's region: E, Pa; nu; rho, kg/m3; stretch and width, actual over nominal
#: height and breadth; height, breadth and length of the element, m; shear coefficient; offset of
#: the neutral axis over the height, in the stiffness and in the mass.
SECTION = (
    "E",
    "nu",
    "rho",
    "stretch",
    "width",
    "height",
    "breadth",
    "length",
    "shear",
    "offset",
    "mass_offset",
)


def _above_zero(value):
    return (value > 0) & (value < np.inf)


def _not_below_zero(value):
    return (value >= 0) & (value < np.inf)


#: Range of each property, for one value or many, and in words.
_RANGES = {
    "E": (_above_zero, "E > 0 Pa"),
    "nu": (lambda value: (value > -1) & (value < 0.5), "-1 < nu < 0.5"),
    "rho": (_not_below_zero, "rho >= 0 kg/m3"),
    **{key: (_above_zero, f"{key} > 0") for key in ("stretch", "width", "shear", "axial")},
    **{key: (_above_zero, f"{key} > 0 m") for key in ("height", "breadth", "length")},
    **{key: (_above_zero, f"{key} > 0 N m") for key in ("k1", "k2")},
    # Zero leaves a lap that slides.
    "k_axial": (_not_below_zero, "k_axial >= 0 N/m"),
}


def _check(where: str, q) -> None:
    for key, value in q.items():
        inside, words = _RANGES.get(key, (None, ""))
        good = inside is None or inside(value)
        if good is not True and not np.all(good):
            bad = np.atleast_1d(value)[~np.atleast_1d(good)][0]
            # Names of a joint's regions begin with the joint's.
            owner = where.partition(".")[0] if key in ("axial", "k1", "k2", "k_axial") else where
            raise InputError(f"{owner}.{key} = {bad:g} is out of range: expected {words}.")


def _section(q):
    """Height, m, area, m2, and phi."""
    height = q["height"] * q["stretch"]
    phi = bending_number(q["nu"], height, q["length"], q["shear"])
    return height, height * q["breadth"] * q["width"], phi


def _beam_stiffness(q) -> np.ndarray:
    height, area, phi = _section(q)
    EA, arm = q["E"] * area, q["offset"] * height
    EI = EA * height**2 / 12
    return np.array([EA, EA * arm, EA * arm**2 + EI, EI / (1 + phi)])


def _beam_mass(number: int) -> Callable:
    """The factor of a matrix of `mass_matrices`."""

    def heavy(q):
        height, area, phi = _section(q)
        if number < 3:
            return q["rho"] * area * (q["mass_offset"] * height) ** number
        by_phi, across = (number - 3) % 3, height**2 / 12 if number > 5 else 1.0
        return q["rho"] * area * across * phi**by_phi / (1 + phi) ** 2

    return heavy


def _none(*arguments):
    raise NotImplementedError("laws of beams have matrices, no forms")


def _law(name: str, properties: tuple[str, ...], terms, heavy, check=_check) -> Law:
    return Law(name, properties, _none, terms, (), check, inertia=_none, inertia_term=heavy)


def _joint_law(name: str, *properties: str) -> Law:
    """The law of a joint element: one stiffness, the product of its properties, and no mass."""

    def stiffness(q):
        return np.array([np.prod([q[key] for key in properties], axis=0)])

    return _law(name, properties, stiffness, lambda q: 0.0 * q[properties[0]])


#: A beam by itself.
BEAM = _law("offset beam", SECTION, _beam_stiffness, _beam_mass(0))
#: A beam in a lap: the joint elements have its stiffness, all but the axial one.
LAPPED = _law(
    "lapped beam", (*SECTION, "axial"), lambda q: q["axial"] * _beam_stiffness(q)[:1], _beam_mass(0)
)


def _no_stiffness(q) -> np.ndarray:
    return np.zeros((0, *np.shape(q["E"])))


def _checked_before(where: str, q) -> None:
    """The beam's own region has the same properties."""


#: The further terms of a beam's mass.
BEAM_MASSES = tuple(
    _law(f"beam mass {i}", SECTION, _no_stiffness, _beam_mass(i), _checked_before)
    for i in range(1, 9)
)
#: Generic joint elements (Jalali et al. 2019, eq. 2): k1, k2 in N m, k_axial in N/m.
SLAP, SLIP = _joint_law("slap", "k1"), _joint_law("slip", "k2")
AXIAL = _joint_law("axial", "k_axial", "axial")

register(BEAM, LAPPED, *BEAM_MASSES, SLAP, SLIP, AXIAL)
