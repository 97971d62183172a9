"""The linearised joint: stuck, sliding, open and springs, and that preload changes frequencies."""

from dataclasses import replace

import numpy as np
import pytest
from contact_blocks import both, pressed
from mpi4py import MPI
from scipy.optimize import brentq

from fenics_joints.errors import InputError
from fenics_joints.meshes import c_beams, stacked_blocks
from fenics_joints.modal import solve_modes
from fenics_joints.preload import (
    OPEN,
    SLIP,
    STICK,
    BeamBolt,
    Contact,
    PreloadModel,
    Traction,
    WasherForce,
    solve_preload,
)
from fenics_joints.preload.linear_joint import (
    LinearJoint,
    cutoff_conditions,
    pair_conditions,
    pressure_stiffness,
    status_conditions,
)
from fenics_joints.structure import Parameter, Sensors, Structure, Support, part

E, NU, RHO = 194e9, 0.29, 8000.0
SMALL = {"element_size": 12e-3, "radial_size": 6e-3, "middle_size": 80e-3, "n_thickness": (1, 1)}


def bare(degree=2, cell="hexahedron", bonded=False, parameters=()):
    mesh = c_beams(MPI.COMM_WORLD, bonded=bonded, cell=cell, **SMALL)
    modulus = "E" if parameters else E
    parts = [part("beams", ("beam_1", "beam_2"), E=modulus, nu=NU, rho=RHO)]
    return Structure(mesh, parts, parameters, degree=degree)


def beams(degree=2, bolts=True, **more):
    pads = Contact("pads", "interface_lower", "interface_upper", friction=0.3)
    ends = [(f"bolt_{i}", f"washer_{i}_lower", f"washer_{i}_upper") for i in (1, 2)]
    spiders = [BeamBolt(*end, 28e3, 7.9e-3, head_mass=0.01) for end in ends]
    return PreloadModel(bare(degree, **more), [pads], spiders if bolts else [])


@pytest.mark.parallel
@pytest.mark.parametrize(
    ("degree", "cell"), [(1, "hexahedron"), (2, "hexahedron"), (2, "tetrahedron")]
)
def test_all_stuck_is_the_mesh_that_shares_its_vertices(degree, cell):
    stuck = LinearJoint(beams(degree, bolts=False, cell=cell))
    found = solve_modes(stuck, n_modes=12)
    whole = solve_modes(bare(degree, cell, bonded=True), n_modes=12)
    assert found.n_rigid == whole.n_rigid == 6
    assert found.frequencies_hz[6:] == pytest.approx(whole.frequencies_hz[6:], rel=1e-8)
    sensors = Sensors([[0.2, 0.0, -0.01], [0.3, 0.01, 0.008]], [[0, 0, 1.0], [0, 1.0, 0]])
    shapes = [np.abs(modes.at(sensors)[:, 6:]) for modes in (found, whole)]
    assert shapes[0] == pytest.approx(shapes[1], rel=1e-4, abs=1e-6)


@pytest.mark.parallel
def test_all_open_is_two_beams_apart():
    model = beams(bolts=False)
    n = len(model.interfaces[0])
    joint = LinearJoint(model, {"pads": np.full(n, OPEN)})
    apart = solve_modes(joint, n_modes=16)
    assert apart.n_rigid == 12
    # Two equal beams: every frequency comes twice.
    assert apart.frequencies_hz[12::2] == pytest.approx(apart.frequencies_hz[13::2], rel=1e-9)


@pytest.mark.parallel
def test_preload_changes_frequencies():
    """More force presses no larger patch on flat pads, but less than stuck all over; and a bolt
    that presses nothing leaves the pads to the beams of the bolts alone."""
    model = beams(1)
    result = solve_preload(model)
    pressed = LinearJoint(model, status_conditions(result))
    stuck = solve_modes(LinearJoint(model), n_modes=12).frequencies_hz[6:]
    partly = solve_modes(pressed, n_modes=12).frequencies_hz[6:]
    loose = pressed.change({"pads": np.full(len(model.interfaces[0]), OPEN)})
    open_ = solve_modes(loose, n_modes=12).frequencies_hz[6:]
    assert np.all(open_ < partly) and np.all(partly <= stuck)
    assert partly[0] < 0.99 * stuck[0] and open_[0] < 0.8 * partly[0]


def test_a_gap_closes_with_the_force_and_frequencies_follow():
    """Pads machined slightly apart at their rims: more bolt force closes more of them."""
    model = beams(1)

    def crown(x):
        return 0.2 * np.minimum(x[:, 0] - 0.02485, 0.48315 - x[:, 0]) ** 2

    pads = replace(model.contacts[0], gap=crown)
    model = PreloadModel(model.structure, [pads], model.bolts)
    areas, first = [], []
    for force in (2e3, 20e3, 60e3):
        result = solve_preload(model, {"bolt_1": force, "bolt_2": force})
        areas.append(result["pads"].area)
        joint = LinearJoint(model, status_conditions(result))
        first.append(solve_modes(joint, n_modes=8).frequencies_hz[6])
    assert areas[0] < areas[1] < areas[2]
    assert first[0] < first[1] < first[2]


