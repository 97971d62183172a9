"""Bodies that do not give way, and faces that are moved, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from contact_blocks import COMM, STEEL, both, faces, half_width

from fenics_joints.errors import InputError, MeshError
from fenics_joints.meshes import graded_lines, stacked_blocks
from fenics_joints.preload import (
    SLIP,
    STICK,
    Cylinder,
    Displacement,
    Obstacle,
    Plane,
    PreloadAdjoint,
    PreloadModel,
    PreloadSolver,
    Sphere,
    Traction,
    solve_preload,
)
from fenics_joints.structure import Parameter, Structure, Support


def block(degree=1, size=1.0, parameters=(), supports=(), **properties):
    """One block, 2 high: two glued ones, from -1 to 1 times a size."""
    line, x = np.linspace(0.0, size, 4), np.linspace(0.0, size, 5)
    tagged = stacked_blocks(COMM, lower=(x, -line[::-1]), upper=line)
    return Structure(tagged, both(**properties), parameters, supports=supports, degree=degree)


@pytest.mark.parallel
@pytest.mark.parametrize("degree", [1, 2])
def test_block_between_grip_and_plane(degree):
    """A block moved onto a smooth plane: the strain is even, the force that of plane strain."""
    E, way = Parameter("E", STEEL["E"]), 3e-4
    structure = block(degree, parameters=[E], E="E")
    floor = Obstacle("floor", "bottom", Plane((0.0, -1.0), (0.0, 2.0)), gap=1e-4)
    grip = Displacement("grip", "top", (None, -way))
    solver = PreloadSolver(PreloadModel(structure, [floor, faces(bonded=True)], (), [grip]))
    force = E.value / (1 - STEEL["nu"] ** 2) * (way - 1e-4) / 2
    result = solver.solve()
    assert np.allclose(result["floor"].pressure, force, rtol=1e-9)
    with PreloadAdjoint(result) as adjoint:
        found = adjoint.force("floor")
    assert found.parameters["E"] == pytest.approx(force / E.value, rel=1e-8)
    assert found.forces["grip"] == pytest.approx(force * way / (way - 1e-4), rel=1e-8)
    half = solver.solve({"grip": 0.5}, initial=result)["floor"]
    assert half.normal_force == pytest.approx(force * 0.25, rel=1e-8)
    assert abs(solver.solve({"grip": 0.2})["floor"].normal_force) < 1e-12 * force


R, E_STAR = 0.1, STEEL["E"] / (1 - STEEL["nu"] ** 2)


def ball_on_a_block(a, **drive):
    """A rigid ball above a clamped cylinder, with elements for a patch of radius ``a``."""
    h, size = a / 12, 20 * a
    x = graded_lines([0.0, 1.2 * a, size], [h, h, size / 4])
    z = graded_lines([0.0, a, size], [h, 2 * h, size / 4])
    tagged = stacked_blocks(COMM, lower=(x, -z[::-1]), upper=(0.0, size))
    # The ball comes from below onto the upper face of the lower block; the other one is apart.
    structure = Structure(
        tagged, both(), degree=1, axisymmetric=True, supports=[Support("bottom"), Support("top")]
    )
    return PreloadModel(
        structure, [Obstacle("ball", "interface_lower", Sphere((0.0, R), R), **drive)]
    )


@pytest.mark.parallel
def test_hertz_by_a_rigid_ball():
    """A ball that does not give way, pressed in by a way: Hertz's patch for the force it takes."""
    a = 1e-3
    state = solve_preload(ball_on_a_block(a, travel=(0.0, -(a**2) / R)))["ball"]
    found = (3 * state.normal_force * R / (4 * E_STAR)) ** (1 / 3)
    assert abs(half_width(state) / found - 1) < 0.01
    assert abs(state.pressure.max() / (2 * E_STAR * found / (np.pi * R)) - 1) < 0.01
    assert 0.8 < found / a < 1.2


@pytest.mark.parallel
def test_hertz_by_a_ball_that_is_pushed():
    """Hertz's pressure for the force given; the way found is the one that takes this force."""
    a = 1e-3
    force = 4 * E_STAR * a**3 / (3 * R)
    result = solve_preload(ball_on_a_block(a, force=(0.0, -force)))
    state, way = result["ball"], result.motion("ball")
    assert state.normal_force == pytest.approx(force, rel=1e-9)
    assert result.reaction("ball")[1] == pytest.approx(-force, rel=1e-9)
    assert abs(state.pressure.max() / (2 * E_STAR * a / (np.pi * R)) - 1) < 0.01
    # The bottom is 20 a away, so that Hertz's half-space gives way by some per cent more.
    assert way[0] == 0 and 0.9 < -way[1] / (a**2 / R) < 1.0
    again = solve_preload(ball_on_a_block(a, travel=tuple(way)))["ball"]
    assert again.normal_force == pytest.approx(force, rel=1e-7)


