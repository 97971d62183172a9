"""The reduced model in the loop of a combined update, made better where it turns out to be off."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fenics_joints.array_model import ArrayModel
from fenics_joints.damped_pencil import DampedPencil, point_loads
from fenics_joints.damping import Damping
from fenics_joints.frf_basis import frf_error
from fenics_joints.frf_modal import modal_pencil
from fenics_joints.gap import pair_modes
from fenics_joints.modal import Modes, solve_modes
from fenics_joints.reduction import ReducedStructure
from fenics_joints.snapshots import SNAPSHOT, Snapshots
from fenics_joints.structure import Structure
from fenics_joints.updating_data import Target

__all__ = ["CombinedModel", "ModelError"]

#: Share of the largest energy below which a direction is left out of the basis: at first, and by
#: which factor it falls when the model is bettered.
_BASIS, _FINER = 1e-5, 0.03
#: Lines at which functions are checked against the direct solution.
_CHECKED = 6


@dataclass(frozen=True)
class ModelError:
    """Error of the reduced model at some values against the full one.

    Attributes:
        frequencies: Largest relative error of the paired frequencies; 0 without any.
        frfs: Largest |H - H_full| / |H_full| over the lines that were checked; None without.
    """

    frequencies: float
    frfs: float | None


class CombinedModel:
    """A reduced model for the frequencies, shapes and functions of a target. Collective.

    Its basis holds modes and, for functions, residual vectors of their forces, sensors and damped
    layers, at samples of the parameters; more samples can be added.

    Args:
        full: The full model.
        target: The data.
        damping: The damping, its values numbers or parameters.
        n_modes: Modes of the full model at a sample.

    Attributes:
        arrays: The reduced model as it is now.
        samples: How many samples are in it.
    """

    def __init__(self, full: Structure, target: Target, damping: Damping, n_modes: int):
        self.full, self.target, self.damping, self.n_modes = full, target, damping, n_modes
        self.samples, self._tolerance = 0, _BASIS
        self.arrays: ArrayModel | None = None
        self._snapshots = Snapshots(full)
        self._solver = self._exact = None
        frfs = target.frfs
        self._loads = None
        if frfs is not None:
            self._loads = np.hstack([
                point_loads(full, frfs.excitation, "excitation"), point_loads(full, frfs.sensors),
            ])  # fmt: skip

    def add(self, values: Mapping[str, float]) -> None:
        """Take the modes and residual vectors at some values into the basis of the next `build`."""
        modes = self._modes(values, SNAPSHOT)
        more = None
        if self._loads is not None:
            pencil = DampedPencil(self.full, values, self.damping)
            try:
                lines = self.target.frfs.frequencies_hz
                modal = modal_pencil(pencil, self._loads, lines, modes=modes)
            finally:
                pencil.destroy()
            more = modal.basis[:, len(modes) :]
        self._snapshots.add(modes, more=more)
        self.samples += 1

    def _modes(self, values, tolerance: float = 1e-7) -> Modes:
        modes = solve_modes(
            self.full, values, n_modes=self.n_modes, solver=self._solver, tolerance=tolerance
        )
        self._solver = modes.solver
        return modes

    def build(self) -> ArrayModel:
        """The reduced model on all samples so far."""
        places, target = [], self.target
        if target.shape_sensors is not None:
            places.append(target.shape_sensors)
        if target.frfs is not None:
            places += [target.frfs.excitation, target.frfs.sensors]
        reduced = ReducedStructure(self.full, self._snapshots.basis(self._tolerance))
        self.arrays = reduced.arrays(*places)
        return self.arrays

    def better(self, values: Mapping[str, float]) -> ArrayModel:
        """The reduced model with one more sample, and with directions of less energy."""
        self.add(values)
        self._tolerance *= _FINER
        return self.build()

    def modes(self, values: Mapping[str, float]) -> Modes:
        """Modes of the full model."""
        modes = solve_modes(self.full, values, n_modes=self.n_modes, solver=self._exact)
        self._exact = modes.solver
        return modes

    def error(self, values: Mapping[str, float], modes: Modes) -> ModelError:
        """Error of the reduced model.

        Args:
            values: Values of the parameters.
            modes: Modes of the full model there.
        """
        frequencies, target = 0.0, self.target
        if len(target):
            own = solve_modes(self.arrays, values, n_modes=min(self.n_modes, self.arrays.n_dofs))
            ours, theirs = (
                m.frequencies_hz[pair_modes(
                    m, len(target), target.shape_sensors, reference=target.shapes
                ).index]
                for m in (own, modes)
            )  # fmt: skip
            frequencies = float(np.max(np.abs(ours / theirs - 1)))
        if target.frfs is None:
            return ModelError(frequencies, None)
        found = frf_error(
            self.arrays, self.full, [values], frequencies_hz=target.frfs.frequencies_hz,
            excitation=target.frfs.excitation, sensors=target.frfs.sensors, damping=self.damping,
            lines=_CHECKED,
        )  # fmt: skip
        return ModelError(frequencies, found.worst)
