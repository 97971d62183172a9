"""Friction against closed forms: a pulled bar, a pushed block, Cattaneo and Mindlin."""

from __future__ import annotations

import numpy as np
import pytest
from contact_blocks import COMM, STEEL, pair, pressed, slope_of
from mpi4py import MPI

from fenics_joints.meshes import graded_lines, stacked_blocks
from fenics_joints.preload import SLIP, STICK, PreloadSolver, Traction


def bar(n: int, t: float):
    """A bar of thickness t, pressed on a rigid base and pulled at its end."""
    length, p, mu = 0.2, 1e5, 0.3
    tagged = stacked_blocks(
        COMM,
        lower=(np.append(np.linspace(0, length, n + 1), 0.3), (-0.05, 0.0)),
        upper=(0.0, t),
        upper_span=(0.0, length),
    )

    def end(x):
        return 1.0 * (x[:, 0] < length + 1e-9)

    loads = [
        Traction("press", "top", (0.0, -p * length)),
        Traction("pull", "right", (1.0, 0.0), end),
    ]
    parts = pair({"E": 1e15, "nu": 0.0}, {"E": 70e9, "nu": 0.0})
    solver = PreloadSolver(pressed(tagged, loads, parts=parts, friction=mu))
    return solver, mu * p, 70e9 * t, length


def pulled(solver, force, before=None):
    """Result of a pull, and how far the bar's end went."""
    result = solver.solve({"pull": force}, initial=before)
    state = result["c"]
    end = np.argmax(state.interface.points[:, 0])
    return result, state.slip[end, 0] * state.interface.frames[end, 1, 0]


def test_slip_of_a_bar():
    """Slip length F/(mu p), elongation F^2/(2 E A mu p), and Masing's unloading and reloading.

    Those are of a bar without thickness: the error is in proportion to it. Slip ends at a vertex.
    """
    errors, thickness = [], np.array([2e-3, 1e-3, 5e-4])
    for t in thickness:
        solver, tau, stiffness, length = bar(40, t)
        F = 0.6 * tau * length
        full = F**2 / (2 * stiffness * tau)
        result, moved = pulled(solver, F)
        errors.append(abs(moved / full - 1))
        state = result["c"]
        slipping = state.interface.areas[state.status == SLIP].sum()
        assert abs(slipping - F / tau) < length / 40
    assert errors[-1] < 2e-3
    assert abs(slope_of(errors, thickness) - 1) < 0.05
    result, moved = pulled(solver, 0.2 * F, result)
    assert abs(moved / (full - 2 * full * (0.8 / 2) ** 2) - 1) < 5e-3
    result, moved = pulled(solver, F, result)
    assert abs(moved / full - 1) < 5e-3


def pushed_block(mu: float, share: float, comm=COMM):
    """A block of steel on one of aluminium, pushed sideways with a share of Coulomb's limit."""
    x, z = np.linspace(0, 0.1, 7), np.linspace(0, 0.05, 4)
    tagged = stacked_blocks(comm, lower=(x, x, -z[::-1]), upper=z)

    def uneven(x):
        return 1 + 20 * x[:, 0]

    side = share * mu * 1e4
    loads = [
        Traction("down", "top", (0.0, 0.0, -1e4)),
        Traction("side", "top", (0.6 * side, 0.8 * side, 0.0), uneven),
    ]
    return PreloadSolver(pressed(tagged, loads, parts=pair({"E": 70e9}, {}), friction=mu))


@pytest.mark.parametrize("mu, share", [(0.1, 0.9), (0.3, 0.9), (1.0, 0.5)])
def test_hard_friction(mu, share):
    """Strong and weak friction in space, near the limit of sliding, obeys Coulomb exactly."""
    result, side = pushed_block(mu, share).solve(), share * mu * 1e4
    state = result["c"]
    assert result.iterations < 25
    assert np.allclose(state.resultant, (-0.6 * side, -0.8 * side, 1e4), atol=1e-5)
    size, limit = np.linalg.norm(state.force[:, 1:], axis=1), mu * state.force[:, 0]
    slips, sticks = state.status == SLIP, state.status == STICK
    assert slips.any() and sticks.any()
    assert np.all(size[sticks] < limit[sticks])
    assert np.allclose(size[slips], limit[slips], atol=1e-6)
    # Against the slip, and no slip where it sticks.
    work = np.sum(state.force[:, 1:] * state.slip, axis=1)
    far = np.linalg.norm(state.slip, axis=1)
    assert np.allclose(work[slips], -(size * far)[slips], rtol=1e-6, atol=1e-12)
    assert far[sticks].max() < 1e-9 * far[slips].max()


@pytest.mark.parallel
def test_ranks_agree():
    """Several ranks find the pressures of one, in as many iterations."""
    shared, alone = (pushed_block(0.3, 0.9, comm).solve() for comm in (COMM, MPI.COMM_SELF))
    assert shared.iterations == alone.iterations
    sorted_forces = []
    for result in (shared, alone):
        state = result["c"]
        order = np.lexsort(np.round(state.interface.points.T, 9))
        sorted_forces.append(state.force[order])
    assert np.allclose(*sorted_forces, rtol=0, atol=1e-10 * 1e4)


def test_cattaneo_mindlin():
    """A pressed cylinder, then pushed: stick within c = a sqrt(1 - Q / mu P), q by Mindlin.

    Johnson, Contact Mechanics, 1985, eqs. 7.24 to 7.28. Pressed and pushed in two steps; pushed
    back to the opposite force the tractions are the opposite ones.
    """
    R, a, mu, share, size = 0.1, 1e-3, 0.3, 0.6, 100.0
    E_star = 0.5 * STEEL["E"] / (1 - STEEL["nu"] ** 2)
    P, peak = np.pi * E_star * a**2 / (4 * R), E_star * a / (2 * R)
    h, Q = a / 12, share * mu * P
    x = graded_lines([0.0, 1.2 * a, size * a], [h, h, size * a / 4])
    z = graded_lines([0.0, a, size * a], [h, 2 * h, size * a / 4])
    tagged = stacked_blocks(COMM, lower=(np.concatenate([-x[:0:-1], x]), -z[::-1]), upper=z)
    # Forces up on one half and down on the other take up the moment of the push.
    couple = Q * size * a / (size * a)
    loads = [
        Traction("down", "top", (0.0, -P)),
        Traction("push", "top", (Q, 0.0)),
        Traction("up", "top", (0.0, couple), lambda x: 1.0 * (x[:, 0] > 0)),
        Traction("back", "top", (0.0, -couple), lambda x: 1.0 * (x[:, 0] < 0)),
    ]
    round_ = {"friction": mu, "gap": lambda x: x[:, 0] ** 2 / (2 * R)}
    solver = PreloadSolver(pressed(tagged, loads, **round_))
    result, c = None, a * np.sqrt(1 - share)
    for factor in (0.0, 1.0, 0.0, -1.0):
        result = solver.solve(dict.fromkeys(("push", "up", "back"), factor), initial=result)
        assert result.iterations < 25
        if factor == 0.0:
            continue
        state = result["c"]
        at = state.interface.points[:, 0]
        whole, inner = (np.sqrt(np.maximum(1 - (at / s) ** 2, 0.0)) for s in (a, c))
        q = factor * mu * peak * (whole - c / a * inner)
        found = -state.traction[:, 0] * state.interface.frames[:, 1, 0]
        assert np.abs(found - q).max() < 0.05 * mu * peak
        if factor == 1.0:
            assert abs(np.abs(at[state.status == STICK]).max() - c) < 1.5 * h
