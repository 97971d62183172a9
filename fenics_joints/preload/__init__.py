"""Bolts, their preload and the contact that it makes.

A `PreloadModel` is a structure of several bodies with contacts, bolts and loads; `solve_preload`
finds pressures, gaps, slips and status of every contact at given bolt forces.

What solves is imported when it is first asked for: bolts and torques need no DOLFINx.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fenics_joints.machine.lazy import lazy
from fenics_joints.preload.threads import Thread, thread
from fenics_joints.preload.torque import friction_from, motosh_force, nut_factor_force

if TYPE_CHECKING:
    from fenics_joints.preload.adjoint import Gradient, PreloadAdjoint
    from fenics_joints.preload.components import (
        BeamBolt,
        Contact,
        Cylinder,
        Displacement,
        Obstacle,
        Plane,
        Pressure,
        PretensionSection,
        Sphere,
        Traction,
        WasherForce,
    )
    from fenics_joints.preload.conditions import OPEN, SLIP, STICK
    from fenics_joints.preload.contact_state import ContactState
    from fenics_joints.preload.linear_joint import (
        LinearJoint,
        cutoff_conditions,
        pair_conditions,
        pressure_stiffness,
        status_conditions,
        stuck_conditions,
    )
    from fenics_joints.preload.model import PreloadModel
    from fenics_joints.preload.solve import METHODS, PreloadResult, PreloadSolver, solve_preload
    from fenics_joints.structure.faces import check_contact

__all__ = [
    "METHODS",
    "OPEN",
    "SLIP",
    "STICK",
    "BeamBolt",
    "Contact",
    "ContactState",
    "Cylinder",
    "Displacement",
    "Gradient",
    "LinearJoint",
    "Obstacle",
    "Plane",
    "PreloadAdjoint",
    "PreloadModel",
    "PreloadResult",
    "PreloadSolver",
    "Pressure",
    "PretensionSection",
    "Sphere",
    "Thread",
    "Traction",
    "WasherForce",
    "check_contact",
    "cutoff_conditions",
    "friction_from",
    "motosh_force",
    "nut_factor_force",
    "pair_conditions",
    "pressure_stiffness",
    "solve_preload",
    "status_conditions",
    "stuck_conditions",
    "thread",
]

#: Files that hold the other names; each is imported with those before it at the latest.
_FILES = (
    "components",
    "conditions",
    "fenics_joints.structure.faces",
    "model",
    "contact_state",
    "solve",
    "adjoint",
    "linear_joint",
)

__getattr__ = lazy(__name__, dict.fromkeys(__all__, _FILES))
