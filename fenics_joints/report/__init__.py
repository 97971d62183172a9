"""Kits for pages, summaries and pictures, which know no command."""

from fenics_joints.report.contact_pictures import pressure_map, pressure_profile, status_map
from fenics_joints.report.mesh_pictures import cell_map, mode_shape
from fenics_joints.report.patch_pictures import patch_map
from fenics_joints.report.stabilisation import write_stabilisation

__all__ = [
    "cell_map",
    "mode_shape",
    "patch_map",
    "pressure_map",
    "pressure_profile",
    "status_map",
    "write_stabilisation",
]
