"""Natural frequencies, mode shapes and their derivatives by parameters."""

from fenics_joints.modal.eigensolver import EigenResult, EigenSolver
from fenics_joints.modal.iterative import IterativeEigenSolver
from fenics_joints.modal.modes import Modes, solve_modes, write_shapes
from fenics_joints.modal.sensitivity import Identifiability, frequency_sensitivity, identifiability

__all__ = [
    "EigenResult",
    "EigenSolver",
    "Identifiability",
    "IterativeEigenSolver",
    "Modes",
    "frequency_sensitivity",
    "identifiability",
    "solve_modes",
    "write_shapes",
]
