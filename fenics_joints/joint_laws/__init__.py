"""Nonlinear joint laws with memory."""

from fenics_joints.joint_laws.iwan import (
    Backbone,
    Bilinear,
    RichardAbbott,
    Segalman,
    iwan_sliders,
    slider_edges,
)
from fenics_joints.joint_laws.kernel import HarmonicStress, LawKernel
from fenics_joints.joint_laws.law import JointLaw
from fenics_joints.joint_laws.layer import IwanLayer
from fenics_joints.joint_laws.library import (
    BoucWen,
    CoulombStick,
    CubicSpring,
    DilatantCoulomb,
    Iwan,
    Valanis,
)

__all__ = [
    "Backbone",
    "Bilinear",
    "BoucWen",
    "CoulombStick",
    "CubicSpring",
    "DilatantCoulomb",
    "HarmonicStress",
    "Iwan",
    "IwanLayer",
    "JointLaw",
    "LawKernel",
    "RichardAbbott",
    "Segalman",
    "Valanis",
    "iwan_sliders",
    "slider_edges",
]
