"""A reduced model of a structure in files, with its basis, for every test of that structure.

What a test brings by itself is not in them: its sensors, and the points where something may hang.
"""

from __future__ import annotations

import hashlib
import zipfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from fenics_joints._compat import geometry_dofmap
from fenics_joints.errors import InputError
from fenics_joints.files import write_arrays
from fenics_joints.parallel import on_root
from fenics_joints.reduction.arrays import ArrayModel
from fenics_joints.reduction.files import read_array_model, write_array_model
from fenics_joints.reduction.projection import Projection
from fenics_joints.structure import Sensors, Structure
from fenics_joints.structure.changes import PlacedPoint
from fenics_joints.structure.sparse import vectors_like

__all__ = ["KeptModel", "read_vectors", "write_vectors"]

#: Digits of a node's place, relative to the body, by which it is known again.
_DIGITS = 9


class KeptModel:
    """The files of a reduced model: its matrices, and beside them its basis, each rank's part of
    it. Collective.

    Args:
        full: The full structure.
        file: The file of the matrices.
    """

    def __init__(self, full: Structure, file: Path):
        self.full, self.file = full, file

    def read(self) -> tuple[ArrayModel, list[PETSc.Vec]] | None:
        """The model without what is a test's own, and its basis; None if they are not to be had, or
        were kept by another number of ranks."""
        comm, model = self.full.comm, None
        if comm.bcast(self.file.is_file()):
            try:
                model = read_array_model(self.file)
            except (InputError, MemoryError):
                pass
        # Two runs that kept their models at a time may have left one's matrices, another's basis.
        stamp = "" if model is None else _stamp(model)
        basis = read_vectors(self.full, self.file, stamp)
        if model is None or basis is None or len(basis) != model.n_dofs:
            return None
        return model, basis

    def write(self, model: ArrayModel, basis: Sequence[PETSc.Vec]) -> None:
        """Keep a model and its basis."""
        own = {change.name for change in self.full.changes if isinstance(change, PlacedPoint)}
        regions = [region for region in model.regions if region.name not in own]
        lasting = ArrayModel(replace(model.pencil, regions=regions), model.scale_hz)
        on_root(self.full.comm, lambda: write_array_model(lasting, self.file))
        write_vectors(self.full, self.file, basis, _stamp(lasting))

    def for_test(
        self, model: ArrayModel, basis: Sequence[PETSc.Vec], sensors: Sensors | None
    ) -> ArrayModel:
        """A model that was read, with the test's sensors and points.

        Args:
            model: From `read`.
            basis: Likewise.
            sensors: What the test saw.
        """
        on, known = Projection(self.full, basis), {r.name: r for r in model.regions}
        full = self.full
        own = [*full.regions, *full.elastic_supports, *full.changes]
        regions = [known[each.name] if each.name in known else on.change(each) for each in own]
        pencil = replace(model.pencil, parameters=full.parameters, regions=regions)
        return ArrayModel(pencil, model.scale_hz, *on.sensors(sensors))


def write_vectors(
    full: Structure, file: Path, vectors: Sequence[PETSc.Vec], stamp: str, **more: np.ndarray
) -> None:
    """Keep vectors of a structure, each rank its part. Collective.

    Args:
        full: The structure.
        file: A file beside which they go, in one named by this rank.
        vectors: The vectors.
        stamp: What they belong to.
        more: Further arrays.
    """
    rows = np.array([vector.array_r for vector in vectors])
    write_arrays(
        _of_rank(full, file), rows=rows, stamp=np.array(f"{stamp} {_layout(full)}"), **more
    )


def read_vectors(
    full: Structure, file: Path, stamp: str, more: dict[str, np.ndarray] | None = None
) -> list[PETSc.Vec] | None:
    """What `write_vectors` kept; None if it is not there, or of another layout. Collective.

    Args:
        full: The structure.
        file: See `write_vectors`.
        stamp: Likewise.
        more: Gets the further arrays.
    """
    rows, found = None, {}
    try:
        with np.load(_of_rank(full, file)) as kept:
            if str(kept["stamp"]) == f"{stamp} {_layout(full)}":
                found = {name: kept[name] for name in kept.files}
                rows = found.pop("rows")
    except (OSError, ValueError, KeyError, EOFError, MemoryError, zipfile.BadZipFile):
        pass
    good = rows is not None and rows.ndim == 2 and rows.shape[1] == full.n_local
    if not full.comm.allreduce(good, op=MPI.LAND):
        return None
    if more is not None:
        more |= found
    return vectors_like(PETSc.Vec().createMPI((full.n_local, None), comm=full.comm), rows)


def _of_rank(full: Structure, file: Path) -> Path:
    comm = full.comm
    rank = "" if comm.size == 1 else f"-{comm.rank + 1}of{comm.size}"
    return file.with_name(f"{file.stem}{rank}.npz")


def _layout(full: Structure) -> str:
    """Which degrees of freedom this rank has, in which order: a mesh is parted anew each time."""
    x = full.mesh.geometry.x
    size = max(float(np.abs(x).max(initial=0.0)), 1e-300)
    found = hashlib.sha256((np.round(x / size, _DIGITS) + 0.0).tobytes())
    for numbers in (geometry_dofmap(full.mesh), full.V.dofmap.list):
        found.update(np.ascontiguousarray(numbers, dtype=np.int64).tobytes())
    return found.hexdigest()[:16]


def _stamp(model: ArrayModel) -> str:
    return hashlib.sha256(np.ascontiguousarray(model.regions[0].inertia).tobytes()).hexdigest()[:16]
