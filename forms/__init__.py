"""Materials and joint laws as small pure functions that return UFL; import one into any script."""

from fenics_joints.forms.axisymmetric import (
    axisymmetric_elasticity,
    axisymmetric_mass,
    axisymmetric_strain,
    circumference,
)
from fenics_joints.forms.backbones import (
    bilinear,
    bilinear_slope,
    richard_abbott,
    richard_abbott_slope,
    segalman,
    segalman_limits,
    segalman_slope,
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
from fenics_joints.forms.hysteresis import (
    bouc_wen,
    coulomb_matrix,
    coulomb_stick,
    dilatant_coulomb,
    parallel,
    slider,
    slider_dissipation,
    slider_energy,
    valanis,
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
    "bilinear",
    "bilinear_slope",
    "bouc_wen",
    "circumference",
    "constrained_layer",
    "contact_gap",
    "contact_interface",
    "contact_radius",
    "contact_slip",
    "coulomb_matrix",
    "coulomb_stick",
    "coulomb_traction",
    "dilatant_coulomb",
    "elasticity",
    "graded_modulus",
    "isotropic_layer",
    "isotropic_stress",
    "lame_from_moduli",
    "lame_parameters",
    "layer_strain",
    "mass",
    "parallel",
    "peak_pressure",
    "penalty_pressure",
    "pressure_cone",
    "radius",
    "richard_abbott",
    "richard_abbott_slope",
    "segalman",
    "segalman_limits",
    "segalman_slope",
    "slider",
    "slider_dissipation",
    "slider_energy",
    "spring_interface",
    "spring_traction",
    "strain",
    "stretched_gradient",
    "uncoupled_layer",
    "uncoupled_layer_stress",
    "valanis",
]
