"""Mode shapes in files for ParaView."""

from __future__ import annotations

from pathlib import Path

import basix.ufl
from dolfinx import fem

from fenics_joints.errors import InputError
from fenics_joints.modal.modes import Modes
from fenics_joints.structure.paraview import write_fields


def write_shapes(modes: Modes, path: str | Path) -> list[Path]:
    """Write all elastic modes: VTX for ``.bp``, XDMF with HDF5 for ``.xdmf``. Collective.

    Every mode is a vector field ``mode_07_123.45_Hz``, M-normalised, kg^-1/2: in ParaView choose it
    in a filter "Warp By Vector". In VTX it is of the model's degree, in XDMF linear between
    vertices.

    Args:
        modes: Modes of solids.
        path: Name of the file; one that is there is replaced.

    Returns:
        The files.

    Raises:
        InputError: If the model has no mesh or no mode is elastic; for another ending, a DOLFINx
            without ADIOS2, or if a file cannot be written.
    """
    check_meshed(modes.model, path)
    elastic = range(modes.n_rigid, len(modes))
    if not elastic:
        raise InputError(
            f"{path}: all {len(modes)} modes are those of a rigid body; expected more modes."
        )
    V = modes.shape(elastic[0]).function_space
    degree = 1 if Path(path).suffix == ".xdmf" else V.ufl_element().degree
    shape = (V.mesh.geometry.dim,)
    element = basix.ufl.element("Lagrange", V.mesh.topology.cell_name(), degree, shape=shape)
    W = fem.functionspace(V.mesh, element)
    fields = []
    for i in elastic:
        field = fem.Function(W, name=f"mode_{i + 1:02d}_{modes.frequencies_hz[i]:.2f}_Hz")
        field.interpolate(modes.shape(i))
        fields.append(field)
    return write_fields(fields, path)


def check_meshed(model: object, path: str | Path) -> None:
    """Refuse a model whose modes are no fields.

    Raises:
        InputError: If it is of beams, or reduced.
    """
    if not hasattr(model, "displacement"):
        raise InputError(
            f"{path}: a {type(model).__name__} has no mesh for ParaView; expected a model of solids"
        )
