"""From a basis to a reduced model with interfaces: what layers and contacts share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from petsc4py import PETSc

from fenics_joints.errors import InputError
from fenics_joints.interfaces.model import InterfacePoints
from fenics_joints.interfaces.reduced import LayerTerm, ReducedInterfaceModel
from fenics_joints.reduction.affine import AffinePencil
from fenics_joints.reduction.reduced import ReducedStructure
from fenics_joints.structure.sparse import vectors_like
from fenics_joints.structure.structure import Structure

#: Places by name, and this rank's rows of their loads, (n_local, m).
Placed = tuple[Mapping[str, np.ndarray | None], np.ndarray]


def assemble(
    basis: np.ndarray,
    source: ReducedStructure,
    interfaces: Sequence[InterfacePoints],
    pencil: AffinePencil,
    layers: Mapping[str, LayerTerm],
    given: Mapping[str, float] | None,
    forces: Placed,
    sensors: Placed,
) -> ReducedInterfaceModel:
    """The model of a basis, at the parameters given. Collective.

    Args:
        basis: This rank's rows of the basis, (n_local, n).
        source: The structure in that basis, with its mesh.
        interfaces: Points with their strain rows in the basis.
        pencil: K without the interfaces' stress, and M, in the basis.
        layers: Strains of those interfaces that are layers, by name.
        given: Parameters that differ from their nominal value.
        forces: The forces and their loads.
        sensors: Those of the sensors.
    """
    comm = source.full.comm
    rows = [comm.allreduce(basis.T @ loads).T for _, loads in (forces, sensors)]
    identity = np.eye(basis.shape[1])  # until `at` puts in what the pencil is
    model = ReducedInterfaceModel(
        identity,
        identity,
        tuple(interfaces),
        forces=dict(zip(forces[0], rows[0], strict=True)),
        sensors=dict(zip(sensors[0], rows[1], strict=True)),
        pencil=pencil,
        layers=layers,
        given=dict(given or {}),
        scale_hz=source.scale_hz,
        places=sensors[0],
        source=source,
    )
    return model.at({})


def check_uniform(structure: Structure) -> None:
    """Refuse properties that vary in space, which no matrix of a parameter stands for.

    Raises:
        InputError: If there are any.
    """
    for region in structure.regions:
        if any(callable(p) for p in region.properties.values()):
            raise InputError(
                f"{region.name}: its properties vary in space; expected uniform ones in a model "
                "with nonlinear interfaces."
            )


def as_columns(vectors: Sequence[PETSc.Vec]) -> np.ndarray:
    """This rank's rows of vectors, (n_local, m)."""
    return np.column_stack([v.array_r for v in vectors])


def as_vectors(A: PETSc.Mat, columns: np.ndarray) -> list[PETSc.Vec]:
    """Columns of this rank's rows, (n_local, m), as vectors that a matrix can be applied to."""
    return vectors_like(A.createVecRight(), columns.T)
