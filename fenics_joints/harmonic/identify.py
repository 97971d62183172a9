"""Parameters of nonlinear joint laws from measured responses near a resonance.

Iranzad and Ahmadian 2012, section 5: the parameters make the least of eq. 6, sum |a - a_e| / a_e
over a few points near the peak of one level's curve; what they predict of other levels is the test
of the model. `identify` does it by direct search, as the paper, or by least squares with the exact
derivatives of harmonic balance. Loops of force against response, which the paper takes its
sharpness n from, enter alike; so does a measured backbone, frequency and damping over amplitude.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from textwrap import shorten

import numpy as np
from scipy.optimize import minimize

from fenics_joints.errors import ConvergenceError, InputError, member, real, reals, wanted, whole
from fenics_joints.harmonic.backbone import NonlinearMode
from fenics_joints.harmonic.fourier import basis
from fenics_joints.harmonic.frf import solve_harmonic
from fenics_joints.harmonic.measured_mode import MeasuredLoop, ModeData, Offset, as_motion
from fenics_joints.harmonic.result import HarmonicResult
from fenics_joints.interfaces.model import InterfaceModel
from fenics_joints.measurements.amplitude.backbone import MeasuredBackbone
from fenics_joints.measurements.curves import MeasuredCurves
from fenics_joints.measurements.least_squares import LeastSquares
from fenics_joints.modal.sensitivity import Identifiability, identifiability

# -- measured curves against a model's -------------------------------------------------------------


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


# -- residuals -------------------------------------------------------------------------------------


#: Relative change of a width from which the search is repeated; chosen.
_SAME_WIDTH = 0.1
#: The model for values of its parameters.
Change = Callable[[Mapping[str, float]], InterfaceModel]


class _ForcedData:
    """Responses at some frequencies to a force of one level, measured at one sensor."""

    level: float
    frequencies: np.ndarray
    sensor: str

    def solve(self, model: InterfaceModel, force: str, options, warm) -> HarmonicResult:
        """The model's responses."""
        return solve_harmonic(
            model,
            force,
            self.level,
            at=self.frequencies,
            sensor=self.sensor,
            initial=warm,
            **options,
        )


@dataclass(frozen=True)
class CurveData(_ForcedData):
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

    def jacobian(self, result: HarmonicResult, change: Change, values) -> np.ndarray:
        """Derivatives of the residual by the parameters, (n, parameters)."""
        gradient = result.by_parameters(change, values)
        return gradient.amplitude(self.sensor, self.kind, "first") / self.amplitudes[:, None]


class LoopData(_ForcedData):
    """One measured loop; residuals whose root of the sum of squares is its relative rms error."""

    def __init__(self, loop: MeasuredLoop, sensor: str):
        self.loop, self.sensor, self.level = loop, sensor, loop.level
        self.frequencies = np.array([loop.frequency_hz])
        self._scale = np.sqrt(len(loop.times)) * float(np.std(loop.responses))

    def __len__(self) -> int:
        return len(self.loop.times)

    def objective(self, residual: np.ndarray) -> float:
        """It counts as one point of a curve, with its relative rms error."""
        return float(np.linalg.norm(residual))

    def _made(self, coefficients: np.ndarray) -> np.ndarray:
        """Responses of harmonics (..., K) at the samples, (n, ...); none measures the mean."""
        at = basis(self.loop.angles(), coefficients.shape[-1])
        return at[:, 1:] @ coefficients[..., 1:].T / self._scale

    def residual(self, result: HarmonicResult) -> np.ndarray:
        """Error at each sample, over root n times the response's deviation, (n,)."""
        measured = self.loop.responses - self.loop.responses.mean()
        made = self._made(result.sensor_coefficients(self.sensor, self.loop.response)[0])
        return made - measured / self._scale

    def jacobian(self, result: HarmonicResult, change: Change, values) -> np.ndarray:
        """Derivatives of the residual by the parameters, (n, parameters)."""
        gradient = result.by_parameters(change, values)
        return self._made(gradient.sensor_coefficients(self.sensor, self.loop.response)[0])


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
        self.gradients = self.solutions = self.iterations = 0
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
        """Widen the errors of measured modes to the residuals that the model leaves; whether any
        width changed."""
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


