"""Residuals of a model's responses to measured curves and loops, and their derivatives."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.harmonic.fourier import basis
from fenics_joints.harmonic.frf import solve_harmonic
from fenics_joints.harmonic.loops import MeasuredLoop
from fenics_joints.harmonic.measured_mode import ModeData
from fenics_joints.harmonic.predict import near_peak
from fenics_joints.harmonic.result import HarmonicResult
from fenics_joints.harmonic.sensitivity import ResponseGradient
from fenics_joints.interfaces.model import InterfaceModel

#: Relative change of a width that asks for another search.
_SAME_WIDTH = 0.1
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

    def solve(self, model: InterfaceModel, force: str, options, warm) -> HarmonicResult:
        """The model's response at the curve's frequencies."""
        return _response(self, model, force, options, warm)

    def objective(self, residual: np.ndarray) -> float:
        """Eq. 6: the sum of the errors."""
        return float(np.abs(residual).sum())

    def residual(self, result: HarmonicResult) -> np.ndarray:
        """Error at each frequency, relative, (n,)."""
        return result.amplitude(self.sensor, self.kind, "first") / self.amplitudes - 1.0

    def jacobian(self, result: HarmonicResult, change: Change, values) -> np.ndarray:
        """Derivatives of the residual by the parameters, (n, parameters)."""
        gradient = result.by_parameters(change, values)
        return gradient.amplitude(self.sensor, self.kind, "first") / self.amplitudes[:, None]


@dataclass(frozen=True)
class Loop:
    """One measured loop; residuals whose root of the sum of squares is its relative rms error."""

    loop: MeasuredLoop
    sensor: str

    def __len__(self) -> int:
        return len(self.loop.times)

    def solve(self, model: InterfaceModel, force: str, options, warm) -> HarmonicResult:
        """The model's response at the loop's frequency."""
        return _response(self, model, force, options, warm)

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

    def jacobian(self, result: HarmonicResult, change: Change, values) -> np.ndarray:
        """Derivatives of the residual by the parameters, (n, parameters)."""
        gradient: ResponseGradient = result.by_parameters(change, values)
        turned = gradient.sensor_coefficients(self.sensor, self.loop.response)[0]
        at = basis(self.loop.angles(), turned.shape[1])
        return (at[:, 1:] @ turned[:, 1:].T) / self._scale()


def _response(data: Curve | Loop, model: InterfaceModel, force: str, options, warm):
    return solve_harmonic(
        model, force, data.level, at=data.frequencies, sensor=data.sensor, initial=warm, **options
    )


class CurveFit:
    """Residuals and their derivatives by ln of the parameters, and what they cost.

    Args:
        change: The model for values of the parameters.
        names: Their names.
        data: Curves, loops and measured modes.
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
            result = one.solve(model, self.force, self.options, warm)
            found.append(result)
            self.solutions += len(result)
            self.iterations += int(np.sum(result.iterations))
        r = np.concatenate([d.residual(y) for d, y in zip(self.data, found, strict=True)])
        self.results, self._at, self._residual = found, np.array(x), r
        self._note(x, self.objective(r))
        return r

    def parts(self, r: np.ndarray) -> list[np.ndarray]:
        """The residuals of each of the data."""
        return np.split(r, np.cumsum([len(one) for one in self.data])[:-1])

    def objective(self, r: np.ndarray) -> float:
        """Eq. 6 of all data."""
        return sum(one.objective(p) for one, p in zip(self.data, self.parts(r), strict=True))

    def widen(self, x: np.ndarray) -> bool:
        """Take what the model does not follow of measured modes for noise; whether that changed."""
        r, changed = self.residual(x), False
        for i, (one, part) in enumerate(zip(self.data, self.parts(r), strict=True)):
            if isinstance(one, ModeData):
                share = round(len(x) * len(part) / len(r))
                self.data[i] = one.widened(part, share)
                ratio = np.log(np.divide(self.data[i].widths, one.widths))
                changed |= bool(np.abs(ratio).max() > _SAME_WIDTH)
        if changed:
            self._at = None
        return changed

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
            one.jacobian(result, self.change, self.values(x))
            for one, result in zip(self.data, self.results, strict=True)
        ]
        return np.vstack(parts) * np.exp(x)


def checked_data(curves, level, points, loops, sensor, modes=()) -> list[Curve | Loop | ModeData]:
    """What is fitted: the points near the peak of a level's curve, loops, and measured modes.

    Raises:
        InputError: For an unknown level, too few points, or no data.
    """
    found: list[Curve | Loop | ModeData] = []
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
    found += [*(Loop(loop, sensor) for loop in loops), *modes]
    if not found:
        raise InputError("there are no data: expected curves and a level, loops, or a backbone.")
    return found
