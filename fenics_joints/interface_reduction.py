"""Reduced models of structures whose joints are nonlinear.

`reduce_layers` makes thin layers nonlinear, `reduce_contacts` zero-thickness contacts; both give a
`ReducedInterfaceModel`, which harmonic balance and time integration work on, which takes the calls
of a linear structure for small vibrations, and whose linear parameters can still be changed.
"""

from fenics_joints.interface_places import Places
from fenics_joints.reduced_contacts import reduce_contacts
from fenics_joints.reduced_interface import (
    ReducedInterfaceModel,
    with_modal_damping,
    with_rayleigh_damping,
)
from fenics_joints.reduced_layers import reduce_layers

__all__ = [
    "Places",
    "ReducedInterfaceModel",
    "reduce_contacts",
    "reduce_layers",
    "with_modal_damping",
    "with_rayleigh_damping",
]
