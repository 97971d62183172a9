"""The same as `test_odd_values` for meshes, beams, statistics, databases and effects."""

from __future__ import annotations

from math import nan

import numpy as np
import pytest
from mpi4py import MPI
from odd_values import ABOVE_0, ANY, COUNT, FLAG, FROM_0, NAMED_FROM_0, TEXT, WORD, not_refused

from fenics_joints import bayes, beams, database, diagnosis, meshes, random_fields
from fenics_joints.case.preload import known_thread

COMM = MPI.COMM_SELF
NUMBERS = tuple(v for v in ANY if v != "text")
SIDES = (None, "abc", 1.0, [], [1.0], [1.0, 1.0, 0.0], [1.0, nan, 1.0], [True] * 3, [1e300] * 3)
LINES = (None, "ab", 1.0, [nan, 1.0], [None, 1.0], ["a", "b"])


def box(**arguments):
    return meshes.box(COMM, **arguments)


def of_meshes():
    yield (
        box,
        {"lengths": (1.0, 1.0, 1.0), "counts": (1, 1, 1)},
        {
            "lengths": SIDES,
            "cell": WORD,
            "counts": (
                None,
                "abc",
                1,
                [],
                [1],
                [1, 1, 0],
                [1, 1, 1.5],
                [True] * 3,
                [1, 1, 10**400],
            ),
        },
    )
    yield meshes.grid_lines, {"edges": [0.0, 1.0], "size": 0.5}, {"edges": LINES, "size": ABOVE_0}
    yield (
        meshes.graded_lines,
        {"edges": [0.0, 1.0], "sizes": [0.1, 0.2]},
        {"edges": (*LINES, [1.0, 0.0]), "sizes": (*LINES, [0.0, 1.0], [0.1])},
    )
    bolts = (None, "ab", 1.0, [1.0], [(1.0,)], [(nan, 0.0)], [(None, 1.0)], [(0.14, 0.02)] * 2)
    yield (
        meshes.LapPlates,
        {},
        {
            "length": ABOVE_0,
            "width": ABOVE_0,
            "thickness": ABOVE_0,
            "layer": FROM_0,
            "element_size": ABOVE_0,
            "n_thickness": COUNT,
            "n_length": COUNT[1:],
            "bolts": bolts,
            "zone": FROM_0,
            "cell": WORD,
        },
    )
    yield (
        meshes.CBeams,
        {},
        {
            "length": ABOVE_0,
            "hole_diameter": ABOVE_0,
            "bonded": FLAG,
            "layer": FROM_0,
            "n_thickness": (None, "ab", 1, [1], [1, 0], [1.5, 1], [True, True]),
        },
    )
    yield meshes.Dumbbell, {}, {"head": SIDES, "neck": SIDES, "holes": FLAG, "layer": ABOVE_0}
    yield meshes.LapBeam, {}, {"length": ABOVE_0, "n_lap": COUNT, "bonded": FLAG, "root": FROM_0}
    yield (
        meshes.RoundPlates,
        {"size": 0.01},
        {
            "radius": ABOVE_0,
            "growth": (*ABOVE_0, 0.5),
            "seats": WORD,
            "quarter": FLAG,
            "n_around": COUNT,
            "parts": WORD,
            "thickness": (None, "ab", 1.0, [1.0], [1.0, 0.0]),
        },
    )


def of_beams():
    size = {"name": "b", "length": 1.0, "breadth": 0.1, "height": 0.1, "n_elements": 4}
    yield (
        beams.Beam,
        size | {"E": 2e11, "nu": 0.3, "rho": 7800.0},
        {
            "name": TEXT,
            "length": ABOVE_0,
            "breadth": ABOVE_0,
            "height": ABOVE_0,
            "E": NUMBERS,
            "n_elements": COUNT,
            "nu": NUMBERS,
            "rho": NUMBERS,
            "stretch": NUMBERS,
            "shear": ABOVE_0,
            "offset": ANY[1:],
        },
    )
    lap = {"name": "j", "length": 0.1, "n_elements": 2, "k1": 1e3, "k2": 1e3}
    yield (
        beams.GenericJoint,
        lap,
        {
            "name": TEXT,
            "length": ABOVE_0,
            "n_elements": COUNT,
            "k1": (*NUMBERS, [1.0], [nan, 1.0]),
            "k2": (*NUMBERS, [None, 1.0]),
            "c": NUMBERS,
            "k_axial": NUMBERS[1:],
            "axial": NUMBERS,
        },
    )
    yield (
        beams.LumpedMass,
        {"name": "m", "mass": 1.0, "point": (0.0, 0.0, 0.0)},
        {
            "name": TEXT,
            "mass": NAMED_FROM_0,
            "point": (*SIDES[:5], [nan] * 3),
            "radius": FROM_0,
            "travel": NUMBERS,
            "share": FROM_0,
            "range": ("ab", 1.0, [1.0], [1.0, 0.0], [nan, 1.0]),
        },
    )
    yield beams.Held, {"x": 0.0}, {"x": ANY, "motions": (None, "x", 1, [], ["y"], [1])}
    yield (
        beams.Clamp,
        {"name": "c", "last": True, "k_n": 1.0, "k_t": 1.0},
        {"name": TEXT, "last": FLAG, "k_n": NAMED_FROM_0, "k_t": NAMED_FROM_0},
    )


