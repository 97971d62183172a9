"""Preload contact against closed forms: patch test, Hertz, receding contact, Lamé."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from contact_blocks import COMM, STEEL, faces, half_width, pair, pressed, slope_of

from fenics_joints.errors import ConvergenceError
from fenics_joints.meshes import graded_lines, stacked_blocks
from fenics_joints.preload import (
    OPEN,
    SLIP,
    STICK,
    PreloadSolver,
    Traction,
    WasherForce,
    solve_preload,
)
from fenics_joints.preload.front import beyond
from fenics_joints.structure import Spring, Support


def distorted_blocks(cell: str):
    """Two unequal stacks whose plan, the same for both, has no two equal cells."""
    x = np.array([0.0, 0.2, 0.55, 0.7, 1.0])
    y = np.array([0.0, 0.4, 0.65, 1.0])
    z = np.array([-1.3, -0.5, 0.0])
    flat = cell in ("quadrilateral", "triangle")
    tagged = stacked_blocks(
        COMM, lower=(x + 0.5, z) if flat else (x, y, z), upper=(0.0, 0.3, 0.9), cell=cell
    )
    if not flat:
        p = tagged.mesh.geometry.x
        bump = p[:, 0] * (1 - p[:, 0]) * p[:, 1] * (1 - p[:, 1])
        p[:, :2] += np.column_stack([1.1 * bump, -0.9 * bump])
    return tagged


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize(
    "cell",
    [
        pytest.param("quadrilateral", marks=pytest.mark.parallel),
        "triangle",
        "hexahedron",
        pytest.param("tetrahedron", marks=pytest.mark.parallel),
        "round quadrilateral",
        "round triangle",
    ],
)
def test_patch(cell, degree):
    """Evenly pressed faces carry the same pressure at every vertex, whatever the mesh."""
    axisymmetric = cell.startswith("round")
    tagged = distorted_blocks(cell.removeprefix("round "))
    area = np.pi * (1.5**2 - 0.5**2) if axisymmetric else 1.0
    for method, friction in (("semismooth", 0.0), ("vi", 0.0), ("semismooth", 0.3)):
        bolts = [WasherForce("bolt", "bottom", "top", 1e5)]
        free = {"held": (), "degree": degree, "axisymmetric": axisymmetric}
        solver = PreloadSolver(
            pressed(tagged, bolts=bolts, friction=friction, **free), method=method
        )
        state = solver.solve()["c"]
        assert np.allclose(state.pressure, 1e5 / area, rtol=1e-8)
        assert np.allclose(state.facet_pressure, 1e5 / area, rtol=1e-8)
        assert abs(state.facet_area.sum() - area) < 1e-12 * area
        assert abs(state.normal_force - 1e5) < 1e-3
        assert np.all(state.status == (STICK if friction else SLIP))
        solver.destroy()


@cache
def hertz(kind: str, per_a: float, method: str = "semismooth", size: float = 25.0):
    """Peak pressure and half-width of a cylinder or sphere on a block, over Hertz's; iterations.

    Half or quarter of two equal blocks, one of which is round by its gap r^2 / 2R; ``per_a``
    elements along the half-width a.
    """
    R, a = 0.1, 1e-3
    E_star = 0.5 * STEEL["E"] / (1 - STEEL["nu"] ** 2)
    if kind == "line":
        force, peak = np.pi * E_star * a**2 / (4 * R), E_star * a / (2 * R)
        force /= 2  # half of it
    else:
        force, peak = 4 * E_star * a**3 / (3 * R), 2 * E_star * a / (np.pi * R)
        force /= 4 if kind == "space" else 1
    h = a / per_a
    coarse = 2 if kind == "space" else 1
    x = graded_lines([0.0, 1.2 * a, size * a], [h, h, coarse * size * a / 4])
    z = graded_lines([0.0, a, size * a], [h, 2 * coarse * h, coarse * size * a / 4])
    plan = (x, x) if kind == "space" else (x,)
    tagged = stacked_blocks(COMM, lower=(*plan, -z[::-1]), upper=z)
    held = [Support("left", (0,)), Support("bottom", (len(plan),))]
    held += [Support("front", (1,))] if kind == "space" else []

    def gap(x):
        return (x[:, : len(plan)] ** 2).sum(axis=1) / (2 * R)

    load = Traction("load", "top", (0.0,) * len(plan) + (-force,))
    model = pressed(tagged, [load], held=held, axisymmetric=kind == "round", gap=gap)
    result = solve_preload(model, method=method)
    state = result["c"]
    assert result.complementarity < 1e-8
    assert abs(state.normal_force / force - 1) < 1e-8
    return state.pressure.max() / peak, half_width(state, len(plan)) / a, result.iterations


def test_hertz_line():
    """Peak and half-width of a cylinder: within 2 %, errors falling at least linearly."""
    sizes = [4, 8, 16, 32]
    found = np.array([hertz("line", n)[:2] for n in sizes])
    errors = np.abs(found - 1)
    assert np.all(errors[1:] < 0.02)
    assert np.all(errors[-1] < 2e-3)
    assert slope_of(errors[:, 1], sizes) < -1


def test_hertz_sphere():
    """The same of a sphere as a body of revolution, and coarse in space."""
    sizes = [4, 8, 16]
    found = np.array([hertz("round", n)[:2] for n in sizes])
    errors = np.abs(found - 1)
    assert np.all(errors[-1] < 0.01)
    assert slope_of(errors[:, 0], sizes) < -1
    peak, width, _ = hertz("space", 5, size=6.0)
    assert abs(peak - 1) < 0.02
    assert abs(width - 1) < 0.02


def discs(n: int, friction: float = 0.0, lower=STEEL):
    """Half sections of two free discs, pressed together by rings near their hole."""
    inner, ring, outer, thickness = 0.00675, 0.012, 0.08, 0.02
    r = np.concatenate(
        [
            np.linspace(inner, ring, n + 1),
            np.linspace(ring, 0.04, 4 * n + 1)[1:],
            np.geomspace(0.04, outer, 2 * n + 1)[1:],
        ]
    )
    z = np.linspace(0, thickness, 3 * n + 1)
    tagged = stacked_blocks(COMM, lower=(r, -z[::-1]), upper=z)

    def under(x):
        return 1.0 * (x[:, 0] <= ring + 1e-9)

    loads = [
        Traction("low", "bottom", (0.0, 1.0), under),
        Traction("up", "top", (0.0, -1.0), under),
    ]
    parts = pair(lower, {})
    return pressed(tagged, loads, parts=parts, held=(), axisymmetric=True, friction=friction)


@pytest.mark.smoke
@pytest.mark.parametrize("friction", [0.0, 0.1])
def test_receding_contact(friction):
    """The patch is the same at all forces and its pressure in proportion; it ends within."""
    model = discs(4, friction, STEEL | {"E": 70e9})
    small, large = (
        solve_preload(model, {"low": force, "up": force})["c"] for force in (1e2, 2.5e4)
    )
    assert 0 < np.sum(small.status == OPEN) < len(small.status)
    assert np.array_equal(small.status, large.status)
    assert np.allclose(250 * small.force, large.force, rtol=0, atol=1e-8 * large.force.max())
    assert abs(small.radius(1e4) / large.radius(2.5e6) - 1) < 1e-9
    if friction:
        assert {SLIP, STICK} <= set(small.status.tolist())


@pytest.mark.parametrize("method", ["semismooth", "vi"])
def test_iterations(method):
    """From coarse to fine the iterations stay below 25, and both methods stop at exact contact."""
    for n in (2, 4, 8):
        solver = PreloadSolver(discs(n), method=method)
        result = solver.solve({"low": 2.5e4, "up": 2.5e4})
        assert 1 < result.iterations < 25
        assert result.complementarity < 1e-8
        assert hertz("round", 2 * n, method)[2] < 25


@pytest.mark.smoke
def test_methods_agree():
    """The variational inequality is the semismooth result; penalty nears it with its stiffness."""
    model = discs(3)
    exact = solve_preload(model)["c"]
    bounded = solve_preload(model, method="vi")["c"]
    top = exact.pressure.max()
    assert np.array_equal(exact.status, bounded.status)
    assert np.allclose(exact.force, bounded.force, rtol=0, atol=1e-9 * exact.force.max())
    stiffness = np.array([4e14, 16e14, 64e14])
    errors = [
        np.abs(solve_preload(model, method="penalty", penalty=k)["c"].pressure - exact.pressure)
        for k in stiffness
    ]
    errors = np.array([e.max() for e in errors]) / top
    assert errors[-1] < 1e-3
    assert abs(slope_of(errors, stiffness) + 1) < 0.1


@pytest.mark.parametrize("degree", [1, 2])
def test_interference_fit(degree):
    """A ring shrunk on another, of another material: the pressure is Lamé's in plane stress."""
    a, b, c, length, delta = 0.02, 0.03, 0.045, 0.01, 20e-6
    errors = []
    for n in (4, 8):
        s = np.linspace(0, length, 3)
        tagged = stacked_blocks(
            COMM, lower=(s, np.linspace(a - b, 0, n + 1)), upper=np.linspace(0, c - b, n + 1)
        )
        # Blocks on one another turned by a quarter: rings around one another.
        x = tagged.mesh.geometry.x
        x[:, :2] = np.column_stack([b + x[:, 1], -x[:, 0]])
        parts = pair({"E": 100e9}, {"nu": 0.25})
        more = {"degree": degree, "axisymmetric": True, "gap": -delta}
        result = solve_preload(pressed(tagged, parts=parts, held=(), **more))
        out = ((c**2 + b**2) / (c**2 - b**2) + 0.25) / 200e9
        inside = ((b**2 + a**2) / (b**2 - a**2) - 0.3) / 100e9
        errors.append(np.abs(result["c"].pressure * b * (out + inside) / delta - 1).max())
        assert result.complementarity < 1e-8
    assert errors[1] < (2e-3 if degree == 1 else 2e-5)
    assert errors[1] < errors[0] / 3.5


