"""Joint parameters by bolt, force, thickness and roughness: rows, their interpolation, answers.

The contact analysis is imported when it is first asked for: answers need no DOLFINx.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from fenics_joints.database.joints import Joint
from fenics_joints.database.kriging import Kriging
from fenics_joints.database.query import Answer, Surfaces, TorqueToForce, query
from fenics_joints.database.store import Store, seed_database
from fenics_joints.database.sweep import Sample, grid, sweep

if TYPE_CHECKING:
    from fenics_joints.database.analysis import (
        BoltedPlates,
        bolted_plates_radius,
        solve_bolted_plates,
    )

_ANALYSIS = ("BoltedPlates", "bolted_plates_radius", "solve_bolted_plates")

__all__ = [
    "Answer",
    "BoltedPlates",
    "Joint",
    "Kriging",
    "Sample",
    "Store",
    "Surfaces",
    "TorqueToForce",
    "bolted_plates_radius",
    "grid",
    "query",
    "seed_database",
    "solve_bolted_plates",
    "sweep",
]


def __getattr__(name: str):
    if name not in _ANALYSIS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.analysis"), name)
