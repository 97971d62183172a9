"""The view of an updated model's modes, beside what the test measured of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fenics_joints.beams import BeamStructure
from fenics_joints.case import Case
from fenics_joints.measurements import Target
from fenics_joints.modal.modes import Modes
from fenics_joints.reduction.frf_basis import paired
from fenics_joints.structure import Sensors, Structure


@dataclass(frozen=True, repr=False)
class UpdatedShapes:
    """Shapes of the updated model's modes that are the test's, m of them; on rank 0.

    Attributes:
        vertices: Corners of all cells, m, (n_cells, n_corners, 3).
        motions: How they move, kg^-1/2, (m, n_cells, n_corners, 3).
        frequencies_hz: Hz, (m,).
        sensors: Where shapes were measured, k of them; None where they were not.
        test: Measured shapes in the model's scale, (k, m), nan where a sensor was missing.
        model: The model's, (k, m).
    """

    vertices: np.ndarray
    motions: np.ndarray
    frequencies_hz: np.ndarray
    sensors: Sensors | None = None
    test: np.ndarray | None = None
    model: np.ndarray | None = None

    def __repr__(self) -> str:
        return f"UpdatedShapes({len(self.motions)} modes, {len(self.vertices)} cells)"


def updated_shapes(
    case: Case, full: Structure | BeamStructure, target: Target, modes: Modes
) -> UpdatedShapes | None:
    """Shapes of the modes that are the test's. Collective; None but on rank 0.

    Args:
        case: The case, whose measured shapes stand beside.
        full: The full model, whose cells are drawn.
        target: The test's data.
        modes: Modes of the updated model, in full.
    """
    if not len(target) or modes.model.n_dofs != full.n_dofs:
        return None
    pairing, test = paired(modes, target), case.measurements().shapes
    sensors = None if test is None else target.shape_sensors
    vectors = [modes.vector(int(i)) for i in pairing.index]
    vertices, motions = full.corner_motion(vectors)
    seen = None if test is None else modes.at(sensors)[:, pairing.index]
    if not len(vertices):
        return None
    hz = modes.frequencies_hz[pairing.index]
    if seen is None or sensors.points.shape[1] != 3:
        return UpdatedShapes(vertices, motions, hz)
    known = np.where(np.isnan(test), 0.0, test)
    scale = np.sum(known * seen, axis=0) / np.maximum(np.sum(known**2, axis=0), 1e-300)
    return UpdatedShapes(vertices, motions, hz, sensors, test * scale, seen)
