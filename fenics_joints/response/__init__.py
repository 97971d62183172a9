"""Damped structures: frequency response functions, complex modes, derivatives of shapes."""

from fenics_joints.modal.modes import Modes, solve_modes
from fenics_joints.response.complex_modes import ComplexModes, solve_complex_modes
from fenics_joints.response.frf import FRF, solve_frf
from fenics_joints.response.shape_sensitivity import (
    SplitModes,
    clusters,
    mac_gradients,
    shape_gradients,
    span_gradients,
    split_modes,
)

__all__ = [
    "FRF",
    "ComplexModes",
    "Modes",
    "SplitModes",
    "clusters",
    "mac_gradients",
    "shape_gradients",
    "solve_complex_modes",
    "solve_frf",
    "solve_modes",
    "span_gradients",
    "split_modes",
]
