"""A reduced model in the service of a fit: built, asked for frequencies, checked, improved."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from petsc4py import PETSc

from fenics_joints.files import write_arrays
from fenics_joints.measurements.gap import largest_difference
from fenics_joints.modal.modes import Modes, solve_modes
from fenics_joints.parallel import on_root
from fenics_joints.progress import Progress
from fenics_joints.reduction.adaptive import Points
from fenics_joints.reduction.arrays import ArrayModel
from fenics_joints.reduction.files import read_array_model, write_array_model
from fenics_joints.reduction.reduced import ReducedStructure, reduce
from fenics_joints.reduction.sampled import SampledBasis
from fenics_joints.reduction.seen import SeenModes, places_all_over
from fenics_joints.reduction.snapshots import SNAPSHOT, orthonormal
from fenics_joints.structure import Sensors, Structure
from fenics_joints.structure.sparse import vectors_like

__all__ = ["Surrogate"]

#: Share of a mode's energy at a sample that the basis may lack: 1e-4 of its frequency, well below
#: what tests can see.
_LACKING = 2e-4
#: Share of the largest energy below which a combination of the basis's vectors is round-off.
_DEPENDENT = 1e-13


class Surrogate(SeenModes):
    """A parametric reduced model of what a test sees, with its error under control. Collective.

    Args:
        full: The full structure.
        start: See `SeenModes`.
        samples: Gives the parameter values at which its modes make the basis.
        travel: Gives the ranges of moving masses, see `ReducedStructure`.
        by_order: Of beams, see `fenics_joints.beams.tested.ExactModes`.
        keep: Gives the file of the reduced model for these samples: read if it is there, else
            written; None for neither.
        progress: Told what is being done, and after each sample.
        given: See `SeenModes`.
    """

    tolerance = SNAPSHOT

    def __init__(
        self,
        full: Structure,
        start: Mapping[str, float],
        *,
        samples: Callable[[], Points],
        travel: Callable[[], Mapping[str, tuple[float, float]]] | None = None,
        keep: Callable[[Points], Path] | None = None,
        progress: Progress | None = None,
        by_order: bool = False,
        **given,
    ):
        self.samples, self.travel = samples(), travel and travel()
        self.progress = progress or Progress(silent=True)
        self.n_samples, self.keep = len(self.samples), keep and keep(self.samples)
        self.progress.step("reduced model: sampling the parameters", self.n_samples)
        super().__init__(full, start, **given)
        self._basis: list[PETSc.Vec] | None = None
        keep = self.keep
        kept = keep is not None and full.comm.bcast(keep.is_file() if full.comm.rank == 0 else None)
        model = read_array_model(keep) if kept else self._reduce()
        if keep is not None and not kept:
            self._write(model)
        self.forward = self._forward(model)

    def _in_basis(self, modes: Modes) -> np.ndarray:
        return np.concatenate([np.arange(modes.n_rigid), self._seen(modes)])

    def errors(self, points: Points) -> np.ndarray:
        """Largest relative frequency error against the full model at each point, (n,).

        See `fenics_joints.measurements.gap.largest_difference`.

        Raises:
            InputError: If either lacks a mode that the test saw.
        """
        # Others are let go: they hold vectors of the full model's size.
        wanted = {tuple(values.items()) for values in points}
        self._solved = {key: m for key, m in self._solved.items() if key in wanted}
        errors = np.array([
            largest_difference(*self.forward.solve(values), *self._paired(values), self.sensors)
            for values in points
        ])  # fmt: skip
        # Every rank has to take the same way from here.
        return self.full.comm.bcast(errors)

    def extend(self, points: Points) -> None:
        """Take modes of the full model into the basis."""
        solved = [self.solve(values) for values in points]
        if self._basis is None:
            self._basis = self._kept_basis()
        if self._basis is None:
            self.forward.model = self._reduce()
        known = self.forward.model
        sampled = SampledBasis(_LACKING, self._basis, known)
        for modes in solved:
            sampled.add(modes, self._in_basis(modes))
        self.forward.model = self._on(sampled, known)
        self.forward.forget()

    def facts(self) -> dict[str, object]:
        """Its size and use."""
        return {
            "dofs": self.full.n_dofs, "basis": self.model.n_dofs, "samples": self.n_samples,
            "reduced_solutions": self.forward.calls,
        }  # fmt: skip

    def wide(self, points: Points) -> ReducedStructure:
        """A reduced model with all modes, whether the test sees them or not. Collective.

        Args:
            points: Parameter values at which its modes make the basis.
        """
        return reduce(self.full, points, self.n_modes, travel=self.travel)

    def point_rows(self, model: ReducedStructure, points: np.ndarray) -> np.ndarray:
        """Displacement of a model's basis at points, shape (n_points, gdim, n_dofs)."""
        return model.projection.points(points)

    def everywhere(self, count: int) -> Sensors:
        """Points all over the structure, each in all directions. Collective."""
        return places_all_over(self.full, count)

    def _reduce(self) -> ArrayModel:
        """The reduced model on the modes at the samples."""
        sampled, solver = SampledBasis(_LACKING), None
        for values in self.samples:
            modes = solve_modes(
                self.full, values, n_modes=self.n_modes, solver=solver, tolerance=SNAPSHOT
            )
            solver = modes.solver
            sampled.add(modes, self._in_basis(modes), just_solved=True)
            self.progress.advance()
        if solver is not None:
            self._solver = solver  # as accurate as a check needs
        return self._on(sampled)

    def _on(self, sampled: SampledBasis, known: ArrayModel | None = None) -> ArrayModel:
        """The reduced model on a basis, made orthonormal; of the first of its vectors it may be
        known."""
        n = 0 if known is None else known.n_dofs
        self._basis = orthonormal(
            self.full, sampled.vectors, self.samples[0], _DEPENDENT, n, known=known
        )
        if known is not None and len(self._basis) == n:
            return known
        reduced = ReducedStructure(self.full, self._basis, self.travel, known)
        return reduced.arrays(sensors=self.sensors)

    def _write(self, model: ArrayModel) -> None:
        """Keep the model, and on one rank, whose part of the mesh is the same again, its basis."""
        comm = self.full.comm
        on_root(comm, lambda: write_array_model(model, self.keep))
        if comm.size == 1:
            basis = np.array([vector.array_r for vector in self._basis])
            write_arrays(self.keep.with_suffix(".npz"), basis=basis)

    def _kept_basis(self) -> list[PETSc.Vec] | None:
        """The basis from its file, if it can be had."""
        file = None if self.keep is None else self.keep.with_suffix(".npz")
        if file is None or self.full.comm.size > 1 or not file.is_file():
            return None
        try:
            with np.load(file) as kept:
                basis = kept["basis"]
        except (OSError, ValueError, KeyError, EOFError, MemoryError, zipfile.BadZipFile):
            return None
        if basis.ndim != 2 or basis.shape[1] != self.nominal.vector(0).getLocalSize():
            return None
        return vectors_like(self.nominal.vector(0), basis)
