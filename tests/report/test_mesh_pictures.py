"""Pictures of meshes: colours, levels, and motion of corners."""

from __future__ import annotations

import base64
import io
import re
import xml.etree.ElementTree as ElementTree

import basix.ufl
import matplotlib.image
import numpy as np
import pytest
from cell_map import cells
from dolfinx import fem
from mpi4py import MPI

from fenics_joints.meshes import lap_plates
from fenics_joints.report import mesh_pictures
from fenics_joints.structure.grids import corner_motion
from fenics_joints.structure.points import Sensors


def images_of(svg: str) -> list[np.ndarray]:
    """The rasterised parts of a picture, RGBA."""
    found = re.findall(r"data:image/png;base64,([^\"]+)", svg)
    return [matplotlib.image.imread(io.BytesIO(base64.b64decode(code))) for code in found]


def test_mode_shape_is_coloured_along_the_direction():
    x = cells().vertices
    tilt = np.zeros_like(x)
    tilt[..., 2] = x[..., 0] - x[..., 0].mean()
    (image,) = images_of(mesh_pictures.mode_shape(x, tilt, (0, 0, 1), "m", "tilt"))
    rows = image[image.shape[0] // 2]
    seen = rows[rows[:, 3] > 0.9]
    left, right = (np.median(part, axis=0) for part in (seen[: len(seen) // 4], seen[-20:]))
    assert left[2] > left[0] + 0.2 and right[0] > right[2] + 0.2
    (still,) = images_of(mesh_pictures.mode_shape(x, tilt, (0, 1, 0), "m", "tilt"))
    faces = still[still[..., 3] > 0.9][:, :3]
    assert np.median(np.ptp(faces, axis=1)) < 0.05  # nothing moves along y


@pytest.mark.parallel
@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
def test_motion_of_corners_is_the_field_there(cell):
    """A linear field, which every element holds, is known at the corners without any element."""
    msh = lap_plates(MPI.COMM_WORLD, element_size=0.04, n_thickness=1, zone=0.0, cell=cell).mesh
    family = "S" if cell == "hexahedron" else "Lagrange"
    element = basix.ufl.element(family, cell, 2)
    V = fem.functionspace(msh, basix.ufl.element(family, cell, 2, shape=(3,)))
    A = np.array([[1.0, 2.0, -1.0], [0.5, 0.0, 3.0], [-2.0, 1.0, 0.25]])
    u = fem.Function(V)
    u.interpolate(lambda x: A @ x)
    vertices, motions = corner_motion([u], V, element)
    if msh.comm.rank == 0:
        assert len(vertices) == msh.topology.index_map(3).size_global
        np.testing.assert_allclose(motions[0], vertices @ A.T, atol=1e-12)
        volume = np.ptp(vertices.reshape(-1, 3), axis=0)
        np.testing.assert_allclose(volume, [0.32, 0.08, 0.0165])


def test_arrows_stand_at_the_sensors_that_measured():
    """One arrow of the model for each sensor, of the test where it has a value."""
    vertices = cells().vertices
    places = np.asarray(vertices, dtype=float).reshape(-1, 3)[:3]
    sensors = Sensors(places, (0, 0, 1.0))
    test, model = np.array([1.0, np.nan, -2.0]), np.array([0.9, 0.5, -2.1])
    line = places[[0, 2]]
    text = mesh_pictures.sensor_shapes(
        vertices, sensors, test, model, "pair7", "both <shapes>", [line]
    )
    assert "both &lt;shapes&gt;" in text and "nan" not in text.lower()
    assert ElementTree.fromstring(text).tag.endswith("svg")
    assert "#1f4e9c" in text and "#d1661f" in text