def checked_data(curves, level, points, loops, sensor, modes=()) -> list:
    """What is fitted: the points near the peak of a level's curve, loops, and measured modes.

    Raises:
        InputError: For an unknown level, too few points, or no data.
    """
    found: list[CurveData | LoopData | ModeData] = []
    if curves is not None:
        if level is None:
            raise InputError("level = None: expected the level of one of the curves, N.")
        frequencies, amplitudes = curves.at(level)
        kept = near_peak(amplitudes, whole("points", points, 3))
        found.append(CurveData(level, frequencies[kept], amplitudes[kept], sensor, curves.response))
    elif level is not None:
        raise InputError(f"level = {level:g}: expected curves that have it.")
    found += [*(LoopData(loop, sensor) for loop in loops), *modes]
    if not found:
        raise InputError("there are no data: expected curves and a level, loops, or a backbone.")
    return found


# -- the search ------------------------------------------------------------------------------------


#: Default bounds of a parameter: its start divided by this, and times this; chosen.
_RANGE = 1e3
#: First steps, of ln of the parameters, of the search by gradient on a mode over its amplitude;
#: chosen.
_STRIDE = 0.3
#: Most searches with errors of a backbone that are widened in between; chosen.
_WIDENINGS = 8
#: First steps of the direct search, of ln of the parameters; chosen.
_SIMPLEX = 0.3


