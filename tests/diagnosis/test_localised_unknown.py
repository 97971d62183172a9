"""An unknown cause that has a place: what patches would do, how probable it is, and where."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from four_regions import MODES, NAMES, beam, measured, sensors
from mpi4py import MPI
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.fitted import Fit
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.diagnosis.evidence.localised_unknown import with_localised_unknown
from fenics_joints.diagnosis.evidence.scales import ERRORS
from fenics_joints.diagnosis.where.cells import MeshCells
from fenics_joints.diagnosis.where.patches import patches, signatures
from fenics_joints.diagnosis.where.score_tests import Place, score_tests
from fenics_joints.measurements import pair_modes
from fenics_joints.modal import solve_modes

#: Modes of the model that shapes are made of.
SPAN = 40


def of(comm, hz, shapes, n=1):
    """The nominal bar's signatures for a test of it, and the test with these."""
    model = beam(comm)
    modes = solve_modes(model, n_modes=SPAN)
    pairing = pair_modes(modes, MODES, sensors(), reference=shapes)
    scaled = shapes / np.sqrt(np.mean(shapes**2, axis=0))
    test = Evidence(
        np.array([1.0]),
        np.log(hz)[None, :],
        np.full((1, MODES), 5e-4),
        0.002,
        shapes=scaled,
        shape_sd=0.01,
        shape_error=0.02,
    )
    cells = MeshCells(model)
    split = patches(cells, n)
    found = signatures(cells, modes, pairing, test, split, sensors())
    return replace(test, signatures=found), (cells, modes, pairing, split)


def nominal_fit(test: Evidence, comm) -> Fit:
    """What the nominal bar says of a test, as the fit of an unknown cause without tolerances."""
    hz, shapes = measured(beam(comm))
    shapes = shapes * np.sum(shapes * test.shapes, axis=0) / np.sum(shapes**2, axis=0)
    predicted = np.concatenate([np.log(hz), shapes.ravel()])
    residual = predicted - test.data
    wide = multivariate_normal.logpdf(residual, cov=test.covariance(unknown=True))
    nothing = Hypothesis((), name="none of these", unknown=True)
    return Fit(
        nothing,
        np.zeros(0),
        np.zeros((0, 0)),
        predicted,
        test.shape,
        np.zeros((len(predicted), 0)),
        float(wide),
        0.0,
        len(predicted),
    )


@pytest.mark.parallel
def test_what_each_cell_does_adds_up_to_the_pencil():
    """Over all cells x_i^T K x_k is lambda_i where i is k, and nought else; x_i^T M x_k is one."""
    model = beam(MPI.COMM_WORLD, "b")
    cells, modes = MeshCells(model), solve_modes(model, n_modes=12)
    number, index = np.zeros(len(cells.volume), dtype=int), [6, 9]
    for i, crossed in zip(index, cells.crossed(modes, index), strict=True):
        stiff, mass = (cells.sums(number, by_cell, 1)[0] for by_cell in crossed)
        unit = np.eye(12)[i]
        assert mass == pytest.approx(unit, abs=1e-8)
        assert stiff / modes.eigenvalues[i] == pytest.approx(unit, abs=1e-6)


@pytest.mark.parallel
@pytest.mark.parametrize("what", ["stiffness", "mass"])
def test_signatures_are_derivatives(what):
    """As differences of bars with one region 1 % off, expected 15 and 10 %."""
    comm, step = MPI.COMM_WORLD, 0.01
    key = {"stiffness": "factor", "mass": "density"}[what]
    hz, shapes = measured(beam(comm))
    test, (_, _, _, split) = of(comm, hz, shapes)
    found, which = test.signatures, ["stiffness", "mass"].index(what)
    ends = []
    for factor in (1 + step, 1 - step):
        other, moved = measured(beam(comm, "b", **{"factor": 1.0, key: factor}))
        moved = moved * np.sum(moved * test.shapes, axis=0) / np.sum(moved**2, axis=0)
        ends.append((np.log(other), moved))
    by_f, by_shape = (
        (a - b) / (2 * step) * found.expected[which] for a, b in zip(*ends, strict=True)
    )
    patch = split.region.index("b")
    assert found.log_f[:, patch, which] == pytest.approx(by_f, rel=2e-3)
    size = np.abs(by_shape).max()
    assert found.shapes[:, :, patch, which] == pytest.approx(by_shape, abs=0.05 * size)


