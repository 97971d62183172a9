"""Structures that nothing holds: against held ones, and static steps against a dense solution."""

import numpy as np
import pytest
from mpi4py import MPI
from oscillators import BAND, CUBIC, DAMPING, FORCE, Cubic, duffing

from fenics_joints.errors import InputError
from fenics_joints.harmonic import solve_backbone, solve_harmonic
from fenics_joints.interfaces import InterfaceModel, InterfacePoints, full_layers, loading_shapes
from fenics_joints.joint_laws import Iwan, Segalman
from fenics_joints.meshes import half_lap_beam_section
from fenics_joints.modal import solve_modes
from fenics_joints.structure import Spring, Structure, joint, part
from fenics_joints.structure.sparse import product

MASS = 2.0  # of each: the reduced mass is the oscillator's


def pair(law=None) -> InterfaceModel:
    """Two free masses with the oscillator's spring, damper and law between them."""
    along = np.array([[1.0, -1.0]])
    between = along.T @ along
    interface = InterfacePoints("joint", law or Cubic(k=CUBIC), along[None], np.ones(1))
    first = np.array([1.0, 0.0])
    return InterfaceModel(
        MASS * np.eye(2),
        between,
        (interface,),
        DAMPING * between,
        {"push": first},
        {"stretch": along[0], "first": first},
    )


def test_two_free_masses_move_against_each_other_as_one_held_mass():
    """Through the turning points; their centre moves as the force alone has it."""
    found = solve_harmonic(pair(), "push", 2 * FORCE, BAND, sensor="stretch", harmonics=5)
    held = solve_harmonic(duffing(), "push", FORCE, BAND, harmonics=5)
    assert found.peak.frequency_hz == pytest.approx(held.peak.frequency_hz, rel=1e-4)
    assert found.peak.amplitude == pytest.approx(held.peak.amplitude, rel=1e-4)
    centre = found.coefficients.mean(axis=1)
    force = -2 * FORCE / (2 * MASS * found.omegas**2)
    assert centre[:, 1] == pytest.approx(force, rel=1e-6)
    assert np.abs(np.delete(centre, 1, axis=1)).max() < 1e-8


def test_a_balanced_static_load_shifts_the_stretch_and_no_more():
    load, at = 0.5, [0.15, 0.2]
    found = solve_harmonic(
        pair(), "push", 2 * FORCE, at=at, static=np.array([load, -load]), harmonics=5
    )
    held = solve_harmonic(duffing(), "push", FORCE, at=at, static=np.array([load]), harmonics=5)
    stretch = found.sensor_coefficients("stretch")
    assert stretch == pytest.approx(held.sensor_coefficients("mass"), abs=1e-8)
    assert stretch[0, 0] > 0.3 and np.abs(found.coefficients.mean(axis=1)[:, 0]).max() < 1e-8
    with pytest.raises(InputError, match="expected a load in balance with itself"):
        solve_harmonic(pair(), "push", FORCE, at=at, static=np.array([load, -0.9 * load]))


def test_a_free_mode_is_the_held_ones_backbone():
    ends = 0.1, 2.0
    free = solve_backbone(pair(), ends, sensor="stretch", near=0.16)
    held = solve_backbone(duffing(), ends)
    expected = np.interp(free.amplitude("stretch"), held.amplitude("mass"), held.frequencies_hz)
    assert free.frequencies_hz == pytest.approx(expected, rel=1e-3)


def test_what_a_law_alone_resists_is_not_free():
    """A mass that a cubic spring ties to another: none of its stiffness is there at rest."""
    K = np.diag([1.0, 0.0])
    tie = InterfacePoints("tie", Cubic(k=CUBIC), np.array([[[-1.0, 1.0]]]), np.ones(1))
    assert len(InterfaceModel(np.eye(2), K).free_motions()) == 1
    assert len(InterfaceModel(np.eye(2), K, (tie,)).free_motions()) == 0
    assert len(pair().free_motions()) == 1 and len(duffing().free_motions()) == 0


# -- a meshed beam ---------------------------------------------------------------------------------

E, G, LAYER = 2.1e6, 10.3e6, 1e-4


def beam(springs=()) -> Structure:
    mesh = half_lap_beam_section(MPI.COMM_WORLD, layer=LAYER, washer=0.0, n_length=4, n_lap=6)
    regions = [
        part("beams", ("beam_1", "beam_2"), E=194e9, nu=0.3, rho=7733.0, normal=(0.0, 1.0)),
        joint("lap", "joint", E=E, G=G, normal=(0.0, 1.0)),
    ]
    return Structure(mesh, regions, springs=springs)


def full(structure: Structure):
    law = Iwan(Segalman(2e4, G, -0.5, 1.0), 8)
    return full_layers(structure, {"lap": law}, forces={"push": ((0.085, 6.35e-3), (0.0, 1.0))})


@pytest.mark.parallel
def test_inertia_bears_what_a_static_load_does_not_balance():
    """A small force at one place: K u = f - M a, u at right angles to rigid motion, densely."""
    structure = beam()
    model = full(structure)
    load = model.forces["push"]
    (found,) = loading_shapes(model, load, [1e-3])
    start, end = load.getOwnershipRange()
    unit = np.eye(load.getSize())[start:end]
    K, M = (
        np.vstack(structure.comm.allgather(product(A, unit)))
        for A in (structure.stiffness(), structure.mass())
    )
    f, u = (np.concatenate(structure.comm.allgather(v.array_r)) for v in (load, found))
    values, modes = np.linalg.eigh(K)
    rigid = modes[:, :3]
    assert len(model.free) == 3 and values[2] < 1e-6 * values[3]
    heavy = M @ rigid
    f = 1e-3 * (f - heavy @ np.linalg.solve(rigid.T @ heavy, rigid.T @ f))
    exact = modes[:, 3:] @ (modes[:, 3:].T @ f / values[3:])
    exact -= rigid @ np.linalg.solve(rigid.T @ heavy, heavy.T @ exact)
    assert u == pytest.approx(exact, abs=1e-4 * np.abs(exact).max())


@pytest.mark.parallel
@pytest.mark.parametrize("hung", [False, True])
def test_steps_up_to_slip_are_found_of_a_beam_that_is_free_or_hung(hung):
    """To within round-off, which in a thin layer is above the tolerance that is asked."""
    ends = [(0.1, 6.35e-3), (0.62, 6.35e-3)]
    springs = [Spring(f"cord_{i}", 300.0, end, (0.0, 1.0)) for i, end in enumerate(ends)]
    structure = beam(springs if hung else ())
    model, modes = full(structure), solve_modes(structure, n_modes=4)
    assert len(model.free) == modes.n_rigid == (1 if hung else 3)
    load = model.M * modes.shapes[3]
    load.scale(float(modes.eigenvalues[3]))
    factors = np.geomspace(1e-4, 1e-2, 6)
    # At round-off the residual moves by chance: some steps more reach its bound.
    options = {"snes_rtol": 1e-14, "snes_max_it": 40}
    found = loading_shapes(model, load, factors, petsc_options=options)
    assert len(found) >= len(factors)
    compliance = np.array([u.dot(load) for u in found[:6]]) / factors
    # The joint gives way more and more.
    assert np.all(np.diff(compliance) > 0) and compliance[-1] > 1.02 * compliance[0]
    mean = np.array([model.free.inertia.T @ u.array_r for u in found])
    assert np.abs(MPI.COMM_WORLD.allreduce(mean)).max() < 1e-9
