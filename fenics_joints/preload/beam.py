"""One Timoshenko beam element in bending, and a bolt's shank of such elements as dense matrices.

The shape functions contain the shear parameter phi = 12 E I / (kappa G A L^2), so that they solve
the unloaded Timoshenko beam: the stiffness is exact for any number of elements and does not lock
(Friedman and Kosmatka, Computers & Structures 47, 1993; the stiffness is Przemieniecki's, Theory
of Matrix Structural Analysis, 1968, eq. 5.116). The mass is consistent, with rotary inertia. Both
are sums of matrices that depend on the length alone: `fenics_joints.beams` needs them so.

In a plane an element has the degrees of freedom (w1, theta1, w2, theta2); a node of the shank has
six, (ux, uy, uz, rx, ry, rz) in global axes, rotations in rad.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from fenics_joints.structure.faces import frames

#: Deflection at x = t L by (w1, L theta1, w2, L theta2), coefficients of 1, t, t^2, t^3: what is
#: there without shear, and what multiplies phi; both over 1 + phi.
_DEFLECTION = np.array(
    [
        [[1, 0, -3, 2], [0, 1, -2, 1], [0, 0, 3, -2], [0, 0, -1, 1]],
        [[1, -1, 0, 0], [0, 0.5, -0.5, 0], [0, 1, 0, 0], [0, -0.5, 0.5, 0]],
    ]
)


def bending_shapes(t: float, length: float) -> np.ndarray:
    """Deflection, its slope, the section's rotation and the curvature at x = t L, (4, 2, 4).

    Of each the share without phi and the factor of phi, both to be divided by 1 + phi.
    """
    powers = np.array([[1, t, t**2, t**3], [0, 1, 2 * t, 3 * t**2], [0, 0, 2, 6 * t]])
    scale = np.array([1, length, 1, length]) / length ** np.arange(3)[:, None]
    w, slope, bend = np.einsum("pij,dj->dpi", _DEFLECTION, powers) * scale[:, None]
    # Without shear the section stays normal to the line.
    turn = np.array([slope[0], [0, 1 - t, 0, t]])
    return np.array([w, slope, turn, [bend[0], [0, -1 / length, 0, 1 / length]]])


def bending_rows(length: float) -> np.ndarray:
    """t = theta2 - theta1 and g = theta1 + theta2 - 2 (w2 - w1) / L as rows, (2, 4).

    The energy is half of E I / L t^2 + 3 E I / ((1 + phi) L) g^2.
    """
    return np.array([[0, -1, 0, 1], [2 / length, 1, -2 / length, 1]])


def bending_mass(length: float) -> np.ndarray:
    """Mass at rho A = 1, and rotary inertia at rho I = 1, over (1 + phi)^2, (2, 3, 4, 4).

    Of each the factors of 1, phi and phi^2.
    """
    found = np.zeros((2, 3, 4, 4))
    points, weights = np.polynomial.legendre.leggauss(4)  # exact for the cubics' products
    for t, weight in zip((points + 1) / 2, weights * length / 2, strict=True):
        w, _, turn, _ = bending_shapes(t, length)
        for kind, (a, b) in enumerate((w, turn)):
            mixed = np.outer(a, b)
            found[kind] += weight * np.array([np.outer(a, a), mixed + mixed.T, np.outer(b, b)])
    return found


def beam_matrices(
    start: np.ndarray,
    end: np.ndarray,
    *,
    diameter: float,
    E: float,
    nu: float,
    rho: float,
    n_elements: int = 25,
    axial: bool = True,
) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness and mass of a straight circular shank, its inner nodes kept.

    The shear coefficient is Cowper's for a solid circle, 6 (1 + nu)/(7 + 6 nu) (J. Appl. Mech. 33,
    1966), the torsion constant 2 I.

    Args:
        start: First reference point, m, (3,).
        end: Second reference point, m, (3,).
        diameter: Diameter of the section, m.
        E: Young's modulus, Pa.
        nu: Poisson's ratio.
        rho: Density, kg/m3.
        n_elements: Elements along the shank.
        axial: False leaves out the axial stiffness of the middle element, for a bolt whose force
            is prescribed: the ends then do not pull at each other, and yet every inner node is
            held by one of them, which a shank without any axial stiffness would let float.

    Returns:
        (K, M), each symmetric of shape (6 (n_elements + 1), 6 (n_elements + 1)), nodes from
        ``start`` to ``end``; N/m, N and N m, and kg, kg m and kg m2.
    """
    area, inertia = np.pi * diameter**2 / 4, np.pi * diameter**4 / 64
    whole = np.linalg.norm(end - start)
    length = whole / n_elements
    shear = 3 * E / (7 + 6 * nu) * area
    phi = 12 * E * inertia / (shear * length**2)
    t, g = bending_rows(length)
    stiff = E * inertia / length * (np.outer(t, t) + 3 / (1 + phi) * np.outer(g, g))
    by_phi = phi ** np.arange(3) / (1 + phi) ** 2
    heavy = rho * np.tensordot(np.outer([area, inertia], by_phi), bending_mass(length), 2)
    k, m = np.zeros((12, 12)), np.zeros((12, 12))
    rod = np.array([[1, -1], [-1, 1]]) / length
    # A section with two equal axes has the polar inertia 2 I: G J = E I / (1 + nu).
    for dof, along, mass in ((0, E * area, area), (3, E * inertia / (1 + nu), 2 * inertia)):
        dofs = np.ix_([dof, dof + 6], [dof, dof + 6])
        k[dofs], m[dofs] = along * rod, rho * mass * length / 6 * np.array([[2, 1], [1, 2]])
    # Deflection uy turns by +rz along x, uz by -ry.
    for w, turn, sign in ((1, 5, 1.0), (2, 4, -1.0)):
        dofs, signs = np.array([w, turn, w + 6, turn + 6]), np.array([1.0, sign, 1.0, sign])
        at = np.ix_(dofs, dofs)
        k[at], m[at] = stiff * np.outer(signs, signs), heavy * np.outer(signs, signs)
    size = 6 * (n_elements + 1)
    K, M = np.zeros((size, size)), np.zeros((size, size))
    for first in range(0, size - 6, 6):
        K[first : first + 12, first : first + 12] += k
        M[first : first + 12, first : first + 12] += m
    if not axial:
        x = [6 * (n_elements // 2), 6 * (n_elements // 2) + 6]
        K[np.ix_(x, x)] -= E * area * rod
    R = np.kron(np.eye(size // 6), np.kron(np.eye(2), frames((end - start)[None] / whole)[0]))
    return R.T @ K @ R, R.T @ M @ R


def condense_to_ends(K: np.ndarray, M: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Static condensation (Guyan, AIAA J. 3, 1965) of a shank to its two ends, (12, 12) each.

    The stiffness is exact for loads there, the mass that of the static deflections.
    """
    ends = np.r_[0:6, len(K) - 6 : len(K)]
    T = np.zeros((len(K), 12))
    T[ends] = np.eye(12)
    if len(K) > 12:
        T[6:-6] = -cho_solve(cho_factor(K[6:-6, 6:-6]), K[6:-6, ends])
    # With T in both factors the result is symmetric to round-off, where K_cc + K_ci T is not.
    return T.T @ K @ T, T.T @ M @ T
