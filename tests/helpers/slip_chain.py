"""Three masses with a joint that slips between the first two, and its true parameters."""

from __future__ import annotations

import numpy as np

from fenics_joints.interfaces import InterfaceModel, InterfacePoints
from fenics_joints.joint_laws import IwanLayer, RichardAbbott

TRUTH = {"lap.E_p": 0.2, "lap.S_y": 0.3, "lap.n": 2.5}
PLACES = {"force": "push", "sensor": "end"}


def chain(sliders: int = 20, K: float = 1.0, C: float = 0.01) -> InterfaceModel:
    """The joint has ten points with normal strain and shear."""
    stiffness = K * np.array([[1.0, 0, 0], [0, 1.0, -1.0], [0, -1.0, 1.0]])
    law = IwanLayer(RichardAbbott(K, *TRUTH.values()), 0.4 * K, sliders)
    across = np.array([-1.0, 1.0, 0.0])
    rows = np.array([[s * across, 0.3 * across] for s in np.linspace(0.2, 1.5, 10)])
    joint = InterfacePoints("lap", law, rows, np.full(10, 0.15), normal=True)
    end = np.eye(3)[2]
    return InterfaceModel(
        np.eye(3), stiffness, (joint,), C * np.eye(3), {"push": end}, {"end": end}
    )
