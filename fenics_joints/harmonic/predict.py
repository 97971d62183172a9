"""Measured curves near their peaks against a model's (Iranzad and Ahmadian 2012, eq. 6)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fenics_joints.errors import reals, wanted, whole
from fenics_joints.harmonic.frf import solve_harmonic
from fenics_joints.harmonic.result import HarmonicResult
from fenics_joints.interfaces.model import InterfaceModel
from fenics_joints.measurements.curves import MeasuredCurves


def near_peak(amplitudes: np.ndarray, points: int) -> np.ndarray:
    """Indices of the ``points`` largest of a curve's amplitudes, ascending."""
    return np.sort(np.argsort(-np.asarray(amplitudes), kind="stable")[:points])


def peak_of(frequencies_hz: np.ndarray, amplitudes: np.ndarray) -> tuple[float, float]:
    """(frequency, Hz, amplitude) of a sampled curve's peak.

    The vertex of the parabola of 1 / amplitude^2 through the largest and its neighbours, which a
    lightly damped resonance is; the largest itself where that has none, or at an end.
    """
    f, a = np.asarray(frequencies_hz, dtype=float), np.asarray(amplitudes, dtype=float)
    i = int(np.argmax(a))
    if not 0 < i < len(a) - 1:
        return float(f[i]), float(a[i])
    x, y = f[i - 1 : i + 2] - f[i], a[i] ** 2 / a[i - 1 : i + 2] ** 2
    bend, slope, level = np.polyfit(x, y, 2)
    vertex = -slope / (2 * bend) if bend > 0 else np.inf
    least = level + 0.5 * slope * vertex if np.isfinite(vertex) else 0.0
    if not (x[0] < vertex < x[2] and least > 0):
        return float(f[i]), float(a[i])
    return float(f[i] + vertex), float(a[i] / np.sqrt(least))


@dataclass(frozen=True, repr=False)
class CurvePrediction:
    """What a model makes of a measured curve.

    Attributes:
        level: Amplitude of the force, N.
        frequencies_hz: The measured frequencies, Hz, (n,).
        measured: Amplitudes, in SI units, (n,).
        computed: Those of the model, (n,).
        near_peak: Indices of the points near the peak that `objective` takes.
        response: The model's response.
    """

    level: float
    frequencies_hz: np.ndarray
    measured: np.ndarray
    computed: np.ndarray
    near_peak: np.ndarray
    response: HarmonicResult

    def __repr__(self) -> str:
        return f"CurvePrediction({self.level:g} N, mean error {self.mean_error:.2%})"

    @property
    def objective(self) -> float:
        """Eq. 6."""
        i = self.near_peak
        return float(np.sum(np.abs(self.computed[i] / self.measured[i] - 1.0)))

    @property
    def mean_error(self) -> float:
        """Eq. 6 per point: the mean relative error."""
        return self.objective / len(self.near_peak)

    @property
    def peaks(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """(frequency, Hz, amplitude) of the measured peak and of the model's, see `peak_of`."""
        return peak_of(self.frequencies_hz, self.measured), peak_of(
            self.frequencies_hz, self.computed
        )

    @property
    def frequency_error(self) -> float:
        """Error of the peak's frequency, relative."""
        measured, computed = self.peaks
        return computed[0] / measured[0] - 1.0

    @property
    def amplitude_error(self) -> float:
        """Error of the peak's amplitude, relative."""
        measured, computed = self.peaks
        return computed[1] / measured[1] - 1.0

    def to_dict(self) -> dict:
        """Everything that people read, for JSON."""
        measured, computed = self.peaks
        return {
            "level": self.level,
            "frequency_hz": self.frequencies_hz.tolist(),
            "measured": self.measured.tolist(),
            "computed": self.computed.tolist(),
            "objective": self.objective,
            "mean_error": self.mean_error,
            "measured_peak": list(measured),
            "computed_peak": list(computed),
            "frequency_error": self.frequency_error,
            "amplitude_error": self.amplitude_error,
        }


def predict(
    model: InterfaceModel,
    curves: MeasuredCurves,
    levels: Sequence[float] | None = None,
    *,
    force: str,
    sensor: str,
    points: int = 9,
    harmonics: int = 3,
    **options,
) -> tuple[CurvePrediction, ...]:
    """The model's responses at the measured frequencies, and their errors, by level.

    Args:
        model: The model.
        curves: Measured curves.
        levels: Levels, N; all by default.
        force, sensor, points: As for `identify`.
        harmonics, options: ``samples``, ``static``, ``settings``, ``comm``: As for
            `solve_harmonic`.

    Raises:
        InputError: For an unknown name or level.
        ConvergenceError: If a response is not found.
    """
    if not isinstance(curves, MeasuredCurves):
        raise wanted("curves", curves, "MeasuredCurves, as read_curves gives them")
    whole("points", points)
    found = []
    for level in curves.levels if levels is None else reals("levels", levels, (None,)).tolist():
        frequencies, measured = curves.at(level)
        result = solve_harmonic(
            model, force, level, at=frequencies, harmonics=harmonics, sensor=sensor, **options
        )
        computed = result.amplitude(sensor, curves.response, "first")
        kept = near_peak(measured, points)
        found.append(CurvePrediction(level, frequencies, measured, computed, kept, result))
    return tuple(found)
