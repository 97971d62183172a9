"""Amplitude data of one mode: frequency and damping over the level of vibration, from any test.

`read_amplitude` reads plain tables, curves at constant response or constant force and ring-downs,
and reduces each to a `MeasuredBackbone`.
"""

from fenics_joints.measurements.amplitude.backbone import (
    MeasuredBackbone,
    by_mode,
    test_by_level,
    with_modes_at_rest,
)
from fenics_joints.measurements.amplitude.files import read_amplitude
from fenics_joints.measurements.amplitude.ring_downs import from_ring_down
from fenics_joints.measurements.amplitude.sweeps import from_constant_force, from_constant_response

__all__ = [
    "MeasuredBackbone",
    "by_mode",
    "from_constant_force",
    "from_constant_response",
    "from_ring_down",
    "read_amplitude",
    "test_by_level",
    "with_modes_at_rest",
]
