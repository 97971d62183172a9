"""Kits for pages, summaries and pictures, which know no command.

Pictures are imported when they are first asked for: a line on a terminal needs no matplotlib.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fenics_joints.machine.lazy import lazy

if TYPE_CHECKING:
    from fenics_joints.report.contact_pictures import pressure_map, pressure_profile, status_map
    from fenics_joints.report.mesh_pictures import mode_shape
    from fenics_joints.report.patch_pictures import patch_map
    from fenics_joints.report.stabilisation import write_stabilisation

__all__ = [
    "mode_shape",
    "patch_map",
    "pressure_map",
    "pressure_profile",
    "status_map",
    "write_stabilisation",
]

_FILES = ("contact_pictures", "mesh_pictures", "patch_pictures", "stabilisation")
__getattr__ = lazy(__name__, dict.fromkeys(__all__, _FILES))
