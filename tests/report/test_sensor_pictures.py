"""Pictures of measured shapes beside a model's."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree

import numpy as np
from cell_map import cells

from fenics_joints.report.sensor_pictures import sensor_shapes
from fenics_joints.structure.points import Sensors


def test_arrows_stand_at_the_sensors_that_measured():
    """One arrow of the model for each sensor, of the test where it has a value."""
    vertices = cells().vertices
    places = np.asarray(vertices, dtype=float).reshape(-1, 3)[:3]
    sensors = Sensors(places, (0, 0, 1.0))
    test, model = np.array([1.0, np.nan, -2.0]), np.array([0.9, 0.5, -2.1])
    line = places[[0, 2]]
    text = sensor_shapes(vertices, sensors, test, model, "pair7", "both <shapes>", [line])
    assert "both &lt;shapes&gt;" in text and "nan" not in text.lower()
    assert ElementTree.fromstring(text).tag.endswith("svg")
    assert "#1f4e9c" in text and "#d1661f" in text
