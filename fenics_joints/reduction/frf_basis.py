"""Reduced models for frequency response functions, checked against the full one.

Modes alone are a poor basis for an FRF: a force at a point excites all modes, and the response of
those beyond the basis decides where the antiresonances are. So the basis also holds, at every
sample of the parameters, residual vectors for the forces, the sensors and the damped layers (see
`response.modal_basis`). `frf_error` gives the error against the direct solution of the full model,
and `checked_frf_model` adds samples until it is small enough at given points.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np
from scipy.stats import qmc

from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.measurements import Pairing, Target, pair_modes
from fenics_joints.measurements.gap import largest_difference, same_modes
from fenics_joints.modal.modes import Modes, solve_modes
from fenics_joints.progress import Progress
from fenics_joints.reduction.arrays import ArrayModel
from fenics_joints.reduction.basis import SNAPSHOT, Points, Snapshots
from fenics_joints.reduction.reduced import ReducedStructure
from fenics_joints.response.complex_modes import damping_ratios
from fenics_joints.response.frf import solve_frf
from fenics_joints.response.modal_basis import check_lines, modal_pencil
from fenics_joints.response.pencil import DampedPencil
from fenics_joints.structure import Damping, Parameter, Sensors, Structure

Values = Mapping[str, float]


@dataclass(frozen=True)
class FRFError:
    """Error of a reduced model's FRFs against the full one's direct solution.

    Attributes:
        frequencies_hz: Lines at which it was found, Hz, (n_f,).
        relative: |H - H_full| / |H_full|, (n_points, n_f, n_sensors, n_excitations).
    """

    frequencies_hz: np.ndarray
    relative: np.ndarray

    @property
    def by_point(self) -> np.ndarray:
        """The largest relative error at each point, (n_points,)."""
        return self.relative.max(axis=(1, 2, 3))

    @property
    def worst(self) -> float:
        """The largest relative error of all."""
        return float(self.relative.max())

    def __repr__(self) -> str:
        points, lines = self.relative.shape[:2]
        return f"FRFError(at most {self.worst:.2g} at {points} points, {lines} lines)"


@dataclass(frozen=True)
class CheckedFRFModel:
    """A reduced model and its error.

    Attributes:
        reduced: The reduced model.
        arrays: The same as plain arrays, with displacements where forces and sensors are.
        error: Its error at the points where it was checked.
        history: In each round: size of the basis, largest relative error over all points.
    """

    reduced: ReducedStructure
    arrays: ArrayModel
    error: FRFError
    history: tuple[tuple[int, float], ...]

    def __repr__(self) -> str:
        return f"CheckedFRFModel({self.reduced.n_dofs} vectors, {self.error!r})"


class ResponseSampler:
    """Modes and residual vectors at one sample after the other, one factorisation each.

    Args:
        structure: The full model.
        n_modes: Modes at each sample.
        loads: Forces and rows of sensors as columns, (n_local, k); None for none.
        lines: Lines of interest, Hz; None for the modes' own frequencies.
        damping: The damping.

    Attributes:
        snapshots: The modes and residual vectors.
    """

    def __init__(
        self, structure: Structure, n_modes: int, loads: np.ndarray | None, lines, damping: Damping
    ):
        self.structure, self.n_modes, self.damping = structure, n_modes, damping
        self.loads, self.lines = loads, lines
        self.snapshots, self.solver = Snapshots(structure), None

    def modes(self, given: Values) -> Modes:
        """Modes at a sample."""
        modes = solve_modes(
            self.structure, given, n_modes=self.n_modes, solver=self.solver, tolerance=SNAPSHOT
        )
        self.solver = modes.solver
        return modes

    def add(self, given: Values, modes: Modes, residual: bool = True) -> None:
        """Take the modes in, and residual vectors for the loads and the damped layers."""
        more = None
        if residual:
            lines = modes.frequencies_hz[modes.n_rigid :] if self.lines is None else self.lines
            pencil = DampedPencil(self.structure, given, self.damping)
            try:
                modal = modal_pencil(pencil, self.loads, lines, modes=modes)
            finally:
                pencil.destroy()
            more = modal.basis[:, len(modes) :]
        self.snapshots.add(modes, more=more)


def response_loads(structure: Structure, excitation: Sensors, sensors: Sensors) -> np.ndarray:
    """Loads of a unit at excitations and sensors, this rank's rows, (n_local, k)."""
    return np.hstack([structure.loads(excitation, "excitation"), structure.loads(sensors)])


