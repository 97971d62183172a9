"""Kits for pages, summaries and pictures, which know no command.

Pictures are imported when they are first asked for: a line on a terminal needs no matplotlib.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

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

_FILES = {
    "contact_pictures": ("pressure_map", "pressure_profile", "status_map"),
    "mesh_pictures": ("mode_shape",),
    "patch_pictures": ("patch_map",),
    "stabilisation": ("write_stabilisation",),
}
_FILE_OF = {name: file for file, names in _FILES.items() for name in names}


def __getattr__(name: str):
    if name not in _FILE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_FILE_OF[name]}"), name)
