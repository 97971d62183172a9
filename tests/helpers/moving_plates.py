"""Free lap plates with a massless layer, a mass that moves and a soft spring."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from fenics_joints.meshes import lap_plates
from fenics_joints.structure import Parameter, PointMass, Sensors, Spring, Structure, joint, part

VALUES = {
    "plates.E": 69e9,
    "nu": 0.283,
    "plates.rho": 2750.0,
    "layer.E": 8e7,
    "layer.G": 3e7,
    "tip.mass": 0.03,
    "tip.travel": 0.004,
    "cord": 4e3,
}
PLACES = Sensors(
    np.array([[0.013, 0.031, 0.008], [0.307, 0.071, 0.012], [0.151, 0.017, 0.0165]]),
    np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.4], [0.3, 0.2, 1.0]]),
)


def plates(comm=MPI.COMM_SELF, values=VALUES, layer="layer.E", cord=True):
    """The structure, whose parameters are ``values``; ``layer`` is the modulus of the layer."""
    spring = Spring("cord", "cord", (0.3, 0.03, 0.012), (0.0, 0.0, 1.0))
    return Structure(
        lap_plates(comm, element_size=0.08, n_thickness=1),
        [
            part("plates", ("plate_1", "plate_2"), E="plates.E", nu="nu", rho="plates.rho"),
            joint("layer", ("joint_near", "joint_away"), E=layer, G="layer.G"),
        ],
        [Parameter(name, value) for name, value in values.items()],
        masses=[PointMass("tip", "tip.mass", (0.01, 0.033, 0.0), travel="tip.travel")],
        springs=[spring] if cord else (),
    )
