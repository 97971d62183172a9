"""The error of the mesh, measured with one degree more, against a mesh thrice as fine."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI

from fenics_joints.diagnosis.evidence.entries import SHAPE
from fenics_joints.diagnosis.evidence.evidence import Evidence, evidence_of
from fenics_joints.diagnosis.model.prepared import Prepared
from fenics_joints.diagnosis.model.resolution import MeshErrors, mesh_errors
from fenics_joints.measurements import TestData, pair_modes
from fenics_joints.measurements.gap import mac
from fenics_joints.meshes import box
from fenics_joints.modal import solve_modes
from fenics_joints.progress import Progress
from fenics_joints.reduction.files import Cache
from fenics_joints.reduction.matched import MatchedModes
from fenics_joints.structure import Sensors, Structure, part

SIZE = (0.3, 0.06, 0.006)
SILENT = Progress(silent=True)
#: On both edges of a strip, as bending and torsion need.
EDGES = Sensors(
    [[x, y, 0.006] for x in np.linspace(0, 0.3, 7) for y in (0.0, 0.06)], [0.0, 0.0, 1.0]
)


def strip(*elements, degree=2, size=SIZE):
    body = part("strip", "body", E=69e9, nu=0.3, rho=2700.0)
    return Structure(box(MPI.COMM_WORLD, size, elements), [body], degree=degree)


def matched(full, sensors, n_test, shapes=None, n_modes=24):
    return MatchedModes(full, {}, sensors=sensors, n_test=n_test, n_modes=n_modes, shapes=shapes)


@pytest.fixture(scope="module")
def fine():
    """Modes of a mesh thrice as fine."""
    return solve_modes(strip(30, 6, 2), n_modes=24)


@pytest.mark.parallel
@pytest.mark.parametrize("degree", [1, 2])
def test_mesh_error_is_that_against_a_finer_mesh(degree, fine, shared_tmp_path, monkeypatch):
    """Of four bending modes: 5 elements of degree 2 along a strip, or 30 of degree 1."""
    x = np.linspace(0.01, 0.29, 9)
    line = np.array([x, 0.03 + 0 * x, 0.006 + 0 * x]).T
    sensors, few = (Sensors(some, [0.0, 0.0, 1.0]) for some in (line, line[:7]))
    small = matched(strip(30 if degree == 1 else 5, 2, 1, degree=degree), sensors, 4)
    cache = Cache(shared_tmp_path, "key", MPI.COMM_WORLD)
    found = mesh_errors(small, {}, SILENT, cache)
    # From the file without a solution; another test of the same structure.
    other = matched(small.full, few, 2)
    with monkeypatch.context() as patched:
        patched.setattr("fenics_joints.reduction.kept.solve_modes", None)
        kept = mesh_errors(other, {}, SILENT, cache)
    assert kept.frequencies == pytest.approx(found.frequencies[:2], abs=1e-9)
    index, theirs = small.pairing.index, pair_modes(fine, 4, sensors).index
    true = small.nominal.frequencies_hz[index] / fine.frequencies_hz[theirs] - 1
    assert found.frequencies == pytest.approx(true, rel=0.15, abs=2e-5)


def test_to_few_sensors_two_modes_may_look_alike(fine):
    """One sensor on a corner, which bending and torsion move alike: each mode is still compared
    with itself on the finer mesh. Some are in another order there, and of these the mesh resolves
    no mode that a test counts."""
    corner = Sensors([[0.3, 0.06, 0.006]], [0.0, 0.0, 1.0])
    small = matched(strip(8, 2, 1), corner, 6)
    found = mesh_errors(small, {}, SILENT).frequencies
    at = np.array([[x, y, 0.006] for x in np.linspace(0, 0.3, 9) for y in (0.0, 0.03, 0.06)])
    grid = Sensors(at, [0.0, 0.0, 1.0])
    index = small.pairing.index
    best = pair_modes(fine, 6, grid, reference=small.nominal.at(grid)[:, index])
    true = small.nominal.frequencies_hz[index] / fine.frequencies_hz[best.index] - 1
    counted = fine.frequencies_hz[pair_modes(fine, 6, corner).index]
    same = np.abs(np.log(counted / fine.frequencies_hz[best.index])) < 0.01
    assert 2 <= same.sum() < 6 and best.mac.min() > 0.95
    assert np.isfinite(found).tolist() == same.tolist()
    assert found[same] == pytest.approx(true[same], rel=0.5, abs=5e-4)


def test_modes_that_any_error_turns_are_resolved():
    """Of a bar of square section bending comes in pairs, which each mesh turns as it likes."""
    bar = strip(12, 1, 1, size=(0.3, 0.01, 0.01))
    at = np.array([[x, 0.0, 0.0] for x in np.linspace(0, 0.3, 7)])
    both = Sensors(np.repeat(at, 2, axis=0), np.tile([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], (7, 1)))
    found = mesh_errors(matched(bar, both, 4, n_modes=16), {}, SILENT).frequencies
    assert found[0] == pytest.approx(found[1], rel=1e-3) and 0 < found[0] < found[2] < 0.01


def test_modes_that_a_mesh_does_not_resolve_are_left_out():
    hz = np.array([[100.0, 200.0, 300.0]])
    model = Prepared.__new__(Prepared)
    model.data = TestData([1.0], hz, ("a", "b", "c"))
    model.evidence = Evidence(np.array([1.0]), np.log(hz), np.zeros((1, 3)), 0.01)
    model.on_mesh(MeshErrors(np.array([0.01, np.nan, 0.02]), np.zeros(3)))
    assert model.evidence.fitted.tolist() == [True, False, True]
    assert np.isnan(model.data.frequencies_hz[0]).tolist() == [False, True, False]
    assert model.unresolved == ("b",) and list(model.mesh_error()) == ["a", "c"]
    assert "does not resolve b: " in model.mesh_notes()[0]
    # What is most of the test stays.
    coarse = Prepared.__new__(Prepared)
    coarse.data, coarse.evidence = TestData([1.0], hz, ("a", "b", "c")), model.evidence
    coarse.on_mesh(MeshErrors(np.array([0.01, np.nan, np.nan]), np.zeros(3)))
    assert coarse.left_out is None and "most of the test" in coarse.mesh_notes()[0]


def test_no_degree_is_above_the_third():
    cubic = strip(3, 1, 1, degree=2).finer()
    assert cubic.degree == 3 and cubic.finer() is None
    modes = solve_modes(cubic, n_modes=7)
    assert modes.n_rigid == 6


def test_the_mesh_error_is_taken_off_and_a_part_of_it_stays():
    """A test of a model without a mesh is one of its mesh once it is raised by the mesh's error,
    of which one degree more finds all but a part; what stays is mostly common to the modes."""
    log_f = np.log([[100.0, 200.0, np.nan, 300.0]])
    bare = Evidence(np.array([1.0]), log_f, np.zeros((1, 4)), 0.01)
    error = np.array([0.1, -0.001, 0.002, np.nan])
    test = bare.on_mesh(error)
    raised = np.array([1.1, 0.999, 1.0]) ** 1.3 * [100.0, 200.0, 300.0]
    assert np.exp(test.log_f[0, [0, 1, 3]]) == pytest.approx(raised, rel=1e-12)
    assert np.exp(test.off_mesh(test.log_f))[0] == pytest.approx(np.exp(log_f[0]), nan_ok=True)
    common = 0.3 * np.log([1.1, 0.999, 1.0])
    own = np.diag([0.02, 0.01, 0.1]) ** 2
    assert test.covariance() == pytest.approx(own + np.outer(common, common), abs=1e-15)
    assert bare.off_mesh(log_f) is log_f


def test_the_larger_of_mesh_error_and_discrepancy_counts():
    log_f = np.log([[100.0, 200.0, 300.0]])
    test = Evidence(
        np.array([1.0]), log_f, np.zeros((1, 3)), 0.01, mesh_error=np.array([0.002, 0.03, 0.01])
    )
    assert np.sqrt(np.diag(test.covariance())) == pytest.approx([0.01, 0.03, 0.01])


def test_a_shape_that_the_mesh_changes_says_less():
    """Its error is what the mesh does to it where that is more than any model's."""
    hz = np.array([[100.0, 200.0]])
    sensors = Sensors([[0.0, 0, 0], [1.0, 0, 0], [2.0, 0, 0]], [0.0, 0.0, 1.0])
    shapes = np.array([[1.0, 1.0], [0.0, -1.0], [1.0, 1.0]])
    data = TestData([1.0], hz, ("a", "b"), sensors=sensors, shapes=shapes, shape_noise=0.0)
    test = evidence_of(data, 0.001, 0.05).on_mesh(np.array([0.0, 0.0]), np.array([0.01, 0.3]))
    sd = np.sqrt(np.diag(test.full_covariance()))
    e = test.entries
    assert sd[(e.kind == SHAPE) & (e.mode == 0)] == pytest.approx([0.05] * 3, rel=1e-6)
    assert sd[(e.kind == SHAPE) & (e.mode == 1)] == pytest.approx([0.3] * 3, rel=1e-6)


