"""Parametric reduced models against the full models they stand for."""

from __future__ import annotations

import numpy as np
import pytest
from dolfinx import fem
from mpi4py import MPI
from scipy.stats import qmc

from fenics_joints.errors import InputError
from fenics_joints.measurements.gap import TooFewModes
from fenics_joints.meshes import lap_plates
from fenics_joints.modal import EigenSolver, frequency_sensitivity, solve_modes
from fenics_joints.progress import Progress
from fenics_joints.reduction import ReducedStructure, reduce
from fenics_joints.reduction.arrays import trimmed
from fenics_joints.reduction.basis import SampledBasis, orthonormal
from fenics_joints.reduction.files import Cache
from fenics_joints.reduction.kept import KeptModel, read_reduced, write_reduced
from fenics_joints.reduction.prediction import Slopes, ways_of
from fenics_joints.reduction.reduced import monomials, shape_curvature
from fenics_joints.reduction.surrogate import ReducedModel
from fenics_joints.structure import Parameter, PointMass, Sensors, Spring, Structure, joint, part
from fenics_joints.structure.sparse import product

N_MODES = 12
#: Low and high of every parameter, log-uniform but for nu and the travel.
RANGES = {
    "plates.E": (6e10, 8e10),
    "plates.nu": (0.2, 0.35),
    "plates.thickness": (0.9, 1.1),
    "layer.E": (1e7, 1e10),
    "layer.G": (1e7, 1e10),
    "tip.mass": (0.005, 0.05),
    "tip.travel": (0.0, 0.1),
    "cord.stiffness": (1e3, 1e5),
}
TRAVEL = {"tip": RANGES["tip.travel"]}
SENSORS = Sensors(np.array([[0.02, 0.04, 0.008], [0.3, 0.01, 0.016]]), [0.0, 0.0, 1.0])


def build(comm=MPI.COMM_SELF):
    solid = {"E": "plates.E", "nu": "plates.nu", "rho": 2750.0, "stretch": "plates.thickness"}
    plates = part("plates", ("plate_1", "plate_2"), **solid)
    layer = joint("layer", ("joint_near", "joint_away"), E="layer.E", G="layer.G")
    return Structure(
        lap_plates(comm, element_size=0.04, n_thickness=1),
        [plates, layer],
        [Parameter(n, (a * b) ** 0.5 or 0.05, log=False) for n, (a, b) in RANGES.items()],
        masses=[PointMass("tip", "tip.mass", (0.01, 0.03, 0.0), travel="tip.travel")],
        springs=[Spring("cord", "cord.stiffness", (0.02, 0.0, 0.004), (0.0, 1.0, 0.0))],
    )


def samples(count, seed):
    """Values of all parameters, spread over their ranges."""
    unit = qmc.Sobol(len(RANGES), seed=seed).random_base2(4)[:count]
    low, high = np.array(list(RANGES.values())).T
    place = low * (high / np.maximum(low, 1e-9)) ** unit
    place[:, low == 0] = (high * unit)[:, low == 0]
    return [dict(zip(RANGES, map(float, row), strict=True)) for row in place]


@pytest.fixture(scope="module")
def full():
    return build()


@pytest.fixture(scope="module")
def checks(full):
    return [(p, solve_modes(full, p, n_modes=N_MODES)) for p in samples(4, seed=11)]


def errors(model, checks):
    """Relative frequency errors of elastic modes at all checks, shape (n,)."""
    found = []
    for point, exact in checks:
        modes = solve_modes(model, point, n_modes=N_MODES)
        elastic = slice(exact.n_rigid, N_MODES)
        found.append(modes.frequencies_hz[elastic] / exact.frequencies_hz[elastic] - 1)
    return np.concatenate(found)


