"""Meshes with named parts and faces: builders for known geometries, and a reader of ``.msh``."""

from fenics_joints.meshes.blocks import box, stacked_blocks
from fenics_joints.meshes.bolted_plates import (
    RoundPlates,
    RoundPlatesSection,
    bolted_plates,
    bolted_plates_section,
)
from fenics_joints.meshes.c_beam import CBeams, c_beams
from fenics_joints.meshes.cad import StepAssembly, read_step
from fenics_joints.meshes.check import check_mesh
from fenics_joints.meshes.dumbbell import Dumbbell, dumbbell
from fenics_joints.meshes.engraving_machine import EngravingMachine, engraving_machine
from fenics_joints.meshes.facets import separate
from fenics_joints.meshes.grid import graded_lines, grid_lines
from fenics_joints.meshes.grow import Grown
from fenics_joints.meshes.half_lap_beam import (
    HalfLapBeam,
    HalfLapBeamSection,
    half_lap_beam,
    half_lap_beam_section,
)
from fenics_joints.meshes.lap_beam import LapBeam, LapBeamSection, lap_beam, lap_beam_section
from fenics_joints.meshes.lap_plates import LapPlates, lap_plates
from fenics_joints.meshes.msh import read_msh
from fenics_joints.meshes.rings import Ring, layer_thickness, measure_layer, measure_ring
from fenics_joints.meshes.tagged import TaggedMesh, extent, in_patches

__all__ = [
    "CBeams",
    "Dumbbell",
    "EngravingMachine",
    "Grown",
    "HalfLapBeam",
    "HalfLapBeamSection",
    "LapBeam",
    "LapBeamSection",
    "LapPlates",
    "Ring",
    "RoundPlates",
    "RoundPlatesSection",
    "StepAssembly",
    "TaggedMesh",
    "bolted_plates",
    "bolted_plates_section",
    "box",
    "c_beams",
    "check_mesh",
    "dumbbell",
    "engraving_machine",
    "extent",
    "graded_lines",
    "grid_lines",
    "half_lap_beam",
    "half_lap_beam_section",
    "in_patches",
    "lap_beam",
    "lap_beam_section",
    "lap_plates",
    "layer_thickness",
    "measure_layer",
    "measure_ring",
    "read_msh",
    "read_step",
    "separate",
    "stacked_blocks",
]