def test_its_evidence_is_that_of_a_covariance():
    """Summed over lengths, sizes, kinds and the errors' scales, with density of the normal
    distribution whose covariance has each patch's change in it."""
    comm = MPI.COMM_SELF
    hz, shapes = measured(beam(comm, "b", 0.9), noise=0.01)
    test, _ = of(comm, hz, shapes, n=2)
    test = replace(test, scales=ERRORS.expected(2))
    fit, found = nominal_fit(test, comm), test.signatures
    residual = fit.predicted - test.data
    away = np.linalg.norm(found.middle[:, None] - found.middle[None, :], axis=2)
    away = np.where(np.equal.outer(found.region, found.region), away / away.max(), np.inf)
    logs = []
    for scales, weight in test.scales.tried():
        own = test.at(scales).covariance()
        for length, (size, p), kind in product(
            (0.05, 0.2, 1.0), ((1 / 3, 0.25), (1, 0.5), (3, 0.25)), ((1, 0), (0, 1), (1, 1))
        ):
            alike = size**2 * np.exp(-0.5 * (away / length) ** 2)
            total = own + sum(
                on * column @ alike @ column.T
                for on, column in zip(kind, test.patch_columns(), strict=True)
            )
            logs.append(weight + np.log(p / 9) + multivariate_normal.logpdf(residual, cov=total))
    placed = logsumexp(logs)
    both = with_localised_unknown(fit, test)
    assert both.log_evidence == pytest.approx(
        np.logaddexp(placed, fit.log_evidence) - np.log(2), abs=1e-2
    )
    assert both.placed == pytest.approx(1 / (1 + np.exp(fit.log_evidence - placed)), rel=1e-2)


@pytest.mark.parallel
@pytest.mark.parametrize("n", [1, 2])
@pytest.mark.parametrize(
    ("wrong", "factor", "density"), [("b", 0.7, 1.0), ("d", 0.7, 1.0), ("d", 1.0, 1.3)]
)
def test_it_says_where(wrong, factor, density, n):
    """A third of the stiffness gone in one region, or a third more mass, with noise: far more
    probable than that anything may happen; the score tests have that region's patches first, and
    a whole region's change has about that size."""
    comm = MPI.COMM_WORLD
    hz, shapes = measured(beam(comm, wrong, factor, density), noise=0.01)
    test, _ = of(comm, hz, shapes, n=n)
    fit, signs = nominal_fit(test, comm), test.signatures
    assert with_localised_unknown(fit, test).placed > 0.99
    columns = np.stack(test.patch_columns(), axis=-1)
    rows = zip(signs.names, signs.region, columns.swapaxes(0, 1), strict=True)
    places = [Place(name, region, "part", own) for name, region, own in rows]
    tests = score_tests(test.data - fit.predicted, places, None, test)
    best = max(tests, key=lambda found: found.log_evidence)
    assert best.region == wrong and best.significant and best.log_f < 0
    assert len(tests) == n * len(NAMES)
    if n == 1:
        which, sought = (0, factor) if density == 1.0 else (1, density)
        found = best.change[which] * signs.expected[which]
        assert found == pytest.approx(np.log(sought), abs=0.4 * abs(np.log(sought)))


def test_a_test_without_signatures_stays_as_it_is():
    hz, shapes = measured(beam(MPI.COMM_SELF))
    test, _ = of(MPI.COMM_SELF, hz, shapes)
    bare = replace(test, signatures=None)
    fit = nominal_fit(bare, MPI.COMM_SELF)
    assert with_localised_unknown(fit, bare) is fit