def _sampled(structure, samples, n_modes, asked) -> ResponseSampler:
    """Modes and residual vectors at samples."""
    damping = asked.get("damping") or Damping()
    damping.check(structure.parameters, structure.layers)
    loads = response_loads(structure, asked["excitation"], asked["sensors"])
    lines = check_lines(asked["frequencies_hz"])
    sampler = ResponseSampler(structure, n_modes, loads, lines, damping)
    for given in samples:
        sampler.add(given, sampler.modes(given))
    return sampler


def frf_basis(
    structure: Structure,
    samples: Iterable[Values],
    *,
    n_modes: int,
    tolerance: float = 1e-8,
    travel: Mapping[str, tuple[float, float]] | None = None,
    **asked,
) -> ReducedStructure:
    """Reduced model on modes and residual vectors at samples of the parameters. Collective.

    Args:
        structure: The full model.
        samples: Values at which they are computed.
        n_modes: Modes at each sample, rigid-body ones included.
        tolerance: Directions with less than this share of the largest energy are left out.
        travel: Ranges of moving masses, see `ReducedStructure`.
        asked: ``frequencies_hz`` (lines of interest, whose median weighs the layers' damping),
            ``excitation``, ``sensors`` and ``damping``, as `fenics_joints.response.solve_frf` has
            them. Damped layers get residual vectors of their own.

    Raises:
        InputError: Without samples, or if a value is out of range or a point outside the mesh.
        ConvergenceError: If modes were not found.
    """
    sampler = _sampled(structure, samples, n_modes, asked)
    return ReducedStructure(structure, sampler.snapshots.basis(tolerance), travel)


def frf_error(
    reduced, structure: Structure, at: Sequence[Values], *, lines: int | None = 5, **asked
) -> FRFError:
    """Error of FRFs of a reduced model at parameter values. Collective.

    Receptance, mobility and accelerance have the same relative error.

    Args:
        reduced: A `ReducedStructure` or `ArrayModel`.
        structure: The full model, which is solved directly; by modes where it has modal ratios.
        at: Values of the parameters, n_points sets of them.
        lines: At how many lines, evenly from the first to the last; None for all.
        asked: As in `frf_basis`.

    Raises:
        InputError: As `solve_frf`; without values.
        ConvergenceError: If a line is at a resonance without damping.
    """
    if not len(at):
        raise InputError("at: expected at least one set of parameter values.")
    asked |= {"frequencies_hz": _some(check_lines(asked["frequencies_hz"]), lines)}
    return _error(reduced, at, [_exact(structure, given, asked) for given in at], asked)


