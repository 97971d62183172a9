"""What a misplaced sensor reads, against displacements that are cubics."""

from __future__ import annotations

import numpy as np
import pytest
from dolfinx import fem
from mpi4py import MPI

from fenics_joints.meshes import lap_plates
from fenics_joints.reduction.prediction import ways_of
from fenics_joints.reduction.reduced import monomials, shape_curvature
from fenics_joints.structure import Sensors, Structure, joint, part


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
