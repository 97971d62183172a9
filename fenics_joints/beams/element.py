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
integrating the shape functions (tests/beams/test_structure.py):

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
"""

from __future__ import annotations

import numpy as np

#: A to F of the appendix (A2 to A7) as polynomials in phi, lowest power first: what multiplies 1,
#: and what multiplies (r / L)^2; C, D by L and E, F by L^2 besides.
_INERTIA = {
    "A": ((13 / 35, 7 / 10, 1 / 3), (6 / 5, 0.0, 0.0)),
    "B": ((9 / 70, 3 / 10, 1 / 6), (-6 / 5, 0.0, 0.0)),
    "C": ((11 / 210, 11 / 120, 1 / 24), (1 / 10, -1 / 2, 0.0)),
    "D": ((13 / 420, 3 / 40, 1 / 24), (-1 / 10, 1 / 2, 0.0)),
    "E": ((1 / 105, 1 / 60, 1 / 120), (2 / 15, 1 / 6, 1 / 3)),
    "F": ((1 / 140, 1 / 60, 1 / 120), (1 / 30, 1 / 6, -1 / 6)),
}


def bending_number(nu, height, length, shear):
    """phi = 12 E I alpha / (G A L^2), eq. 1, of a rectangular section.

    Args:
        nu: Poisson's ratio.
        height: Height h of the section, m.
        length: Length L of the element, m.
        shear: Shear area coefficient alpha, 1.2 for a rectangle.
    """
    return 2 * (1 + nu) * shear * (height / length) ** 2


def _rows(length: float) -> tuple[np.ndarray, ...]:
    """Rows over (u1, w1, theta1, u2, w2, theta2): extension at q = 0, t and g."""
    extension = np.array([-1.0, 0.0, 0.0, 1.0, 0.0, 0.0])
    bending = np.array([0.0, 0.0, -1.0, 0.0, 0.0, 1.0])
    sway = np.array([0.0, 2 / length, 1.0, 0.0, -2 / length, 1.0])
    return extension, bending, sway


def _between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.outer(a, b) + np.outer(b, a)


def stiffness_matrices(length: float) -> np.ndarray:
    """Matrices of eq. 1, shape (4, 6, 6).

    Their factors are E A, E A q, E A q^2 + E I and E I / (1 + phi).

    Args:
        length: Length L of the element, m.
    """
    extension, bending, sway = _rows(length)
    return (
        np.array(
            [
                np.outer(extension, extension),
                -_between(extension, bending),
                np.outer(bending, bending),
                3 * np.outer(sway, sway),
            ]
        )
        / length
    )


def joint_matrices(length: float) -> np.ndarray:
    """Matrices of eq. 2, shape (3, 6, 6); their factors: k1, k2 (N m), the axial 2 k_A (N/m)."""
    extension, bending, sway = _rows(length)
    return np.array([np.outer(row, row) for row in (sway, bending, extension)])


def joint_damping_matrix() -> np.ndarray:
    """Matrix of eq. 3, shape (6, 6); its factor is c, N m s. It is k2's: slip alone is damped."""
    bending = _rows(1.0)[1]
    return np.outer(bending, bending)


def mass_matrices(length: float) -> np.ndarray:
    """Matrices of A1, shape (9, 6, 6), and of the offset.

    Their factors are rho A times 1, q, q^2 (what moves along), then times 1, phi, phi^2 and r^2,
    r^2 phi, r^2 phi^2 over (1 + phi)^2 (what moves across), with r the radius of gyration, m.

    Args:
        length: Length L of the element, m.
    """
    along = length * np.array([[1 / 3, 1 / 6], [1 / 6, 1 / 3]])
    u, theta = np.zeros((2, 6)), np.zeros((2, 6))
    u[[0, 1], [0, 3]] = theta[[0, 1], [2, 5]] = 1.0
    mixed = u.T @ along @ theta
    found = [u.T @ along @ u, -mixed - mixed.T, theta.T @ along @ theta]
    for which, scale in ((0, 1.0), (1, length**-2)):
        for power in range(3):
            numbers = {key: table[which][power] for key, table in _INERTIA.items()}
            found.append(length * scale * _across(numbers, length))
    return np.array(found)


def _across(numbers, L: float) -> np.ndarray:
    """The pattern of A1 in w and theta."""
    a, b, c, d, e, f = (numbers[key] for key in "ABCDEF")
    c, d, e, f = L * c, L * d, L**2 * e, L**2 * f
    matrix = np.zeros((6, 6))
    matrix[np.ix_([1, 2, 4, 5], [1, 2, 4, 5])] = [
        [a, c, b, -d],
        [c, e, d, -f],
        [b, d, a, -c],
        [-d, -f, -c, e],
    ]
    return matrix


def shape_functions(t: float, length: float, phi: float) -> tuple[np.ndarray, ...]:
    """Rows of u, w, theta at x = t L of an element, and of their slopes by x; each (3, 6).

    Those of a Timoshenko beam that is loaded at its ends only (Friedman and Kosmatka, Comput.
    Struct. 47, 1993): A1 is their mass matrix. Axial displacements are linear between the nodes.

    Args:
        t: Place in the element, from 0 to 1.
        length: Its length, m.
        phi: See `bending_number`.
    """
    L, g = length, 1 / (1 + phi)
    at, slope = np.zeros((3, 6)), np.zeros((3, 6))
    at[0, [0, 3]], slope[0, [0, 3]] = (1 - t, t), (-1 / L, 1 / L)
    columns = [1, 2, 4, 5]
    at[1, columns] = g * np.array(
        [
            1 + phi * (1 - t) - 3 * t**2 + 2 * t**3,
            L * (t - 2 * t**2 + t**3 + phi / 2 * (t - t**2)),
            phi * t + 3 * t**2 - 2 * t**3,
            L * (t**3 - t**2 + phi / 2 * (t**2 - t)),
        ]
    )
    slope[1, columns] = (
        g
        / L
        * np.array(
            [
                -phi - 6 * t + 6 * t**2,
                L * (1 - 4 * t + 3 * t**2 + phi / 2 * (1 - 2 * t)),
                phi + 6 * t - 6 * t**2,
                L * (3 * t**2 - 2 * t + phi / 2 * (2 * t - 1)),
            ]
        )
    )
    at[2, columns] = g * np.array(
        [
            6 * (t**2 - t) / L,
            1 - 4 * t + 3 * t**2 + phi * (1 - t),
            6 * (t - t**2) / L,
            3 * t**2 - 2 * t + phi * t,
        ]
    )
    slope[2, columns] = (
        g
        / L
        * np.array([6 * (2 * t - 1) / L, 6 * t - 4 - phi, 6 * (1 - 2 * t) / L, 6 * t - 2 + phi])
    )
    return at, slope