def test_reduced_frequencies_bound_the_full_from_above_and_converge(full, checks):
    """Rayleigh and Ritz: a subspace can only be too stiff; more samples, less error."""
    worst = []
    for count in (2, 8, 16):
        found = errors(reduce(full, samples(count, seed=1), N_MODES, travel=TRAVEL), checks)
        assert found.min() > -1e-7
        worst.append(found.max())
    assert worst[1] < 0.3 * worst[0] and worst[2] < worst[1]
    assert worst[2] < 1e-3


def surrogate(structure, points, **more):
    """A model that serves a fit, by default of three modes that are seen in order."""
    given = {"sensors": None, "n_test": 3, "n_modes": N_MODES, "travel": lambda: TRAVEL}
    return ReducedModel(structure, structure.values(), samples=lambda: points, **given | more)


def test_a_sample_is_reproduced(full):
    """Frequencies, gradients, shapes at sensors and mass are the full model's at a sample."""
    point = samples(1, seed=5)[0]
    model = reduce(full, [{}, point], N_MODES, travel=TRAVEL)
    exact, small = (solve_modes(m, point, n_modes=N_MODES) for m in (full, model))
    assert small.n_rigid == exact.n_rigid == 5
    elastic = np.arange(5, N_MODES - 1)
    assert small.frequencies_hz[elastic] == pytest.approx(exact.frequencies_hz[elastic], rel=1e-6)
    scale = np.array([point[n] for n in full.parameters]) / exact.eigenvalues[elastic][:, None]
    difference = (small.gradients(elastic) - exact.gradients(elastic)) * scale
    assert np.abs(difference).max() < 1e-3
    assert np.abs(small.at(SENSORS)[:, elastic]) == pytest.approx(
        np.abs(exact.at(SENSORS)[:, elastic]), rel=1e-3, abs=1e-3
    )
    assert model.total_mass(point) == pytest.approx(full.total_mass(point), rel=1e-12)


def test_reduced_matrices_are_the_projected_ones_at_any_values(full):
    """Also far from every sample: the laws' terms are exact, the travel's spline nearly so."""
    model = reduce(full, [{}], N_MODES, travel=TRAVEL)
    for point in samples(3, seed=3):
        for key in ("stiffness", "mass"):
            projected = model.projection.matrix(getattr(full, key)(point))
            reduced = getattr(model, key)(point)
            assert np.abs(reduced - projected).max() < 1e-5 * np.abs(projected).max()


@pytest.mark.parametrize("kept", [False, True])
@pytest.mark.parametrize("law", ["uncoupled", "isotropic", "constrained"])
def test_terms_of_the_laws_reproduce_the_assembled_stiffness(law, kept):
    """On vectors that were never modes: the terms are an identity of matrices."""
    rng = np.random.default_rng(2)
    plates = part("plates", ("plate_1", "plate_2"), E="E", nu="nu", rho="rho", stretch="s")
    layer = joint(
        "layer", ("joint_near", "joint_away"), law=law, E="l.E", G="l.G", rho="l.rho", stretch="l.s"
    )
    names = ("E", "nu", "rho", "s", "l.E", "l.G", "l.rho", "l.s")
    model = Structure(
        lap_plates(MPI.COMM_SELF, element_size=0.04, n_thickness=1),
        [plates, layer],
        [Parameter(n, 0.3) for n in names],
        degree=1,
    )
    if kept:
        model.assemble_samples()
    vectors = []
    for _ in range(6):
        x = model.mass({"l.G": 1.0}).createVecRight()
        x.array[:] = rng.standard_normal(x.local_size)
        vectors.append(x)
    small = ReducedStructure(model, vectors)
    low = np.array([6e10, -0.2, 1e3, 0.5, 1.0, 1e6, 0.0, 0.2])
    high = np.array([2e11, 0.45, 8e3, 2.0, 2.9, 1e10, 1e3, 3.0])
    for _ in range(4):
        point = dict(zip(names, rng.uniform(low, high), strict=True))
        point["l.E"] *= point["l.G"]
        for key in ("stiffness", "mass"):
            assembled = small.projection.matrix(getattr(model, key)(point))
            near = pytest.approx(assembled, rel=1e-8, abs=1e-9 * np.abs(assembled).max())
            assert getattr(small, key)(point) == near


