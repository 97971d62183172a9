"""Offset Timoshenko beams with generic joint elements (seed 002), without a mesh."""

from fenics_joints.beams.components import Beam, Clamp, GenericJoint, Held, LumpedMass
from fenics_joints.beams.structure import BeamStructure

__all__ = ["Beam", "BeamStructure", "Clamp", "GenericJoint", "Held", "LumpedMass"]
