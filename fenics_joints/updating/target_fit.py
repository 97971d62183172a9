"""Least squares of a model's predictions for one target or several, in any coordinates."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
from scipy.optimize import OptimizeResult

from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.measurements.least_squares import HeldBy, LeastSquares
from fenics_joints.updating.prediction import Prediction, Predictor
from fenics_joints.updating.residuals import Residuals


class Curved(Protocol):
    """Coordinates x of the parameters' values at every condition."""

    names: tuple[str, ...]

    def at(self, condition: int, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values at a condition, (p,), and their derivative by the coordinates, (p, n)."""

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of the coordinates, (n,) each."""


class TargetFit(LeastSquares):
    """Residuals of the data at one condition or several.

    Args:
        predictors: The model's predictions of the target of each condition.
        coordinates: From coordinates to the parameters' values at each condition.
        prior: What holds the coordinates beside the data.
        on_step: Told the coordinates of each accepted step, and whether lines were moved.

    Attributes:
        residuals: Those of each condition.
    """

    def __init__(
        self,
        predictors: Sequence[Predictor],
        coordinates: Curved,
        prior: HeldBy | None = None,
        on_step: Callable[[np.ndarray, bool], None] | None = None,
    ):
        super().__init__(prior=prior, bounds=coordinates.bounds())
        self.predictors, self.coordinates = predictors, coordinates
        self.residuals = [Residuals(predictor.target) for predictor in predictors]
        self.on_step = on_step
        self._size: int | None = None

    def predict(self, condition: int, x: np.ndarray, moved: bool = False) -> Prediction:
        """The prediction at coordinates."""
        values, _ = self.coordinates.at(condition, x)
        named = dict(zip(self.coordinates.names, values.tolist(), strict=True))
        return self.predictors[condition](named, moved)

    def residual(self, x: np.ndarray, moved: bool = False) -> np.ndarray:
        """The residuals, (r,); infinite where a step leaves the model's range, which the trust
        region answers with a shorter one. At the start that is an exception."""
        try:
            parts = [r.values(self.predict(k, x, moved)) for k, r in enumerate(self.residuals)]
        except (InputError, ConvergenceError, np.linalg.LinAlgError):
            if self._size is None:
                raise
            return np.full(self._size, np.inf)
        if self.prior is not None:
            parts.append(self.prior(x)[0])
        found = np.concatenate(parts)
        self._size = len(found)
        return found

    def slope(self, x: np.ndarray, moved: bool = False) -> np.ndarray:
        """Their derivatives by the coordinates, (r, n); called once at each accepted step."""
        if self.on_step is not None:
            self.on_step(x, moved)
        found = self.jacobian(x, moved)
        for k, predictor in enumerate(self.predictors):
            if predictor.follows:
                predictor.follow(self.predict(k, x, moved))
        return found

    def jacobian(self, x: np.ndarray, moved: bool = False) -> np.ndarray:
        """The same derivatives, wherever they are wanted."""
        parts = [
            r.slopes(self.predict(k, x, moved)) @ self.coordinates.at(k, x)[1]
            for k, r in enumerate(self.residuals)
        ]
        if self.prior is not None:
            parts.append(self.prior(x)[1])
        return np.concatenate(parts)

    def misfit(self, x: np.ndarray) -> float:
        """Minus the logarithm of the posterior density, up to a constant; widths count."""
        return 0.5 * float(np.sum(self.residual(x) ** 2)) + sum(r.volume() for r in self.residuals)

    def inside(self, x: np.ndarray) -> np.ndarray:
        """The nearest coordinates a little within the bounds."""
        low, high = self.bounds
        margin = 1e-6 * np.minimum(1.0, high - low)
        return np.clip(x, low + margin, high - margin)

    def solve(
        self,
        x: np.ndarray,
        max_evaluations: int,
        *,
        moved: bool = False,
        accuracy: float = 1e-8,
        still: float | None = None,
    ) -> OptimizeResult:
        """Least squares from coordinates ``x``, by a trust region with bounds.

        Args:
            x: Coordinates at the start.
            max_evaluations: Most evaluations of the residuals.
            moved: Whether FRF lines are moved with the resonances.
            accuracy: Relative change of the sum of squares, and of the coordinates, at the end.
            still: That of the coordinates, where it is another.

        Raises:
            ConvergenceError: If the model cannot be solved at the start.
        """
        start = self.inside(x)
        try:
            return super().solve(
                start,
                max_evaluations,
                jac=self.slope,
                args=(moved,),
                ftol=accuracy,
                xtol=still or accuracy,
                gtol=1e-8,
            )
        except ValueError as error:
            if np.isfinite(self.residual(start, moved)).all():
                raise
            raise ConvergenceError(
                "at the start of the fit the model has no counterpart of the measured modes: do "
                "the shapes and the frequencies belong to the same modes?"
            ) from error
