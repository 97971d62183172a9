"""Bayes on solid models: the reduced model behind the samples against the full one."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from fenics_joints.case import build_structure, load_case
from fenics_joints.commands.bayes import model as module
from fenics_joints.commands.bayes.model import case_model, case_prior, within_laws
from fenics_joints.errors import InputError
from fenics_joints.measurements import pair_modes
from fenics_joints.modal import solve_modes
from fenics_joints.reduction.greedy import FreePencil, GreedyModel
from fenics_joints.structure.sparse import product

BAYES = """
[update.bayes]
samples = 2400
[update.bayes.priors]
"near.G" = { kind = "lognormal", median = "0.5 GPa", log_sd = 0.7 }
"away.G" = { kind = "lognormal", median = "0.5 MPa", log_sd = 0.7 }
"""
TWO = ('parameters = ["near.E", "near.G", "away.E", "away.G"]', 'parameters = ["near.G", "away.G"]')
START = ('start = { "near.E" = "3 GPa" }', 'start = { "near.G" = "0.5 GPa" }')
COARSE = ('element_size = "20 mm"', 'element_size = "40 mm"')
HELD = """
[supports.clamp]
facets = "end_1"
"""


def a_case(write_case, folder, *edits, more=BAYES):
    """The coarse plates with two free moduli and their priors. Collective."""
    comm = MPI.COMM_WORLD
    if comm.rank == 0:
        write_case(folder, TWO, START, COARSE, ("hold_out = [4, 8, 12]\n", ""), *edits)
        with (folder / "case.toml").open("a", encoding="utf-8") as file:
            file.write(more)
    comm.barrier()
    return load_case(folder)


@pytest.fixture
def case(write_case, shared_tmp_path):
    return a_case(write_case, shared_tmp_path)


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """Folder of the reduced model that the first test that needs one makes."""
    return tmp_path_factory.mktemp("kept")


@pytest.mark.parallel
def test_sums_are_what_is_assembled(case):
    """Residuals at other values of moduli, a density, a mass and a spring, and the total mass; and
    the model on modes, which at the place they were found are themselves."""
    full = build_structure(case, MPI.COMM_WORLD, attached=True)
    values = {"near.G": 3e8, "away.E": 1.1e6, "plates.rho": 2900.0, "plates.E": 7.2e10}
    values |= {"accelerometer.mass": 0.03, "rope.stiffness": 5e5}
    start = {name: p.value for name, p in full.parameters.items()} | {"rope.stiffness": 1e3}
    there = {**start, **values}
    terms = FreePencil(full, list(values), start)
    fresh = build_structure(case, MPI.COMM_WORLD, attached=True)  # which has no sums
    exact = solve_modes(fresh, there, n_modes=12, tolerance=1e-9)
    small = terms.on(exact.shapes, None)
    again, elastic = solve_modes(small, there, n_modes=12), slice(exact.n_rigid, None)
    assert again.eigenvalues[elastic] == pytest.approx(exact.eigenvalues[elastic], rel=1e-8)
    assert small.total_mass(there) == pytest.approx(full.total_mass(there))
    X, square = np.random.default_rng(1).standard_normal((full.n_local, 3)), np.full(3, 1e7)
    forces = product(fresh.stiffness(there), X), product(fresh.mass(there), X) * square
    found = terms.residuals(X, square, [values] * 3)
    assert found == pytest.approx(forces[0] - forces[1], abs=1e-11 * np.abs(forces[0]).max())
    with pytest.raises(InputError, match=r"accelerometer.travel: expected parameters that are not"):
        FreePencil(full, ["accelerometer.travel"], start)


def model_and_points(case):
    """A model of three points, and others with the full one's modes."""
    full = build_structure(case, MPI.COMM_WORLD)
    start = {**case.nominal(), **case.start()}
    free = within_laws([full.parameters[n] for n in case.update.parameters], start, full)
    prior = case_prior(case, free, start, full)
    data = case.measurements()
    model = GreedyModel(full, start, prior.names, sensors=data.sensors, n_test=4, n_modes=14)

    def drawn(n, seed):
        rows = prior.values(prior.sample(n, np.random.default_rng(seed))).tolist()
        return [dict(zip(prior.names, row, strict=True)) for row in rows]

    model.extend(drawn(2, 1))
    points = drawn(12, 2)
    return full, model, points, [solve_modes(full, {**start, **p}, n_modes=14) for p in points]


@pytest.mark.parallel
def test_estimate_is_above_the_error_and_near_it(case):
    full, model, points, solved = model_and_points(case)

    def off():
        errors = []
        for values, modes in zip(points, solved, strict=True):
            pairing = pair_modes(modes, 4, model.sensors, reference=model.reference)
            exact = np.log(modes.frequencies_hz[pairing.index])
            errors.append(np.max(model.forward(values)[0] - exact))
        return np.array(errors)

    before, estimate = off(), model.errors(points)
    assert before.max() > 1e-4
    seen = before > 1e-7
    assert np.all(estimate[seen] > before[seen]) and np.all(estimate[seen] < 30 * before[seen])
    # Where it is largest is where a sample pays.
    worst = np.argsort(estimate)[-3:]
    model.extend([points[i] for i in worst])
    assert model.errors([points[i] for i in worst]).max() < 1e-6
    assert off().max() < 0.2 * before.max()


