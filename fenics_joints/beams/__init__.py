"""Offset Timoshenko beams with generic joint elements (seed 002), without a mesh."""

from fenics_joints.beams.components import Beam, Clamp, GenericJoint, Held, LumpedMass
from fenics_joints.beams.damped import (
    DampingFit,
    SlipTable,
    identify_damping,
    slip_table,
)
from fenics_joints.beams.structure import BeamStructure

__all__ = [
    "Beam",
    "BeamStructure",
    "Clamp",
    "DampingFit",
    "GenericJoint",
    "Held",
    "LumpedMass",
    "SlipTable",
    "identify_damping",
    "slip_table",
]