@pytest.mark.parametrize("swapped", [False, True])
def test_shrunk_quarter_ring(swapped):
    """In plane strain, on a polygon: the pressure is even up to the ends that symmetry holds."""
    a, b, c, delta = 0.02, 0.03, 0.045, 20e-6
    names = ["interface_lower", "interface_upper"]
    contact = replace(
        faces(gap=-delta, friction=0.1), lower=names[swapped], upper=names[not swapped]
    )
    materials = {"E": 100e9, "nu": 0.3}, {"E": 200e9, "nu": 0.25}
    E1, E2 = (m["E"] / (1 - m["nu"] ** 2) for m in materials)
    inside = ((b**2 + a**2) / (b**2 - a**2) - 0.3 / 0.7) / E1
    out = ((c**2 + b**2) / (c**2 - b**2) + 0.25 / 0.75) / E2
    errors = []
    for n in (4, 8):
        tagged = stacked_blocks(
            COMM,
            lower=(np.linspace(0, np.pi / 2, 2 * n + 1), np.linspace(a - b, 0, n + 1)),
            upper=np.linspace(0, c - b, n + 1),
        )
        x = tagged.mesh.geometry.x
        radius, angle = b + x[:, 1], np.pi / 2 - x[:, 0]
        x[:, :2] = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
        held = [Support("left", (0,)), Support("right", (1,))]
        model = pressed(tagged, parts=pair(*materials), held=held, contacts=[contact])
        pressure = solve_preload(model)["c"].pressure
        assert np.ptp(pressure) < 1e-6 * pressure.max()
        errors.append(abs(pressure.mean() * b * (inside + out) / delta - 1))
    assert errors[1] < 5e-4
    assert errors[1] < errors[0] / 3.5


