"""Components of models, and K(p) and M(p) of solids with joints."""

from fenics_joints.structure.components import (
    ElasticSupport,
    Parameter,
    PointMass,
    Region,
    Spring,
    Support,
    interface,
    joint,
    part,
    transition,
)
from fenics_joints.structure.damping import Damping
from fenics_joints.structure.form_model import FormModel
from fenics_joints.structure.model import Damped, Model, Pictured
from fenics_joints.structure.own_laws import joint_law
from fenics_joints.structure.points import Sensors
from fenics_joints.structure.structure import Structure

__all__ = [
    "Damped",
    "Damping",
    "ElasticSupport",
    "FormModel",
    "Model",
    "Parameter",
    "Pictured",
    "PointMass",
    "Region",
    "Sensors",
    "Spring",
    "Structure",
    "Support",
    "interface",
    "joint",
    "joint_law",
    "part",
    "transition",
]
