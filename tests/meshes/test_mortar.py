"""Contact of faces whose meshes do not match, against closed forms."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from contact_blocks import STEEL, both, half_width, pair, pressed, unlike_blocks
from dolfinx import fem

from fenics_joints.errors import MeshError
from fenics_joints.meshes.mortar import hats, overlap
from fenics_joints.preload import (
    Contact,
    LinearJoint,
    PreloadAdjoint,
    PreloadModel,
    Traction,
    WasherForce,
    solve_preload,
)
from fenics_joints.structure import Parameter, Structure


def lean(x: np.ndarray) -> None:
    """Shear in the plan: facets stay parallelograms, and no two edges are parallel to axes."""
    if x.shape[1] == 3:
        x[:, 0] += 0.3 * x[:, 1]


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize(
    ("cell", "lower", "upper"),
    [
        pytest.param("quadrilateral", (5, 2), (3, 2), marks=pytest.mark.parallel),
        ("triangle", (3, 2), (7, 3)),
        ("hexahedron", (3, 2, 2), (2, 3, 2)),
        pytest.param("tetrahedron", (3, 2, 2), (2, 3, 2), marks=pytest.mark.parallel),
    ],
)
def test_patch(cell, lower, upper, degree):
    """Evenly pressed faces carry the same pressure at every vertex, whatever the two meshes."""
    tagged, bolts = (
        unlike_blocks(lower, upper, cell, lean),
        [WasherForce("b", "bottom", "top", 1e5)],
    )
    for friction in (0.0, 0.3):
        model = pressed(tagged, held=(), bolts=bolts, degree=degree, friction=friction)
        state = solve_preload(model)["c"]
        assert np.allclose(state.pressure, 1e5, rtol=1e-8)
        assert abs(state.area - 1) < 1e-12


def test_hertz_line():
    """A cylinder pressed on a block, each with its own mesh: peak and half-width are Hertz's."""
    R, a, size = 0.1, 1e-3, 25e-3
    E_star = 0.5 * STEEL["E"] / (1 - STEEL["nu"] ** 2)
    force, peak = np.pi * E_star * a**2 / (4 * R), E_star * a / (2 * R)

    def grade(x):
        across = 2 * x[:, 0] - 1
        x[:, 0] = size * np.sign(across) * np.abs(across) ** 2
        x[:, 1] = size * np.sign(x[:, 1]) * np.abs(x[:, 1]) ** 2

    tagged = unlike_blocks((110, 30), (91, 24), "quadrilateral", grade)
    load = Traction("load", "top", (0.0, -force))
    state = solve_preload(pressed(tagged, [load], gap=lambda x: x[:, 0] ** 2 / (2 * R)))["c"]
    assert abs(state.normal_force / force - 1) < 1e-8
    assert abs(state.pressure.max() / peak - 1) < 0.01
    assert abs(half_width(state) / a - 1) < 0.02


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cell", ["quadrilateral", "tetrahedron"])
def test_glued_faces_carry_any_even_stress(cell, degree):
    """Bonded: under even shear and tension the displacement is linear through both meshes."""
    counts = {"quadrilateral": ((3, 2), (4, 3)), "tetrahedron": ((2, 3, 2), (3, 2, 2))}[cell]
    structure = Structure(unlike_blocks(*counts, cell, lean), both(), degree=degree)
    glue = Contact("glue", "interface_lower", "interface_upper", bonded=True)
    joint = LinearJoint(PreloadModel(structure, [glue]))
    gdim = structure.gdim
    V, T = structure.V, joint.jumps.T
    u = fem.Function(V)
    slope = np.random.default_rng(1).normal(size=(gdim, gdim))
    u.interpolate(lambda x: slope @ x[:gdim])
    # Of a linear field all bubbles and jumps are zero: x is u, with the glued entries left out.
    y, x = T.createVecLeft(), T.createVecRight()
    x.array[:] = u.x.array[: x.getLocalSize()]
    c = joint.jumps.bonded[0]
    for nodes in (c.upper, c.coupling.midsides):
        joint.jumps.put(x.array, joint.jumps.entries(nodes), 0.0)
    T.mult(x, y)
    assert np.abs(y.array_r - u.x.array[: y.getLocalSize()]).max() < 1e-12


