"""Damping ratios of a test beside a model's, in an update."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fenics_joints.formatting import number
from fenics_joints.measurements.gap import rms

__all__ = ["DampingTable", "HeldRatio", "ratio_words"]


@dataclass(frozen=True, eq=False)
class DampingTable:
    """Damping ratios of the test's modes beside those of the full model.

    Attributes:
        test: Measured, (m,); nan where missing.
        before: At the start, (m,).
        after: Updated, (m,).
        fitted: Which of them the fit saw, (m,), bool.
    """

    test: np.ndarray
    before: np.ndarray
    after: np.ndarray
    fitted: np.ndarray

    @property
    def error_before(self) -> np.ndarray:
        """Relative errors, model over test minus one, (m,); nan where not measured."""
        return self.before / self.test - 1

    @property
    def error_after(self) -> np.ndarray:
        """The same, updated."""
        return self.after / self.test - 1

    @property
    def measured(self) -> np.ndarray:
        """Indices of the modes whose ratios were measured."""
        return np.flatnonzero(np.isfinite(self.test))

    def rms(self) -> tuple[float, float]:
        """Root mean squares of the errors of what was fitted, before and after."""
        return rms(self.error_before[self.fitted]), rms(self.error_after[self.fitted])

    def row(self, j: int) -> dict[str, float | bool | None]:
        """A mode in the JSON of ``update``."""
        row = {
            "damping_test": self.test[j], "damping_before": self.before[j],
            "damping_after": self.after[j],
            "damping_error_before_percent": 100 * self.error_before[j],
            "damping_error_after_percent": 100 * self.error_after[j],
        }  # fmt: skip
        row = {key: float(v) if np.isfinite(v) else None for key, v in row.items()}
        return row | {"damping_fitted": bool(self.fitted[j])}


@dataclass(frozen=True)
class HeldRatio:
    """A damping ratio that a fit did not see.

    Attributes:
        test: Measured; nan if it was not.
        before: The model's at the start.
        predicted: That of the model fitted to all else.
        sd: Relative standard deviation of that by the parameters' covariance alone; nan where no
            fitted mode had a ratio.
    """

    test: float
    before: float
    predicted: float
    sd: float

    @property
    def error(self) -> float:
        """Predicted over measured, minus one."""
        return self.predicted / self.test - 1

    def json(self) -> dict[str, float | None]:
        """Keys of a held mode in the JSON of ``update``."""
        row = {
            "damping_test": self.test, "damping_before": self.before,
            "damping_predicted": self.predicted, "damping_error_percent": 100 * self.error,
            "damping_standard_deviation_percent": 100 * self.sd,
        }  # fmt: skip
        return {key: float(v) if np.isfinite(v) else None for key, v in row.items()}


def ratio_words(ratio: float) -> str:
    """A damping ratio in per cent, three digits; a dash for one that is missing."""
    return f"{number(100 * ratio)} %" if np.isfinite(ratio) else number(ratio)
