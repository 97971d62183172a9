"""Parameters of nonlinear joint laws from measured responses near a resonance.

Seed 003, section 5: the parameters make the least of eq. 6, sum |a - a_e| / a_e over a few points
near the peak of one level's curve; what they predict of other levels is the test of the model.
`identify` does it by direct search, as the seed, or by least squares with the exact derivatives of
harmonic balance. Loops of force against response, which the seed takes its sharpness n from, enter
alike.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mpi4py import MPI
from scipy.optimize import least_squares, minimize

from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.files import json_text, write_text
from fenics_joints.harmonic.continuation import Settings
from fenics_joints.harmonic.fourier import basis, differentiated
from fenics_joints.harmonic.frf import solve_harmonic
from fenics_joints.harmonic.loops import MeasuredLoop
from fenics_joints.harmonic.result import HarmonicResult
from fenics_joints.interfaces.model import InterfaceModel
from fenics_joints.joint_laws.law import JointLaw
from fenics_joints.measurements.curves import MeasuredCurves
from fenics_joints.modal.sensitivity import Identifiability, identifiability

__all__ = [
    "IdentificationResult", "LawParameters", "Prediction", "identify", "near_peak", "peak_of",
    "predict",
]  # fmt: skip

#: Bounds of a parameter by default: its start over and times this.
_RANGE = 1e3
#: First steps of the direct search, of ln of the parameters.
_SIMPLEX = 0.3

Change = Callable[[Mapping[str, float]], InterfaceModel]


class LawParameters:
    """The model for values of its laws' parameters, named ``INTERFACE.PARAMETER``.

    Args:
        model: The model.
    """

    def __init__(self, model: InterfaceModel):
        self.model = model
        self.laws = {points.name: points.law for points in model.interfaces}
        for points in model.interfaces:
            points.kernel  # noqa: B018  compiled once, and taken over by changed laws

    def __call__(self, values: Mapping[str, float]) -> InterfaceModel:
        """The model with these values.

        Raises:
            InputError: For an unknown name, or a value that the law does not allow.
        """
        changes: dict[str, dict[str, float]] = {}
        for name, value in values.items():
            interface, _, key = name.rpartition(".")
            if interface not in self.laws:
                known = ", ".join(self.laws) or "none"
                raise InputError(
                    f"parameters: {name!r} belongs to no interface; expected INTERFACE.PARAMETER "
                    f"with one of the interfaces {known}."
                )
            changes.setdefault(interface, {})[key] = float(value)
        return self.model.with_laws(**{k: _changed(self.laws[k], v) for k, v in changes.items()})


def _changed(law: JointLaw, values: Mapping[str, float]) -> JointLaw:
    # A law made from a backbone has its parameters, not those of its sliders.
    change = getattr(law, "change", law.with_values)
    return change(**values)


# -- data ------------------------------------------------------------------------------------------


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


@dataclass(frozen=True)
class _Curve:
    """Amplitudes at some frequencies of one level; a residual for each, relative."""

    level: float
    frequencies: np.ndarray
    amplitudes: np.ndarray
    sensor: str
    kind: str

    def computed(self, result: HarmonicResult) -> np.ndarray:
        return result.amplitude(self.sensor, self.kind, "first")

    def residual(self, result: HarmonicResult) -> np.ndarray:
        return self.computed(result) / self.amplitudes - 1.0

    def slope(self, gradient) -> np.ndarray:
        change = gradient.amplitude(self.sensor, self.kind, "first")
        return change / self.amplitudes[:, None]


@dataclass(frozen=True)
class _Loop:
    """One measured loop; residuals whose root of the sum of squares is its relative rms error."""

    loop: MeasuredLoop
    sensor: str

    @property
    def level(self) -> float:
        return self.loop.level

    @property
    def frequencies(self) -> np.ndarray:
        return np.array([self.loop.frequency_hz])

    def _scale(self) -> float:
        return np.sqrt(len(self.loop.times)) * float(np.std(self.loop.responses))

    def residual(self, result: HarmonicResult) -> np.ndarray:
        c = result.sensor_coefficients(self.sensor, self.loop.response)[0]
        measured = self.loop.responses - self.loop.responses.mean()
        at = basis(self.loop.angles(), len(c))
        # An accelerometer measures no mean.
        return (at[:, 1:] @ c[1:] - measured) / self._scale()

    def slope(self, gradient) -> np.ndarray:
        result = gradient.result
        row = result.model.row("sensors", self.sensor)
        change = np.einsum("n,nkj->jk", row, gradient.coefficients[0])
        change = differentiated(change, result.omegas[0], self.loop.response)
        at = basis(self.loop.angles(), change.shape[1])
        return (at[:, 1:] @ change[:, 1:].T) / self._scale()


# -- the fit ---------------------------------------------------------------------------------------


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
        """Eq. 6; a loop counts as one point, with its relative rms error."""
        total, at = 0.0, 0
        for one in self.data:
            n = len(one.frequencies) if isinstance(one, _Curve) else len(one.loop.times)
            part, at = r[at : at + n], at + n
            total += np.abs(part).sum() if isinstance(one, _Curve) else np.linalg.norm(part)
        return float(total)

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


@dataclass(frozen=True, kw_only=True)
class IdentificationResult:
    """Identified parameters, how they were found, and how well the data determine them.

    Attributes:
        method: ``direct`` or ``gradient``.
        level: Amplitude of the force of the curve, N; of the first loop if there is no curve.
        frequencies_hz: Selected frequencies of the curve, Hz.
        start: Values at the start, by name.
        values: Values found.
        objective: Eq. 6 at those values.
        start_objective: Eq. 6 at the start.
        history: Eq. 6 at each evaluation; infinite where there was no response.
        trials: Parameters at each evaluation, (evaluations, parameters).
        evaluations: Responses of the model that were asked for, at all selected frequencies (and
            of all loops) each.
        solutions: Single periodic solutions in them.
        iterations: Newton iterations in them.
        gradients: Derivatives, each without a further solution.
        failures: Evaluations without a response.
        residuals: Relative residuals at the values, (n,).
        jacobian: d residuals / d ln of the parameters, (n, parameters).
        noise: Relative standard deviation that a residual is taken to have, the larger of what was
            given and the residuals' own.
        known: What the data determine: standard deviations of ln of the parameters (`sd`),
            condition number, and the parameters that are left open.
        at_bound: Parameters that ended at a bound.
        message: How the optimiser ended.
        model: The model with these values.
        responses: Its responses, one of the curve and one of each loop.
    """

    method: str
    level: float
    frequencies_hz: np.ndarray
    start: dict[str, float]
    values: dict[str, float]
    objective: float
    start_objective: float
    history: np.ndarray
    trials: np.ndarray
    evaluations: int
    solutions: int
    iterations: int
    gradients: int
    failures: int
    residuals: np.ndarray
    jacobian: np.ndarray
    noise: float
    known: Identifiability
    at_bound: tuple[str, ...]
    message: str
    model: InterfaceModel
    responses: tuple[HarmonicResult, ...]

    @property
    def sd(self) -> dict[str, float]:
        """Standard deviation of ln of each parameter, from the data alone."""
        return dict(zip(self.known.names, self.known.sd.tolist(), strict=True))

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Parameters that the data do not determine to a factor e, or that met a bound."""
        held = (*self.known.undetermined, *self.at_bound)
        return tuple(n for n in self.known.names if n in held or self.sd[n] > 1.0)

    def to_dict(self) -> dict:
        """Everything that people read, for JSON."""
        keys = (
            "method", "level", "start", "values", "objective", "start_objective", "evaluations",
            "solutions", "iterations", "gradients", "failures", "noise", "at_bound", "message",
        )  # fmt: skip
        return {key: getattr(self, key) for key in keys} | {
            "frequency_hz": self.frequencies_hz.tolist(),
            "history": [float(v) if np.isfinite(v) else None for v in self.history],
            "trials": self.trials.tolist(),
            "residuals": self.residuals.tolist(),
            "sd_ln": {k: v if np.isfinite(v) else None for k, v in self.sd.items()},
            "condition": self.known.condition if np.isfinite(self.known.condition) else None,
            "undetermined": list(self.undetermined),
        }

    def write_json(self, path: str | Path) -> None:
        """Write `to_dict` to a file.

        Raises:
            InputError: If it cannot be written.
        """
        write_text(path, json_text(self.to_dict()))


