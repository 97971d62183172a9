"""Reduced models of structures whose joints are nonlinear.

`reduce_layers` makes thin layers nonlinear, `reduce_contacts` zero-thickness contacts; both give a
`ReducedInterfaceModel`, which harmonic balance and time integration work on, which takes the calls
of a linear structure for small vibrations, and whose linear parameters can still be changed.
"""

from fenics_joints.interfaces.contacts import reduce_contacts
from fenics_joints.interfaces.layers import reduce_layers
from fenics_joints.interfaces.reduced import (
    ReducedInterfaceModel,
    with_modal_damping,
    with_rayleigh_damping,
)
from fenics_joints.structure.loads import Places

__all__ = [
    "Places",
    "ReducedInterfaceModel",
    "reduce_contacts",
    "reduce_layers",
    "with_modal_damping",
    "with_rayleigh_damping",
]