def rods(bolts=(), loads=(), supports=()):
    """Two rods of 0.1 m with a square section of 0.01 m, end to end."""
    plan, height = np.linspace(0.0, 0.01, 2), np.linspace(0.0, 0.1, 21)
    mesh = stacked_blocks(MPI.COMM_WORLD, lower=(plan, plan, -height[::-1]), upper=height)
    parts = both(E=E, nu=0.0, rho=RHO)
    return pressed(mesh, loads, parts=parts, held=supports, bolts=bolts, degree=2)


@pytest.mark.parallel
@pytest.mark.parametrize("force", [100.0, 1000.0])
def test_springs_of_pressure_against_two_rods_and_a_spring(force):
    """Two free rods with K = alpha P^beta between them: a tan a = 2 K L / E, a = omega L / c."""
    model, length = rods([WasherForce("bolt", "bottom", "top", 100.0)]), 0.1
    result = solve_preload(model, {"bolt": force})
    state = result["c"]
    springs = pressure_stiffness(state, (3e8, 0.5), (1e9, 0.5))
    joint = LinearJoint(model, springs={"c": springs})
    modes = solve_modes(joint, n_modes=24)
    K = 3e8 * (force / 1e-4) ** 0.5
    a = brentq(lambda a: a * np.tan(a) - 2 * K * length / E, 1e-6, np.pi / 2 - 1e-9)
    exact = a / length * np.sqrt(E / RHO) / (2 * np.pi)
    end = Sensors(2 * [[0.005, 0.005, -0.1]], [[0, 0, 1.0], [1.0, 0, 0]])
    axial, side = np.abs(modes.at(end))
    stretching = modes.frequencies_hz[(modes.frequencies_hz > 10) & (axial > 10 * side)]
    assert np.abs(stretching / exact - 1).min() < 2e-4


def test_a_support_of_one_side_holds_both_where_they_are_stuck():
    """The lower rod's end is held: the upper rod stands on it, as on a support of its own."""
    length, held = 0.1, {}
    for face in ("interface_lower", "interface_upper"):
        joint = LinearJoint(rods(supports=[Support(face)]))
        held[face] = solve_modes(joint, n_modes=8).frequencies_hz
    assert held["interface_lower"] == pytest.approx(held["interface_upper"], rel=1e-5)
    # Clamped at one end (Euler and Bernoulli), 1.875^2 / (2 pi) r c / L^2 with r = side / sqrt(12).
    bending = 1.8751**2 / (2 * np.pi) * 0.01 / np.sqrt(12) * np.sqrt(E / RHO) / length**2
    assert held["interface_lower"][0] == pytest.approx(bending, rel=0.01)


def test_cutoff_conditions_by_hand():
    model = beams(degree=1)
    state = solve_preload(model)["pads"]
    p = state.facet_pressure
    cut = np.sort(p)[-5]
    two, three = (cutoff_conditions(state, cut, scheme) for scheme in ("two", "three"))
    assert np.sum(two == STICK) == np.sum(three == STICK) == 5
    assert np.all(three[(p < cut) & (p > 1e3)] == SLIP) and np.all(two[p < cut] == OPEN)
    assert np.all(three[p < 1e-3] == OPEN)
    pairs = pair_conditions(state.interface, two)
    corners = np.unique(state.interface.facets[two == STICK])
    assert np.array_equal(np.flatnonzero(pairs == STICK), corners)


def test_bad_input_is_named():
    model = beams(degree=1)
    with pytest.raises(InputError, match="no contact 'pad'"):
        LinearJoint(model, {"pad": np.zeros(3)})
    with pytest.raises(InputError, match="expected"):
        LinearJoint(model, {"pads": np.zeros(3)})
    state = solve_preload(model)["pads"]
    with pytest.raises(InputError, match="'two' or 'three'"):
        cutoff_conditions(state, 1e6, "four")
    with pytest.raises(InputError, match="alpha >= 0"):
        pressure_stiffness(state, (-1.0, 0.5), (1.0, 0.5))


def test_the_gradient_by_the_modulus_is_half_the_frequency():
    """With springs none, every frequency is proportional to the root of E in parts and bolts."""
    joint = LinearJoint(beams(1, bolts=False, parameters=[Parameter("E", E, "Pa")]))
    modes = solve_modes(joint, n_modes=9)
    slope = modes.gradients([6, 7, 8])[:, 0]
    assert slope == pytest.approx(modes.eigenvalues[6:9] / E, rel=1e-6)


def test_traction_profile_and_bolt_are_loads():
    """A load's profile is scaled to its force; half the patch carries all of it."""
    half = Traction("press", "top", (0.0, 0.0, -50.0), profile=lambda x: 1.0 * (x[:, 0] < 1.0))
    model = rods(loads=[half, Traction("base", "bottom", (0.0, 0.0, 50.0))])
    for factor in (1.0, 2.0):
        state = solve_preload(model, {"press": factor, "base": factor})["c"]
        assert state.normal_force == pytest.approx(50.0 * factor, rel=1e-9)
