"""Modes by LOBPCG with multigrid against the direct solver's factorisation, and what it refuses."""

import numpy as np
import pytest
from mpi4py import MPI

from fenics_joints.beams import Beam, BeamStructure
from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.meshes import box, dumbbell, lap_plates
from fenics_joints.modal import IterativeEigenSolver, solve_modes
from fenics_joints.structure import (
    ElasticSupport,
    Parameter,
    PointMass,
    Spring,
    Structure,
    Support,
    joint,
    part,
    transition,
)

IRON = {"E": 1.5e11, "nu": 0.25, "rho": 7200.0}
ALUMINIUM = {"E": 69e9, "nu": 0.3, "rho": 2750.0}
H = 0.7e-3


def dumbbells(comm=MPI.COMM_WORLD) -> Structure:
    """Thin layer without mass between cast bodies; square in plan: pairs of bending modes."""
    tagged = dumbbell(
        comm, head=(0.2, 0.2, 0.08), neck=(0.1, 0.1, 0.04), layer=H, element_size=0.05
    )
    bodies = [part(n, n, **IRON) for n in ("head_1", "neck_1", "neck_2", "head_2")]
    layer = transition("joint", "joint", E="E", nu=0.2, h=H, meshed=H, rho=0.0)
    return Structure(tagged, [*bodies, layer], [Parameter("E", 6e9)])


def plates(E: float = 1e6) -> Structure:
    """Plates 4 mm thick with cells of 14 mm, and between them 0.5 mm at a 70,000th of their E."""
    tagged = lap_plates(MPI.COMM_WORLD, n_length=14, n_width=5, n_thickness=1, zone=0.0)
    layer = [n for n in tagged.cell_names if n.startswith("joint")]
    regions = [part(n, n, **ALUMINIUM) for n in ("plate_1", "plate_2")]
    regions += [joint(n, n, E=E, G=0.4 * E) for n in layer]
    return Structure(tagged, regions)


def beam(degree: int = 2, **more) -> Structure:
    """A bar of 0.4 x 0.03 x 0.02 m."""
    tagged = box(MPI.COMM_WORLD, (0.4, 0.03, 0.02), (12, 2, 2))
    return Structure(tagged, [part("bar", tuple(tagged.cell_names), **IRON)], degree=degree, **more)


def compare(structure: Structure, n: int, given=None, rel=1e-8, **settings):
    """Frequencies of both ways agree, elastic shapes span the same; the iterative modes.

    Both lose round-off times the spread of the spectrum, 1e-16 times 1e8 or so: other processors,
    other last digits.
    """
    direct = solve_modes(structure, given, n_modes=n)
    found = solve_modes(structure, given, n_modes=n, method="iterative", **settings)
    rigid = direct.n_rigid
    assert found.n_rigid == rigid
    assert found.frequencies_hz[rigid:] == pytest.approx(direct.frequencies_hz[rigid:], rel=rel)
    M = structure.mass(given)
    cross = np.array([[x.dot(M * y) for y in found.shapes] for x in direct.shapes])
    assert np.linalg.svd(cross, compute_uv=False) == pytest.approx(np.ones(n), abs=1e-5)
    own = np.array([[x.dot(M * y) for y in found.shapes] for x in found.shapes])
    assert own == pytest.approx(np.eye(n), abs=1e-6)
    assert np.all(found.residuals < 1e-5)
    return found


@pytest.mark.parallel
def test_free_dumbbells_have_exact_rigid_modes_and_all_close_pairs():
    structure = dumbbells()
    found = compare(structure, 11)
    assert np.all(found.eigenvalues[:6] == 0.0)
    ratios = found.frequencies_hz[7:] / found.frequencies_hz[6:-1]
    assert np.any(np.abs(ratios - 1) < 1e-6)
    assert found.statistics["iterations"] <= 20
    # A near model from these modes, on the same meshes: fewer steps, the direct method's modes.
    given = {"E": 5.5e9}
    near = compare(structure, 11, given, solver=found.solver, initial=found)
    assert near.solver is found.solver
    assert near.statistics["iterations"] < found.statistics["iterations"]


