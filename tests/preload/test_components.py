"""Bolts of all three forms, rigid bodies and moved faces: forces, and closed forms of ways."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from contact_blocks import COMM, STEEL, both, faces, half_width, pressed
from dolfinx import fem

from fenics_joints.errors import InputError, MeshError
from fenics_joints.meshes import bolted_plates_section, graded_lines, separate, stacked_blocks
from fenics_joints.meshes.facets import add_faces, exterior_facets
from fenics_joints.meshes.grid import extruded, tensor_grid
from fenics_joints.meshes.tagged import distribute
from fenics_joints.parallel import on_root
from fenics_joints.preload import (
    SLIP,
    STICK,
    BeamBolt,
    Contact,
    Cylinder,
    Displacement,
    Obstacle,
    Plane,
    PreloadAdjoint,
    PreloadModel,
    PreloadSolver,
    PretensionSection,
    Sphere,
    Traction,
    WasherForce,
    solve_preload,
)
from fenics_joints.structure import Parameter, Structure, Support, part


def clamp():
    """A bolt x in (0, 1) beside a member x in (2, 4), both 3 high, between two yokes (metres)."""
    names = {"low": 1, "high": 2, "member": 3}

    def lists():
        y = np.array([-1.0, 0.0, 1.5, 3.0, 4.0])
        values = np.array([[1, 1, 1, 1], [1, 0, 3, 3], [2, 0, 3, 3], [2, 2, 2, 2]])
        whole = extruded(*tensor_grid(np.arange(5.0)), y, values, "quadrilateral", names)
        seams = {
            ("low", "high"): ("cut_low", "cut_high"),
            ("low", "member"): ("nut", "foot"),
            ("member", "high"): ("top", "head"),
        }
        whole = separate(whole, names, seams)
        facets, _ = exterior_facets(whole)
        at = whole.x[facets][:, :, 0]
        sides = {"left": np.all(at == 0, axis=1), "right": np.all(at == 4, axis=1)}
        return add_faces(whole, {name: facets[mask] for name, mask in sides.items()})

    return distribute(COMM, on_root(COMM, lists))


def clamped(degree: int):
    """The clamp with rigid yokes, which do not tilt, and what it takes to shorten its bolt."""
    E_bolt, E_member = 210e9, 70e9

    def stiffness(x, p):
        yoke = ufl.Or(ufl.lt(x[1], 0), ufl.gt(x[1], 3))
        return ufl.conditional(yoke, 1e6, 1.0) * E_bolt

    parts = [
        part("bolt", ("low", "high"), E=stiffness, nu=0.0, rho=1.0),
        part("member", "member", E=E_member, nu=0.0, rho=1.0),
    ]
    held = [Support("left", (0,)), Support("right", (0,))]
    structure = Structure(clamp(), parts, supports=held, degree=degree)
    contacts = [Contact("foot", "nut", "foot"), Contact("head", "top", "head")]
    bolt = PretensionSection("bolt", "cut_low", "cut_high", 1e6)
    return PreloadModel(structure, contacts, [bolt]), 3 / E_bolt + 3 / (2 * E_member)


@pytest.mark.parallel
@pytest.mark.smoke
@pytest.mark.parametrize("degree", [1, 2])
def test_section_in_series(degree):
    """The shortening is F (L/EA of the bolt + L/EA of the member); the shank carries F."""
    model, compliance = clamped(degree)
    solver = PreloadSolver(model)
    for force in (1e6, 3e6):
        result = solver.solve({"bolt": force})
        for contact in result.contacts.values():
            assert abs(contact.normal_force / force - 1) < 1e-6
        assert abs(result.shortening("bolt") / (force * compliance) - 1) < 2e-5
        u, msh = result.displacement, model.structure.tagged.mesh
        dx = ufl.Measure("dx", domain=msh, subdomain_data=model.structure.tagged.cell_tags)
        x = ufl.SpatialCoordinate(msh)
        shank = ufl.conditional(ufl.And(ufl.gt(x[1], 0), ufl.lt(x[1], 3)), 1.0, 0.0)
        work = fem.form(210e9 * u[1].dx(1) * shank * dx((1, 2)))
        assert abs(COMM.allreduce(fem.assemble_scalar(work)) / (3 * force) - 1) < 1e-6
    with pytest.raises(InputError, match="'nut' has no pretension section; expected: bolt"):
        result.shortening("nut")


@pytest.mark.parametrize("degree", [1, 2])
def test_solid_bolt_in_plates(degree):
    """All interfaces of a bolted joint carry the bolt's force, by vertices and by facets."""
    tagged = bolted_plates_section(COMM, parts="bolt", size=2.5e-3, radius=0.06)
    everything = tuple(tagged.cell_names)
    structure = Structure(
        tagged,
        [part("steel", everything, E=200e9, nu=0.3, rho=7800.0)],
        supports=[Support("axis", (0,))],
        degree=degree,
        axisymmetric=True,
    )
    names = ["interface", "seat_1", "seat_2", "head_1", "head_2"]
    contacts = [Contact(n, f"{n}_lower", f"{n}_upper", friction=0.15) for n in names]
    bolt = PretensionSection("bolt", "section_lower", "section_upper", 25e3)
    result = solve_preload(PreloadModel(structure, contacts, [bolt]))
    assert result.iterations < 25
    assert result.complementarity < 1e-8
    for state in result.contacts.values():
        assert abs(state.normal_force / 25e3 - 1) < 1e-6
        assert abs(np.sum(state.facet_pressure * state.facet_area) / 25e3 - 1) < 1e-6
    # Between a shank whose plates are rigid, and one of half its length that is alone.
    shank = 25e3 * 0.045 / (200e9 * np.pi * 0.006**2)
    assert shank < result.shortening("bolt") < 2 * shank


