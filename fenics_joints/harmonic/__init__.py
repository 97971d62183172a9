"""Periodic vibration of structures with nonlinear interfaces, by harmonic balance.

`solve_harmonic` makes frequency responses at constant force, `solve_constant_response` those at
constant response, `solve_backbone` frequency and damping against amplitude, and
`solve_static_backbone` the same from static loads; `identify` finds the laws' numbers from measured
responses.
"""

from fenics_joints.harmonic.backbone import NonlinearMode, solve_backbone
from fenics_joints.harmonic.balance import Balance, Load, default_samples
from fenics_joints.harmonic.bifurcations import (
    Bifurcation,
    Stability,
    find_bifurcations,
    switch_branch,
)
from fenics_joints.harmonic.chosen import neglected_harmonics, solve_to_tolerance
from fenics_joints.harmonic.continuation import (
    Branch,
    BranchProblem,
    ContinuationSettings,
    follow,
    load_branch,
)
from fenics_joints.harmonic.fourier import Fourier
from fenics_joints.harmonic.frf import solve_constant_response, solve_harmonic
from fenics_joints.harmonic.identify import CurvePrediction, IdentificationResult, identify, predict
from fenics_joints.harmonic.measured_mode import MeasuredLoop, read_loops
from fenics_joints.harmonic.result import HarmonicResult, Loops, Periodic
from fenics_joints.harmonic.sliders import fitted_sliders, slider_ranges
from fenics_joints.harmonic.stability import floquet_multipliers, hill_multipliers
from fenics_joints.harmonic.static_mode import StaticBackbone, solve_static_backbone
from fenics_joints.harmonic.tracking import Folds, solve_isola, track_folds, track_resonance

__all__ = [
    "NonlinearMode",
    "Balance",
    "Bifurcation",
    "Branch",
    "CurvePrediction",
    "Folds",
    "Fourier",
    "HarmonicResult",
    "IdentificationResult",
    "Load",
    "Loops",
    "MeasuredLoop",
    "Periodic",
    "BranchProblem",
    "ContinuationSettings",
    "Stability",
    "StaticBackbone",
    "default_samples",
    "fitted_sliders",
    "find_bifurcations",
    "floquet_multipliers",
    "follow",
    "hill_multipliers",
    "identify",
    "load_branch",
    "neglected_harmonics",
    "predict",
    "read_loops",
    "slider_ranges",
    "solve_backbone",
    "solve_constant_response",
    "solve_harmonic",
    "solve_isola",
    "solve_static_backbone",
    "solve_to_tolerance",
    "switch_branch",
    "track_folds",
    "track_resonance",
]