def test_moving_mass_is_where_it_says(full):
    """The spline over the travel against rows located anew, and its slope against differences."""
    model = reduce(full, [{}], N_MODES, travel=TRAVEL)
    u = model.basis[0]
    for travel in (0.0137, 0.0561, 0.0999):
        at, slope = model.pencil.moving[0](travel)
        located = model.projection.points((0.01 + travel, 0.03, 0.0))[0]
        assert at == pytest.approx(located, abs=1e-4 * np.abs(located).max())
        assert u.array_r.any()
        near = [model.pencil.moving[0](travel + d)[0] for d in (-1e-6, 1e-6)]
        assert slope == pytest.approx((near[1] - near[0]) / 2e-6, rel=1e-4, abs=1e-3)


@pytest.mark.parallel
def test_slopes_at_sensors_are_differences_of_what_they_read():
    """Of the modes' shapes, within cells, each sensor along its own way."""
    model = build(MPI.COMM_WORLD)
    modes = solve_modes(model, n_modes=8)
    points = np.array([[0.031, 0.037, 0.0021], [0.287, 0.011, 0.0127]])
    reads, ways = np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8]]), np.array([[2.0, 0, 0], [0, 3, 4]])
    slopes = model.observe_slopes(modes.shapes, Sensors(points, reads), ways)
    step = 1e-6 * ways / np.linalg.norm(ways, axis=1, keepdims=True)
    ahead, behind = (modes.at(Sensors(points + s * step, reads)) for s in (1, -1))
    assert slopes == pytest.approx((ahead - behind) / 2e-6, rel=1e-6, abs=1e-6)
    assert np.abs(slopes).max() > 1.0
    with pytest.raises(InputError, match="expected non-zero vectors"):
        model.observe_slopes(modes.shapes, Sensors(points, reads), [0.0, 0.0, 0.0])


def sampled(structure, points, share=2e-4):
    """A model on a basis that grew point by point."""
    basis = SampledBasis(share)
    for values in points:
        modes = solve_modes(structure, values, n_modes=N_MODES)
        basis.add(modes, range(len(modes)))
    vectors = orthonormal(structure, basis.vectors, points[0], 1e-13)
    return ReducedStructure(structure, vectors, TRAVEL)


def test_a_basis_holds_each_samples_modes_however_stiff_or_soft_its_joint(full, checks):
    """In the energy of the first, modes with a soft joint are nothing but its opening."""
    far = [{"layer.E": E, "layer.G": E} for E in (1e12, 1e6)]
    model = sampled(full, far)
    for values in far:
        exact, found = (solve_modes(m, values, n_modes=N_MODES) for m in (full, model))
        elastic = slice(exact.n_rigid, N_MODES)
        error = found.frequencies_hz[elastic] / exact.frequencies_hz[elastic] - 1
        assert np.all(error > -1e-7) and error.max() < 1e-4  # round-off: 1.4e-8 on some processors
    assert model.n_dofs < 2 * N_MODES  # what both have is there once
    # One that grows knows what is new, and still what it knew.
    _, exact = checks[0]
    grown = SampledBasis(2e-4, model.basis)
    grown.add(exact, range(len(exact)))
    richer = ReducedStructure(full, grown.vectors, TRAVEL)
    at, others = checks[:1], checks[1:]
    assert np.abs(errors(richer, at)).max() < min(1e-4, 0.05 * errors(model, at).max())
    assert errors(richer, others).max() <= errors(model, others).max() + 1e-9


