"""Modes of structures against dense LAPACK, and the same on two ranks."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from mpi4py import MPI

from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.meshes import box, half_lap_beam, lap_plates
from fenics_joints.modal import solve_modes
from fenics_joints.modal.modes import dense_modes, refine_modes
from fenics_joints.structure import (
    Parameter,
    PointMass,
    Sensors,
    Spring,
    Structure,
    interface,
    joint,
    part,
)

VALUES = {"plates.E": 69e9, "layer.E": 8e7, "layer.G": 3e7, "tip.mass": 0.03, "tip.travel": 0.004}
#: Odd places: no line of the mesh runs through them, and the last is inside a plate.
SENSORS = Sensors(
    np.array([[0.013, 0.031, 0.008], [0.151, 0.017, 0.0165], [0.307, 0.071, 0.012]]),
    np.array([[0.0, 0.0, 1.0], [0.3, 0.2, 1.0], [0.0, 1.0, 0.0]]),
)


def build(comm=MPI.COMM_SELF, degree=2, springs=(), **size):
    size = {"element_size": 0.02, "n_thickness": 1} | size
    plates = part("plates", ("plate_1", "plate_2"), E="plates.E", nu=0.283, rho=2750.0)
    layer = joint("layer", ("joint_near", "joint_away"), E="layer.E", G="layer.G")
    return Structure(
        lap_plates(comm, **size),
        [plates, layer],
        [Parameter(name, value) for name, value in VALUES.items()],
        masses=[PointMass("tip", "tip.mass", (0.01, 0.033, 0.0), travel="tip.travel")],
        springs=springs,
        degree=degree,
    )


def dense(matrix):
    """A PETSc matrix of one process as an array."""
    copy = matrix.convert("dense")
    return np.array(copy.getDenseArray())


def finite_eigenvalues(K, M, count):
    """Lowest eigenvalues with the massless motions condensed, so that none can slip in."""
    weights, directions = scipy.linalg.eigh(M)
    heavy = weights > 1e-12 * weights[-1]
    A, B = directions[:, heavy], directions[:, ~heavy]
    condensed = A.T @ K @ A
    if B.shape[1]:
        cross = B.T @ K @ A
        condensed = condensed - cross.T @ np.linalg.solve(B.T @ K @ B, cross)
    scale = 1 / np.sqrt(weights[heavy])
    return scipy.linalg.eigvalsh(scale[:, None] * condensed * scale, subset_by_index=[0, count - 1])


@pytest.mark.parametrize("G", [3e5, 3e10])
def test_massless_layers_leave_no_spurious_mode(G):
    """Degree 2: the nodes inside the layer have no inertia, be it soft or stiff."""
    model = build(element_size=0.04, bolts=[(0.16, 0.04)])
    given = {"layer.G": G}
    modes = solve_modes(model, given, n_modes=16)
    exact = finite_eigenvalues(dense(model.stiffness(given)), dense(model.mass(given)), 16)
    assert modes.n_rigid == 6
    assert modes.eigenvalues[6:] == pytest.approx(exact[6:], rel=1e-6)
    # Rigid motions stand far below the first strained one, on both routes.
    assert np.abs(modes.eigenvalues[:6]).max() < 1e-6 * exact[6]
    assert np.abs(exact[:6]).max() < 1e-3 * exact[6]


@pytest.mark.parametrize("hung", [False, True])
def test_round_off_of_a_layer_of_a_micrometre_makes_no_mode_elastic(hung):
    """A long beam, its halves bonded over it: 0.08 Hz by round-off; on soft cords it bounces."""
    n = {"n_length": 3, "n_lap": 4, "n_width": 1}
    mesh, h = half_lap_beam(MPI.COMM_WORLD, length=3.0, layer=1e-6, washer=0.0, **n), 1e-6
    regions = [
        part("beams", ("beam_1", "beam_2"), E=194e9, nu=0.3, rho=7745.0),
        interface("lap", ("joint",), k_n=194e9 / h, k_t=75e9 / h, meshed=h),
    ]
    cords = [Spring(f"cord {x}", 300.0, (x, 0.0, 0.00635), (0.0, 0.0, 1.0)) for x in (0.5, 2.5)]
    beam = Structure(mesh, regions, [], degree=2, springs=cords if hung else [])
    modes = solve_modes(beam, n_modes=8)
    assert modes.n_rigid == (4 if hung else 6)
    bounce = np.sqrt(600 / beam.total_mass()) / (2 * np.pi)
    assert not hung or modes.frequencies_hz[4] == pytest.approx(bounce, rel=0.05)


def test_what_is_too_stiff_to_have_a_mass_by_round_off_is_no_mode():
    # Of three masses the third is on a spring that makes its 1 / lambda less than the round-off of
    # the rigid mode's.
    K = np.array([[1.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, 1e30]])
    values, shapes = dense_modes(K, np.diag([1.0, 1.0, 1e-3]), 1e-2, 3)
    assert np.isinf(values[2]) and not shapes[:, 2].any()
    assert values[:2] == pytest.approx([0.0, 2.0], abs=1e-9)
    assert np.abs(shapes[:2, :2]) == pytest.approx(np.full((2, 2), 0.5**0.5))


@pytest.fixture(scope="module")
def modes():
    """Twelve of the lap plates."""
    return solve_modes(build(), n_modes=12)


def test_shapes_are_orthonormal_in_mass_and_carry_their_eigenvalue(modes):
    model = modes.model
    K, M = model.stiffness(), model.mass()
    heavy = np.array([[x.dot(M * y) for y in modes.shapes] for x in modes.shapes])
    assert heavy == pytest.approx(np.eye(12), abs=1e-9)
    stiff = np.array([x.dot(K * x) for x in modes.shapes])
    assert stiff[6:] == pytest.approx(modes.eigenvalues[6:], rel=1e-8)
    assert np.all(modes.residuals[6:] < 1e-5)


@pytest.mark.parametrize("shift_hz", [5.0, 60.0, 900.0])
def test_the_shift_moves_no_frequency(modes, shift_hz):
    """A free body is singular at zero; any shift below it gives the same modes."""
    moved = solve_modes(modes.model, n_modes=12, shift_hz=shift_hz)
    assert moved.frequencies_hz[6:] == pytest.approx(modes.frequencies_hz[6:], rel=1e-8)
    assert moved.solver.solver.getST().getShift() == pytest.approx(-((2 * np.pi * shift_hz) ** 2))


def test_options_reach_slepc(modes):
    options = {"eps_type": "arnoldi", "eps_ncv": 40}
    other = solve_modes(modes.model, n_modes=10, petsc_options=options)
    assert other.solver.solver.getType() == "arnoldi"
    assert other.solver.solver.getDimensions()[1] == 40
    assert other.frequencies_hz[6:] == pytest.approx(modes.frequencies_hz[6:10], rel=1e-7)


def test_start_from_near_modes_gives_the_same():
    model = build(element_size=0.04)
    first = solve_modes(model, n_modes=10)
    near = {"layer.G": 3.3e7}
    cold = solve_modes(model, near, n_modes=10)
    warm = solve_modes(model, near, n_modes=10, solver=first.solver, initial=first)
    assert warm.frequencies_hz[6:] == pytest.approx(cold.frequencies_hz[6:], rel=1e-8)


@pytest.mark.parallel
def test_two_ranks_agree_to_round_off():
    """Frequencies, shapes at sensors and all gradients, against one process in the same run."""
    both = MPI.COMM_SELF, MPI.COMM_WORLD
    # An eigenvalue's error is the square of its shape's: shapes to 1e-8 need a tighter solution.
    alone, together = (solve_modes(build(c), n_modes=12, tolerance=1e-10) for c in both)
    loose = solve_modes(build(MPI.COMM_WORLD), n_modes=12)
    assert loose.frequencies_hz[6:11] == pytest.approx(alone.frequencies_hz[6:11], rel=1e-8)
    assert together.n_rigid == alone.n_rigid == 6
    elastic = np.arange(6, 11)
    assert together.frequencies_hz[elastic] == pytest.approx(alone.frequencies_hz[elastic], 1e-8)
    first, second = (np.abs(m.at(SENSORS)[:, elastic]) for m in (alone, together))
    assert second == pytest.approx(first, abs=1e-8 * first.max())
    relative = np.array(list(VALUES.values())) / alone.eigenvalues[elastic][:, None]
    first, second = (m.gradients(elastic) * relative for m in (alone, together))
    assert second == pytest.approx(first, abs=1e-8 * np.abs(first).max())
    assert together.visibility(SENSORS)[6:11] == pytest.approx(
        alone.visibility(SENSORS)[6:11], 1e-7
    )


def block(rho=7800.0, **more):
    body = part("block", "body", E=2e11, nu=0.3, rho=rho)
    return Structure(box(MPI.COMM_SELF, (0.1, 0.1, 0.1), (2, 2, 2)), [body], **more)


def test_visibility_of_a_translation_is_one_along_it_and_none_across():
    """A block on soft springs along z: its one mode that is not free moves every point alike."""
    modes = solve_modes(block(springs=[Spring("z", 1e5, (0.05, 0.05, 0.05))]), n_modes=6)
    points = np.array([[0.01, 0.02, 0.03], [0.1, 0.1, 0.1]])
    assert modes.n_rigid == 5
    assert modes.visibility(Sensors(points, [0, 0, 1.0]))[5] == pytest.approx(1.0, rel=1e-3)
    assert modes.visibility(Sensors(points, [0.6, 0, 0.8]))[5] == pytest.approx(0.8, rel=1e-3)
    assert modes.visibility(Sensors(points, [1.0, 0, 0]))[5] < 1e-3


def test_impossible_requests_are_named():
    model = build(element_size=0.04, degree=1)
    with pytest.raises((InputError, ConvergenceError), match=str(model.n_dofs + 1)):
        solve_modes(model, n_modes=model.n_dofs + 1)
    outside = Sensors([[9.0, 0.0, 0.0]], [0, 0, 1.0])
    with pytest.raises(InputError, match=r"sensor at \[9.0, 0.0, 0.0\] m is outside the mesh"):
        solve_modes(model, n_modes=7).at(outside)
    with pytest.raises(InputError, match="no mass: expected a density > 0"):
        solve_modes(block(rho=0.0), n_modes=7)


@pytest.mark.parallel
def test_refined_modes_are_a_tenth_as_far_off_as_where_they_start():
    """From modes with a share of higher ones; the matrices are others than the solver's last."""
    model = build(MPI.COMM_WORLD, element_size=0.04)
    near = solve_modes(model, n_modes=14)
    given = {"layer.E": 4e7, "plates.E": 60e9}
    true = solve_modes(model, given, n_modes=36)
    x, lam = np.array([vector.array_r for vector in true.shapes]).T, true.eigenvalues
    mixed = 0.1 * np.random.default_rng(3).standard_normal((24, 12)) / 5
    found = refine_modes(model, given, near.solver, x[:, :12] + x[:, 12:] @ mixed)
    assert found.n_rigid == true.n_rigid == 6
    off = found.eigenvalues / lam[:12] - 1
    own = (lam[:12] + lam[12:] @ mixed**2) / (1 + np.sum(mixed**2, axis=0)) / lam[:12] - 1
    assert own[6:].min() > 1e-3
    assert np.all(off[6:] > -1e-9) and np.all(off[6:] < 0.1 * own[6:])