@pytest.mark.parallel
def test_pushed_askew():
    """What is pushed askew on a smooth face presses until its share along the push is the push."""
    way, push = np.array([0.6, 0.8]), 1e5
    structure = block(supports=[Support("top")])
    wedge = Obstacle("wedge", "bottom", Plane((0.0, -1.0), (0.0, 1.0)), force=tuple(push * way))
    solver = PreloadSolver(PreloadModel(structure, [wedge, faces(bonded=True)]))
    result = solver.solve()
    assert result["wedge"].normal_force == pytest.approx(push / way[1], rel=1e-8)
    assert result.reaction("wedge") == pytest.approx([0.0, push / way[1]], abs=1e-6 * push)
    moved = result.motion("wedge")
    assert moved[0] / moved[1] == pytest.approx(0.75)
    with PreloadAdjoint(result) as adjoint:
        found = adjoint.force("wedge").forces["wedge"]
    assert found == pytest.approx(push / way[1], rel=1e-8)
    half = solver.solve({"wedge": 0.5})
    assert half["wedge"].normal_force == pytest.approx(0.5 * push / way[1], rel=1e-8)


@pytest.mark.parallel
def test_a_free_block_between_two_that_are_pushed():
    """Two opposed obstacles squeeze a block that nothing else holds."""
    ends = {"low": ("bottom", -1.0, 1.0), "high": ("top", 1.0, -1.0)}
    pushed = [
        Obstacle(name, face, Plane((0.0, y), (0.0, n)), force=(0.0, 1e5 * n))
        for name, (face, y, n) in ends.items()
    ]
    solver = PreloadSolver(PreloadModel(block(), [*pushed, faces(bonded=True)]))
    result = solver.solve()
    assert [result[n].normal_force for n in ends] == pytest.approx([1e5, 1e5], rel=1e-8)
    squeezed = 2 * 1e5 * (1 - STEEL["nu"] ** 2) / STEEL["E"]
    assert (result.motion("low") - result.motion("high"))[1] == pytest.approx(squeezed, rel=1e-7)


def test_dragged_over_a_rough_plane():
    """Pressed and then dragged, a block slips everywhere with Coulomb's share of its force."""
    structure = block()
    floor = Obstacle("floor", "bottom", Plane((0.0, -1.0), (0.0, 1.0)), friction=0.25)
    ways = [
        Displacement("down", "top", (None, -1e-5)),
        Displacement("along", "bottom", (0.0, None)),
    ]
    with pytest.raises(MeshError, match="both govern one vertex"):
        PreloadModel(structure, [floor, faces(bonded=True)], (), ways)
    grip = Displacement("grip", "top", (1e-4, -1e-5))
    solver = PreloadSolver(PreloadModel(structure, [floor, faces(bonded=True)], (), [grip]))
    result = solver.solve({"grip": 1.0})
    state = result["floor"]
    assert SLIP in state.status and STICK not in state.status
    shear = state.resultant[0]
    assert abs(shear) == pytest.approx(0.25 * state.normal_force, rel=1e-6)
    shift = solver.model.jumps.shift(0)
    held = solver.model.jumps.gather(result.reactions, shift)
    assert held == pytest.approx(-state.resultant, rel=1e-8)


def test_bore():
    """Distances from the wall of a bore are those to its radius, its normals look to the axis."""
    pin = Cylinder((0.0, 0.0, 0.0), (0.0, 0.0, 2.0), 1.0, inside=True)
    distance, normal = pin(np.array([[0.5, 0.0, 3.0], [0.0, -2.0, 1.0]]))
    assert distance == pytest.approx([0.5, -1.0])
    assert normal == pytest.approx(np.array([[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))


def test_bad_input():
    """What is wrong is said: shapes, ways, faces that look away, names given twice."""
    structure, floor = block(), Plane((0.0, -1.0), (0.0, 1.0))

    def model(shape=floor, loads=(), bonded=(), **options):
        contacts = [Obstacle("floor", "bottom", shape, **options), *bonded]
        return PreloadModel(structure, contacts, (), loads)

    glue, twice = [faces(bonded=True)], [Traction("floor", "top", (0.0, -1.0))]
    for kind, call, message in (
        (MeshError, lambda: model(Plane((0.0, -1.0), (0.0, -1.0))), "floor: no facet of the face"),
        (InputError, lambda: model(travel=(0.0, 0.0, 1.0)), r"floor\.travel.*expected 2"),
        (InputError, lambda: Displacement("grip", "top", (None, None)), "not all of them None"),
        (InputError, lambda: model(lambda x: (x, x)), r"floor\.shape: expected distances"),
        (InputError, lambda: model(loads=twice), "floor is the name of two"),
        (InputError, lambda: solve_preload(model(bonded=glue)), "nothing presses the parts"),
    ):
        with pytest.raises(kind, match=message):
            call()