@pytest.mark.parallel
def test_what_is_new_in_a_basis_is_projected_alone():
    """Beside vectors whose model is known; as if all were projected, and as orthogonal."""
    full = build(MPI.COMM_WORLD)
    points = [{}, *samples(2, seed=3)]
    start = sampled(full, points[:1])
    first, basis = start.arrays(), start.basis
    grown, whole = SampledBasis(2e-4, basis, first), SampledBasis(2e-4, basis)
    for values in points[1:]:
        modes = solve_modes(full, values, n_modes=N_MODES)
        grown.add(modes, range(len(modes))), whole.add(modes, range(len(modes)))
    assert len(grown.vectors) == len(whole.vectors) > len(basis)
    n = len(basis)
    vectors = orthonormal(full, grown.vectors, points[0], 1e-13, n, known=first)
    new, old = (ReducedStructure(full, vectors, TRAVEL, known=known) for known in (first, None))
    for point in samples(3, seed=8):
        for key in ("stiffness", "mass"):
            b = getattr(old, key)(point)
            near = pytest.approx(b, rel=1e-7, abs=1e-9 * np.abs(b).max())
            assert getattr(new, key)(point) == near
    K, M = old.stiffness(points[0]), old.mass(points[0])
    energy = K + np.trace(K) / np.trace(M) * M
    apart = energy[:n, n:] / np.sqrt(np.outer(np.diag(energy)[:n], np.diag(energy)[n:]))
    assert np.abs(apart).max() < 0.02


@pytest.mark.parallel
def test_refined_modes_make_as_good_a_model_as_solved_ones(monkeypatch):
    """Six solutions beside the nominal one, and a joint over three decades."""
    world, solved, solve = build(MPI.COMM_WORLD), [], EigenSolver.solve
    monkeypatch.setattr(EigenSolver, "solve", lambda *a, **k: solved.append(a) or solve(*a, **k))
    start = world.values()
    points = [start, *samples(8, seed=3)]
    model = surrogate(world, points, n_test=5, lacking=1e-3)
    assert len(solved) == 7
    best = sampled(world, points, 1e-3)
    for there in (points, samples(4, seed=11)):
        exact = [errors(best, [(v, model.solve(v))])[:5].max() for v in there]
        assert model.errors(there).max() < 1.2 * max(exact) + 1e-4


@pytest.mark.parallel
def test_a_kept_model_serves_another_test_of_the_structure(shared_tmp_path):
    """Other sensors, another number of modes: as good as what is made for it alone."""
    world, cache = build(MPI.COMM_WORLD), Cache(shared_tmp_path, "key", MPI.COMM_WORLD)
    start = world.values()
    points = [start, *samples(8, seed=3)]

    surrogate(world, points, n_test=5, lacking=1e-3, keep=cache)
    few = Sensors([[0.02, 0.01, 0.008], [0.15, 0.07, 0.008], [0.3, 0.04, 0.016]], [0.0, 0.0, 1.0])
    seen = {"sensors": few, "lacking": 1e-3}
    alone = surrogate(world, points, **seen)
    kept = surrogate(world, points, **seen, keep=cache)
    assert kept.model.n_dofs < cache.read("model", KeptModel).model.n_dofs
    elsewhere = samples(4, seed=11)
    own, best = (s.errors(elsewhere) for s in (kept, alone))
    assert np.all(own < 2 * best + 1e-4)
    # Against modes that are refined from its own, the same errors; what is off is mended by them.
    quick = kept.quick
    assert quick.errors(elsewhere) == pytest.approx(own, rel=0.1, abs=1e-6)
    quick.extend(elsewhere)
    assert np.all(kept.errors(elsewhere) < 1e-5 + 0.05 * own)


