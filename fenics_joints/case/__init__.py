"""Cases: a structure, its test and what to do with them, in one validated TOML file."""

from fenics_joints.case.build import build_mesh, build_preload, build_structure
from fenics_joints.case.case import Case
from fenics_joints.case.load import load_case
from fenics_joints.case.model_damping import model_damping
from fenics_joints.case.parameters import parameters

__all__ = [
    "Case", "build_mesh", "build_preload", "build_structure", "load_case", "model_damping",
    "parameters",
]  # fmt: skip
