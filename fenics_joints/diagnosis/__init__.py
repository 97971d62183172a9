"""Diagnosis of the sim-to-real gap: where it lies, which effect causes it, how far it shrinks."""

from fenics_joints.diagnosis.diagnose import diagnose
from fenics_joints.diagnosis.effects.effect import Effect, Prior
from fenics_joints.diagnosis.result import Diagnosis

__all__ = ["Diagnosis", "Effect", "Prior", "diagnose"]
