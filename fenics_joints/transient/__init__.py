"""Time integration of structures with nonlinear joints; damping from ring-downs."""

from fenics_joints.transient.transient import (
    RingDown,
    TransientResult,
    ring_down,
    solve_transient,
    steady_harmonics,
    stepped_sine,
)

__all__ = [
    "RingDown",
    "TransientResult",
    "ring_down",
    "solve_transient",
    "steady_harmonics",
    "stepped_sine",
]
