"""Functions that build meshes say what they take, and refuse what cannot be by its name."""

import inspect
import re
from dataclasses import fields

import numpy as np
import pytest
from mpi4py import MPI

import fenics_joints.meshes as meshes
from fenics_joints.errors import MeshError


@pytest.mark.parametrize(
    "builder", [meshes.LapPlates, meshes.LapBeamSection, meshes.RoundPlates, meshes.StepAssembly]
)
def test_a_function_has_the_arguments_of_its_builder(builder):
    function = getattr(meshes, builder.function)
    given = inspect.signature(function).parameters
    own = {name: p for name, p in given.items() if name not in ("path", "comm")}
    assert own.keys() == {f.name for f in fields(builder)}
    defaults = {f.name: f.default for f in fields(builder)}
    assert all(p.default == defaults[name] for name, p in own.items() if p.default is not p.empty)
    assert "comm" in given and function.__name__ == builder.function


X, LOW, HIGH = np.array([0, 0.5, 1]), np.array([-0.5, -0.2, 0]), np.array([0, 0.1, 0.3])
BLOCKS = {"lower": (X, LOW), "upper": HIGH}
BOLT = {"parts": "bolt"}
HOLE = {"hole_diameter": 0.011}
TWO_BOLTS = {"hole_diameter": 0.01, "bolts": [(0.15, 0.04), (0.16, 0.045)]}
RINGS = {"rings": [(-0.01, 0), (0.02, 0)], "r_wai": 0.02}
#: Builders, what is wrong, and what its message says.
REFUSED = {
    "stacked_blocks": [
        ({"lower": (X,)}, "expected lines (x, height), or"),
        ({"lower": (X, -HIGH)}, "lower[1] is [-0.0, -0.1, -0.3], "),
        ({"lower": (X, HIGH)}, "expected heights that end at 0 m"),
        ({"upper": LOW}, "expected heights that start at 0 m"),
        ({"upper_span": (0.1234, 1)}, "upper_span is (0.1234, 1), expected two ascending lines"),
        ({"cell": "hexahedron"}, "expected one of quadrilateral, triangle in 2-D"),
    ],
    "c_beams": [
        ({"thickness": 0.02}, "thickness is 0.02, expected less than pad_thickness"),
        ({"zone": 0.04}, "zone is 0.04, expected less than width = 0.0318 m"),
        ({"washer_diameter": 0.023}, "expected less than 0.9 * zone = 0.0216 m"),
    ],
    "bolted_plates_section": [
        ({"parts": "nut"}, "parts is 'nut', expected one of plates, washers, bolt"),
        ({"fine_radius": 0.2}, "fine_radius is 0.2, expected from half washer_diameter"),
        ({"washer_diameter": 0.3}, "washer_diameter is 0.3, expected between hole_diameter"),
        ({"growth": 1.0}, "growth is 1.0, expected a ratio above 1"),
        (BOLT | {"bolt_diameter": 0.013}, "expected less than the holes, 0.013 m"),
        (BOLT | {"head_diameter": 0.03}, "head_diameter is 0.03, expected above"),
        (BOLT | {"seats": "glued"}, "seats is 'glued', expected 'contact' or"),
    ],
    "bolted_plates": [(BOLT | {"n_around": 12}, "n_around is 12, expected a multiple of 8")],
    "lap_plates": [
        ({"length": -1.0}, "length is -1.0, expected a length above 0 m"),
        ({"lap": 0.2}, "lap is 0.2, expected less than length = 0.2 m"),
        ({"layer": -1e-3}, "layer is -0.001, expected 0 m or"),
        ({"n_length": 2.5}, "n_length is 2.5, expected a whole number"),
        ({"cell": "prism"}, "cell is 'prism', expected 'hexahedron' or 'tetrahedron'"),
        ({"bolts": [0.14, 0.02]}, "bolts is [0.14, 0.02], expected a pair (x, y)"),
        ({"zone": 0.05}, "zone is 0.05, expected at most 0.04 m, so that the square of bolts[0]"),
        ({"hole_diameter": 0.019}, "hole_diameter is 0.019, expected a diameter above 0 m and"),
        ({"washer_diameter": 0.02}, "washer_diameter is 0.02, expected None when hole_diameter"),
        (HOLE | {"washer_diameter": 0.01}, "0.01, expected more than hole_diameter = 0.011 m"),
        (TWO_BOLTS, "zone is 0.02, expected at most the distance of bolts[0] and bolts[1], 0.01 m"),
    ],
    "lap_beam": [
        ({"lap": 0.3}, "lap is 0.3, expected less than length = 0.235 m"),
        ({"washer": 0.03}, "washer is 0.03, expected 0 m, or a side above it of at most"),
    ],
    "lap_beam_section": [({"cell": "hexahedron"}, "expected 'quadrilateral' or 'triangle'")],
    "half_lap_beam": [
        ({"lap": 0.8}, "lap is 0.8, expected less than length = 0.72 m"),
        ({"gap": 0.4}, "gap is 0.4, expected less than 0.3 m"),
        ({"layer": 0.02}, "layer is 0.02, expected less than thickness = 0.0127 m"),
        ({"bolts": 9}, "washer is 0.015, expected 0 m, or at most 0.012 m, the pitch of 9 bolts"),
        ({"bolts": 10**9, "washer": 0.0}, "expected a whole number of at most 1000"),
        ({"washer": 0.026}, "washer is 0.026, expected 0 m, or at most 0.0254 m, the width"),
        ({"washer": 0.022, "hole": 0.01}, "at most 0.02032 m, the width, over 1.25"),
        ({"hole": 0.02}, "hole is 0.02, expected 0 m, or less than washer = 0.015 m"),
    ],
    "dumbbell": [
        ({"neck": (0.3, 0.06, 0.04)}, "neck is"),
        ({"rings": [(0, 0)]}, "r_wai is None"),
        ({"rings": [(0.05, 0)], "r_wai": 0.02}, "stays within -0.06 to"),
        (RINGS, "distance"),
        (RINGS | {"zone": 0.03}, "r_wai is 0.02, expected at most 0.45 * zone"),
    ],
    "engraving_machine": [
        ({"bed": (0.5, 0.8)}, "bed is (0.5, 0.8), expected three lengths"),
        ({"element_size": 1e-9}, "cells"),
        ({"bed": (0.7, 0.8, 0.2)}, "expected a width of at least 0.77"),
        ({"bed": (0.8, 0.8, 0.2)}, "expected a length above 0.90"),
        ({"arm": (0.1, 0.2)}, "beyond the flange"),
        ({"column": 0.3}, "column is 0.3, expected more than 0.447 m"),
        ({"bolts": (2, 5)}, "bolts is"),
        ({"zone": 0.1}, "zone is 0.1, expected at least 0.1105"),
        ({"r_wai": 0.005}, "r_wai is 0.005, expected a radius above r_nei"),
    ],
}


@pytest.mark.parametrize(
    ("builder", "wrong", "message"),
    [(builder, *each) for builder, entries in REFUSED.items() for each in entries],
)
def test_what_cannot_be_is_refused_by_its_name(builder, wrong, message):
    given = BLOCKS | wrong if builder == "stacked_blocks" else wrong
    with pytest.raises(MeshError, match=re.escape(message)):
        getattr(meshes, builder)(MPI.COMM_SELF, **given)