def checked_frf_model(
    structure: Structure,
    samples: Sequence[Values],
    points: Sequence[Values],
    *,
    n_modes: int,
    error: float = 1e-3,
    lines: int | None = 5,
    rounds: int = 8,
    tolerance: float = 1e-8,
    travel: Mapping[str, tuple[float, float]] | None = None,
    **asked,
) -> CheckedFRFModel:
    """Reduced model whose FRFs have no larger error than asked at points. Collective.

    The point with the largest error becomes a sample, until all errors are small enough.

    Args:
        structure: The full model.
        samples: Values at which the basis is made to begin with.
        points: Values at which the error shall be small.
        n_modes: As in `frf_basis`.
        error: Largest relative error of any FRF at any of the points and lines.
        lines: At how many lines each point is checked, see `frf_error`.
        rounds: How many points may be added.
        tolerance: As in `frf_basis`.
        travel: Ranges of moving masses.
        asked: As in `frf_basis`.

    Raises:
        InputError: As `frf_basis`.
        ConvergenceError: If the error is still larger after all rounds.
    """
    if not len(samples) or not len(points):
        raise InputError("samples and points: expected at least one set of values in each.")
    sampler = _sampled(structure, samples, n_modes, asked)
    asked |= {"frequencies_hz": _some(sampler.lines, lines)}
    exact = [_exact(structure, given, asked) for given in points]
    history, own = [], np.zeros(len(points), dtype=bool)
    while True:
        reduced = ReducedStructure(structure, sampler.snapshots.basis(tolerance), travel)
        found = _error(reduced, points, exact, asked)
        history.append((reduced.n_dofs, found.worst))
        worst = int(np.argmax(np.where(own, 0.0, found.by_point)))
        late = found.worst > error
        if not late or len(history) > rounds or own.all() or found.by_point[worst] <= error:
            break
        own[worst] = True
        sampler.add(points[worst], sampler.modes(points[worst]))
    if late:
        raise ConvergenceError(
            f"the FRFs of the reduced model of {reduced.n_dofs} vectors have an error of "
            f"{found.worst:.1e} at the worst of {len(points)} points, more than the {error:.1e} "
            "asked for: allow more rounds, more modes or a smaller tolerance."
        )
    arrays = reduced.arrays(asked["excitation"], asked["sensors"])
    return CheckedFRFModel(reduced, arrays, found, tuple(history))


def _some(lines: np.ndarray, count: int | None) -> np.ndarray:
    """Some of the lines, evenly from the first to the last."""
    if count is None or count >= len(lines):
        return lines
    if count < 1:
        raise InputError(f"lines = {count}: expected at least 1, or None for all.")
    return lines[np.unique(np.linspace(0, len(lines) - 1, count).round().astype(int))]


def _exact(structure, given: Values, asked) -> np.ndarray:
    """Receptances of the full model, (n_f, n_sensors, n_excitations)."""
    modal = asked.get("damping") and asked["damping"].is_modal
    settings = {"method": "modal", "check": 0} if modal else {}
    return solve_frf(structure, given, **asked, **settings).values


def _error(reduced, at: Sequence[Values], exact, asked) -> FRFError:
    found = np.array([solve_frf(reduced, given, **asked).values for given in at])
    return FRFError(asked["frequencies_hz"], np.abs(found / np.array(exact) - 1))


#: Samples for each parameter beside the start: chosen; the error is checked.
_SAMPLES = 2
#: Range of the samples, a factor up and down from the start: chosen.
_RANGE = 30.0
#: Share of the largest energy below which a direction is left out of the first basis, and its
#: factor each time the model is extended: chosen; the error is checked.
_BASIS, _FINER = 1e-5, 0.03
#: Largest accepted relative error of frequencies: well below the noise of tests.
_FREQUENCY = 2e-4
#: Largest accepted error of functions and damping ratios, as a share of their noise: chosen.
_SHARE = 0.1
#: Lines at which functions are checked against the direct solution: chosen, for time.
_CHECKED = 6
#: Frequency that the modes of a sample must reach, over the highest line, since the basis needs the
#: modes in the band; and their largest number, over that asked for: chosen.
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
    """A reduced model for the frequencies, shapes, damping ratios and functions of a target.
    Collective.

    Its basis holds modes at samples of the parameters. For functions it also holds residual vectors
    of forces and sensors, and for functions and damping ratios those of damped layers.

    Args:
        full: The full model.
        target: The data.
        damping: The damping, its values numbers or parameters.
        n_modes: Modes of the full model at a sample; more if they do not reach the lines.

    Attributes:
        arrays: The current reduced model.
        samples: Number of samples in it.
        limits: Largest accepted errors.
        error: Error of the reduced model at the last point where it was found.
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
        """Damping ratios of the test's modes by the full model, (m,); None if not among the data.

        Args:
            values: Values of the parameters.
            modes: Modes of the full model there, the last that were solved for.
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
    """The test's modes among a model's."""
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
        parameters: Parameters to vary.
        start: Values of all parameters.
        count: Number of samples beside the start; by default two for each parameter.
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
    """Whether the laws of a structure allow these values."""
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
