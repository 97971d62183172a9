"""What every way to identify parameters from a target has in common."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fenics_joints.errors import capable, items, mapping, wanted
from fenics_joints.measurements.target import Target
from fenics_joints.modal.sensitivity import identifiability
from fenics_joints.structure import Damping, Parameter
from fenics_joints.updating.coordinates import Coordinates
from fenics_joints.updating.prediction import Prediction, Predictor
from fenics_joints.updating.residuals import Residuals, relative_errors
from fenics_joints.updating.result import Iteration, Update


class Identification:
    """Predictions, residuals and coordinates of one target, and the way gone so far.

    Args:
        model: As for `fenics_joints.updating.fit.update`.
        parameters: What is identified.
        target: The data.
        start: Values at the start.
        damping: The model's damping.
        n_modes: Modes to compute; by default enough for the target.

    Attributes:
        first: Values of the parameters at the start, (p,).
        history: The iterations.
    """

    #: As in `Update.method`.
    method: str

    def __init__(
        self,
        model,
        parameters: Sequence[Parameter],
        target: Target,
        start: Mapping[str, float],
        damping: Damping | None,
        n_modes: int | None,
    ):
        if not isinstance(target, Target):
            raise wanted("target", target, "a Target")
        capable("model", model, ("parameters", "n_dofs"), "a model, whole or reduced")
        if start is None or not mapping("start", start, "values by the parameters' names"):
            raise wanted("start", start, "a value for each parameter")
        items("parameters", parameters, Parameter, "parameters")
        self.target, self.coordinates = target, Coordinates(parameters, start, model)
        self.names = self.coordinates.names
        fixed = {n: v for n, v in start.items() if n not in self.names}
        self.predictor = Predictor(
            model, target, self.names, fixed, damping=damping, n_modes=n_modes
        )
        self.residuals = Residuals(target)
        self.first = np.array([start[n] for n in self.names], dtype=float)
        self.history: list[Iteration] = []

    def whitened(self, values: np.ndarray, prediction: Prediction) -> np.ndarray:
        """Derivatives of the residuals by the logarithms of the parameters, (r, p)."""
        return self.residuals.slopes(prediction) * self.coordinates.working(values)

    def record(
        self,
        values: np.ndarray,
        prediction: Prediction,
        conditions: tuple[float, float],
        *,
        moved: bool = False,
        cost: float = np.nan,
    ) -> None:
        """Write down an iteration; see `Iteration`."""
        errors = relative_errors(self.target, prediction)
        self.history.append(Iteration(values, *errors, moved, cost, *conditions))

    def excess(self, prediction: Prediction, taken: float) -> float:
        """Misfit beyond the widths of the residuals: chi2 per degree of freedom, at least 1.

        Args:
            prediction: The model's prediction.
            taken: Number of parameters that the data determine.
        """
        _, count = self.residuals.chi2(prediction)
        return max(
            1.0, float(np.sum(self.residuals.values(prediction) ** 2)) / max(count - taken, 1.0)
        )

    def result(
        self,
        values: np.ndarray,
        prediction: Prediction,
        covariance: np.ndarray,
        excess: float,
        converged: bool,
        message: str,
    ) -> Update:
        """What was found; see `Update`."""
        chi2, count = self.residuals.chi2(prediction)
        whitened = self.whitened(values, prediction) / np.sqrt(excess)
        return Update(
            self.method,
            self.names,
            self.first,
            values,
            covariance,
            identifiability(whitened, self.names),
            converged,
            message,
            self.predictor.calls,
            tuple(self.history),
            prediction,
            chi2,
            count - len(self.names),
            self.residuals.widths,
            excess,
        )