@pytest.mark.parallel
def test_block_on_springs():
    """Stick, slip, unloading and a turn of the push of a pressed block, held by weak springs.

    Once it slips the springs carry what Coulomb's limit does not: Jenkins' element.
    """
    N, mu, k = 1e4, 0.4, 1e6
    x = np.array([0.0, 0.04, 0.06, 0.1])
    tagged = stacked_blocks(COMM, lower=(x, x, (-0.02, 0.0)), upper=(0.0, 0.005))
    at = (0.05, 0.05, 0.005)
    springs = [Spring("x", k, at, (1.0, 0.0, 0.0)), Spring("y", k, at, (0.0, 1.0, 0.0))]
    loads = [Traction("down", "top", (0.0, 0.0, -N))]
    loads += [Traction(n, "top", d) for n, d in (("x", (1.0, 0, 0)), ("y", (0, 1.0, 0)))]
    solver = PreloadSolver(pressed(tagged, loads, springs=springs, friction=mu))
    limit = mu * N
    steps = [  # push along x and y, and the motion that the springs allow
        (0.8 * limit, 0.0, 0.0, 0.0),
        (1.5 * limit, 0.0, 0.5 * limit / k, 0.0),
        (0.0, 0.0, 0.5 * limit / k, 0.0),  # stuck where it is
        (-1.5 * limit, 0.0, -0.5 * limit / k, 0.0),
        (-1.5 * limit, 0.6 * limit, None, None),
    ]
    result = before = None
    for push_x, push_y, move_x, move_y in steps:
        before, result = result, solver.solve({"x": push_x, "y": push_y}, initial=result)
        state = result["c"]
        friction = -state.resultant[:2]
        sides = np.abs(state.force[:, 1:])
        assert abs(state.normal_force / N - 1) < 1e-9
        assert np.all(np.linalg.norm(sides, axis=1) <= mu * state.force[:, 0] + 1e-9 * limit)
        if move_x is not None:
            found = (np.array([push_x, push_y]) - friction) / k
            assert np.allclose(found, (move_x, move_y), atol=2e-2 * limit / k)
            slipping = abs(push_x) > limit
            assert np.all(state.status == (SLIP if slipping else STICK))
            # Unloaded it sticks at once: round-off about the limit does not say who slips.
            assert slipping or result.iterations <= 2
            if slipping:
                assert abs(np.linalg.norm(friction) / limit - 1) < 1e-7
    # The last: slip along the change of the springs' load.
    moved = state.slip - before["c"].slip
    slip = np.einsum("nk,nki->ni", moved, state.interface.frames[:, 1:])
    assert slip[:, 1].min() > 0