@pytest.mark.parallel
def test_a_soft_thin_layer_between_flat_cells_costs_few_iterations():
    found = compare(plates(), 10)
    assert found.n_rigid == 6
    assert found.statistics["iterations"] <= 30


@pytest.mark.parallel
def test_a_layer_of_any_stiffness_costs_few_iterations():
    found = [
        # K's spread grows with it.
        compare(plates(stiffness * 69e9), 10, rel=1e-7).statistics["iterations"]
        for stiffness in (1e-3, 1.0, 1e3)  # of the plates' modulus
    ]
    assert max(found) <= min(30, 1.3 * min(found))


@pytest.mark.parallel
def test_modes_beyond_a_block_are_found_as_others_are_locked():
    compare(dumbbells(), 24)


@pytest.mark.parallel
def test_held_and_partly_held_bars():
    held = compare(beam(supports=[Support("x_min", (0, 1, 2))]), 4)
    assert held.n_rigid == 0
    # In x alone, which leaves three rigid motions: two ways across and one turn about x.
    assert compare(beam(supports=[Support("x_min", (0,))]), 6).n_rigid == 3
    one = compare(beam(degree=1, supports=[Support("x_min", (0, 1, 2))]), 4)
    assert one.solver.solver.getPC().getType() == "gamg"


def test_weak_springs_are_no_rigid_modes_and_masses_count():
    ends = [(0.0, 0.0, 0.0), (0.4, 0.0, 0.0), (0.4, 0.03, 0.0), (0.0, 0.03, 0.02)]
    springs = [
        Spring(f"s{i}{j}", 30.0, point, tuple(np.eye(3)[j]))
        for i, point in enumerate(ends)
        for j in range(3)
    ]
    masses = [PointMass("m", 0.3, (0.4, 0.0, 0.02))]
    # At 1 Hz both ways are left with the round-off of a K that is 1e13 times stiffer.
    found = compare(beam(springs=springs, masses=masses), 8, rel=1e-5)
    assert np.all(found.eigenvalues > 0.0)
    # Rayleigh's quotient of the bar's bounce in z is above the lowest mode.
    total = 0.3 + 7200 * 0.4 * 0.03 * 0.02
    assert found.frequencies_hz[0] < np.sqrt(4 * 30.0 / total) / (2 * np.pi)
    support = [ElasticSupport("mat", "z_min", 1e8, 1e7)]
    assert compare(beam(supports=support), 8).n_rigid == 0


def test_the_inverse_is_that_of_the_shifted_matrix():
    structure = dumbbells()
    found = solve_modes(structure, n_modes=7, method="iterative")
    K, M = structure.stiffness(), structure.mass()
    rhs = np.random.default_rng(1).standard_normal((K.getLocalSize()[0], 2))
    x, b = K.createVecs()
    for right, column in zip(rhs.T, found.solver.inverse(rhs).T, strict=True):
        x.array[:], b.array[:] = column, right
        r = K * x - found.solver.shift * (M * x) - b
        assert r.norm() < 1e-5 * b.norm()


def test_what_does_not_work_is_told():
    structure = beam()
    solver = IterativeEigenSolver(10, shift=-1e5, max_iterations=2)
    with pytest.raises(ConvergenceError, match="of 4 elastic modes converged in 2 iterations"):
        solver.solve(structure)
    solver.destroy()
    with pytest.raises(InputError, match="one of: direct, iterative"):
        solve_modes(structure, method="lanczos")
    with pytest.raises(InputError, match="expected a Structure"):
        solve_modes(BeamStructure([Beam("rod", 0.5, 0.02, 0.01, 4, **IRON)]), method="iterative")
    with pytest.raises(InputError, match="below zero"):
        IterativeEigenSolver(3, shift=0.0)
    # An exact coarse level instead of GAMG, by an option.
    found = compare(structure, 8, petsc_options={"pc_type": "cholesky"})
    assert found.solver.solver.getPC().getType() == "cholesky"
