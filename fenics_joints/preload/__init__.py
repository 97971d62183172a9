"""Bolts, their preload and the contact that it makes.

A `PreloadModel` is a structure of several bodies with contacts, bolts and loads; `solve_preload`
finds pressures, gaps, slips and status of every contact at given bolt forces.
"""

from fenics_joints.preload.components import (
    BeamBolt,
    Contact,
    PretensionSection,
    Traction,
    WasherForce,
)
from fenics_joints.preload.conditions import OPEN, SLIP, STICK
from fenics_joints.preload.model import PreloadModel
from fenics_joints.preload.result import ContactState, PreloadResult
from fenics_joints.preload.solve import METHODS, PreloadSolver, solve_preload

__all__ = [
    "METHODS",
    "OPEN",
    "SLIP",
    "STICK",
    "BeamBolt",
    "Contact",
    "ContactState",
    "PreloadModel",
    "PreloadResult",
    "PreloadSolver",
    "PretensionSection",
    "Traction",
    "WasherForce",
    "solve_preload",
]
