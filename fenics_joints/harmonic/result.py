"""Periodic responses along a branch, what people read from them, and their derivatives."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy.linalg

from fenics_joints.errors import ConvergenceError, InputError, reals
from fenics_joints.files import dataframe
from fenics_joints.harmonic.balance import Balance, Load, load_work
from fenics_joints.harmonic.fourier import amplitude, amplitude_gradient, differentiated
from fenics_joints.interfaces.model import InterfaceModel, check_interfaces


@dataclass(frozen=True, repr=False)
class ResponseGradient:
    """Derivatives of responses by parameters.

    Attributes:
        coefficients: d X / d p, (N, n, K, parameters).
        parameters: Their names.
        result: The `HarmonicResult` it belongs to.
    """

    coefficients: np.ndarray
    parameters: tuple[str, ...]
    result: object

    def __repr__(self) -> str:
        return f"ResponseGradient({len(self.result)} responses by {', '.join(self.parameters)})"

    def sensor_coefficients(self, sensor: str, kind: str = "displacement") -> np.ndarray:
        """Derivatives of the harmonics at a sensor, (N, parameters, K)."""
        row = self.result.model.row("sensors", sensor)
        change = np.einsum("n,pnkj->pjk", row, self.coefficients)
        periods = self.result.balance.fourier.periods
        return differentiated(change, self.result.omegas[:, None], kind, periods)

    def amplitude(
        self, sensor: str, kind: str = "displacement", measure: str | None = None
    ) -> np.ndarray:
        """Derivatives of the amplitude at a sensor, (N, parameters).

        At a peak that is the derivative of the peak's amplitude too, whose frequency may move.
        """
        c = self.result.sensor_coefficients(sensor, kind)
        periods = self.result.balance.fourier.periods
        gradient = amplitude_gradient(c, measure or self.result.measure, periods)
        return np.einsum("pk,pjk->pj", gradient, self.sensor_coefficients(sensor, kind))


#: Relative step of the central differences of the equations by a parameter; chosen.
_STEP = 1e-5


def slopes_by_parameters(
    problem, changed: Callable, points: Sequence, values: Mapping[str, float], what
) -> list[np.ndarray]:
    """Derivatives of solutions of R(y, p) = 0 by parameters p, each (unknowns, parameters).

    dy/dp = -R_y^-1 R_p, with the exact R_y, and R_p from two evaluations of the residual at the
    same y: nothing is solved again.

    Args:
        problem: Function of a point: R_y.
        changed: Function of values of the parameters: the residual as a function of a point.
        points: The solutions.
        values: Present values.
        what: Function of an index: what has no derivatives where R_y is singular.

    Raises:
        InputError: If a value is zero, which no relative step changes.
        ConvergenceError: Where R_y is singular.
    """
    pairs = []
    for key, value in values.items():
        if value == 0:
            raise InputError(f"{key} = 0: expected a value that a relative step can change.")
        ends = [changed({**values, key: value * (1 + s * _STEP)}) for s in (1, -1)]
        pairs.append((*ends, 2 * _STEP * value))
    found = []
    for i, point in enumerate(points):
        by_values = [(up(point) - down(point)).reshape(-1) / way for up, down, way in pairs]
        try:
            found.append(-scipy.linalg.solve(problem(point), np.column_stack(by_values)))
        except scipy.linalg.LinAlgError as error:
            raise ConvergenceError(f"{what(i)} has no derivatives", str(error)) from error
    return found


def changed_balance(balance: Balance, model: InterfaceModel) -> Balance:
    """The balance of a model with other parameters.

    Raises:
        InputError: If the model has another size.
    """
    if model.n_dofs != balance.model.n_dofs:
        raise InputError(
            f"the changed model has {model.n_dofs} degrees of freedom, expected "
            f"{balance.model.n_dofs}."
        )
    return balance.changed(model)


#: Energy of a cycle, relative to its terms, below which the terms cancel up to round-off.
_NO_LOSS = 1e-8


@dataclass(frozen=True)
class Peak:
    """A local maximum of the response along the branch.

    Attributes:
        index: Its point.
        frequency_hz: Frequency, Hz.
        amplitude: Amplitude of displacement, m.
    """

    index: int
    frequency_hz: float
    amplitude: float


@dataclass(frozen=True, repr=False)
class Loops:
    """One interface over one cycle.

    Attributes:
        strain: Strain or jump, (P, T, d).
        stress: Stress, Pa, (P, T, d).
        slip_amplitude: Half of the tangential strain's or jump's peak to peak, (P,).
        dissipation: Energy per cycle, J/m2 (J/m3 in a layer, J at a discrete spring), (P,).
        energy: Energy per cycle of the whole interface, J.
    """

    strain: np.ndarray
    stress: np.ndarray
    slip_amplitude: np.ndarray
    dissipation: np.ndarray
    energy: float

    def __repr__(self) -> str:
        return f"Loops({len(self.strain)} points, {self.energy:.4g} J per cycle)"


@dataclass(frozen=True, kw_only=True, repr=False)
class Periodic:
    """Periodic motions of one model.

    Attributes:
        balance: The equations that they solve.
        frequencies_hz: Frequency of each motion, or of its force if it takes several of its
            periods, Hz, (N,).
        coefficients: Harmonics of the displacements, m, (N, n, K).
        iterations: Newton steps that each took, (N,).
        jacobians: Jacobians that they took, (N,).
        sensor: Sensor whose amplitude is meant where none is named.
        measure: What is meant by amplitude, ``first`` or ``peak`` (see `amplitude`).
    """

    balance: Balance
    frequencies_hz: np.ndarray
    coefficients: np.ndarray
    iterations: np.ndarray
    jacobians: np.ndarray
    sensor: str
    measure: str = "first"
    _loops: dict = field(default_factory=dict, repr=False, compare=False)

    def __len__(self) -> int:
        return len(self.frequencies_hz)

    def __repr__(self) -> str:
        low, high = self.frequencies_hz.min(), self.frequencies_hz.max()
        return (
            f"{type(self).__name__}({len(self)} responses, {low:.4g} to {high:.4g} Hz, "
            f"at {self.sensor})"
        )

    @property
    def model(self) -> InterfaceModel:
        """The model."""
        return self.balance.model

    @property
    def omegas(self) -> np.ndarray:
        """Angular frequencies, rad/s, (N,)."""
        return 2 * np.pi * self.frequencies_hz

    def sensor_coefficients(self, sensor: str, kind: str = "displacement") -> np.ndarray:
        """Harmonics at a sensor, (N, K).

        Args:
            sensor: Name.
            kind: ``displacement``, ``velocity`` or ``acceleration``.

        Raises:
            InputError: For an unknown sensor or kind.
        """
        c = np.einsum("n,pnk->pk", self.model.row("sensors", sensor), self.coefficients)
        return differentiated(c, self.omegas, kind, self.balance.fourier.periods)

    def amplitude(
        self, sensor: str | None = None, kind: str = "displacement", measure: str | None = None
    ) -> np.ndarray:
        """Amplitude at a sensor, (N,); sensor and measure by default those of the result.

        Raises:
            InputError: For an unknown sensor, kind or measure.
        """
        c = self.sensor_coefficients(sensor or self.sensor, kind)
        return amplitude(c, measure or self.measure, self.balance.fourier.periods)

    def loops(self, i: int) -> dict[str, Loops]:
        """Strain and stress over a cycle at all interfaces, at response ``i``."""
        i = range(len(self))[i]
        if i not in self._loops:
            self._loops[i] = self._make_loops(i)
        return self._loops[i]

    def _make_loops(self, i: int) -> dict[str, Loops]:
        found, G, X = {}, self.balance.fourier.derivative, self.coefficients[i]
        stresses = self.balance.stresses(X, self.omegas[i])
        for points in self.model.interfaces:
            made = stresses[points.name]
            strain = points.rows @ X
            rate = strain @ G.T
            # Of a closed integral of stress by strain only equal harmonics are left.
            terms = np.pi * made.coefficients[..., 1:] * rate[..., 1:]
            density = terms.sum(axis=(1, 2))
            density[np.abs(density) < _NO_LOSS * np.abs(terms).sum(axis=(1, 2))] = 0.0
            reach = amplitude(strain[:, 1:] if points.normal else strain, "peak")
            found[points.name] = Loops(
                made.strain,
                made.stress,
                np.linalg.norm(reach, axis=-1),
                density,
                float(points.weights @ density),
            )
        return found

    def dissipation(self, indices: Sequence[int] | None = None) -> dict[str, np.ndarray]:
        """Energy per cycle that each interface takes, J, at some responses; all by default."""
        indices = range(len(self)) if indices is None else indices
        energy = {points.name: [] for points in self.model.interfaces}
        for i in indices:
            known = self._loops.get(range(len(self))[i])
            loops = self._make_loops(i) if known is None else known
            for name in energy:
                energy[name].append(loops[name].energy)
        return {name: np.array(values) for name, values in energy.items()}

    def closure(self, i: int) -> float:
        """How far the hysteresis loops at response ``i`` are from closed, relative: give more
        ``cycles`` if that is too far."""
        return max(
            (s.closure for s in self.balance.stresses(self.coefficients[i]).values()), default=0.0
        )

    def to_dict(self) -> dict:
        """Everything that people read, for JSON."""
        sensors = {
            name: {
                "amplitude_m": self.amplitude(name).tolist(),
                "acceleration_m_s2": self.amplitude(name, "acceleration").tolist(),
            }
            for name in self.model.sensors
        }
        return {
            "harmonics": self.balance.fourier.harmonics,
            "samples": self.balance.fourier.samples,
            "periods": self.balance.fourier.periods,
            "sensor": self.sensor,
            "measure": self.measure,
            "frequency_hz": self.frequencies_hz.tolist(),
            "sensors": sensors,
            "iterations": self.iterations.tolist(),
            "jacobians": self.jacobians.tolist(),
        }


@dataclass(frozen=True, kw_only=True, repr=False)
class HarmonicResult(Periodic):
    """Responses to a harmonic force, along a branch or at prescribed frequencies.

    Attributes:
        force: Name of the force's place.
        force_amplitudes: Amplitude of the force, N, (N,).
        tangents: Tangents of the branch, coefficients first and omega last; None if the responses
            are not points of a branch.
        more: Further loads.
        power: Of the frequency that the force is multiplied by.
    """

    force: str
    force_amplitudes: np.ndarray
    tangents: np.ndarray | None = None
    more: tuple[Load, ...] = ()
    power: int = 0

    def loads(self, force: float) -> tuple[Load, ...]:
        """The loads at an amplitude of the force, N."""
        return Load(self.force, force, power=self.power), *self.more

    def constant_force(self) -> float:
        """Amplitude of the force, N, of a branch on which it is the same everywhere.

        Raises:
            InputError: For responses that are no such branch.
        """
        force = self.force_amplitudes
        if self.tangents is None or np.ptp(force) > 1e-9 * abs(force[0]):
            raise InputError("result: expected a branch at constant force, as solve_harmonic's.")
        return float(force[0])

    def frf(self, sensor: str, kind: str = "displacement") -> np.ndarray:
        """First harmonic at a sensor over the force, complex, per N, (N,)."""
        c = self.sensor_coefficients(sensor, kind)
        first = self.balance.fourier.cosine()
        return (c[:, first] - 1j * c[:, first + 1]) / self.force_amplitudes

    @cached_property
    def peaks(self) -> tuple[Peak, ...]:
        """Local maxima of the sensor's amplitude per force, those at the ends not counted."""
        a = self.amplitude()
        p = a / self.force_amplitudes
        found = [i for i in range(1, len(p) - 1) if p[i] > p[i - 1] and p[i] >= p[i + 1]]
        return tuple(Peak(i, float(self.frequencies_hz[i]), float(a[i])) for i in found)

    @property
    def peak(self) -> Peak:
        """The highest response per force, of the peaks where there are any."""
        a = self.amplitude()
        p = a / self.force_amplitudes
        i = max((peak.index for peak in self.peaks), key=p.__getitem__, default=int(np.argmax(p)))
        return Peak(i, float(self.frequencies_hz[i]), float(a[i]))

    def to_dataframe(self):
        """A ``pandas.DataFrame`` with frequency_hz, force_n and displacement_m at the sensor.

        Raises:
            InputError: If pandas is not installed.
        """
        return dataframe(
            {
                "frequency_hz": self.frequencies_hz,
                "force_n": self.force_amplitudes,
                "displacement_m": self.amplitude(),
            }
        )

    def force_work(self) -> np.ndarray:
        """Work of the loads per cycle, J, (N,): all that interfaces and viscous damping take."""
        row = self.model.row("forces", self.force)
        forces = self.force_amplitudes * self.omegas**self.power
        sine = self.balance.fourier.cosine() + 1
        work = np.pi * forces * (self.coefficients[:, :, sine] @ row)
        return work + load_work(self.balance, self.more, self.coefficients, self.omegas)

    def by_parameters(
        self, change: Callable[[Mapping[str, float]], InterfaceModel], values: Mapping[str, float]
    ) -> ResponseGradient:
        """Derivatives of the responses, each at its own frequency and force, by parameters.

        Args:
            change: The model for values of the parameters; the result's for ``values``.
            values: Present values by name. The equations are evaluated beside them, not solved.

        Raises:
            InputError: If a parameter's value is zero or ``change`` gives another size.
        """
        balance, points = self.balance, list(zip(self.coefficients, self.omegas, strict=True))

        def changed(values: Mapping[str, float]) -> Callable:
            other = changed_balance(balance, change(values))
            return lambda point: other.evaluate(*point, jacobian=False)[0]

        made = slopes_by_parameters(
            lambda point: balance.evaluate(*point)[1],  # the loads are the same ones
            changed,
            points,
            values,
            lambda i: f"the response at {points[i][1] / (2 * np.pi):.6g} Hz, a turning point,",
        )
        made = np.reshape(made, (len(points), *balance.shape, len(values)))
        return ResponseGradient(made, tuple(values), self)

    def to_dict(self) -> dict:
        """Everything that people read, for JSON."""
        made = super().to_dict()
        for name, sensor in made["sensors"].items():
            sensor["phase_rad"] = np.angle(self.frf(name)).tolist()
        made["force"] = self.force
        made["force_amplitude_n"] = self.force_amplitudes.tolist()
        made["peaks"] = [
            {"point": p.index, "frequency_hz": p.frequency_hz, "amplitude_m": p.amplitude}
            for p in self.peaks
        ]
        made["interfaces_at_peak"] = {
            name: {
                "energy_per_cycle_j": loops.energy,
                "largest_slip_amplitude": float(loops.slip_amplitude.max(initial=0.0)),
            }
            for name, loops in self.loops(self.peak.index).items()
        }
        return made


def check_interval(key: str, pair: Sequence[float], unit: str) -> tuple[float, float]:
    """Two numbers, 0 < low < high, or an `InputError`."""
    low, high = reals(key, pair, (2,), unit, above=0).tolist()
    if not low < high:
        raise InputError(f"{key} = ({low}, {high}): expected 0 < low < high, {unit}.")
    return low, high


def check_sensor(model: InterfaceModel, sensor: str | None) -> str:
    """The sensor's name, by default the model's first.

    Raises:
        InputError: If there is none, or it is unknown.
    """
    check_interfaces(model)
    if sensor is None:
        if not model.sensors:
            raise InputError("sensors: the model has none; expected at least one.")
        return next(iter(model.sensors))
    model.row("sensors", sensor)
    return sensor