@dataclass(frozen=True, kw_only=True, repr=False)
class IdentificationResult:
    """Identified parameters, how they were found, and how well the data determine them.

    Attributes:
        method: ``direct`` or ``gradient``.
        level: Amplitude of the force of the curve, N; of the first loop if there is no curve; of a
            backbone alone its highest amplitude.
        frequencies_hz: Selected frequencies of the curve, Hz.
        start: Values at the start, by name.
        values: Values found.
        objective: Eq. 6 at those values.
        start_objective: Eq. 6 at the start.
        history: Eq. 6 at each evaluation; infinite where there was no response.
        trials: Parameters at each evaluation, (evaluations, parameters).
        solutions: Single periodic solutions that were found.
        iterations: Newton iterations in them.
        gradients: Derivatives, each without a further solution.
        residuals: Relative residuals at the values, (n,).
        jacobian: d residuals / d ln of the parameters, (n, parameters).
        noise: Relative standard deviation that a residual is taken to have, the larger of what was
            given and the residuals' own.
        known: What the data determine: standard deviations of ln of the parameters (`sd`),
            condition number, and the parameters that are left open.
        at_bound: Parameters that ended at a bound.
        message: How the optimiser ended.
        model: The model with these values.
        responses: Its responses, one of the curve and one of each loop; a `NonlinearMode` of a
            backbone.
        mode: The backbone as it was fitted, with the widths of its errors; or None.
        offsets: What the model lacks at rest by that backbone: its frequency, relative, and its
            damping ratio.
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
    solutions: int
    iterations: int
    gradients: int
    residuals: np.ndarray
    jacobian: np.ndarray
    noise: float
    known: Identifiability
    at_bound: tuple[str, ...]
    message: str
    model: InterfaceModel
    responses: tuple[HarmonicResult | NonlinearMode, ...]
    mode: ModeData | None = None
    offsets: Mapping[str, Offset] = field(default_factory=dict)

    def __repr__(self) -> str:
        values = ", ".join(f"{name} = {value:.4g}" for name, value in self.values.items())
        return f"IdentificationResult({shorten(values, 60)}; objective {self.objective:.3g})"

    @property
    def evaluations(self) -> int:
        """Responses of the model that were asked for, at all selected frequencies (and of all
        loops) each."""
        return len(self.history)

    @property
    def failures(self) -> int:
        """Evaluations without a response."""
        return int(np.isinf(self.history).sum())

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
        keys = "method level start values objective start_objective evaluations solutions "
        keys += "iterations gradients failures noise at_bound message"
        return {key: getattr(self, key) for key in keys.split()} | {
            "frequency_hz": self.frequencies_hz.tolist(),
            "history": [float(v) if np.isfinite(v) else None for v in self.history],
            "trials": self.trials.tolist(),
            "residuals": self.residuals.tolist(),
            "sd_ln": {k: v if np.isfinite(v) else None for k, v in self.sd.items()},
            "condition": self.known.condition if np.isfinite(self.known.condition) else None,
            "undetermined": list(self.undetermined),
            "backbone": None if self.mode is None else self._mode_dict(),
        }

    def _mode_dict(self) -> dict:
        """The measured and the computed mode."""
        measured, points = self.mode.measured, self.responses[-1]
        return {
            "kind": measured.kind,
            "displacement_m": self.mode.displacements.tolist(),
            "measured_hz": measured.frequencies_hz.tolist(),
            "measured_damping": [z if np.isfinite(z) else None for z in measured.damping.tolist()],
            "computed_hz": points.frequencies_hz.tolist(),
            "computed_damping": points.damping_ratios.tolist(),
            "error_widths": list(self.mode.widths),
            "at_rest": {k: {"value": o.value, "sd": o.sd} for k, o in self.offsets.items()},
        }


def identify(
    change: Change,
    curves: MeasuredCurves | None,
    level: float | None,
    parameters: Mapping[str, float],
    *,
    force: str,
    sensor: str,
    method: str = "gradient",
    points: int = 9,
    loops: Sequence[MeasuredLoop] = (),
    backbone: MeasuredBackbone | None = None,
    rest: float | None = None,
    rest_damping: float | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    noise: float = 0.01,
    tolerance: float = 1e-3,
    max_evaluations: int = 200,
    harmonics: int = 3,
    **options,
) -> IdentificationResult:
    """Find parameters of nonlinear laws from the curve of one level, loops, a backbone, or several.

    Works on ln of the parameters. ``direct`` minimises eq. 6 by Nelder and Mead's simplex;
    ``gradient`` its squares by a trust-region method (both scipy's). Each response starts from the
    last one. A trial whose response is not found counts as one, and is turned away.

    Of a backbone the law is in how frequency and damping change: the frequency counts up to a
    factor and damping up to a constant, which the model at rest may be off. What the model does not
    follow widens the errors of frequency and of damping, each of its own, until both fit.

    Args:
        change: The model for values of the parameters, by name, such as
            `InterfaceModel.with_parameters`.
        curves: Measured curves; None to take loops alone.
        level: The level to take, N; None without curves.
        parameters: Values to start from, > 0, by name.
        force: Place of the force.
        sensor: The sensor that was measured.
        method: ``direct`` or ``gradient``.
        points: Points of the curve that are taken, those of the largest amplitudes.
        loops: Loops of force against the sensor's response. One counts as one point of the curve.
        backbone: Frequency and damping over amplitude of the mode near its lowest frequency.
        rest: Relative error of the model's frequency at rest, one standard deviation; 1 %.
        rest_damping: Error of its damping ratio at rest; as large as the lowest one measured.
        bounds: Least and largest value by name; by default a thousandth of the start and a
            thousand times.
        noise: Relative standard deviation of a measured amplitude.
        tolerance: Change of ln of the parameters, and relative one of the objective, at the end.
        max_evaluations: Most responses.
        harmonics, options: ``samples``, ``static``, ``settings``, ``comm``: As for
            `solve_harmonic`.

    Raises:
        InputError: For an unknown name, a value out of range, or no data.
        ConvergenceError: If there is no response at the start.
    """
    member("method", method, ("direct", "gradient"))
    start = _checked_start(parameters)
    low, high = _checked_bounds(start, bounds or {})
    for key, value in (("noise", noise), ("tolerance", tolerance)):
        real(key, value, above=0, most=1)
    whole("max_evaluations", max_evaluations, 2)
    modes = []
    if backbone is not None:
        moved = as_motion(backbone, change(start), force, sensor)
        modes = [ModeData.of(moved, sensor, noise, rest, rest_damping)]
    data = checked_data(curves, level, points, loops, sensor, modes)
    fit = CurveFit(change, start, data, force, {"harmonics": harmonics, **options})
    x = np.log(list(start.values()))
    first = fit.objective(fit.residual(x))  # raises what is wrong with names and model
    search = _direct if method == "direct" else _gradient
    begun, rounds = x, 0
    # From wide errors to narrow ones: what the law does not follow must not lead it astray first.
    fit.widen(x)
    while True:
        x, message = search(fit, x, low, high, tolerance, max_evaluations)
        rounds += 1
        if rounds >= _WIDENINGS or not fit.widen(x):
            break
    if modes:
        first = fit.objective(fit.residual(begun))  # with the errors of the end
    return _finished(fit, method, start, first, x, (low, high), noise, message)


def _direct(fit: CurveFit, x, low, high, tolerance, most):
    """Nelder and Mead's simplex on eq. 6."""

    def objective(x):
        r = fit.tried(x)
        return np.inf if r is None else fit.objective(r)

    # A first step away from the nearer bound.
    steps = np.where(high - x > _SIMPLEX, _SIMPLEX, -np.minimum(_SIMPLEX, x - low))
    options = {
        "initial_simplex": np.vstack([x, x + np.diag(steps)]),
        "xatol": tolerance,
        "fatol": tolerance * max(fit.history[0], 1e-300),
        "maxfev": most - 1,
    }
    found = minimize(
        objective,
        x,
        method="Nelder-Mead",
        bounds=list(zip(low, high, strict=True)),
        options=options,
    )
    return found.x, str(found.message)


def _gradient(fit: CurveFit, x, low, high, tolerance, most):
    """Trust-region least squares with exact derivatives."""
    start, size = x, len(fit.residual(x))
    # A mode hardly changes at first, and a long step would leap over all that it does.
    stride = _STRIDE if any(isinstance(one, ModeData) for one in fit.data) else 1.0

    def residual(change):
        r = fit.tried(start + change)
        return np.full(size, np.inf) if r is None else r

    problem = LeastSquares(
        residual, lambda change: fit.jacobian(start + change), bounds=(low - start, high - start)
    )
    found = problem.solve(
        np.zeros_like(x), most, x_scale=stride, xtol=tolerance, ftol=tolerance, gtol=1e-12
    )
    return start + found.x, str(found.message)


def _finished(fit, method, start, first, x, bounds, noise, message) -> IdentificationResult:
    r, J = fit.residual(x), fit.jacobian(x)
    # What the model cannot follow is noise to the parameters.
    spread = max(noise, float(np.sqrt(r @ r / max(len(r) - len(x), 1))))
    values = fit.values(x)
    met = [min(abs(x[i] - b[i]) for b in bounds) < 1e-6 for i in range(len(x))]
    curve = next((d for d in fit.data if isinstance(d, CurveData)), None)
    mode = next((d for d in fit.data if isinstance(d, ModeData)), None)
    return IdentificationResult(
        method=method,
        level=fit.data[0].level,
        frequencies_hz=np.empty(0) if curve is None else curve.frequencies,
        start=dict(start),
        values=values,
        objective=fit.objective(r),
        start_objective=first,
        history=np.array(fit.history),
        trials=np.array(fit.trials),
        solutions=fit.solutions,
        iterations=fit.iterations,
        gradients=fit.gradients,
        residuals=r,
        jacobian=J,
        noise=spread,
        known=identifiability(J / spread, fit.names),
        at_bound=tuple(n for n, m in zip(fit.names, met, strict=True) if m),
        message=message,
        model=fit.change(values),
        responses=tuple(fit.results),
        mode=mode,
        offsets={} if mode is None else mode.offsets(fit.results[-1]),
    )


def _checked_start(parameters: Mapping[str, float]) -> dict[str, float]:
    if not parameters:
        raise InputError("parameters: there are none; expected a start value for each by name.")
    return {
        name: real(f"parameters[{name!r}]", value, above=0) for name, value in parameters.items()
    }


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