@pytest.mark.parallel
def test_a_model_kept_on_some_ranks_serves_any(shared_tmp_path):
    """Kept on all of them, read on one: the basis is that of the matrices."""
    world, own = build(MPI.COMM_WORLD), build()
    start = world.values()
    surrogate(world, [start], keep=Cache(shared_tmp_path, "key", MPI.COMM_WORLD))
    model, basis = read_reduced(own, Cache(shared_tmp_path, "key"))
    Z = np.array([vector.array_r for vector in basis]).T
    K = own.stiffness(start)
    theirs = model.stiffness(start)
    assert Z.T @ product(K, Z) == pytest.approx(theirs, abs=1e-6 * np.abs(theirs).max())
    MPI.COMM_WORLD.barrier()
    if MPI.COMM_WORLD.rank == 0:
        # Kept by one rank it serves all of them.
        write_reduced(own, Cache(shared_tmp_path, "one rank"), model, basis)
    MPI.COMM_WORLD.barrier()
    _, again = read_reduced(world, Cache(shared_tmp_path, "one rank", MPI.COMM_WORLD))
    assert sum(v.norm() for v in again) == pytest.approx(sum(v.norm() for v in basis), rel=1e-12)


def test_a_model_that_was_damaged_or_is_of_another_mesh_is_not_taken(tmp_path):
    model, cache, told = build(), Cache(tmp_path, "key"), []
    start = model.values()
    surrogate(model, [start], keep=cache)
    assert read_reduced(model, cache) is not None
    file = cache.path("model")
    whole = file.read_bytes()
    file.write_bytes(whole[:-1])
    assert read_reduced(model, cache) is None
    file.write_bytes(whole)
    progress = Progress(silent=True)
    progress.step = told.append
    assert read_reduced(model, Cache(tmp_path, "other"), progress) is None
    assert "another structure" in told.pop() and not told
    # Of the same key, but one node stands elsewhere.
    moved = build()
    moved.mesh.geometry.x[0, 0] += 1e-9
    assert read_reduced(moved, cache) is None


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_sensor_may_be_off_along_its_face(full, axis):
    """Two ways across each direction, or the line in which all stand; both as differences."""
    normal = np.eye(3)[axis]
    points = np.array([[0.05, 0.03, 0.006], [0.15, 0.05, 0.012], [0.28, 0.02, 0.014]])
    ways = ways_of(Sensors(points, normal), 3)
    assert ways.shape == (2, 3, 3) and np.abs(ways @ normal).max() < 1e-12
    assert np.einsum("wsk,vsk->swv", ways, ways) == pytest.approx(np.tile(np.eye(2), (3, 1, 1)))
    line = points[0] + np.outer([0.0, 1.0, 2.0], [0.1, 0.0, 0.0])
    assert ways_of(Sensors(line, normal), 3) == pytest.approx(np.tile([1.0, 0, 0], (1, 3, 1)))


def test_derivatives_along_directions_are_those_by_all(full):
    """And sums from a near one those of all terms, in a model some of whose parameters stay."""
    model = reduce(full, samples(4, seed=2), N_MODES, travel=TRAVEL).arrays()
    start = full.values()
    still = ["plates.thickness", "cord.stiffness"]
    few = trimmed(model, still, start)
    assert len(few.pencil.terms[0]) < len(model.pencil.terms[0])
    few.pencil.set_reference(few.values(start))
    rng = np.random.default_rng(1)
    directions = rng.standard_normal((len(RANGES), 3))
    for name in still:
        directions[list(RANGES).index(name)] = 0.0
    for values in samples(5, seed=9):
        values = values | {name: start[name] for name in still}
        K, M = model.pencil.assemble(values)
        for got, expected in zip(few.pencil.assemble(values), (K, M), strict=True):
            assert np.abs(got - expected).max() < 1e-9 * np.abs(expected).max()
        modes = solve_modes(few, values, n_modes=N_MODES)
        slopes = Slopes(modes, np.arange(6, N_MODES))
        by_all = frequency_sensitivity(solve_modes(model, values, n_modes=N_MODES), range(6, 12))
        scale = np.abs(by_all @ directions).max()
        assert slopes @ directions == pytest.approx(by_all @ directions, abs=1e-6 * scale)
        assert np.asarray(slopes) @ directions == pytest.approx(slopes @ directions, rel=1e-9)


