"""The bolt's shank against closed forms of Timoshenko's and of Euler and Bernoulli's beam."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg as sla

from fenics_joints.preload.beam import beam_matrices, condense_to_ends

STEEL = {"E": 206e9, "nu": 0.3, "rho": 7850.0}
START, AXIS = np.array([0.3, -0.2, 0.1]), np.array([2.0, -1.0, 2.0]) / 3
ACROSS = np.array([1.0, 2.0, 0.0]) / np.sqrt(5)
D, L = 0.01, 0.03
AREA, INERTIA = np.pi * D**2 / 4, np.pi * D**4 / 64


def shank(n_elements=4, length=L, axis=AXIS, **changes):
    section = {"diameter": D} | STEEL | changes
    return beam_matrices(START, START + length * axis, n_elements=n_elements, **section)


def rigid_motions(n_elements, length=L, axis=AXIS):
    """Translations and rotations about START of all nodes, columns of shape (6 (n + 1), 6)."""
    columns = np.zeros((n_elements + 1, 6, 6))
    for i, s in enumerate(np.linspace(0, length, n_elements + 1)):
        for j, e in enumerate(np.eye(3)):
            columns[i, :3, j] = columns[i, 3:, 3 + j] = e
            columns[i, :3, 3 + j] = np.cross(e, s * axis)
    return columns.reshape(-1, 6)


@pytest.mark.parametrize("n", [1, 3])
def test_cantilever_under_each_end_load_is_exact(n):
    """F L^3/(3 E I) + F L/(kappa G A) across, F L/(E A) along, T L/(2 G I) in torsion, stubby."""
    K, _ = shank(n)
    flexibility = np.linalg.inv(K[6:, 6:])[-6:, -6:]
    G, kappa = STEEL["E"] / 2.6, 6 * 1.3 / 8.8
    E_I, moment = STEEL["E"] * INERTIA, np.cross(AXIS, ACROSS)
    along, across = np.kron([1, 0], AXIS), np.kron([1, 0], ACROSS)
    twist, bend = np.kron([0, 1], AXIS), np.kron([0, 1], moment)
    deflection = L**3 / (3 * E_I) + L / (kappa * G * AREA)
    assert across @ flexibility @ across == pytest.approx(deflection, rel=1e-10)
    assert across @ flexibility @ bend == pytest.approx(L**2 / (2 * E_I), rel=1e-10)
    assert bend @ flexibility @ bend == pytest.approx(L / E_I, rel=1e-10)
    assert along @ flexibility @ along == pytest.approx(L / (STEEL["E"] * AREA), rel=1e-10)
    assert twist @ flexibility @ twist == pytest.approx(L / (2 * G * INERTIA), rel=1e-10)


def test_rigid_motions_cost_nothing_and_carry_the_cylinders_mass():
    """Mass, static moment and inertia tensor of a solid cylinder about its end."""
    K, M = shank()
    R = rigid_motions(4)
    assert np.abs(K @ R).max() < 1e-9 * np.abs(K).max()
    assert np.linalg.matrix_rank(K, tol=1e-12 * np.linalg.norm(K, 2)) == len(K) - 6
    mass = STEEL["rho"] * AREA * L
    along, across = mass * D**2 / 8, mass * (D**2 / 16 + L**2 / 3)
    spread = np.outer(AXIS, AXIS)
    cross = np.cross(np.eye(3), mass * L / 2 * AXIS)  # row j: e_j x m c
    expected = np.block(
        [[mass * np.eye(3), cross.T], [cross, along * spread + across * (np.eye(3) - spread)]]
    )
    np.testing.assert_allclose(R.T @ M @ R, expected, atol=1e-12 * mass)


def test_slender_free_beam_has_euler_bernoullis_frequencies():
    """First bending pair: (4.73004/L)^2 sqrt(E I/(rho A)), less Timoshenko's shift of d^2/L^2."""
    length = 1.0
    K, M = shank(25, length)
    modes = sla.eigh(K, M, eigvals_only=True)[6:8]
    exact = (4.730040744862704 / length) ** 4 * STEEL["E"] * INERTIA / (STEEL["rho"] * AREA)
    np.testing.assert_allclose(modes, exact, rtol=2e-3)
    assert np.all(modes < exact)
    # The shift is of second order in d/L.
    K, M = shank(25, length, diameter=D / 2)
    thin = sla.eigh(K, M, eigvals_only=True)[6] / (exact / 4)
    assert (1 - modes[0] / exact) / (1 - thin) == pytest.approx(4, rel=0.02)


