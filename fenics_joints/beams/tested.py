"""Beams in the service of a fit: exact, with the calls of the models that a solid's basis needs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fenics_joints.beams.structure import BeamStructure
from fenics_joints.measurements.gap import pair_modes
from fenics_joints.measurements.target import Target
from fenics_joints.modal.modes import Modes, solve_modes
from fenics_joints.reduction.arrays import ArrayModel
from fenics_joints.reduction.combined import ModelError, paired
from fenics_joints.reduction.forward import Forward
from fenics_joints.response.damping_ratios import damping_ratios
from fenics_joints.structure.damping import Damping
from fenics_joints.structure.points import Sensors

__all__ = ["ExactBeams", "ExactCombinedModel"]


class ExactBeams:
    """Frequencies of the modes that a test saw, as a `fenics_joints.reduction.surrogate.Surrogate`.

    Args:
        structure: The beams.
        start: Values whose modes say, by order and visibility, which the test's are.
        sensors: What the test saw; None takes elastic modes in order, axial ones too.
        n_test: Number of modes that the test saw.
        n_modes: Number of modes to compute.
        shapes: Measured shapes at the sensors, to match modes to by MAC.

    Attributes:
        model: The beams as arrays.
        forward: Frequencies and derivatives.
        crossings: Pairs of test modes whose order the model changes at the start.
    """

    def __init__(
        self,
        structure: BeamStructure,
        start: Mapping[str, float],
        *,
        sensors: Sensors | None,
        n_test: int,
        n_modes: int,
        shapes: np.ndarray | None = None,
    ):
        self.model = structure.arrays(sensors)
        count = min(max(n_modes, n_test), self.model.n_dofs)
        self.nominal = solve_modes(self.model, start, n_modes=count)
        self.pairing = pair_modes(self.nominal, n_test, sensors, reference=shapes)
        self.crossings: set[tuple[int, int]] = set(self.pairing.crossing)
        reference = self.pairing.shapes if shapes is None else shapes
        self.forward = Forward(self.model, sensors, n_test, count, reference)

    def error(self, points: Sequence[Mapping[str, float]]) -> tuple[float, list[Modes]]:
        """Largest relative error of the frequencies: none."""
        return 0.0, []

    def refine(self, modes: Sequence[Modes]) -> None:
        """Nothing to refine."""


class ExactCombinedModel:
    """Frequencies, shapes, damping ratios and functions, as a
    `fenics_joints.reduction.combined.CombinedModel`.

    Args:
        structure: The beams.
        target: The data.
        damping: The damping.
        n_modes: Number of modes to compute.

    Attributes:
        arrays: The beams as arrays.
        samples: How many samples it took: none.
    """

    samples = 0

    def __init__(self, structure: BeamStructure, target: Target, damping: Damping, n_modes: int):
        self.target, self.damping = target, damping
        self.n_modes = min(n_modes, structure.n_dofs)
        self.functions = target.frfs is not None
        places = [target.frfs.excitation, target.frfs.sensors] if self.functions else []
        self.arrays = structure.arrays(target.shape_sensors, *places)

    def build(self) -> ArrayModel:
        """The beams as arrays."""
        return self.arrays

    def modes(self, values: Mapping[str, float]) -> Modes:
        """Modes at some values."""
        return solve_modes(self.arrays, values, n_modes=self.n_modes)

    def ratios(self, values: Mapping[str, float], modes: Modes) -> np.ndarray | None:
        """Damping ratios of the modes that are the test's, (m,); None if they are no data."""
        if "damping" not in self.target.kinds:
            return None
        index = paired(modes, self.target).index
        return damping_ratios(self.arrays, values, self.damping, modes, index)[0]

    def error(self, values: Mapping[str, float], modes: Modes) -> ModelError:
        """Error of frequencies, ratios and functions: none."""
        ratios = 0.0 if "damping" in self.target.kinds else None
        return ModelError(0.0, 0.0 if self.functions else None, ratios)
