"""Sensors beside a mesh: those near are moved onto it, those far are one error."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from fenics_joints.errors import InputError
from fenics_joints.meshes import box
from fenics_joints.structure import PointMass, Sensors, Structure, part
from fenics_joints.structure.points import locate

#: Extents and cells: the shortest edge is 10 mm.
SIZE, CELLS = (0.3, 0.1, 0.02), (6, 4, 2)


def block(comm=MPI.COMM_SELF, **more):
    body = part("block", "body", E=2e11, nu=0.3, rho=7800.0)
    return Structure(box(comm, SIZE, CELLS), [body], **more)


def read(model, points):
    """This rank's rows by which sensors along z read displacement."""
    return model.loads(Sensors(points, (0.0, 0.0, 1.0)))


@pytest.mark.parallel
def test_a_sensor_beside_the_mesh_reads_at_the_nearest_point_of_it():
    """Over a face, an edge and a corner; the limit is half of a cell's shortest edge, 5 mm."""
    beside = np.array(
        [[0.12, 0.03, 0.0249], [0.303, 0.05, 0.0235], [-0.001, -0.001, -0.001], [0.1, 0.05, 0.01]]
    )
    on = np.clip(beside, 0.0, SIZE)
    model = block(MPI.COMM_WORLD)
    assert read(model, beside) == pytest.approx(read(model, on), abs=1e-9)
    moved = model.rows(beside, "sensor").moved
    assert moved == pytest.approx(np.linalg.norm(beside - on, axis=1), abs=1e-9)
    with pytest.raises(InputError, match="by 5.1 mm.* within 5 mm would be moved"):
        read(model, [[0.12, 0.03, 0.0251]])


def test_masses_beside_the_mesh_are_not_moved():
    """As they are they are near enough for a sensor: no other axes are offered."""
    model = block(masses=[PointMass("m", 1.0, (0.12, 0.03, 0.0201))])
    with pytest.raises(InputError, match=r"outside the mesh, by 0.1 mm: .* 0.02\] m\.$"):
        model.mass()
    places = [[0.05, 0.02, 0.0201], [0.1, 0.05, 0.0201], [0.25, 0.07, 0.0201]]
    with pytest.raises(InputError, match="3 of 3 masses are outside the mesh") as caught:
        locate(model.V, model.element, places, "mass")
    assert "in place of" not in str(caught.value)


@pytest.mark.parallel
def test_all_far_sensors_are_in_one_message_by_name():
    points = [[0.1, 0.02, 0.02], [0.1, 0.02, 0.05], [0.2, 0.08, 0.02], [0.4, 0.08, 0.02]]
    sensors = Sensors(points, (0, 0, 1.0), ["11:+z", "12:+z", "13:+z", "14:+z"])
    with pytest.raises(InputError) as caught:
        block(MPI.COMM_WORLD).loads(sensors)
    text = str(caught.value)
    assert "2 of 4 sensors are outside the mesh" in text
    assert "12:+z at [0.1, 0.02, 0.05] m is outside the mesh, by 30 mm" in text
    assert "14:+z at" in text and "by 100 mm" in text and "11:+z" not in text


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda x: 1e3 * x, "if their numbers were mm and not m"),
        (lambda x: x / 0.0254, "if their numbers were inches and not m"),
        (lambda x: x * [-1, 1, 1], r"with \(-x, y, z\) in place"),
        (lambda x: x[:, [1, 0, 2]], r"with \(y, x, z\) in place"),
        (lambda x: 1e-3 * x, "span 0.2 mm of a structure of 300 mm.*unit"),
    ],
)
def test_sensors_in_other_units_or_axes_are_refused_with_what_would_fit(change, words):
    points = np.array([[0.1, 0.02, 0.02], [0.27, 0.08, 0.02], [0.3, 0.05, 0.013]])
    with pytest.raises(InputError, match=words):
        read(block(), change(points))
