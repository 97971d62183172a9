"""What further measurements would tell two explanations apart, against the models' own modes."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from mpi4py import MPI

from fenics_joints.diagnosis.plan.added import ADDED_MASS
from fenics_joints.diagnosis.separation import added_mass, further_modes, same_in_both
from fenics_joints.meshes import box
from fenics_joints.modal import solve_modes
from fenics_joints.reduction.matched import places_all_over
from fenics_joints.reduction.prediction import ModalPrediction
from fenics_joints.structure import Parameter, PointMass, Sensors, Structure, part

SIZE = (0.4, 0.06, 0.006)


def strip(*masses):
    body = part("strip", "body", E="E", nu=0.33, rho=2700.0)
    mesh = box(MPI.COMM_WORLD, SIZE, (10, 2, 1))
    return Structure(mesh, [body], [Parameter("E", 70e9)], masses=masses)


@pytest.mark.parallel
def test_a_mode_that_one_model_alone_shows_to_the_sensors_puts_none_beside_another():
    """A heavy corner shows bending in the plane to sensors across it, in one of two models: what a
    known mass would tell apart is what it does to each mode, here by solutions with a gram."""
    line = np.array([[x, y, 0.006] for x in np.linspace(0, 0.4, 6) for y in (0.0, 0.06)])
    sensors, n_test, gram = Sensors(line, [0.0, 0.0, 1.0]), 7, 1e-3
    corners = [PointMass("m", m, (0.4, 0.06, 0.0)) for m in (0.053, 0.060)]
    a, b = (solve_modes(strip(m), n_modes=20) for m in corners)
    seen = [m.visibility(sensors)[11] > 0.3 for m in (a, b)]
    assert seen == [False, True]
    surrogate = SimpleNamespace(
        sensors=sensors,
        forward=ModalPrediction(a.model, sensors, n_test, 20),
        everywhere=lambda count: places_all_over(a.model, count),
    )
    pairs = same_in_both(a, b, surrogate)
    assert pairs.tested.tolist() == [[i, i] for i in (6, 7, 8, 9, 10, 12, 13)]
    ((distance, words),) = added_mass(a, b, pairs, sensors, 1e-3)
    at = next(p for p in line if f"({1e3 * p[0]:g}, {1e3 * p[1]:g}, 6)" in words)
    shifts = []
    for m, before in zip(corners, (a, b), strict=True):
        after = solve_modes(strip(m, PointMass("put on", gram, tuple(at))), n_modes=20)
        own = pairs.tested[:, 0]
        shifts.append(np.log(after.frequencies_hz[own] / before.frequencies_hz[own]))
    share = ADDED_MASS * a.model.total_mass() / gram
    true = np.linalg.norm(share * (shifts[0] - shifts[1])) / 1e-3 / 2
    assert distance == pytest.approx(true, rel=0.1)
    # The modes that follow, and those that the sensors miss, are each other's too.
    found = further_modes(a, b, pairs, 1e-3, "in-plane motion")
    assert len(found) == 2 and all(d < 20 for d, _ in found)
