"""Bodies that do not give way, and faces that are moved, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from contact_blocks import COMM, STEEL, both, faces

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


@pytest.mark.parallel
def test_hertz_by_a_rigid_ball():
    """A ball that does not give way, pressed in by a way: Hertz's patch for the force it takes."""
    R, a = 0.1, 1e-3
    h, size = a / 12, 20 * a
    x = graded_lines([0.0, 1.2 * a, size], [h, h, size / 4])
    z = graded_lines([0.0, a, size], [h, 2 * h, size / 4])
    tagged = stacked_blocks(COMM, lower=(x, -z[::-1]), upper=(0.0, size))
    # The ball comes from below onto the upper face of the lower block; the other one is apart.
    structure = Structure(tagged, both(), degree=1, axisymmetric=True,
                          supports=[Support("bottom"), Support("top")])  # fmt: skip
    ball = Obstacle("ball", "interface_lower", Sphere((0.0, R), R), travel=(0.0, -a**2 / R))
    state = solve_preload(PreloadModel(structure, [ball]))["ball"]
    E_star = STEEL["E"] / (1 - STEEL["nu"] ** 2)
    found = (3 * state.normal_force * R / (4 * E_star)) ** (1 / 3)
    r2, inner = state.interface.points[:, 0] ** 2, state.pressure > 0.3 * state.pressure.max()
    slope, top = np.polyfit(r2[inner], state.pressure[inner] ** 2, 1)
    assert abs(np.sqrt(-top / slope) / found - 1) < 0.01
    assert abs(state.pressure.max() / (2 * E_star * found / (np.pi * R)) - 1) < 0.01
    assert 0.8 < found / a < 1.2


def test_dragged_over_a_rough_plane():
    """Pressed and then dragged, a block slips everywhere with Coulomb's share of its force."""
    structure = block()
    floor = Obstacle("floor", "bottom", Plane((0.0, -1.0), (0.0, 1.0)), friction=0.25)
    ways = [Displacement("down", "top", (None, -1e-5)),
            Displacement("along", "bottom", (0.0, None))]  # fmt: skip
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
    structure = block()
    away = Obstacle("floor", "bottom", Plane((0.0, -1.0), (0.0, -1.0)))
    with pytest.raises(MeshError, match="floor: no facet of the face looks at the obstacle"):
        PreloadModel(structure, [away])
    with pytest.raises(InputError, match=r"floor\.travel.*expected 2 components"):
        PreloadModel(structure, [Obstacle("floor", "bottom", Plane((0.0, -1.0), (0.0, 1.0)),
                                          travel=(0.0, 0.0, 1.0))])  # fmt: skip
    with pytest.raises(InputError, match="not all of them None"):
        Displacement("grip", "top", (None, None))
    with pytest.raises(InputError, match=r"floor\.shape"):
        Obstacle("floor", "bottom", 3.0)
    odd = Obstacle("floor", "bottom", lambda x: (x, x))
    with pytest.raises(InputError, match=r"floor\.shape: expected distances"):
        PreloadModel(structure, [odd])
    floor = Obstacle("floor", "bottom", Plane((0.0, -1.0), (0.0, 1.0)))
    with pytest.raises(InputError, match="floor is the name of two"):
        PreloadModel(structure, [floor], (), [Traction("floor", "top", (0.0, -1.0))])
    with pytest.raises(InputError, match="nothing presses the parts together"):
        solve_preload(PreloadModel(structure, [floor, faces(bonded=True)]))
