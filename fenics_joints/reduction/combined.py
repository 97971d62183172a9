"""The reduced model in the loop of a combined update, made better where it turns out to be off."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np
from scipy.stats import qmc

from fenics_joints.errors import InputError
from fenics_joints.measurements import Pairing, Target, pair_modes
from fenics_joints.measurements.gap import largest_difference, same_modes
from fenics_joints.modal.modes import Modes, solve_modes
from fenics_joints.progress import Progress
from fenics_joints.reduction.adaptive import Points
from fenics_joints.reduction.arrays import ArrayModel
from fenics_joints.reduction.frf_basis import ResponseSampler, frf_error, response_loads
from fenics_joints.reduction.reduced import ReducedStructure
from fenics_joints.response.complex_modes import damping_ratios
from fenics_joints.structure import Damping, Parameter, Structure

#: Samples for each parameter, beside the start, and their range about it, a factor either way.
_SAMPLES, _RANGE = 2, 30.0

#: Share of the largest energy below which a direction is left out of the basis: at first, and by
#: which factor it falls when the model is bettered.
_BASIS, _FINER = 1e-5, 0.03
#: Largest accepted relative error of the reduced model's frequencies; and of its functions and
#: damping ratios, as a share of the noise.
_FREQUENCY, _SHARE = 2e-4, 0.1
#: Lines at which functions are checked against the direct solution.
_CHECKED = 6
#: Modes of every sample reach this multiple of the highest line, but are no more than that many
#: times as many as asked for: without the modes in its band a function is not in the basis.
_REACH, _MOST = 1.2, 6


@dataclass(frozen=True)
class ModelError:
    """Error of the reduced model at some values against the full one.

    Attributes:
        frequencies: Largest relative error of the paired frequencies; 0 without any.
        frfs: Largest |H - H_full| / |H_full| over the lines that were checked; None without.
        damping: Largest relative error of the damping ratios that are data; None without.
    """

    frequencies: float
    frfs: float | None
    damping: float | None = None

    def share(self, limits: ModelError) -> float:
        """The largest of the errors as a share of its limit."""
        return max((getattr(self, f.name) or 0.0) / getattr(limits, f.name) for f in fields(self))


class CombinedModel:
    """A reduced model for the frequencies, shapes, ratios and functions of a target. Collective.

    Its basis holds modes and, for functions, residual vectors of their forces and sensors, and for
    them and for damping ratios those of damped layers, at samples of the parameters; more samples
    can be added.

    Args:
        full: The full model.
        target: The data.
        damping: The damping, its values numbers or parameters.
        n_modes: Modes of the full model at a sample; more where they do not reach the lines.

    Attributes:
        arrays: The reduced model as it is now.
        samples: How many samples are in it.
        limits: Largest accepted errors.
        error: Of the reduced model at the last of the points that it was looked at.
    """

    arrays: ArrayModel
    error: ModelError

    def __init__(self, full: Structure, target: Target, damping: Damping, n_modes: int):
        self.full, self.target, self.damping, self.n_modes = full, target, damping, n_modes
        self.samples, self._tolerance, self._most = 0, _BASIS, _MOST * n_modes
        self.limits = error_limits(target)
        self._exact = None
        self._last: Modes | None = None
        self._ratios: dict[tuple, np.ndarray] = {}
        frfs = target.frfs
        loads = frfs if frfs is None else response_loads(full, frfs.excitation, frfs.sensors)
        lines = None if frfs is None else frfs.frequencies_hz
        self._sampler = ResponseSampler(full, n_modes, loads, lines, damping)

    def sample(
        self, parameters: Sequence[Parameter], start: Mapping[str, float], progress: Progress
    ) -> None:
        """Make the first basis, about the start."""
        samples = sample_values(self.full, parameters, start)
        progress.step("reduced model: sampling the parameters", len(samples))
        for values in samples:
            self.add(values)
            progress.advance()
        self.build()

    def add(self, values: Mapping[str, float]) -> None:
        """Take the modes and residual vectors at some values into the basis of the next `build`."""
        sampler = self._sampler
        modes = sampler.modes(values)
        while self._wants_more(modes):
            self.n_modes = min(self.n_modes + self.n_modes // 2, self._most, self.full.n_dofs)
            for solver in (sampler.solver, self._exact):
                if solver is not None:
                    solver.destroy()
            sampler.n_modes, sampler.solver = self.n_modes, None
            self._exact = self._last = None
            modes = sampler.modes(values)
        damped = "damping" in self.target.kinds and bool(self.damping.layers)
        sampler.add(values, modes, self.target.frfs is not None or damped)
        self.samples += 1

    def _wants_more(self, modes: Modes) -> bool:
        """Whether the modes end below the lines."""
        frfs = self.target.frfs
        if frfs is None or self.n_modes >= min(self._most, self.full.n_dofs):
            return False
        return modes.frequencies_hz[-1] < _REACH * frfs.frequencies_hz.max()

    def build(self) -> ArrayModel:
        """The reduced model on all samples so far."""
        places, target = [], self.target
        if target.shape_sensors is not None:
            places.append(target.shape_sensors)
        if target.frfs is not None:
            places += [target.frfs.excitation, target.frfs.sensors]
        reduced = ReducedStructure(self.full, self._sampler.snapshots.basis(self._tolerance))
        self.arrays = reduced.arrays(*places)
        return self.arrays

    def extend(self, points: Points) -> None:
        """Take more samples into the basis, and directions of less energy."""
        for values in points:
            self.add(values)
        self._tolerance *= _FINER
        self.build()

    def errors(self, points: Points) -> np.ndarray:
        """Largest share of its limit that an error takes at each point, (n,)."""
        found = [self.error_at(values, self.modes(values)) for values in points]
        self.error = found[-1]
        return np.array([error.share(self.limits) for error in found])

    def modes(self, values: Mapping[str, float]) -> Modes:
        """Modes of the full model."""
        if self._last is None or self._last.given != dict(values):
            self._last = solve_modes(self.full, values, n_modes=self.n_modes, solver=self._exact)
            self._exact = self._last.solver
        return self._last

    def ratios(self, values: Mapping[str, float], modes: Modes) -> np.ndarray | None:
        """Damping ratios of the full model's modes that are the test's, (m,); None if no data.

        Args:
            values: Values of the parameters.
            modes: Modes of the full model there, the last that were found; remembered.
        """
        if "damping" not in self.target.kinds:
            return None
        key = tuple(values.items())
        if key not in self._ratios:
            index = paired(modes, self.target).index
            self._ratios[key] = damping_ratios(self.full, values, self.damping, modes, index)[0]
        return self._ratios[key]

    def error_at(self, values: Mapping[str, float], modes: Modes) -> ModelError:
        """Error of the reduced model.

        Args:
            values: Values of the parameters.
            modes: Modes of the full model there.
        """
        frequencies, target, off = 0.0, self.target, None
        if len(target):
            own = solve_modes(self.arrays, values, n_modes=min(self.n_modes, self.arrays.n_dofs))
            mine, pairing = paired(own, target), paired(modes, target)
            frequencies = largest_difference(own, mine, modes, pairing, target.shape_sensors)
            exact = self.ratios(values, modes)
            if exact is not None:
                hz = modes.frequencies_hz[pairing.index]
                index = same_modes(own, target.shape_sensors, pairing.shapes, hz)
                ours, _ = damping_ratios(self.arrays, values, self.damping, own, index)
                used = np.isfinite(target.damping_ratios)
                off = float(np.max(np.abs(ours / exact - 1)[used]))
        if target.frfs is None:
            return ModelError(frequencies, None, off)
        found = frf_error(
            self.arrays,
            self.full,
            [values],
            frequencies_hz=target.frfs.frequencies_hz,
            excitation=target.frfs.excitation,
            sensors=target.frfs.sensors,
            damping=self.damping,
            lines=_CHECKED,
        )
        return ModelError(frequencies, found.worst, off)


def error_limits(target: Target) -> ModelError:
    """Largest accepted errors of a reduced model for these data."""
    frfs, functions = target.frfs, np.inf
    if frfs is not None:
        functions = _SHARE * float(np.median(frfs.relative_sd[frfs.used]))
    there = np.isfinite(target.damping_ratios)
    ratios = _SHARE * float(target.damping_log_sd[there].min(initial=np.inf))
    return ModelError(_FREQUENCY, functions, ratios)


def paired(modes: Modes, target: Target) -> Pairing:
    """A model's modes that are the test's."""
    return pair_modes(modes, len(target), target.shape_sensors, reference=target.shapes)


def sample_values(
    full: Structure,
    parameters: Sequence[Parameter],
    start: Mapping[str, float],
    count: int | None = None,
    span: tuple[float, float] = (_RANGE, _RANGE),
) -> list[dict[str, float]]:
    """The start, and a Sobol sequence of parameters about it that the laws allow.

    Args:
        full: The full model.
        parameters: What is varied.
        start: Values of all parameters.
        count: How many samples beside the start; by default some for each parameter.
        span: Range about the start, as factors down and up.
    """
    count = _SAMPLES * len(parameters) if count is None else count
    samples = [dict(start)]
    for row in qmc.Sobol(len(parameters), seed=1).random_base2(7) if parameters else ():
        point = {
            p.name: _between(p, start[p.name], span, share)
            for p, share in zip(parameters, row, strict=True)
        }
        values = {**start, **point}
        if allowed(full, values):
            samples.append(values)
        if len(samples) > count:
            break
    return samples


def allowed(full: Structure, values: Mapping[str, float]) -> bool:
    """Whether the laws of a structure take these values."""
    try:
        for number, region in enumerate(full.regions):
            q = full.field.region_values(number, values)
            if q is not None:
                region.law.check(region.name, q)
    except InputError:
        return False
    return True


def _between(parameter: Parameter, start: float, span: tuple[float, float], share: float) -> float:
    """A value within a factor of the start and the bounds, by logarithm if that is its scale."""
    if not parameter.log and np.isfinite([parameter.lower, parameter.upper]).all():
        return float(parameter.lower + share * (parameter.upper - parameter.lower))
    low = max(start / span[0], parameter.lower)
    high = min(start * span[1], parameter.upper)
    return float(np.exp(np.log(low) + share * (np.log(high) - np.log(low))))
