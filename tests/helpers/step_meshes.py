"""Meshes of drawings that gmsh makes a STEP file of, on one process."""

from __future__ import annotations

from mpi4py import MPI

from fenics_joints.meshes import read_step
from fenics_joints.meshes.step_writer import write_step


def meshed(folder, draw, labels=(), **given):
    """The mesh of a drawing, as coarse as it can be where nothing else is given."""
    path = write_step(folder / "drawing.step", draw, labels)
    return read_step(path, MPI.COMM_SELF, **({"element_size": 0.03, "circle": 8} | given))
