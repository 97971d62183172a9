"""Materials and joint laws as small pure functions that return UFL; import one into any script."""

from fenics_joints.forms.axisymmetric import (
    axisymmetric_elasticity,
    axisymmetric_mass,
    axisymmetric_strain,
    circumference,
)
from fenics_joints.forms.contact import (
    augmented_pressure,
    contact_gap,
    contact_interface,
    contact_slip,
    coulomb_traction,
    penalty_pressure,
)
from fenics_joints.forms.elasticity import (
    attached_mass,
    elasticity,
    isotropic_stress,
    lame_from_moduli,
    lame_parameters,
    mass,
)
from fenics_joints.forms.interface import spring_interface, spring_traction
from fenics_joints.forms.kinematics import layer_strain, strain, stretched_gradient
from fenics_joints.forms.pressure import (
    contact_radius,
    graded_modulus,
    peak_pressure,
    pressure_cone,
    radius,
)
from fenics_joints.forms.thin_layer import (
    constrained_layer,
    isotropic_layer,
    uncoupled_layer,
    uncoupled_layer_stress,
)

__all__ = [
    "attached_mass",
    "augmented_pressure",
    "axisymmetric_elasticity",
    "axisymmetric_mass",
    "axisymmetric_strain",
    "circumference",
    "constrained_layer",
    "contact_gap",
    "contact_interface",
    "contact_radius",
    "contact_slip",
    "coulomb_traction",
    "elasticity",
    "graded_modulus",
    "isotropic_layer",
    "isotropic_stress",
    "lame_from_moduli",
    "lame_parameters",
    "layer_strain",
    "mass",
    "peak_pressure",
    "penalty_pressure",
    "pressure_cone",
    "radius",
    "spring_interface",
    "spring_traction",
    "strain",
    "stretched_gradient",
    "uncoupled_layer",
    "uncoupled_layer_stress",
]