def test_part_that_sticks_out():
    """The upper face half beside the lower one: the part that is covered carries the bolt."""

    def aside(x):
        x[x[:, 1] > 0, 0] += 0.43
        x[:, 0] += 0.43 * ((x[:, 1] == 0) & (np.arange(len(x)) >= 4 * 8))

    tagged = unlike_blocks((3, 7), (9, 2), "quadrilateral", aside)
    load = Traction("load", "top", (0.0, -1e5), lambda x: (x[:, 0] < 0.9) * 1.0)
    state = solve_preload(pressed(tagged, [load]))["c"]
    # Facets are kept whose covered share is above a half: here none is cut near its middle.
    assert state.interface.areas.sum() == pytest.approx(0.57, abs=0.06)
    assert state.normal_force == pytest.approx(1e5, rel=1e-9)


def test_common_area_of_two_squares():
    """A square on another turned by 45 degrees: the octagon's area, whatever the triangles."""
    flat = square(5, 0.0, 1.0), square(4, np.pi / 4, -1.0)
    found = overlap(*flat)
    assert found.weight.sum() == pytest.approx(2 * (np.sqrt(2) - 1), rel=1e-12)
    for face, facets, at in (
        (flat[0], found.upper, found.at_upper),
        (flat[1], found.lower, found.at_lower),
    ):
        corners = face.points[face.facets[facets]]
        places = np.einsum("qk,qki->qi", hats(at, 3), corners)
        assert np.abs(places - found.points).max() < 1e-12


def square(n: int, angle: float, normal: float):
    """A unit square of triangles about the origin, turned in its plane."""
    line = np.linspace(-0.5, 0.5, n + 1)
    x, y = np.meshgrid(line, line, indexing="ij")
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    plan = np.column_stack([x.ravel(), y.ravel()]) @ turn.T
    corner = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()[:, None]
    facets = np.vstack([corner + [0, 1, n + 1], corner + [1, n + 1, n + 2]])
    normals = np.tile([0.0, 0.0, normal], (len(facets), 1))
    return SimpleNamespace(
        points=np.column_stack([plan, np.zeros(len(plan))]), facets=facets, normals=normals
    )


@pytest.mark.parallel
def test_gradient():
    """The adjoint of a load on the upper block, through meshes that do not match."""
    E = Parameter("E", 70e9)
    load = Traction("load", "top", (0.0, -1e5), lambda x: (x[:, 0] - 0.3) ** 2)
    bodies = {"parts": pair({}, {"E": "E"}), "parameters": [E]}
    tagged = unlike_blocks((7, 3), (5, 3), "triangle")
    model = pressed(tagged, [load], friction=0.1, **bodies)

    def pressure(value):
        state = solve_preload(model, given={"E": value})["c"]
        return float(state.pressure @ np.arange(len(state.pressure)))

    result = solve_preload(model)
    with PreloadAdjoint(result) as adjoint:
        found = adjoint.pressure("c", np.arange(len(result["c"].pressure)))
    step = 1e-4 * E.value
    slope = (pressure(E.value + step) - pressure(E.value - step)) / (2 * step)
    assert found.parameters["E"] == pytest.approx(slope, rel=1e-5)


def test_faces_that_are_apart_are_named():
    """Faces that do not lie on one another are an error, and a face cannot touch itself."""

    def aside(x):
        x[x[:, 1] > 0, 0] += 5.0
        x[:, 0] += 5.0 * ((x[:, 1] == 0) & (np.arange(len(x)) >= 12))

    tagged = unlike_blocks((3, 2), (2, 2), "quadrilateral", aside)
    with pytest.raises(MeshError, match="c: the two faces do not lie on one another"):
        pressed(tagged, held=())