def identify(
    model: InterfaceModel | Change,
    curves: MeasuredCurves | None,
    level: float | None,
    parameters: Mapping[str, float],
    *,
    force: str,
    sensor: str,
    method: str = "gradient",
    points: int = 9,
    loops: Sequence[MeasuredLoop] = (),
    bounds: Mapping[str, tuple[float, float]] | None = None,
    noise: float = 0.01,
    tolerance: float = 1e-3,
    max_evaluations: int = 200,
    harmonics: int = 3,
    samples: int | None = None,
    static: np.ndarray | None = None,
    settings: Settings | None = None,
    comm: MPI.Comm | None = None,
) -> IdentificationResult:
    """Find parameters of nonlinear laws from the curve of one level, or from loops, or both.

    Works on ln of the parameters. ``direct`` minimises eq. 6 by Nelder and Mead's simplex;
    ``gradient`` its squares by a trust-region method (both scipy's). Each response starts from the
    last one. A trial whose response is not found counts as one, and is turned away.

    Args:
        model: The model, whose laws' parameters are named ``INTERFACE.PARAMETER``; or a function
            that makes the model for values of any parameters, by name.
        curves: Measured curves; None to take loops alone.
        level: The level to take, N; None without curves.
        parameters: Values to start from, > 0, by name.
        force: Place of the force.
        sensor: The sensor that was measured.
        method: ``direct`` or ``gradient``.
        points: Points of the curve that are taken, those of the largest amplitudes.
        loops: Loops of force against the sensor's response. One counts as one point of the curve.
        bounds: Least and largest value by name; by default a thousandth of the start and a
            thousand times.
        noise: Relative standard deviation of a measured amplitude.
        tolerance: Change of ln of the parameters, and relative one of the objective, at the end.
        max_evaluations: Most responses.
        harmonics, samples, static, settings, comm: As for `solve_harmonic`.

    Raises:
        InputError: For an unknown name, a value out of range, or no data.
        ConvergenceError: If there is no response at the start.
    """
    if method not in ("direct", "gradient"):
        raise InputError(f"method = {method!r}: expected 'direct' or 'gradient'.")
    start = _checked_start(parameters)
    low, high = _checked_bounds(start, bounds or {})
    for key, value in (("noise", noise), ("tolerance", tolerance)):
        if not 0 < value < 1:
            raise InputError(f"{key} = {value}: expected between 0 and 1.")
    if max_evaluations < 2:
        raise InputError(f"max_evaluations = {max_evaluations}: expected at least 2.")
    change = LawParameters(model) if isinstance(model, InterfaceModel) else model
    data = checked_data(curves, level, points, loops, sensor)
    options = {
        "harmonics": harmonics, "samples": samples, "static": static, "settings": settings,
        "comm": comm,
    }  # fmt: skip
    fit = CurveFit(change, start, data, force, options)
    x = np.log(list(start.values()))
    first = fit.objective(fit.residual(x))  # raises what is wrong with names and model
    search = _direct if method == "direct" else _gradient
    x, message = search(fit, x, low, high, tolerance, max_evaluations)
    return _finished(fit, method, start, first, x, (low, high), noise, message)


