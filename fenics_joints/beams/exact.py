"""Beams in the service of a fit: exact, with the calls of `fenics_joints.surrogate.Surrogate`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fenics_joints.beams.structure import BeamStructure
from fenics_joints.gap import pair_modes
from fenics_joints.modal import Modes, solve_modes
from fenics_joints.points import Sensors
from fenics_joints.surrogate import Forward

__all__ = ["ExactBeams"]


class ExactBeams:
    """Frequencies of the modes that a test saw, without a reduction.

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
