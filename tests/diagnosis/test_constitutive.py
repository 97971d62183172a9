"""The error in the constitutive relation finds the region whose stiffness is wrong."""

from __future__ import annotations

import numpy as np
import pytest
from four_regions import MODES, NAMES, beam, measured, sensors
from mpi4py import MPI

from fenics_joints.diagnosis.where.cells import MeshCells
from fenics_joints.diagnosis.where.constitutive import constitutive_error, trust
from fenics_joints.diagnosis.where.patches import patches
from fenics_joints.diagnosis.where.two_fields import SparseFields
from fenics_joints.errors import InputError
from fenics_joints.modal import solve_modes


@pytest.mark.parallel
@pytest.mark.parametrize("wrong", ["b", "d"])
def test_the_wrong_region_has_the_largest_error(wrong):
    """30 % of stiffness missing in one region, shapes with noise and a missing sensor: the error
    over its own strain energy is the largest there, by region and by patch."""
    model = beam(MPI.COMM_WORLD)
    hz, shapes = measured(beam(MPI.COMM_WORLD, wrong), noise=0.01)
    shapes[3, 1] = np.nan
    split = patches(MeshCells(model), 2)
    cells = MeshCells(model)
    found = constitutive_error(cells, None, shapes, hz, sensors(), split=split, noise=0.01)
    others = [v for name, v in zip(NAMES, found.regions.relative, strict=True) if name != wrong]
    assert found.regions.relative[NAMES.index(wrong)] > 2 * max(others)
    assert split.region[int(np.argmax(found.patches.relative))] == wrong
    whole = found.regions.stiffness.sum(axis=0)
    assert found.patches.stiffness.sum(axis=0) == pytest.approx(whole, rel=1e-9)
    assert found.regions.strain.sum(axis=0) == pytest.approx(np.ones(MODES), rel=1e-9)


@pytest.mark.parallel
def test_a_right_model_has_no_error():
    """Its own shapes without noise at its own frequencies: next to nothing is violated. Another
    unit of the shapes, or another number of ranks, changes nothing of a wrong model's error."""
    model = beam(MPI.COMM_WORLD)
    hz, shapes = measured(model)
    hz, shapes = hz[:2], shapes[:, :2]
    found = constitutive_error(MeshCells(model), None, shapes, hz, sensors(), draws=0)
    assert np.all(found.total < 1e-7) and np.all(found.deviation < 1e-3)
    bent = MeshCells(beam(MPI.COMM_WORLD, "b"))
    wrong = constitutive_error(bent, None, shapes, hz, sensors(), draws=0)
    assert np.all(wrong.total > 1e4 * found.total)
    alone = beam(MPI.COMM_SELF, "b")
    scaled = constitutive_error(MeshCells(alone), None, -1e3 * shapes, hz, sensors(), draws=0)
    assert scaled.regions.stiffness == pytest.approx(wrong.regions.stiffness, rel=1e-6)


def test_the_functional_is_at_its_least():
    """Against a dense minimisation of the functional itself, v and w eliminated by equilibrium, on
    the matrices of the structure."""
    model = beam(MPI.COMM_SELF, "b")
    hz, shapes = measured(beam(MPI.COMM_SELF))
    omega, gamma = 2 * np.pi * hz[0], 0.4
    system = SparseFields(model, None, sensors(), gamma)
    K, M, P = (A.convert("dense").getDenseArray().copy() for A in (system.K, system.M, system.P))
    s = shapes[:, 0] / np.sqrt(np.mean(shapes[:, 0] ** 2))
    rho = trust(model.total_mass(), np.ones(len(s), bool), omega, 0.02)
    fields = system.solve([s], np.ones(len(s), bool), omega, rho)
    u, lam = (x.array.copy() for x in fields[0])

    def functional(u, w):
        v = np.linalg.lstsq(K, omega**2 * M @ w, rcond=1e-12)[0]
        # The rigid part of v is free, and strains nothing.
        parts = (u - v) @ K @ (u - v), omega**2 * (u - w) @ M @ (u - w)
        off = P @ u - s
        return gamma * parts[0] + (1 - gamma) * parts[1] + rho * off @ off

    w = u + lam / (1 - gamma)
    least = functional(u, w)
    rng = np.random.default_rng(2)
    modes = solve_modes(model, n_modes=14)
    basis = np.array([x.array for x in modes.shapes]).T
    for _ in range(20):
        du, dw = (basis @ rng.standard_normal(14) * 1e-4 * np.abs(u).max() for _ in range(2))
        # w stays in the range for which K v = omega^2 M w has a solution: no rigid part.
        dw = dw - basis[:, :6] @ (basis[:, :6].T @ M @ dw)
        up, down = functional(u + du, w + dw), functional(u - du, w - dw)
        assert up > least and down > least
        assert abs(up - down) < 1e-3 * (up + down - 2 * least)


def test_noise_alone_accuses_no_region():
    """Noisy shapes of the model itself: the errors are what noise makes on the average, a small
    part of what a wrong region makes."""
    model = beam(MPI.COMM_WORLD)
    hz, shapes = measured(model, noise=0.02)
    quiet = constitutive_error(MeshCells(model), None, shapes, hz, sensors(), noise=0.02)
    assert quiet.regions.stiffness.sum() == pytest.approx(quiet.regions.by_noise.sum(), rel=0.5)
    bent = MeshCells(beam(MPI.COMM_WORLD, "b"))
    loud = constitutive_error(bent, None, shapes, hz, sensors(), noise=0.02)
    assert np.abs(quiet.regions.relative).max() < 0.25 * loud.regions.relative.max()
    assert np.argmax(loud.regions.relative) == NAMES.index("b")


@pytest.mark.parallel
def test_what_cannot_be_is_refused():
    model = beam(MPI.COMM_WORLD)
    shapes = np.ones((len(sensors()), 1))
    with pytest.raises(InputError, match=r"expected \(36, 2\)"):
        constitutive_error(MeshCells(model), None, shapes, [100.0, 200.0], sensors())
    with pytest.raises(InputError, match="above zero"):
        constitutive_error(MeshCells(model), None, shapes, [-1.0], sensors())
    with pytest.raises(InputError, match="gamma = 1"):
        constitutive_error(MeshCells(model), None, shapes, [100.0], sensors(), gamma=1.0)
    with pytest.raises(InputError, match="without any motion"):
        constitutive_error(MeshCells(model), None, 0 * shapes, [100.0], sensors())
