"""Offset Timoshenko beams with generic joint elements (Jalali et al. 2019), without a mesh."""

from fenics_joints.beams.components import Beam, Clamp, GenericJoint, Held, LumpedMass
from fenics_joints.beams.damped import DampingFit, SlipTable, identify_damping, slip_table
from fenics_joints.beams.structure import BeamStructure
from fenics_joints.beams.tested import ExactModes

__all__ = [
    "Beam",
    "BeamStructure",
    "Clamp",
    "DampingFit",
    "ExactModes",
    "GenericJoint",
    "Held",
    "LumpedMass",
    "SlipTable",
    "identify_damping",
    "slip_table",
]
