"""A reduced model of a structure in files, with its basis, for every test of that structure.

What a test brings by itself is not in them: its sensors, and the points where something may hang.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from fenics_joints.errors import InputError
from fenics_joints.files import read_arrays, write_arrays
from fenics_joints.modal.eigensolver import EigenSolver
from fenics_joints.modal.modes import Modes, solve_modes
from fenics_joints.parallel import on_root
from fenics_joints.reduction.affine import RegionTerm
from fenics_joints.reduction.arrays import ArrayModel
from fenics_joints.reduction.files import ARRAYS, read_model, write_model
from fenics_joints.reduction.reduced import Projection
from fenics_joints.structure import Sensors, Structure
from fenics_joints.structure.changes import PlacedPoint
from fenics_joints.structure.node_keys import node_keys
from fenics_joints.structure.sparse import vectors_like


class KeptModel:
    """The files of a reduced model: its matrices, and beside them its basis, each rank's part of
    it, to be read by any number of ranks. Collective.

    Args:
        full: The full structure.
        file: The file of the matrices; its name is part of the model's digest.

    Attributes:
        reason: Why `read` gave nothing although the file exists; else empty.
    """

    def __init__(self, full: Structure, file: Path):
        self.full, self.file, self.reason = full, file, ""
        self._made = f"{file.name} {full.tagged.digest}"

    def read(self) -> tuple[ArrayModel, list[PETSc.Vec]] | None:
        """The model without what is a test's own, and its basis; None if they are not to be had."""
        if not self.full.comm.bcast(self.file.is_file()):
            return None
        model, stamp = None, ""
        try:
            model, stamp = read_model(self.file, ARRAYS, ArrayModel, self._made), self._stamp()
        except (InputError, OSError) as error:
            self.reason = str(error)
        # Two runs that kept their models at a time may have left one's matrices, another's basis.
        basis = read_vectors(self.full, self.file, stamp)
        if model is None or basis is None or len(basis) != model.n_dofs:
            self.reason = self.reason or f"{self.file}: the files of its basis are incomplete"
            return None
        return model, basis

    def write(self, model: ArrayModel, basis: Sequence[PETSc.Vec]) -> None:
        """Keep a model and its basis."""
        regions = list(_lasting(self.full, model).values())
        lasting = ArrayModel(replace(model.pencil, regions=regions), model.scale_hz)

        def written() -> str:
            write_model(lasting, self.file, ARRAYS, self._made)
            return self._stamp()

        comm = self.full.comm
        write_vectors(self.full, self.file, basis, comm.bcast(on_root(comm, written)))

    def _stamp(self) -> str:
        """The digest at the end of the file of matrices, which the files of its basis repeat."""
        with self.file.open("rb") as file:
            file.seek(-64, os.SEEK_END)
            return file.read().decode()


def for_test(
    full: Structure, model: ArrayModel, basis: Sequence[PETSc.Vec], sensors: Sensors | None
) -> ArrayModel:
    """A model with a test's sensors and points, to the last bit the same whether it was just made
    or read. Collective.

    Args:
        full: The full structure.
        model: Its reduced model.
        basis: Of the model.
        sensors: What the test saw.
    """
    on, known = Projection(full, basis), _lasting(full, model)
    own = [*full.regions, *full.elastic_supports, *on.changes]
    regions = [known[each.name] if each.name in known else on.change(each) for each in own]
    pencil = replace(model.pencil, parameters=full.parameters, regions=regions)
    return ArrayModel(pencil, model.scale_hz, *on.sensors(sensors))


def _lasting(full: Structure, model: ArrayModel) -> dict[str, RegionTerm]:
    """The regions that are no test's own, by name."""
    own = {change.name for change in full.changes if isinstance(change, PlacedPoint)}
    return {region.name: region for region in model.regions if region.name not in own}


