"""Reduced models with nonlinear interfaces as HDF5 files, see `fenics_joints.reduction.files`."""

from __future__ import annotations

from pathlib import Path

import fenics_joints.beams.laws  # noqa: F401, files may hold them
from fenics_joints.interfaces.model import InterfacePoints
from fenics_joints.interfaces.reduced import LayerTerm, ReducedInterfaceModel
from fenics_joints.parallel import on_root
from fenics_joints.reduction.files import read_model, register, write_model

__all__ = ["read_interface_model", "write_interface_model"]

_FORMAT = "fenics_joints interface model"

register(InterfacePoints, LayerTerm, ReducedInterfaceModel)


def write_interface_model(model: ReducedInterfaceModel, path: str | Path) -> None:
    """Write a model to an HDF5 file, whole or not at all. Collective if the model has its mesh.

    Args:
        model: The model.
        path: The file; one that exists is replaced.

    Raises:
        InputError: If it cannot be written, or a law has an attribute that no file can hold.
    """
    if model.source is None:
        write_model(model, path, _FORMAT)
    else:
        on_root(model.source.full.comm, lambda: write_model(model, path, _FORMAT))


def read_interface_model(path: str | Path) -> ReducedInterfaceModel:
    """Read a model that `write_interface_model` wrote. Any rank may do so by itself.

    Raises:
        InputError: As `fenics_joints.reduction.files.read_model`.
    """
    return read_model(path, _FORMAT, ReducedInterfaceModel)
