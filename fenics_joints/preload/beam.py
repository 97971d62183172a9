"""A bolt's shank as Timoshenko beam elements between two reference points, as dense matrices.

The shape functions contain the shear parameter phi = 12 E I / (kappa G A l^2), so that they solve
the unloaded Timoshenko beam: the stiffness is exact for any number of elements and does not lock
(Friedman and Kosmatka, Computers & Structures 47, 1993; the stiffness is Przemieniecki's, Theory
of Matrix Structural Analysis, 1968, eq. 5.116). The mass is consistent, with rotary inertia.

A node has six DOFs, (ux, uy, uz, rx, ry, rz) in global axes, rotations in rad.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from fenics_joints.errors import InputError

# Pivots of the scaled inner block below this are round-off: that block is singular.
_SINGULAR = 1e-13


@dataclass(frozen=True)
class _Section:
    """Stiffnesses and inertias of a section with two equal principal axes, SI units."""

    EA: float
    EI: float
    GJ: float
    shear: float  # kappa G A, N
    mass: float  # rho A, kg/m
    rotary: float  # rho I, kg m


def beam_matrices(
    start,
    end,
    *,
    E: float,
    nu: float,
    rho: float,
    diameter: float | None = None,
    area: float | None = None,
    inertia: float | None = None,
    n_elements: int = 25,
    axial: bool = True,
) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness and mass of a straight circular shank, its inner nodes kept.

    The shear coefficient is Cowper's for a solid circle, 6 (1 + nu)/(7 + 6 nu) (J. Appl. Mech. 33,
    1966), the torsion constant 2 I.

    Args:
        start: First reference point, m, shape (3,) or (2,).
        end: Second reference point, m, of the same shape.
        E: Young's modulus, Pa.
        nu: Poisson's ratio.
        rho: Density, kg/m3.
        diameter: Diameter of the section, m.
        area: Area, m2, in the place of the diameter's; with ``inertia``.
        inertia: Second moment of area about a diameter, m4; with ``area``.
        n_elements: Elements along the shank.
        axial: False leaves out the axial stiffness of the middle element, for a bolt whose force
            is prescribed: the ends then do not pull at each other, and yet every inner node is
            held by one of them, which a shank without any axial stiffness would let float.

    Returns:
        (K, M), each symmetric of shape (6 (n_elements + 1), 6 (n_elements + 1)), nodes from
        ``start`` to ``end``; N/m, N and N m, and kg, kg m and kg m2.

    Raises:
        InputError: A value is out of its range, the points coincide, or the section is given
            twice or not at all.
    """
    section = _section(E, nu, rho, diameter, area, inertia)
    if n_elements != int(n_elements) or n_elements < 1:
        raise InputError(f"n_elements = {n_elements}: expected a whole number, at least 1.")
    length, turn = _frame(start, end)
    k, m = _element(section, length / n_elements)
    size = 6 * (int(n_elements) + 1)
    K, M = np.zeros((size, size)), np.zeros((size, size))
    for i in range(int(n_elements)):
        dofs = slice(6 * i, 6 * i + 12)
        K[dofs, dofs] += k
        M[dofs, dofs] += m
    if not axial:
        x = [6 * (n_elements // 2), 6 * (n_elements // 2) + 6]
        K[np.ix_(x, x)] -= section.EA * n_elements / length * np.array([[1, -1], [-1, 1]])
    R = np.kron(np.eye(size // 3), turn)
    return R.T @ K @ R, R.T @ M @ R


def condense(K, M, keep) -> tuple[np.ndarray, np.ndarray | None]:
    """Static condensation (Guyan, AIAA J. 3, 1965) to some of the DOFs.

    Args:
        K: Symmetric stiffness, shape (n, n).
        M: Symmetric mass, shape (n, n), or None.
        keep: Indices of the DOFs to keep, shape (k,), in the wanted order.

    Returns:
        (K, M) of shape (k, k); the stiffness is exact for loads on the kept DOFs, the mass that
        of the static deflections. M is None if none was given.

    Raises:
        InputError: An index is out of range or given twice, or the kept DOFs do not hold the
            others.
    """
    K = np.asarray(K, dtype=float)
    keep = np.asarray(keep, dtype=int)
    if len(set(keep.tolist())) != keep.size or not np.all((keep >= 0) & (keep < len(K))):
        raise InputError(
            f"keep = {keep.tolist()}: expected different indices from 0 to {len(K) - 1}"
        )
    rest = np.setdiff1d(np.arange(len(K)), keep)
    T = np.zeros((len(K), keep.size))
    T[keep, np.arange(keep.size)] = 1.0
    if rest.size:
        T[rest] = -_solve_inner(K[np.ix_(rest, rest)], K[np.ix_(rest, keep)])
    # With T in both factors the result is symmetric to round-off, where K_cc + K_ci T is not.
    return T.T @ K @ T, None if M is None else T.T @ np.asarray(M, dtype=float) @ T


def end_dofs(n_elements: int) -> np.ndarray:
    """Indices of the twelve DOFs of the two ends, shape (12,), to `condense` a shank to them."""
    return np.concatenate([np.arange(6), 6 * n_elements + np.arange(6)])


def _solve_inner(inner: np.ndarray, right: np.ndarray) -> np.ndarray:
    scale = np.sqrt(np.maximum(inner.diagonal(), np.finfo(float).tiny))
    try:
        factor = cho_factor(inner / np.outer(scale, scale), lower=True)
    except np.linalg.LinAlgError:
        factor = None
    if factor is None or np.min(factor[0].diagonal()) ** 2 < _SINGULAR:
        raise InputError("keep: the kept DOFs do not hold the others, whose stiffness is singular.")
    return cho_solve(factor, right / scale[:, None]) / scale[:, None]


def _section(E, nu, rho, diameter, area, inertia) -> _Section:
    if (diameter is None) == (area is None) or (area is None) != (inertia is None):
        raise InputError("expected either diameter, or area and inertia.")
    if diameter is not None:
        _positive("diameter", diameter, "m")
        area, inertia = np.pi * diameter**2 / 4, np.pi * diameter**4 / 64
    for key, value, unit in (("E", E, "Pa"), ("area", area, "m2"), ("inertia", inertia, "m4")):
        _positive(key, value, unit)
    if not -1 < nu < 0.5:
        raise InputError(f"nu = {nu}: expected -1 < nu < 0.5.")
    if not (np.isfinite(rho) and rho >= 0):
        raise InputError(f"rho = {rho}: expected a density >= 0 (kg/m3).")
    G = E / (2 * (1 + nu))
    kappa = 6 * (1 + nu) / (7 + 6 * nu)
    return _Section(
        E * area, E * inertia, 2 * G * inertia, kappa * G * area, rho * area, rho * inertia
    )


def _positive(key: str, value: float, unit: str) -> None:
    if not (np.isfinite(value) and value > 0):
        raise InputError(f"{key} = {value}: expected a number > 0 ({unit}).")


def _frame(start, end) -> tuple[float, np.ndarray]:
    """Length, and the local axes as rows, the first along the beam; the others are arbitrary."""
    start, end = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
    if start.shape != end.shape or start.shape not in ((2,), (3,)):
        raise InputError(f"start and end have shapes {start.shape} and {end.shape}: expected (3,).")
    axis = np.zeros(3)
    axis[: start.size] = end - start
    length = float(np.linalg.norm(axis))
    if not (np.isfinite(length) and length > 0):
        raise InputError(f"start = {start}, end = {end}: expected two different points (m).")
    axis /= length
    second = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    second /= np.linalg.norm(second)
    return length, np.array([axis, second, np.cross(axis, second)])


def _element(section: _Section, length: float) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness and mass of one element in local axes, x along it, shape (12, 12) each."""
    k, m = np.zeros((12, 12)), np.zeros((12, 12))
    rod, both = np.array([[1, -1], [-1, 1]]) / length, length / 6 * np.array([[2, 1], [1, 2]])
    # A section with two equal axes has the polar inertia 2 I.
    for dof, stiffness, heavy in (
        (0, section.EA, section.mass),
        (3, section.GJ, 2 * section.rotary),
    ):
        dofs = np.ix_([dof, dof + 6], [dof, dof + 6])
        k[dofs], m[dofs] = stiffness * rod, heavy * both
    bending, inertia = _bending(section, length)
    # Deflection uy turns by +rz along x, uz by -ry.
    for w, turn, sign in ((1, 5, 1.0), (2, 4, -1.0)):
        dofs = [w, turn, w + 6, turn + 6]
        signs = np.array([1.0, sign, 1.0, sign])
        k[np.ix_(dofs, dofs)] = bending * np.outer(signs, signs)
        m[np.ix_(dofs, dofs)] = inertia * np.outer(signs, signs)
    return k, m


def _bending(section: _Section, length: float) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness and mass in one plane for (w1, theta1, w2, theta2), shape (4, 4) each."""
    phi = 12 * section.EI / (section.shear * length**2)
    points, weights = np.polynomial.legendre.leggauss(4)  # exact for the cubics' products
    k, m = np.zeros((4, 4)), np.zeros((4, 4))
    for s, weight in zip((points + 1) / 2, weights * length / 2, strict=True):
        w, dw, theta, dtheta = _shapes(s, length, phi)
        slip = dw - theta
        k += weight * (section.EI * np.outer(dtheta, dtheta) + section.shear * np.outer(slip, slip))
        m += weight * (section.mass * np.outer(w, w) + section.rotary * np.outer(theta, theta))
    return k, m


def _shapes(s: float, length: float, phi: float) -> np.ndarray:
    """Deflection, its slope, section's rotation and curvature at x = s length, shape (4, 4)."""
    a, b = 6 * (s * s - s) / length, 6 * (2 * s - 1) / length**2
    rows = [
        [
            1 - 3 * s**2 + 2 * s**3 + phi * (1 - s),
            length * (s - 2 * s**2 + s**3 + phi / 2 * (s - s**2)),
            3 * s**2 - 2 * s**3 + phi * s,
            length * (s**3 - s**2 - phi / 2 * (s - s**2)),
        ],
        [
            a - phi / length,
            1 - 4 * s + 3 * s**2 + phi / 2 * (1 - 2 * s),
            phi / length - a,
            3 * s**2 - 2 * s - phi / 2 * (1 - 2 * s),
        ],
        [a, 1 - 4 * s + 3 * s**2 + phi * (1 - s), -a, 3 * s**2 - 2 * s + phi * s],
        [b, (6 * s - 4 - phi) / length, -b, (6 * s - 2 + phi) / length],
    ]
    return np.array(rows) / (1 + phi)