def plates(bolts, E=200e9, **more):
    """Two blocks 0.1 m wide and 0.02 and 0.03 m high, with a washer face on each."""
    x = np.linspace(-0.05, 0.05, 5)
    tagged = stacked_blocks(COMM, lower=(x, x, (-0.02, 0.0)), upper=(0.0, 0.03))
    return pressed(tagged, parts=both(E=E), bolts=bolts, **{"held": (), "friction": 0.2} | more)


def beam(force=2e4, **options):
    return BeamBolt("bolt", "bottom", "top", force, **{"diameter": 0.012} | options)


@pytest.mark.parallel
def test_beam_bends():
    """Rigid plates that slide on one another bend the bolt between guided ends (Timoshenko).

    u = Q (L^3 / 12 EI + L / kappa G A), whatever the preload, which the interface carries.
    """
    Q, E, d, L, nu = 100.0, 210e9, 0.012, 0.05, 0.3
    push = Traction("push", "top", (Q, 0.0, 0.0))
    model = plates([beam()], 1e15, loads=[push], held=["bottom"], friction=0.0)
    kappa = 6 * (1 + nu) / (7 + 6 * nu)
    shear = L * 2 * (1 + nu) / (kappa * E * np.pi * d**2 / 4)
    closed = Q * (L**3 / (12 * E * np.pi * d**4 / 64) + shear)
    solver = PreloadSolver(model)
    for force in (1e4, 2e4):
        state = solver.solve({"bolt": force})["c"]
        moved = np.einsum("nk,nki->ni", state.slip, state.interface.frames[:, 1:])
        assert abs(state.normal_force / force - 1) < 1e-6
        assert np.allclose(moved[:, 0], closed, rtol=1e-3)


def test_free_beam_bolt():
    """A bolt of spiders presses free plates with its force, and its axis may be any."""
    state = solve_preload(plates([beam()]))["c"]
    assert abs(state.normal_force / 2e4 - 1) < 1e-6
    assert np.abs(state.resultant[:2]).max() < 1e-6 * 2e4
    with pytest.raises(InputError, match="bolt.diameter|diameter = -0.01"):
        solve_preload(plates([beam(diameter=-0.01)]))


def test_washer_force():
    """A washer carries its bolt's force; one that pushes parts apart, or is two bolts', is not."""
    bolts = [WasherForce(n, "bottom", "top", f) for n, f in (("a", 1e4), ("b", 3e4))]
    model = plates(bolts[:1])
    assert abs(solve_preload(model)["c"].normal_force / 1e4 - 1) < 1e-6
    assert abs(solve_preload(model, {"a": 3e4})["c"].normal_force / 3e4 - 1) < 1e-6
    with pytest.raises(InputError, match="a = -30000.0: expected a number of at least 0 N"):
        solve_preload(model, {"a": -3e4})
    with pytest.raises(InputError, match="b.lower = 'bottom': the bolt a has this face already"):
        plates(bolts)
    with pytest.raises(InputError, match="a.axis"):
        plates([WasherForce("a", "bottom", "top", 1e4, axis=(0.0, 1.0))])
    with pytest.raises(InputError, match="name of two"):
        plates([bolts[0], bolts[0]])


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
