"""A reduced model of a structure with its basis, and modes, in a cache.

A file serves every test of that structure: it holds neither a test's sensors nor the points at
which the test's effects may attach something.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from fenics_joints.modal.eigensolver import EigenSolver
from fenics_joints.modal.modes import Modes, solve_modes
from fenics_joints.progress import Progress
from fenics_joints.reduction.affine import RegionTerm
from fenics_joints.reduction.arrays import ArrayModel
from fenics_joints.reduction.files import Cache, register
from fenics_joints.reduction.reduced import Projection
from fenics_joints.structure import Sensors, Structure
from fenics_joints.structure.changes import PlacedPoint
from fenics_joints.structure.node_keys import node_keys
from fenics_joints.structure.sparse import vectors_like


@dataclass(frozen=True, eq=False)
class KeptVectors:
    """Vectors of a structure, to be read by any number of ranks.

    Attributes:
        mesh: Digest of the structure's mesh.
        keys: Numbers by which nodes are known again, see `node_keys`, (n_nodes,).
        rows: Values, (k, n_nodes block).
    """

    mesh: str
    keys: np.ndarray
    rows: np.ndarray

    @staticmethod
    def of(full: Structure, vectors: Sequence[PETSc.Vec]) -> KeptVectors | None:
        """All ranks' parts on rank 0, None on the others. Collective."""
        rows = np.array([vector.array_r for vector in vectors])
        digest = full.tagged.digest
        parts = full.comm.gather((node_keys(full.V), rows))
        if parts is None:
            return None
        keys, rows = zip(*parts, strict=True)
        return KeptVectors(digest, np.concatenate(keys), np.concatenate(rows, axis=1))

    def on(self, full: Structure) -> list[PETSc.Vec] | None:
        """The vectors; None if they are of another mesh, or lack a node. Collective."""
        if full.tagged.digest != self.mesh:
            return None
        keys = node_keys(full.V)
        _, own, kept = np.intersect1d(keys, self.keys, return_indices=True)
        if not full.comm.allreduce(len(own) == len(keys), op=MPI.LAND):
            return None
        there = self.rows.reshape(len(self.rows), len(self.keys), -1)
        rows = np.empty((len(there), len(keys), there.shape[2]))
        rows[:, own] = there[:, kept]
        like = PETSc.Vec().createMPI((full.n_local, None), comm=full.comm)
        return vectors_like(like, rows.reshape(len(rows), -1))


@dataclass(frozen=True, eq=False)
class KeptModel:
    """A reduced model without what is a test's own, and its basis."""

    model: ArrayModel
    basis: KeptVectors


@dataclass(frozen=True, eq=False)
class KeptModes:
    """Modes at values of parameters, see `Modes`."""

    values: Mapping[str, float]
    eigenvalues: np.ndarray
    shapes: KeptVectors
    n_rigid: int


register(KeptVectors, KeptModel, KeptModes)


def read_reduced(
    full: Structure, cache: Cache, progress: Progress | None = None
) -> tuple[ArrayModel, list[PETSc.Vec]] | None:
    """The model that `write_reduced` kept, and its basis; None if it cannot be read. Collective.

    Args:
        full: The full structure.
        cache: Where it is.
        progress: See `Cache.read`.
    """
    kept = cache.read("model", KeptModel, progress)
    basis = None if kept is None else kept.basis.on(full)
    return None if basis is None else (kept.model, basis)


def write_reduced(
    full: Structure, cache: Cache, model: ArrayModel, basis: Sequence[PETSc.Vec]
) -> None:
    """Keep a reduced model and its basis. Collective."""
    regions = list(_lasting(full, model).values())
    lasting = ArrayModel(replace(model.pencil, regions=regions), model.scale_hz)
    cache.write("model", KeptModel(lasting, KeptVectors.of(full, basis)))


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
    new = {term.name: term for term in on.terms([c for c in own if c.name not in known])}
    regions = [known.get(each.name) or new[each.name] for each in own]
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
    cache: Cache | None = None,
    name: str = "modes",
    solver: EigenSolver | None = None,
) -> Modes:
    """Modes of a structure, read from a cache if they are there, otherwise solved for and kept
    there. Collective.

    Args:
        full: The structure.
        values: Values of parameters that differ from their nominal value.
        n_modes: Number of modes.
        cache: Where they are kept; None to solve and to keep nothing.
        name: Of the result in the cache.
        solver: See `solve_modes`.

    Returns:
        The modes; those that were read have no solver and no residuals.

    Raises:
        ConvergenceError: See `solve_modes`.
    """
    kept = None if cache is None else cache.read(name, KeptModes)
    if kept is not None and kept.values == values and len(kept.eigenvalues) == n_modes:
        shapes = kept.shapes.on(full)
        if shapes is not None:
            return Modes(full, dict(values), kept.eigenvalues, shapes, kept.n_rigid)
    found = solve_modes(full, values, n_modes=n_modes, solver=solver)
    if cache is not None:
        shapes = KeptVectors.of(full, found.shapes)
        cache.write(name, KeptModes(dict(values), found.eigenvalues, shapes, found.n_rigid))
    return found
