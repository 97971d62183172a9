"""Diagnosis of the sim-to-real gap: where it lies, which effect causes it, how far it shrinks."""

from fenics_joints.diagnosis.diagnose import diagnose
from fenics_joints.diagnosis.effects.effect import Effect, Prior, Silent, in_series, relative_error
from fenics_joints.diagnosis.result import Diagnosis, EffectResult, HypothesisResult
from fenics_joints.measurements import TestData

__all__ = [
    "Diagnosis",
    "Effect",
    "EffectResult",
    "HypothesisResult",
    "Prior",
    "Silent",
    "TestData",
    "diagnose",
    "in_series",
    "relative_error",
]
