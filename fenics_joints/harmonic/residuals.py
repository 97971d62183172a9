"""Residuals of a model's responses to measured curves and loops, and their derivatives."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.harmonic.fourier import basis
from fenics_joints.harmonic.frf import solve_harmonic
from fenics_joints.harmonic.loops import MeasuredLoop
from fenics_joints.harmonic.predict import near_peak
from fenics_joints.harmonic.result import HarmonicResult
from fenics_joints.harmonic.sensitivity import ResponseGradient
from fenics_joints.interfaces.model import InterfaceModel

__all__ = ["Change", "Curve", "CurveFit", "checked_data"]

#: The model for values of its parameters.
Change = Callable[[Mapping[str, float]], InterfaceModel]


@dataclass(frozen=True)
class Curve:
    """Amplitudes at some frequencies of one level; a residual for each, relative."""

    level: float
    frequencies: np.ndarray
    amplitudes: np.ndarray
    sensor: str
    kind: str

    def __len__(self) -> int:
        return len(self.frequencies)

    def objective(self, residual: np.ndarray) -> float:
        """Eq. 6: the sum of the errors."""
        return float(np.abs(residual).sum())

    def residual(self, result: HarmonicResult) -> np.ndarray:
        """Error at each frequency, relative, (n,)."""
        return result.amplitude(self.sensor, self.kind, "first") / self.amplitudes - 1.0

    def slope(self, gradient: ResponseGradient) -> np.ndarray:
        """Derivatives of the residual by the parameters, (n, parameters)."""
        change = gradient.amplitude(self.sensor, self.kind, "first")
        return change / self.amplitudes[:, None]


@dataclass(frozen=True)
class Loop:
    """One measured loop; residuals whose root of the sum of squares is its relative rms error."""

    loop: MeasuredLoop
    sensor: str

    def __len__(self) -> int:
        return len(self.loop.times)

    def objective(self, residual: np.ndarray) -> float:
        """It counts as one point of a curve, with its relative rms error."""
        return float(np.linalg.norm(residual))

    @property
    def level(self) -> float:
        """Amplitude of the force, N."""
        return self.loop.level

    @property
    def frequencies(self) -> np.ndarray:
        """The loop's own, Hz, (1,)."""
        return np.array([self.loop.frequency_hz])

    def _scale(self) -> float:
        return np.sqrt(len(self.loop.times)) * float(np.std(self.loop.responses))

    def residual(self, result: HarmonicResult) -> np.ndarray:
        """Error at each sample, over root n times the response's deviation, (n,)."""
        c = result.sensor_coefficients(self.sensor, self.loop.response)[0]
        measured = self.loop.responses - self.loop.responses.mean()
        at = basis(self.loop.angles(), len(c))
        # An accelerometer measures no mean.
        return (at[:, 1:] @ c[1:] - measured) / self._scale()

    def slope(self, gradient: ResponseGradient) -> np.ndarray:
        """Derivatives of the residual by the parameters, (n, parameters)."""
        change = gradient.sensor_coefficients(self.sensor, self.loop.response)[0]
        at = basis(self.loop.angles(), change.shape[1])
        return (at[:, 1:] @ change[:, 1:].T) / self._scale()


class CurveFit:
    """Residuals and their derivatives by ln of the parameters, and what they cost.

    Args:
        change: The model for values of the parameters.
        names: Their names.
        data: Curves and loops.
        force: Place of the force.
        options: Options of `solve_harmonic`.
    """

    def __init__(self, change: Change, names, data, force: str, options: Mapping[str, object]):
        self.change, self.names, self.data = change, tuple(names), list(data)
        self.force, self.options = force, dict(options)
        self.evaluations = self.gradients = self.failures = 0
        self.solutions = self.iterations = 0
        self.trials, self.history = [], []
        self.results: list = [None] * len(self.data)
        self._at = self._residual = None

    def values(self, x: np.ndarray) -> dict[str, float]:
        """The parameters at x."""
        return dict(zip(self.names, np.exp(x).tolist(), strict=True))

    def residual(self, x: np.ndarray) -> np.ndarray:
        """Relative residuals, (n,). The last response is kept, and not computed twice."""
        if self._at is not None and np.array_equal(self._at, x):
            return self._residual
        self.evaluations += 1
        model, found = self.change(self.values(x)), []
        for one, warm in zip(self.data, self.results, strict=True):
            result = solve_harmonic(
                model, self.force, one.level, at=one.frequencies, sensor=one.sensor,
                initial=warm, **self.options,
            )  # fmt: skip
            found.append(result)
            self.solutions += len(result)
            self.iterations += int(np.sum(result.iterations))
        r = np.concatenate([d.residual(y) for d, y in zip(self.data, found, strict=True)])
        self.results, self._at, self._residual = found, np.array(x), r
        self._note(x, self.objective(r))
        return r

    def objective(self, r: np.ndarray) -> float:
        """Eq. 6 of all data."""
        parts = np.split(r, np.cumsum([len(one) for one in self.data])[:-1])
        return sum(one.objective(part) for one, part in zip(self.data, parts, strict=True))

    def tried(self, x: np.ndarray) -> np.ndarray | None:
        """`residual`, or None where there is no model or no response."""
        try:
            return self.residual(x)
        except (ConvergenceError, InputError):
            self.failures += 1
            self._note(x, np.inf)
            return None

    def _note(self, x: np.ndarray, objective: float) -> None:
        self.trials.append(np.exp(x))
        self.history.append(objective)

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """d residual / d ln p, (n, parameters)."""
        self.residual(x)
        self.gradients += 1
        parts = [
            one.slope(result.by_parameters(self.change, self.values(x)))
            for one, result in zip(self.data, self.results, strict=True)
        ]
        return np.vstack(parts) * np.exp(x)


def checked_data(curves, level, points, loops, sensor) -> list[Curve | Loop]:
    """What is fitted: the points near the peak of a level's curve, and loops.

    Raises:
        InputError: For an unknown level, too few points, or no data.
    """
    found: list[Curve | Loop] = []
    if curves is not None:
        if level is None:
            raise InputError("level = None: expected the level of one of the curves, N.")
        frequencies, amplitudes = curves.at(level)
        if not 3 <= points:
            raise InputError(f"points = {points}: expected at least 3.")
        kept = near_peak(amplitudes, points)
        found.append(Curve(level, frequencies[kept], amplitudes[kept], sensor, curves.response))
    elif level is not None:
        raise InputError(f"level = {level:g}: expected curves that have it.")
    found += [Loop(loop, sensor) for loop in loops]
    if not found:
        raise InputError("there are no data: expected curves and a level, or loops.")
    return found