def test_bad_input_is_named(full):
    with pytest.raises(InputError, match="samples: expected at least one"):
        reduce(full, [], N_MODES)
    with pytest.raises(InputError, match=r"tip.travel: a reduced model needs the range"):
        reduce(full, [{}], N_MODES)
    model = reduce(full, [{}], N_MODES, travel=TRAVEL)
    with pytest.raises(InputError, match=f"n_modes = 100: expected at most {model.n_dofs}"):
        solve_modes(model, n_modes=100)
    with pytest.raises(InputError, match=r"plates.nu = 0.6 is out of range"):
        model.stiffness({"plates.nu": 0.6})
    with pytest.raises(InputError, match="'E' does not exist"):
        model.mass({"E": 1.0})


@pytest.mark.parallel
def test_two_ranks_reduce_to_the_same_frequencies():
    point = samples(1, seed=9)[0]
    alone, together = (
        solve_modes(reduce(build(c), [{}, point], N_MODES, travel=TRAVEL), point, n_modes=N_MODES)
        for c in (MPI.COMM_SELF, MPI.COMM_WORLD)
    )
    found, expected = (modes.frequencies_hz[5:-1] for modes in (together, alone))
    assert found == pytest.approx(expected, rel=1e-6)


def test_a_point_without_the_tests_modes_has_no_error_and_spoils_no_other(monkeypatch):
    model = build()
    start = model.values()
    small = surrogate(model, [start])
    soft, paired = {**start, "layer.E": 1e7}, small.forward.paired

    def lacks(modes):
        if modes.given.get("layer.E") == 1e7:
            raise TooFewModes("two of three")
        return paired(modes)

    monkeypatch.setattr(small.forward, "paired", lacks)
    errors = small.quick.errors([start, soft])
    assert errors[0] < 1e-4 and np.isnan(errors[1])


@pytest.mark.parallel
def test_a_cubic_is_read_where_the_sensor_is():
    """4 cm from where it should be, where its slope alone is far off."""
    plates = part("plates", ("plate_1", "plate_2"), E=7e10, nu=0.3, rho=2750.0)
    layer = joint("layer", ("joint_near", "joint_away"), E=1e9, G=1e9)
    full = Structure(lap_plates(MPI.COMM_WORLD, element_size=0.02, n_thickness=1), [plates, layer])
    shapes = [
        lambda x, y: 3 * x**2 - 9 * x**3,
        lambda x, y: x - 5 * x * y + 2 * y**2 + 7 * x * y**2,
    ]
    basis = []
    for shape in shapes:
        u = fem.Function(full.V)
        u.interpolate(lambda x, f=shape: np.array([0 * x[0], 0 * x[0], f(x[0], x[1])]))
        basis.append(u.x.petsc_vec.copy())
    sensors = Sensors(
        np.array([[0.08, 0.04, 0.008], [0.15, 0.03, 0.008], [0.3, 0.06, 0.0165]]), [0.0, 0.0, 1.0]
    )
    ways = ways_of(sensors, 3)
    rows = full.observe(basis, sensors)
    slopes = np.array([full.observe_slopes(basis, sensors, way) for way in ways])
    found = shape_curvature(full, basis, sensors, ways, rows, slopes)
    a, b = 0.04, -0.02
    moved = sensors.points + a * ways[0] + b * ways[1]
    exact = np.array([f(moved[:, 0], moved[:, 1]) for f in shapes]).T
    linear = rows + a * slopes[0] + b * slopes[1]
    read = linear + np.einsum("k,ksn->sn", monomials(a, b), found)
    # Quadratic elements do not hold a cubic.
    assert read == pytest.approx(exact, abs=1e-4)
    assert np.abs(linear - exact).max() > 3e-3