def leaning(n: int, degree: int, kind: str, **more) -> tuple:
    """A block pressed down on one side of another, then pushed: solver and the second state."""
    x = np.linspace(0.0, 0.1, 2 * n + 1)
    tagged = stacked_blocks(COMM, lower=(x, x, -x[n::-1]), upper=x[: n + 1])
    loads = [
        Traction("down", "top", (0.0, 0.0, -1e5), lambda p: 1.0 * (p[:, 0] < 0.05)),
        Traction("push", "top", (1.5e4, 0.5e4, 0.0)),
    ]
    model = pressed(tagged, loads, friction=0.3, degree=degree)
    solver = PreloadSolver(model, petsc_options={"held_pc_type": kind} | more)
    return solver, solver.solve(initial=solver.solve({"push": 0.0}))


@pytest.mark.parallel
@pytest.mark.parametrize("degree", [1, 2])
def test_multigrid_finds_the_state_that_factorisations_find(degree):
    """With friction, over two steps, of which the second has stick, slip and open pairs."""
    states = []
    for kind in ("cholesky", "mg"):
        solver, result = leaning(3, degree, kind)
        assert (solver.newton.multigrid is not None) == (kind == "mg")
        states.append(result["c"])
        solver.destroy()
    exact, found = states
    assert {OPEN, SLIP, STICK} == set(exact.status.tolist())
    assert np.array_equal(exact.status, found.status)
    assert np.allclose(exact.force, found.force, rtol=0, atol=1e-7 * exact.force.max())
    assert np.allclose(exact.slip, found.slip, rtol=0, atol=1e-7 * np.abs(exact.slip).max())