def test_stubby_supported_beam_converges_to_timoshenko():
    """Lower roots of Timoshenko's frequency equation, to which the elements tend from above.

    The order is two, since elements shorter than the section is high deflect linearly.
    """
    length = 6 * D
    G, kappa = STEEL["E"] / 2.6, 6 * 1.3 / 8.8
    k2 = (np.pi * np.arange(1, 4) / length) ** 2
    bar2, shear2 = STEEL["E"] / STEEL["rho"], kappa * G / STEEL["rho"]
    # With w = a sin kx and theta = b cos kx: (shear2 k2 - w2) (gyration (bar2 k2 - w2) + shear2)
    # = shear2^2 k2, a quadratic equation for the square w2 of the frequency.
    gyration = INERTIA / AREA
    half = (gyration * (shear2 + bar2) * k2 + shear2) / 2
    exact = (half - np.sqrt(half**2 - gyration**2 * shear2 * bar2 * k2**2)) / gyration

    def squares(n):
        K, M = shank(n, length, axis=np.eye(3)[0])
        free = [i for i in range(len(K)) if i % 6 in (1, 5) and i not in (1, 6 * n + 1)]
        K, M = K[np.ix_(free, free)], M[np.ix_(free, free)]
        return sla.eigh(K, M, eigvals_only=True)[:3]

    errors = np.array([squares(n) / exact - 1 for n in (12, 24, 48)])
    assert np.all(errors > 0)
    np.testing.assert_allclose(np.log2(errors[:-1] / errors[1:]), 2, atol=0.1)
    assert errors[1, 0] < 2e-3, errors


def test_axis_direction_does_not_matter():
    """Matrices of an oblique shank are those of one along x, turned; the ends may be exchanged."""
    turn = np.column_stack([AXIS, ACROSS, np.cross(AXIS, ACROSS)])
    R = np.kron(np.eye(10), turn)
    for oblique, straight in zip(shank(), shank(axis=np.eye(3)[0]), strict=True):
        np.testing.assert_allclose(oblique, R @ straight @ R.T, atol=1e-12 * straight.max())
    swapped = beam_matrices(START + L * AXIS, START, n_elements=4, diameter=D, **STEEL)
    order = np.arange(30).reshape(5, 6)[::-1].ravel()
    for one, other in zip(shank(), swapped, strict=True):
        np.testing.assert_allclose(one, other[np.ix_(order, order)], atol=1e-12 * one.max())


def test_condensed_shank_is_one_element_and_keeps_its_mass():
    """The stiffness is exact for one element as for many; rigid motions keep the whole mass."""
    K, M = condense_to_ends(*shank(7))
    one = shank(1)[0]
    np.testing.assert_allclose(K, one, atol=1e-9 * one.max())
    R = rigid_motions(1)
    full = rigid_motions(7)
    inertia = full.T @ shank(7)[1] @ full
    np.testing.assert_allclose(R.T @ M @ R, inertia, atol=1e-11 * inertia.max())


def test_prescribed_force_leaves_the_ends_apart_axially():
    """Without axial stiffness one more motion is free; all else is as before."""
    K, _ = condense_to_ends(*shank(5, axial=False))
    pull = np.concatenate([-AXIS, np.zeros(3), AXIS, np.zeros(3)])
    whole = shank(1)[0]
    expected = whole - STEEL["E"] * AREA / L * np.outer(pull, pull)
    np.testing.assert_allclose(K, expected, atol=1e-9 * whole.max())
