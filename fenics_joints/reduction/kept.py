"""A reduced model of a structure in files, with its basis, for every test of that structure.

What a test brings by itself is not in them: its sensors, and the points where something may hang.
"""

from __future__ import annotations

import hashlib
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from petsc4py import PETSc

from fenics_joints.errors import InputError
from fenics_joints.files import write_arrays
from fenics_joints.parallel import on_root
from fenics_joints.reduction.arrays import ArrayModel
from fenics_joints.reduction.files import read_array_model, write_array_model
from fenics_joints.reduction.projection import Projection
from fenics_joints.structure import Sensors, Structure
from fenics_joints.structure.changes import PlacedPoint
from fenics_joints.structure.sparse import vectors_like

__all__ = ["KeptModel"]


class KeptModel:
    """The files of a reduced model: its matrices, and beside them its basis. Collective.

    A basis is of this rank's part of the mesh, so that only runs on one rank share it.

    Args:
        full: The full structure.
        file: The file of the matrices.
    """

    def __init__(self, full: Structure, file: Path):
        self.full, self.file = full, file

    def read(self, like: PETSc.Vec) -> tuple[ArrayModel, list[PETSc.Vec]] | None:
        """The model without what is a test's own, and its basis; None if they are not to be had.

        Args:
            like: A vector of the full model.
        """
        if self.full.comm.size > 1 or not (self.file.is_file() and self._basis_file.is_file()):
            return None
        try:
            model = read_array_model(self.file)
            with np.load(self._basis_file) as kept:
                basis, stamp = kept["basis"], str(kept["stamp"])
        except (OSError, ValueError, KeyError, EOFError, MemoryError, zipfile.BadZipFile, InputError):
            return None
        fits = basis.ndim == 2 and basis.shape == (model.n_dofs, like.getLocalSize())
        # Two runs that kept their models at a time may have left one's matrices, another's basis.
        if not fits or stamp != _stamp(model):
            return None
        return model, vectors_like(like, basis)

    def write(self, model: ArrayModel, basis: list[PETSc.Vec]) -> None:
        """Keep a model and its basis, on one rank."""
        if self.full.comm.size > 1:
            return
        own = {change.name for change in self.full.changes if isinstance(change, PlacedPoint)}
        regions = [region for region in model.regions if region.name not in own]
        lasting = ArrayModel(replace(model.pencil, regions=regions), model.scale_hz)
        on_root(self.full.comm, lambda: write_array_model(lasting, self.file))
        rows = np.array([vector.array_r for vector in basis])
        write_arrays(self._basis_file, basis=rows, stamp=np.array(_stamp(lasting)))

    def for_test(
        self, model: ArrayModel, basis: list[PETSc.Vec], sensors: Sensors | None
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

    @property
    def _basis_file(self) -> Path:
        return self.file.with_suffix(".npz")


def _stamp(model: ArrayModel) -> str:
    return hashlib.sha256(np.ascontiguousarray(model.regions[0].inertia).tobytes()).hexdigest()[:16]