def test_multigrid_takes_no_more_cycles_on_finer_meshes():
    """And it gives way to a factorisation where it does not work: here it does not smooth."""
    cycles = []
    for n in (3, 6):
        solver, _ = leaning(n, 1, "mg")
        cycles.append(solver.newton.solves)
        solver.destroy()
    assert cycles[1] < 1.3 * cycles[0]
    solver, result = leaning(3, 1, "mg", held_mg_levels_ksp_max_it=0)
    assert solver.newton.multigrid is None
    assert result.complementarity < 1e-8


def test_contact_opens_as_far_as_hertz_says():
    """Hertz's line contact of half-width 90, held to 100, pulls from 95.1 on; to 90 it opens."""
    x = np.arange(-150.0, 151.0)
    line = SimpleNamespace(
        points=np.column_stack([x, 0 * x]),
        facets=np.column_stack([np.arange(300), np.arange(1, 301)]),
    )
    was = np.abs(x) < 100
    now = was & (90**2 + 100**2 > 2 * x**2)
    left = now & ~beyond(line, was, now)
    assert abs(np.abs(x[left]).max() - 90) <= 2  # spacings
    # What pulls far inside, while another edge stays, does not pull at an edge.
    assert not beyond(line, was, was & ((x < -60) | (x > -40)) & (x < 30)).any()


@pytest.mark.parallel
def test_the_stiffness_multiplies_as_before_whatever_is_held():
    solver, result = leaning(3, 2, "cholesky")
    K, exact = solver.model.stiffness(), result.x.duplicate()
    K.mult(result.x, exact)
    found = solver.K * result.x
    found.axpy(-1.0, exact)
    assert found.norm() < 1e-10 * exact.norm()
    assert solver.stiffness.A.getDiagonal().norm() != solver.stiffness.diagonal.norm()
    K.destroy(), solver.destroy()


@pytest.mark.parallel
def test_divergence():
    """A solve that stops says why and what to try, whether Newton or the factorisation fails."""
    model = discs(3)
    with pytest.raises(ConvergenceError, match="Try.*initial=.*DIVERGED_MAX_IT"):
        solve_preload(model, petsc_options={"snes_max_it": 1})
    # Pulled apart, the bodies have no state of rest.
    with pytest.raises(ConvergenceError, match="Try"):
        solve_preload(model, {"low": -1.0, "up": -1.0})


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_on_a_curved_face_the_normal_force_is_the_load(friction):
    """Pressure on an arc points to all sides: its integral is not what it carries.

    With friction shear bears a part of the load, and the integral may be less too.
    """
    load, R = 1e6, 0.4
    x, z = np.linspace(-0.1, 0.1, 17), np.linspace(0.0, 0.1, 9)
    tagged = stacked_blocks(COMM, lower=(x, z - 0.1), upper=z)
    points = tagged.mesh.geometry.x
    points[:, 1] -= R - np.sqrt(R**2 - points[:, 0] ** 2)
    down = Traction("load", "top", (0.0, -load))
    state = solve_preload(pressed(tagged, [down], friction=friction))["c"]
    assert state.resultant == pytest.approx([0.0, load], abs=1e-6 * load)
    assert state.normal_force == pytest.approx(load, rel=1e-9)
    assert abs(state.pressure_force / load - 1) > 5e-3
    if not friction:
        upright = state.interface.frames[:, 0, 1]
        assert state.force[:, 0] @ upright == pytest.approx(load, rel=1e-9)
