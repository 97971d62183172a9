"""Cases: a structure, its test and what to do with them, in one validated TOML file."""

from fenics_joints.case.build import build_mesh, build_preload, build_structure
from fenics_joints.case.case import Case
from fenics_joints.case.load import Examined, examine_case, load_case
from fenics_joints.case.notes import labelled, test_notes
from fenics_joints.case.parameters import model_damping, parameters
from fenics_joints.case.plausible import plausibility
from fenics_joints.case.size import CostEstimate, check_size, estimate

__all__ = [
    "Case",
    "CostEstimate",
    "Examined",
    "build_mesh",
    "build_preload",
    "build_structure",
    "check_size",
    "estimate",
    "examine_case",
    "labelled",
    "load_case",
    "model_damping",
    "parameters",
    "plausibility",
    "test_notes",
]
