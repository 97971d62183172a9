"""Nonlinear joint laws with memory."""

from fenics_joints.joint_laws.field import JointField
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
from fenics_joints.joint_laws.quasi_static import (
    QuasiStatic,
    QuasiStaticHistory,
    solve_quasi_static,
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
    "IwanLayer",
    "JointField",
    "JointLaw",
    "LawKernel",
    "QuasiStatic",
    "QuasiStaticHistory",
    "RichardAbbott",
    "Segalman",
    "Valanis",
    "iwan_sliders",
    "slider_edges",
    "solve_quasi_static",
]
