"""Joint parameters by bolt, force, thickness and roughness: rows, their interpolation, answers."""

from fenics_joints.database.analysis import BoltedPlates, bolted_plates_radius, solve_bolted_plates
from fenics_joints.database.joints import JointRow
from fenics_joints.database.kriging import Interpolation, Kriging
from fenics_joints.database.query import Answer, JointSurfaces, TorqueToForce, query
from fenics_joints.database.store import Store, seed_database
from fenics_joints.database.sweep import Sample, grid, sweep

__all__ = [
    "Answer",
    "BoltedPlates",
    "Interpolation",
    "JointRow",
    "JointSurfaces",
    "Kriging",
    "Sample",
    "Store",
    "TorqueToForce",
    "bolted_plates_radius",
    "grid",
    "query",
    "seed_database",
    "solve_bolted_plates",
    "sweep",
]
