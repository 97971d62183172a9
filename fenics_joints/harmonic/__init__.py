"""Periodic vibration of structures with nonlinear interfaces, by harmonic balance.

`solve_harmonic` makes frequency responses at constant force, `solve_constant_response` those at
constant response, `solve_backbone` and `solve_phase_resonance` frequency and damping against
amplitude.
"""

from fenics_joints.harmonic.balance import Balance, default_samples
from fenics_joints.harmonic.branch import Branch, load_branch, save_branch
from fenics_joints.harmonic.continuation import Problem, Settings, follow, locate
from fenics_joints.harmonic.fourier import Fourier
from fenics_joints.harmonic.frf import solve_harmonic
from fenics_joints.harmonic.result import HarmonicResult, Loops, Peak
from fenics_joints.harmonic.sensitivity import ResponseGradient
from fenics_joints.harmonic.static import static_state

__all__ = [
    "Balance", "Branch", "Fourier", "HarmonicResult", "Loops", "Peak", "Problem",
    "ResponseGradient", "Settings", "default_samples", "follow", "load_branch", "locate",
    "save_branch", "solve_harmonic", "static_state",
]  # fmt: skip