@pytest.mark.parallel
def test_supports_are_held(write_case, shared_tmp_path):
    """An estimate and sums with held and elastically held facets."""
    case = a_case(write_case, shared_tmp_path, more=BAYES + HELD)
    full, model, points, solved = model_and_points(case)
    found = model.solve(points[0])
    assert found.n_rigid == 0
    assert found.frequencies_hz == pytest.approx(solved[0].frequencies_hz, rel=1e-6)
    assert np.all(model.errors(points[:3]) > 0)
    full = build_structure(case, MPI.COMM_WORLD, elastic_supports=True)
    soft = {name: 1e11 for name in full.parameters if name.startswith("clamp.")}
    assert len(soft) == 2
    terms = FreePencil(full, list(soft), {name: 1e12 for name in soft})
    exact = solve_modes(full, soft, n_modes=8, tolerance=1e-9)
    again = solve_modes(terms.on(exact.shapes, None), soft, n_modes=8)
    assert again.eigenvalues == pytest.approx(exact.eigenvalues, rel=1e-7)


def test_kept_model_is_used_for_the_same_case_alone(case, write_case, kept, tmp_path, monkeypatch):
    file = kept / "chains.model.h5"
    first = case_model(case, MPI.COMM_SELF, keep=file)
    assert first.check.n_points == 50 and first.check.error <= first.bound < 1e-4
    points = first.prior.values(first.prior.sample(40, np.random.default_rng(5)))

    class Refused:
        def __init__(self, *_, **__):
            raise RuntimeError("made anew")

    monkeypatch.setattr(module, "SampledModel", Refused)
    again = case_model(case, MPI.COMM_SELF, keep=file)
    np.testing.assert_allclose(again.frequencies(points), first.frequencies(points), rtol=1e-12)
    assert (again.bound, again.check.error) == (first.bound, first.check.error)
    folder = tmp_path / "other"
    folder.mkdir()
    other = a_case(write_case, folder, ('rho = "2750 kg/m3"', 'rho = "2700 kg/m3"'))
    damaged = tmp_path / "damaged.h5"
    damaged.write_bytes(file.read_bytes()[:2000])
    for wanted, path in ((other, file), (case, tmp_path / "none.h5"), (case, damaged)):
        with pytest.raises(RuntimeError, match="made anew"):
            case_model(wanted, MPI.COMM_SELF, keep=path)


def test_command_samples_the_full_models_posterior(case, kept):
    """Densities of draws against the full model's frequencies and the closed form of the prior."""
    pytest.importorskip("arviz")
    from fenics_joints.commands.bayes.run import run_bayes
    from fenics_joints.progress import Progress

    found = run_bayes(case, MPI.COMM_SELF, Progress(silent=True), keep=kept / "chains.nc").result
    assert (kept / "chains.nc").is_file() and (kept / "chains.model.h5").is_file()
    chains = found.chains
    assert chains.names == ("near.G", "away.G") and chains.converged
    full = build_structure(case, MPI.COMM_SELF)
    nominal = solve_modes(full, {**case.nominal(), **case.start()}, n_modes=14)
    data = case.measurements()
    reference = pair_modes(nominal, 4, data.sensors).shapes
    row = data.row(20.0)
    sd = np.hypot(data.log_sd()[row], case.diagnose.discrepancy)
    rng, expected, got = np.random.default_rng(8), [], []
    for c, i in zip(rng.integers(4, size=5), rng.integers(1800, size=5), strict=True):
        values = dict(zip(chains.names, chains.values[c, i], strict=True))
        modes = solve_modes(full, values, n_modes=14)
        index = pair_modes(modes, 4, data.sensors, reference=reference).index
        off = np.log(modes.frequencies_hz[index] / data.frequencies_hz[row]) / sd
        z = (np.log(list(values.values())) - np.log([5e8, 5e5])) / 0.7
        expected.append(-0.5 * (off @ off + z @ z))
        got.append(chains.log_density[c, i])
    assert np.ptp(expected) > 0.1
    assert np.diff(got) == pytest.approx(np.diff(expected), abs=0.02)


def test_what_to_write_is_told(write_case, tmp_path):
    with pytest.raises(InputError, match=r"update\.bayes is missing") as error:
        case_model(a_case(write_case, tmp_path, more=""), MPI.COMM_SELF)
    lines = str(error.value).partition("\n")[2]
    again = tmp_path / "again"
    again.mkdir()
    # What the message says to write can be written.
    case = a_case(write_case, again, more="\n" + lines)
    assert case.update.bayes.priors["near.G"].kind == "lognormal"
