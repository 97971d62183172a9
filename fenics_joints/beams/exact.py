"""A structure that needs no reduction, in the service of a fit as `Surrogate` is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fenics_joints.beams.structure import BeamStructure
from fenics_joints.measurements.gap import VISIBLE, pair_modes
from fenics_joints.modal.modes import Modes, solve_modes
from fenics_joints.reduction.arrays import ArrayModel
from fenics_joints.reduction.forward import Forward
from fenics_joints.structure.points import Sensors

__all__ = ["ExactModel"]

#: How much less visible a mode may become than the least visible one of the test's.
_CLEAR = 10.0


class ExactModel:
    """Beams in the service of a fit, with the calls of a `Surrogate` and no error.

    Args:
        full: The beams.
        start: Values whose modes say, by order and visibility, which the test's are.
        sensors: What the test saw.
        n_test: Number of modes that the test saw.
        n_modes: Number of modes that are looked through.
        shapes: Measured shapes at the sensors, (n_sensors, n_test), to match modes to by MAC.

    Attributes:
        model: The same as plain arrays.
        forward: Frequencies and derivatives.
        nominal: Modes at ``start``.
        pairing: Which of them the test saw.
        crossings: Pairs of test modes whose order the model changes, where it was looked.
    """

    #: Motions that a test may not see, of those that beams in a plane have.
    unseen = "motion along the beams"
    #: What `error` does.
    checking = "looking which modes change places"

    def __init__(
        self,
        full: BeamStructure,
        start: Mapping[str, float],
        *,
        sensors: Sensors | None,
        n_test: int,
        n_modes: int,
        shapes: np.ndarray | None = None,
    ):
        self.full, self.sensors, self.n_test = full, sensors, n_test
        self.n_modes, self.travel = n_modes, {}
        self.model = full.arrays(sensors)
        self.nominal = solve_modes(full, start, n_modes=n_modes)
        self.pairing = pair_modes(self.nominal, n_test, sensors, reference=shapes)
        self.crossings: set[tuple[int, int]] = set(self.pairing.crossing)
        # Without measured shapes modes go by their order, as the test's names of them do: in one
        # plane they do not cross but veer, and by the nominal shapes one along the beams, which
        # shows little, would be taken for any other.
        self.forward = Forward(self.model, sensors, n_test, n_modes, shapes, self._threshold())
        if shapes is None:
            self.forward.further = Forward(
                self.model, sensors, n_test + 1, n_modes + 1, threshold=self.forward.threshold
            )

    def _threshold(self) -> float:
        """A visibility far from those of the nominal modes, so that none comes or goes by a little.

        Between the least of the test's modes and the largest of the others below the highest one.
        """
        if self.sensors is None:
            return VISIBLE
        seen = self.nominal.visibility(self.sensors)
        own = self.pairing.index
        others = np.setdiff1d(np.arange(self.nominal.n_rigid, own.max()), own)
        high = min(float(np.min(seen[own])), 1.0)
        low = max(float(np.max(seen[others], initial=0.0)), high / _CLEAR)
        return float(np.sqrt(low * high)) if low < high else VISIBLE

    def error(self, points: Sequence[Mapping[str, float]]) -> tuple[float, list[Modes]]:
        """None: the arrays are the structure. Looks which modes change places at the points."""
        found = []
        for values in points:
            modes = solve_modes(self.full, values, n_modes=self.n_modes)
            pairing = self.forward.paired(modes)
            self.crossings.update(pairing.crossing)
            found.append(modes)
        return 0.0, found

    def refine(self, modes: Sequence[Modes]) -> None:
        """Nothing: there is no basis."""

    def facts(self, n_samples: int) -> dict[str, object]:
        """Its size and use; it is made from no samples."""
        return {"dofs": self.full.n_dofs, "solutions": self.forward.calls}

    def wide(self, points: Sequence[Mapping[str, float]]) -> ArrayModel:
        """The same that can be seen at all nodes."""
        return self.full.arrays(self.sensors, self.everywhere(len(self.full.layout.x)))

    def point_rows(self, model: ArrayModel, points: np.ndarray) -> np.ndarray:
        """Displacement of a model's basis at points, shape (n_points, 3, n_dofs)."""
        return self.full.displacement_rows(points)

    def everywhere(self, count: int) -> Sensors:
        """Nodes all along the beams, along and across."""
        x = self.full.layout.x
        at = x[np.unique(np.round(np.linspace(0, len(x) - 1, min(count, len(x)))).astype(int))]
        points = np.column_stack([at, np.zeros((len(at), 2))])
        return Sensors(np.repeat(points, 2, axis=0), np.tile(np.eye(3)[[0, 2]], (len(at), 1)))