def _direct(fit: CurveFit, x, low, high, tolerance, most):
    """Nelder and Mead's simplex on eq. 6."""

    def objective(x):
        r = fit.tried(x)
        return np.inf if r is None else fit.objective(r)

    # A first step away from the nearer bound.
    steps = np.where(high - x > _SIMPLEX, _SIMPLEX, -np.minimum(_SIMPLEX, x - low))
    options = {
        "initial_simplex": np.vstack([x, x + np.diag(steps)]), "xatol": tolerance,
        "fatol": tolerance * max(fit.history[0], 1e-300), "maxfev": most - 1,
    }  # fmt: skip
    found = minimize(
        objective, x, method="Nelder-Mead", bounds=list(zip(low, high, strict=True)),
        options=options,
    )  # fmt: skip
    return found.x, str(found.message)


def _gradient(fit: CurveFit, x, low, high, tolerance, most):
    """Trust-region least squares with exact derivatives."""
    start, size = x, len(fit.residual(x))

    def residual(change):
        r = fit.tried(start + change)
        return np.full(size, np.inf) if r is None else r

    found = least_squares(
        residual, np.zeros_like(x), lambda change: fit.jacobian(start + change),
        bounds=(low - start, high - start), xtol=tolerance, ftol=tolerance, gtol=1e-12,
        max_nfev=most,
    )  # fmt: skip
    return start + found.x, str(found.message)


