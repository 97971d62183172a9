"""Bolts of all three forms: their force read back, and closed forms of shortening and bending."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from contact_blocks import COMM, both, pressed
from dolfinx import fem

from fenics_joints.errors import InputError
from fenics_joints.meshes import bolted_plates_section, separate, stacked_blocks
from fenics_joints.meshes.facets import add_faces, exterior_facets
from fenics_joints.meshes.grid import extruded, tensor_grid
from fenics_joints.meshes.tagged import distribute
from fenics_joints.parallel import on_root
from fenics_joints.preload import (
    BeamBolt,
    Contact,
    PreloadModel,
    PreloadSolver,
    PretensionSection,
    Traction,
    WasherForce,
    solve_preload,
)
from fenics_joints.structure import Structure, Support, part


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