def test_what_a_mesh_does_to_shapes_is_that_against_a_finer_one(fine):
    """Torsion of a strip of bricks one across bends its shape at the test's sensors."""
    counted = matched(strip(4, 1, 1), EDGES, 8)
    own = counted.pairing.shapes
    found = mesh_errors(matched(counted.full, EDGES, 8, own), {}, SILENT).shapes
    best = pair_modes(fine, 8, EDGES, reference=own)
    true = np.sqrt(1 - np.diag(mac(own, best.shapes)))
    assert found == pytest.approx(true, rel=0.6, abs=0.02)
    assert true.max() > 0.2


def test_what_a_mesh_does_to_shapes_is_taken_off_the_measured_ones(fine):
    """Shapes of a fine mesh, to the coarse model: nearer to its own than they were measured. One
    that is hardly the model's keeps what it is, and so does the sign."""
    own = pair_modes(fine, 4, EDGES)
    measured = own.shapes * np.array([1.0, -2.0, 1.0, 3.0])
    measured[0, 0] = np.nan
    small = matched(strip(3, 1, 1), EDGES, 4, measured)
    hz = fine.frequencies_hz[own.index][None]
    data = TestData([1.0], hz, tuple("abcd"), sensors=EDGES, shapes=measured, shape_noise=0.0)
    raw = evidence_of(data, 0.01, 0.05)
    errors = mesh_errors(small, {}, SILENT)
    found = raw.on_mesh(*errors)

    def off(shapes):
        return 1 - np.diag(mac(shapes, small.pairing.shapes))

    changed = np.flatnonzero((errors.shapes > 0.05) & (errors.shapes < 0.3))
    assert len(changed) > 0 and np.all(off(found.shapes)[changed] < 0.2 * off(raw.shapes)[changed])
    assert np.nanmax(np.abs(found.shapes - raw.shapes)) < 0.5 and np.isnan(found.shapes[0, 0])


def test_modes_that_the_finer_model_takes_for_others_are_left_out(fine):
    """Measured shapes of a fine mesh, and some of them exchanged with those of other modes of a
    coarse one, as it would have them to the test's sensors."""
    small = matched(strip(10, 2, 1), EDGES, 4, pair_modes(fine, 4, EDGES).shapes)
    assert np.all(np.abs(mesh_errors(small, {}, SILENT).frequencies) < 0.05)
    two = small.pairing.index.copy()
    two[[1, 3]] = two[[3, 1]]
    small.pairing = replace(small.pairing, index=two)
    otherwise = mesh_errors(small, {}, SILENT).frequencies
    assert np.isnan(otherwise).tolist() == [False, True, False, True]
