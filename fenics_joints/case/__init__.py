"""Cases: a structure, its test and what to do with them, in one validated TOML file."""

from fenics_joints.case.build import build_mesh, build_preload, build_structure
from fenics_joints.case.case import Case
from fenics_joints.case.examine import Examined, examine_case
from fenics_joints.case.load import load_case
from fenics_joints.case.model_damping import model_damping
from fenics_joints.case.notes import test_notes, told
from fenics_joints.case.parameters import parameters
from fenics_joints.case.plausible import plausibility
from fenics_joints.case.size import Estimate, check_size, estimate

__all__ = [
    "Case",
    "Estimate",
    "Examined",
    "build_mesh",
    "build_preload",
    "build_structure",
    "check_size",
    "estimate",
    "examine_case",
    "load_case",
    "model_damping",
    "parameters",
    "plausibility",
    "test_notes",
    "told",
]
