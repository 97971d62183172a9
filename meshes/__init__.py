"""Meshes with named parts and faces: builders for known geometries, and a reader of ``.msh``."""

from fenics_joints.meshes.lap_plates import lap_plates
from fenics_joints.meshes.tagged import TaggedMesh

__all__ = ["TaggedMesh", "lap_plates"]