def _finished(fit, method, start, first, x, bounds, noise, message) -> IdentificationResult:
    r, J = fit.residual(x), fit.jacobian(x)
    # What the model cannot follow is noise to the parameters.
    spread = max(noise, float(np.sqrt(r @ r / max(len(r) - len(x), 1))))
    values = fit.values(x)
    met = [min(abs(x[i] - b[i]) for b in bounds) < 1e-6 for i in range(len(x))]
    curve = next((d for d in fit.data if isinstance(d, _Curve)), None)
    return IdentificationResult(
        method=method,
        level=fit.data[0].level,
        frequencies_hz=np.empty(0) if curve is None else curve.frequencies,
        start=dict(start), values=values, objective=fit.objective(r), start_objective=first,
        history=np.array(fit.history), trials=np.array(fit.trials),
        evaluations=fit.evaluations, solutions=fit.solutions, iterations=fit.iterations,
        gradients=fit.gradients, failures=fit.failures,
        residuals=r, jacobian=J, noise=spread, known=identifiability(J / spread, fit.names),
        at_bound=tuple(n for n, m in zip(fit.names, met, strict=True) if m), message=message,
        model=fit.change(values), responses=tuple(fit.results),
    )  # fmt: skip


def _checked_start(parameters: Mapping[str, float]) -> dict[str, float]:
    if not parameters:
        raise InputError("parameters: there are none; expected a start value for each by name.")
    for name, value in parameters.items():
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"parameters[{name!r}] = {value}: expected a number > 0.")
    return {name: float(value) for name, value in parameters.items()}


def _checked_bounds(start: Mapping[str, float], bounds) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of ln of the parameters."""
    for name in bounds:
        if name not in start:
            known = ", ".join(start)
            raise InputError(f"bounds: {name!r} is no parameter; expected one of: {known}.")
    found = []
    for name, value in start.items():
        low, high = bounds.get(name, (value / _RANGE, value * _RANGE))
        if not 0 < low < value < high < np.inf:
            raise InputError(
                f"bounds[{name!r}] = {(low, high)}: expected 0 < low < start = {value:g} < high."
            )
        found.append((np.log(low), np.log(high)))
    low, high = np.array(found).T
    return low, high


def checked_data(curves, level, points, loops, sensor) -> list[_Curve | _Loop]:
    found: list[_Curve | _Loop] = []
    if curves is not None:
        if level is None:
            raise InputError("level = None: expected the level of one of the curves, N.")
        frequencies, amplitudes = curves.at(level)
        if not 3 <= points:
            raise InputError(f"points = {points}: expected at least 3.")
        kept = near_peak(amplitudes, points)
        found.append(_Curve(level, frequencies[kept], amplitudes[kept], sensor, curves.response))
    elif level is not None:
        raise InputError(f"level = {level:g}: expected curves that have it.")
    found += [_Loop(loop, sensor) for loop in loops]
    if not found:
        raise InputError("there are no data: expected curves and a level, or loops.")
    return found


# -- prediction ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Prediction:
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
            "level": self.level, "frequency_hz": self.frequencies_hz.tolist(),
            "measured": self.measured.tolist(), "computed": self.computed.tolist(),
            "objective": self.objective, "mean_error": self.mean_error,
            "measured_peak": list(measured), "computed_peak": list(computed),
            "frequency_error": self.frequency_error, "amplitude_error": self.amplitude_error,
        }  # fmt: skip


def predict(
    model: InterfaceModel,
    curves: MeasuredCurves,
    levels: Sequence[float] | None = None,
    *,
    force: str,
    sensor: str,
    points: int = 9,
    harmonics: int = 3,
    samples: int | None = None,
    static: np.ndarray | None = None,
    settings: Settings | None = None,
    comm: MPI.Comm | None = None,
) -> tuple[Prediction, ...]:
    """The model's responses at the measured frequencies, and their errors, by level.

    Args:
        model: The model.
        curves: Measured curves.
        levels: Levels, N; all by default.
        force, sensor, points, harmonics, samples, static, settings, comm: As for `identify`.

    Raises:
        InputError: For an unknown name or level.
        ConvergenceError: If a response is not found.
    """
    found = []
    for level in curves.levels if levels is None else levels:
        frequencies, measured = curves.at(level)
        result = solve_harmonic(
            model, force, level, at=frequencies, harmonics=harmonics, samples=samples,
            static=static, sensor=sensor, settings=settings, comm=comm,
        )  # fmt: skip
        computed = result.amplitude(sensor, curves.response, "first")
        kept = near_peak(measured, points)
        found.append(Prediction(level, frequencies, measured, computed, kept, result))
    return tuple(found)
