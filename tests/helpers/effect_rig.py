"""A case of two lapped plates with everything that effects change, and the keys they change."""

import numpy as np

from fenics_joints.case import Case

STEEL = {"E": 2e11, "nu": 0.3, "rho": 7800.0}


SOFT = {"E": 1e9, "G": 4e8}


RIG = {
    "mesh": {"builder": "lap_plates", "element_size": 2e-2, "n_thickness": 1, "degree": 1},
    "parts": {
        "upper": {"cells": ["plate_2"], **STEEL},
        "lower": {"cells": ["plate_1"], "tolerance": {"width": 0.01}, **STEEL},
    },
    "joints": {
        "near": {"cells": "joint_near", "bolted": True, **SOFT},
        "away": {"cells": "joint_away", **SOFT},
    },
    "masses": {"nut": {"points": [[0.01, 0.04, 0.0]], "mass": 0.01}},
    "springs": {
        "cord": {
            "points": [[0.01, 0.04, 0.0]],
            "direction": [0, 0, 1],
            "stiffness": 1e3,
            "tolerance": 0.2,
        }
    },
    "attached": {"cell": {"kind": "mass", "points": [[0.01, 0.04, 0.0]], "mass": 0.02}},
    "supports": {"left_end": {"facets": "end"}},
}


LAYER, TORQUES = 5e-4, np.array([5.0, 10.0, 20.0])


def whole(tables):
    base = {key: RIG[key] for key in ("mesh", "parts", "joints")}
    return Case.model_validate(base | tables)


def theta_of(effect, z=0.7):
    return {p.name: p.value(float(np.clip(z, *p.limits()))) for p in effect.priors}


def touched(effect, baseline, condition=10.0) -> set[str]:
    values = dict(baseline)
    if effect.apply is not None:
        effect.apply(values, theta_of(effect), condition)
    assert set(values) == set(baseline)
    return {key for key in values if values[key] != baseline[key]}
