"""Structures whose joints are nonlinear, on few degrees of freedom or in full.

`reduce_layers` makes thin layers nonlinear, `reduce_contacts` zero-thickness contacts; both give a
`ReducedInterfaceModel`, which harmonic balance and time integration work on, which takes the calls
of a linear structure for small vibrations, and whose linear parameters can still be changed.
`full_layers` is the same model, not reduced.
"""

from fenics_joints.interfaces.between_matrices import reduce_matrix_joints
from fenics_joints.interfaces.contacts import reduce_contacts
from fenics_joints.interfaces.full import FullModel, SparsePoints, full_layers
from fenics_joints.interfaces.layers import reduce_layers
from fenics_joints.interfaces.loading import loading_shapes, static_state
from fenics_joints.interfaces.model import (
    InterfaceModel,
    InterfacePoints,
    with_modal_damping,
    with_rayleigh_damping,
)
from fenics_joints.interfaces.reduced import ReducedInterfaceModel, read_interface_model

__all__ = [
    "FullModel",
    "InterfaceModel",
    "InterfacePoints",
    "ReducedInterfaceModel",
    "SparsePoints",
    "full_layers",
    "loading_shapes",
    "read_interface_model",
    "reduce_contacts",
    "reduce_layers",
    "reduce_matrix_joints",
    "static_state",
    "with_modal_damping",
    "with_rayleigh_damping",
]