def of_statistics():
    yield (
        bayes.Settings,
        {},
        {
            "sampler": WORD,
            "samples": (*COUNT, 10),
            "burn_in": (None, "x", -1, 2.5, 10**9),
            "chains": (*COUNT, 1),
            "seed": (None, "x", -1, 2.5, True),
        },
    )
    table = np.full((8, 2), 100.0) + np.arange(16).reshape(8, 2)
    yield (
        bayes.Specimens,
        {"mode_names": ("a", "b"), "frequencies_hz": table},
        {
            "noise": (*ABOVE_0, 1.0),
            "scatter": (*ABOVE_0, 1.0),
            "discrepancy": (*FROM_0, 1.0),
            "noise_known": FLAG,
        },
    )
    yield (
        random_fields.RandomField,
        {"names": ("a", "b"), "eps": 0.1},
        {
            "names": (None, 1.0, [], ["a", "a"], [1.0], [""]),
            "eps": (*ABOVE_0, 1.0),
            "distribution": WORD,
        },
    )
    points = np.linspace(0.0, 1.0, 5)
    yield (
        random_fields.karhunen_loeve,
        {"points": points, "length": 0.5},
        {
            "points": (None, "x", [nan, 1.0]),
            "length": ABOVE_0,
            "kind": WORD,
            "weights": ("x", [1.0], -points),
            "share": (*ABOVE_0, 1.5),
            "n_terms": (*COUNT[1:], 6),
        },
    )
    yield (
        diagnosis.Prior,
        {"name": "p", "median": 1.0, "spread": 0.1},
        {
            "name": TEXT,
            "median": ABOVE_0,
            "spread": ABOVE_0,
            "log": FLAG,
            "scan": (None, "x", -1, 2.5, True),
        },
    )


def of_databases():
    joint = {"diameter": 0.012, "radius": 0.04}
    yield (
        database.Joint,
        joint,
        {
            "diameter": ABOVE_0,
            "radius": (*ABOVE_0[1:], 1e-3, 10.0),
            "force": ABOVE_0[1:],
            "thickness": ABOVE_0[1:],
            "nu": (*ANY[1:], 0.5),
            "bolt": TEXT[1:],
            "settings": ("{", 1.0),
        },
    )
    sample = {"bolt": "M12", "diameter": 0.012, "force": 1e4, "thickness": 0.02}
    yield (
        database.Sample,
        sample,
        {
            "bolt": TEXT,
            "diameter": ABOVE_0,
            "force": ABOVE_0,
            "thickness": ABOVE_0,
            "roughness": ABOVE_0[1:],
        },
    )
    yield (
        database.grid,
        {"bolts": ["M12"], "forces": [1e4], "thicknesses": [0.02]},
        {
            "bolts": ([None], ["M"], [1.0]),
            "forces": ([None], ["x"], [-1.0], [nan], [1e300]),
            "thicknesses": ([None], ["x"], [0.0], [nan]),
            "roughnesses": (["x"], [-1.0], [nan]),
        },
    )
    yield (
        database.BoltedPlates,
        {},
        {
            "model": WORD,
            "friction": FROM_0,
            "plate_radius": ABOVE_0,
            "E": ABOVE_0,
            "size": ABOVE_0,
            "nu": (*ANY, 0.5, -1.0),
            "degree": (*COUNT, 3),
            "penalty": ABOVE_0[1:],
            "P_lim": ABOVE_0,
        },
    )
    yield (
        database.TorqueToForce,
        {},
        {"K": ABOVE_0, "friction": FROM_0[1:], "friction_head": FROM_0[1:]},
    )
    yield known_thread, {"name": "M12"}, {"name": (None, "", "M", 12, nan, [])}


CALLS = {
    "meshes": of_meshes,
    "beams": of_beams,
    "bayes, random_fields, diagnosis": of_statistics,
    "database": of_databases,
}


@pytest.mark.parametrize("rooms", CALLS)
def test_odd_values_are_refused(rooms):
    wrong = not_refused(CALLS[rooms]())
    assert not wrong, "\n".join(wrong)
