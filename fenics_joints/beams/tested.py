"""Beams as small models for fits: they are exact."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fenics_joints.beams.structure import BeamStructure
from fenics_joints.measurements.gap import VISIBLE
from fenics_joints.measurements.target import Target
from fenics_joints.progress import Progress
from fenics_joints.reduction import ArrayModel, ModalPrediction
from fenics_joints.reduction.basis import Points
from fenics_joints.reduction.frf_basis import CombinedModel, ModelError, error_limits
from fenics_joints.reduction.matched import MatchedModes
from fenics_joints.reduction.surrogate import SmallModels, tested_models
from fenics_joints.structure import Damping, Parameter, Sensors

#: Factor by which a mode may become less visible than the least visible of the test's: chosen.
_CLEAR = 10.0
#: Arguments of other small models that `ExactModes` ignores.
_OF_A_BASIS = {"samples", "travel", "keep", "lacking", "still", "progress", "ranks"}


class ExactModes(MatchedModes):
    """The modes of beams that a test saw.

    Args:
        full: The beams.
        start: See `MatchedModes`.
        free: See `GreedyModel`; all parameters of beams are free.
        by_order: Whether modes go by their order, as the test's names of them do, where no shapes
            were measured. In one plane they do not cross but veer, and by the nominal shapes one
            along the beams, which shows little, would be taken for any other. The test may then
            have missed one: see `ModalPrediction.further`.
        shapes: See `MatchedModes`.
        n_modes: See `MatchedModes`.
        given: See `MatchedModes`; what is of a basis, which beams do not need, is left out.
    """

    unseen = "motion along the beams"
    checking = "looking which modes change places"

    def __init__(
        self,
        full: BeamStructure,
        start: Mapping[str, float],
        free: Sequence[str] = (),
        *,
        by_order: bool = False,
        shapes: np.ndarray | None = None,
        n_modes: int,
        **given,
    ):
        given = {key: value for key, value in given.items() if key not in _OF_A_BASIS}
        n_modes = min(max(n_modes, given["n_test"]), full.n_dofs)
        super().__init__(full, start, shapes=shapes, n_modes=n_modes, **given)
        sensors, model = self.sensors, full.arrays(self.sensors)
        if not by_order:
            self.forward = ModalPrediction(model, sensors, self.n_test, n_modes, self.reference)
            return
        self.forward = ModalPrediction(
            model, sensors, self.n_test, n_modes, shapes, self._threshold()
        )
        if shapes is None:
            self.forward.further = ModalPrediction(
                model, sensors, self.n_test + 1, n_modes + 1, threshold=self.forward.threshold
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

    def log_f(self, values: Mapping[str, float]) -> np.ndarray:
        """See `MatchedModes.log_f`."""
        return self.forward(values)[0]

    def errors(self, points: Points) -> np.ndarray:
        """None: the arrays are the structure. Looks which modes change places at the points."""
        for values in points:
            self.crossings.update(self.forward.pairing(values).crossing)
        return np.zeros(len(points))

    def extend(self, points: Points) -> None:
        """Nothing: there is no basis."""

    def facts(self) -> dict[str, object]:
        """Its size and use; it is made from no samples."""
        return {"dofs": self.full.n_dofs, "solutions": self.forward.calls}

    def wide(self, points: Points) -> ArrayModel:
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


class ExactTarget(CombinedModel):
    """Frequencies, shapes, damping ratios and functions of beams.

    Args:
        full: The beams.
        target: The data.
        damping: The damping.
        n_modes: Number of modes to compute.
    """

    def __init__(self, full: BeamStructure, target: Target, damping: Damping, n_modes: int):
        self.target, self.damping, self.samples = target, damping, 0
        self.n_modes, self.limits = min(n_modes, full.n_dofs), error_limits(target)
        functions = target.frfs is not None
        places = [target.frfs.excitation, target.frfs.sensors] if functions else []
        self.full = self.arrays = full.arrays(target.shape_sensors, *places)
        self._exact, self._last, self._ratios = None, None, {}
        ratios = 0.0 if "damping" in target.kinds else None
        self.error = ModelError(0.0, 0.0 if functions else None, ratios)

    def sample(
        self, parameters: Sequence[Parameter], start: Mapping[str, float], progress: Progress
    ) -> None:
        """Nothing: there is no basis."""

    def extend(self, points: Points) -> None:
        """Nothing: there is no basis."""

    def errors(self, points: Points) -> np.ndarray:
        """None at any point."""
        return np.zeros(len(points))


@tested_models.register
def _(full: BeamStructure) -> SmallModels:
    return SmallModels(ExactModes, ExactModes, ExactTarget, exact=True)
