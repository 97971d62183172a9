"""What a vibration test measured: tables, functions, identified modes, and their gap to a model."""

from fenics_joints.measurements.amplitude import MeasuredBackbone, read_amplitude
from fenics_joints.measurements.curves import MeasuredCurves, read_curves
from fenics_joints.measurements.data import TestData
from fenics_joints.measurements.frfs import MeasuredFRFs
from fenics_joints.measurements.gap import Gap, Pairing, mac, pair_modes
from fenics_joints.measurements.identification import IdentifiedModes, identify_modes
from fenics_joints.measurements.measured_shapes import MeasuredShapes, made_real, read_shapes
from fenics_joints.measurements.read_data import read_test_data
from fenics_joints.measurements.readers import read_frfs
from fenics_joints.measurements.tables import read_table
from fenics_joints.measurements.target import FRFTarget, Target
from fenics_joints.measurements.time_records import TimeFRFs, TimeSettings, frfs_from_time

__all__ = [
    "FRFTarget",
    "Gap",
    "IdentifiedModes",
    "MeasuredBackbone",
    "MeasuredCurves",
    "MeasuredFRFs",
    "MeasuredShapes",
    "Pairing",
    "Target",
    "TestData",
    "TimeFRFs",
    "TimeSettings",
    "frfs_from_time",
    "identify_modes",
    "mac",
    "made_real",
    "pair_modes",
    "read_amplitude",
    "read_curves",
    "read_frfs",
    "read_shapes",
    "read_table",
    "read_test_data",
]
