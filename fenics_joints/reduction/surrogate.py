"""A reduced model in the service of a fit: built, asked for frequencies, checked, improved."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from petsc4py import PETSc

from fenics_joints._compat import geometry_dofmap
from fenics_joints.files import write_arrays
from fenics_joints.measurements.gap import pair_modes
from fenics_joints.modal.modes import Modes, solve_modes
from fenics_joints.parallel import on_root
from fenics_joints.progress import Progress
from fenics_joints.reduction.arrays import ArrayModel
from fenics_joints.reduction.files import read_array_model, write_array_model
from fenics_joints.reduction.forward import SPARE, Forward, line_of
from fenics_joints.reduction.reduced import ReducedStructure, enrich, reduce
from fenics_joints.structure.points import Sensors
from fenics_joints.structure.structure import Structure

__all__ = ["Surrogate", "crossing_names"]

#: Least visibility of a mode that enters the basis.
_SEEN = 0.05
#: Share of the largest energy below which a direction is left out of the basis.
_BASIS = 1e-6


class Surrogate:
    """A parametric reduced model of what a test sees, with its error under control.

    Args:
        full: The full structure.
        samples: Parameter values at which its modes make the basis.
        start: Values whose modes say, by order and visibility, which the test's are.
        sensors: What the test saw.
        shapes: Measured shapes at the sensors, (n_sensors, n_test), to match modes to by MAC; the
            shapes at ``start`` take their place where there are none.
        n_test: Number of modes that the test saw.
        n_modes: Number of modes of the full model at a sample.
        travel: Ranges of moving masses, see `ReducedStructure`.
        keep: File of the reduced model: read if it is there, else written; None for neither.
        progress: Told after each sample.

    Attributes:
        forward: Frequencies and derivatives from the reduced model.
        nominal: Modes of the full model at ``start``.
        pairing: Which of them the test saw.
        crossings: Pairs of test modes whose order the model changes, where it was checked.
    """

    #: Motions that a test may not see.
    unseen = "torsion, in-plane motion"
    #: What `error` does.
    checking = "checking the reduced model against the full one"

    def __init__(
        self,
        full: Structure,
        samples: Sequence[Mapping[str, float]],
        start: Mapping[str, float],
        *,
        sensors: Sensors | None,
        n_test: int,
        n_modes: int,
        shapes: np.ndarray | None = None,
        travel: Mapping[str, tuple[float, float]] | None = None,
        keep: Path | None = None,
        progress: Progress | None = None,
    ):
        self.samples, self.progress, self.keep = samples, progress, keep
        self.full, self.sensors, self.n_test = full, sensors, n_test
        self.n_modes, self.travel = n_modes, travel
        self.nominal = solve_modes(full, start, n_modes=n_modes)
        self.pairing = pair_modes(self.nominal, n_test, sensors, reference=shapes)
        self.crossings: set[tuple[int, int]] = set(self.pairing.crossing)
        self._reduced: ReducedStructure | None = None
        kept = keep is not None and full.comm.bcast(keep.is_file() if full.comm.rank == 0 else None)
        self.model = read_array_model(keep) if kept else self._arrays(self._reduce())
        if keep is not None and not kept:
            self._write()
        # With sensors the basis holds what they see alone, besides six rigid-body modes.
        enough = n_modes if sensors is None else 6 + 3 * n_test + SPARE
        reference = self.pairing.shapes if shapes is None else shapes
        self.forward = Forward(self.model, sensors, n_test, enough, reference)

    def _seen(self, modes: Modes) -> np.ndarray:
        index = np.arange(len(modes))
        if self.sensors is None:
            return index
        elastic = index[modes.n_rigid :]
        seen = elastic[modes.visibility(self.sensors)[modes.n_rigid :] > _SEEN]
        return np.concatenate([index[: modes.n_rigid], seen[: self.n_test + SPARE]])

    def error(self, points: Sequence[Mapping[str, float]]) -> tuple[float, list[Modes]]:
        """Largest relative frequency error against the full model, and its modes there."""
        worst, found = 0.0, []
        for values in points:
            modes = solve_modes(
                self.full, values, n_modes=self.n_modes, solver=self.nominal.solver
            )
            pairing = pair_modes(
                modes, self.n_test, self.sensors, reference=self.forward.reference
            )
            self.crossings.update(pairing.crossing)
            exact = np.log(modes.frequencies_hz[pairing.index])
            worst = max(worst, float(np.max(np.abs(self.forward(values)[0] - exact))))
            found.append(modes)
        return worst, found

    def refine(self, modes: Sequence[Modes]) -> None:
        """Take further modes of the full model into the basis."""
        shapes = [m.shape(int(i)) for m in modes for i in self._seen(m)]
        basis = self._kept_basis() if self._reduced is None else self._reduced.basis
        if basis is None:
            basis = self._reduce().basis
        self._reduced = enrich(self.full, basis, shapes, self.travel)
        self.model = self.forward.model = self._arrays(self._reduced)
        self.forward.forget()

    def facts(self, n_samples: int) -> dict[str, object]:
        """Its size and use.

        Args:
            n_samples: Number of samples that it was made from.
        """
        return {
            "dofs": self.full.n_dofs, "basis": self.model.n_dofs, "samples": n_samples,
            "reduced_solutions": self.forward.calls,
        }  # fmt: skip

    def wide(self, points: Sequence[Mapping[str, float]]) -> ReducedStructure:
        """A reduced model with all modes, whether the test sees them or not. Collective.

        Args:
            points: Parameter values at which its modes make the basis.
        """
        return reduce(self.full, points, self.n_modes, travel=self.travel)

    def point_rows(self, model: ReducedStructure, points: np.ndarray) -> np.ndarray:
        """Displacement of a model's basis at points, shape (n_points, gdim, n_dofs)."""
        return model.point_rows(points)

    def everywhere(self, count: int) -> Sensors:
        """Points all over the structure, each in all directions. Collective."""
        full, msh = self.full, self.full.mesh
        owned = msh.topology.index_map(msh.topology.dim).size_local
        middles = msh.geometry.x[geometry_dofmap(msh)[:owned]].mean(axis=1)
        middles = np.concatenate(msh.comm.allgather(middles))[:, : full.gdim]
        middles = middles[np.lexsort(np.round(middles, 9).T)]
        chosen = [0]
        away = np.linalg.norm(middles - middles[0], axis=1)
        while len(chosen) < min(count, len(middles)):
            chosen.append(int(np.argmax(np.round(away, 9))))
            away = np.minimum(away, np.linalg.norm(middles - middles[chosen[-1]], axis=1))
        points = np.repeat(middles[chosen], full.gdim, axis=0)
        return Sensors(points, np.tile(np.eye(full.gdim), (len(chosen), 1)))

    def _reduce(self) -> ReducedStructure:
        """The reduced model on the modes at the samples."""
        self._reduced = reduce(
            self.full, self.samples, self.n_modes, travel=self.travel, keep=self._seen,
            tolerance=_BASIS, progress=self.progress.advance if self.progress else None,
        )  # fmt: skip
        return self._reduced

    def _write(self) -> None:
        """Keep the model, and on one rank, whose part of the mesh is the same again, its basis."""
        comm = self.full.comm
        on_root(comm, lambda: write_array_model(self.model, self.keep))
        if comm.size == 1:
            basis = np.array([vector.array_r for vector in self._reduced.basis])
            write_arrays(self.keep.with_suffix(".npz"), basis=basis)

    def _kept_basis(self) -> list[PETSc.Vec] | None:
        """The basis from its file, if it can be had."""
        file = None if self.keep is None else self.keep.with_suffix(".npz")
        if file is None or self.full.comm.size > 1 or not file.is_file():
            return None
        try:
            with np.load(file) as kept:
                basis = kept["basis"]
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
            return None
        if basis.ndim != 2 or basis.shape[1] != self.nominal.shape(0).getLocalSize():
            return None
        vectors = []
        for row in basis:
            vector = self.nominal.shape(0).duplicate()
            vector.array[:] = row
            vectors.append(vector)
        return vectors

    def _arrays(self, model: ReducedStructure) -> ArrayModel:
        """The same model as plain arrays."""
        rows = shifts = None
        if self.sensors is not None:
            rows = self.full.observe(model.basis, self.sensors)
            line = line_of(self.sensors.points)
            shifts = self.full.observe_slopes(model.basis, self.sensors, line)
        return ArrayModel(model.affine, model.scale_hz, rows, shifts)


def crossing_names(surrogate: Surrogate, mode_names: Sequence[str]) -> list[str]:
    """Pairs of test modes that were seen to change places, in words; they were followed by MAC."""
    return [f"{mode_names[i]} and {mode_names[j]}" for i, j in sorted(surrogate.crossings)]