def kept_modes(
    full: Structure,
    values: Mapping[str, float],
    n_modes: int,
    file: Path | None = None,
    solver: EigenSolver | None = None,
) -> Modes:
    """Modes of a structure, read from a file if they are there, else solved for and written to it.
    Collective.

    Args:
        full: The structure.
        values: Values of parameters that differ from their nominal value.
        n_modes: Number of modes.
        file: The file; its name is part of the digest. None to solve and to keep nothing.
        solver: See `solve_modes`.

    Returns:
        The modes; those that were read have no solver and no residuals.

    Raises:
        ConvergenceError: See `solve_modes`.
    """
    if file is None:
        return solve_modes(full, values, n_modes=n_modes, solver=solver)
    at = hashlib.sha256(repr(sorted(values.items())).encode()).hexdigest()
    made, more = f"{file.name} {full.tagged.digest} {at}", {}
    shapes = read_vectors(full, file, made, more)
    squares, rigid = more.get("eigenvalues"), more.get("n_rigid")
    counted = squares is not None and rigid is not None
    if shapes is not None and counted and len(squares) == len(shapes) == n_modes:
        return Modes(full, dict(values), squares, shapes, int(rigid))
    found = solve_modes(full, values, n_modes=n_modes, solver=solver)
    write_vectors(
        full,
        file,
        found.shapes,
        made,
        eigenvalues=found.eigenvalues,
        n_rigid=np.array(found.n_rigid),
    )
    return found


def write_vectors(
    full: Structure, file: Path, vectors: Sequence[PETSc.Vec], stamp: str, **more: np.ndarray
) -> None:
    """Keep vectors of a structure, each rank its part; those that other ranks kept in this file's
    name go. Collective.

    Args:
        full: The structure.
        file: A file beside which they go, in one named by this rank.
        vectors: The vectors.
        stamp: What they belong to.
        more: Further arrays, equal on all ranks.
    """
    rows = np.array([vector.array_r for vector in vectors])
    keys, mine = node_keys(full.V), _of_rank(full, file)
    write_arrays(mine, rows=rows, keys=keys, stamp=np.array(stamp), **more)
    written = set(full.comm.allgather(mine.name))
    on_root(
        full.comm,
        lambda: [path.unlink(missing_ok=True) for path in _parts(file) if path.name not in written],
    )


def read_vectors(
    full: Structure, file: Path, stamp: str, more: dict[str, np.ndarray] | None = None
) -> list[PETSc.Vec] | None:
    """What `write_vectors` kept, on whichever ranks; None if it is not there. Collective.

    Args:
        full: The structure.
        file: See `write_vectors`.
        stamp: Likewise.
        more: Gets the further arrays.
    """
    keys, rows, found = node_keys(full.V), None, {}
    for path in _parts(file):
        try:
            kept = read_arrays(path)
            if str(kept.pop("stamp")) == stamp:
                rows = _taken(rows, keys, kept.pop("keys"), kept.pop("rows"))
                found |= kept
        except (InputError, KeyError):
            continue
    good = rows is not None and not np.isnan(rows).any()
    if not full.comm.allreduce(good, op=MPI.LAND):
        return None
    if more is not None:
        more |= found
    rows = rows.reshape(len(rows), -1)
    return vectors_like(PETSc.Vec().createMPI((full.n_local, None), comm=full.comm), rows)


def _taken(
    rows: np.ndarray | None, keys: np.ndarray, theirs: np.ndarray, kept: np.ndarray
) -> np.ndarray:
    """This rank's part of vectors, (k, n_nodes, block), with what a file has of it; nan elsewhere.

    Args:
        rows: What there is of it by now, or None.
        keys: Its nodes', (n_nodes,).
        theirs: The file's nodes', (n_theirs,).
        kept: The file's part, (k, n_theirs block).
    """
    kept = kept.reshape(len(kept), len(theirs), -1)
    if rows is None:
        rows = np.full((len(kept), len(keys), kept.shape[2]), np.nan)
    _, own, at = np.intersect1d(keys, theirs, return_indices=True)
    rows[:, own] = kept[:, at]
    return rows


def _of_rank(full: Structure, file: Path) -> Path:
    comm = full.comm
    rank = "" if comm.size == 1 else f"-{comm.rank + 1}of{comm.size}"
    return file.with_name(f"{file.stem}{rank}.npz")


def _parts(file: Path) -> list[Path]:
    """Files of vectors, kept by any number of ranks."""
    name = re.compile(re.escape(file.stem) + r"(-\d+of\d+)?\.npz")
    return sorted(path for path in file.parent.glob("*.npz") if name.fullmatch(path.name))
