"""Frequency and damping of a nonlinear mode against its amplitude.

By the extended periodic motion concept (Krack 2015): the free motion made periodic by negative
damping that is proportional to mass; or by phase resonance: one force, in quadrature with the
motion of a sensor, as a phase-locked loop finds it in a test.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import scipy.linalg

from fenics_joints.errors import ConvergenceError, InputError, real, reals, wanted
from fenics_joints.files import dataframe
from fenics_joints.formatting import hertz, html_table, number, percent
from fenics_joints.harmonic.balance import Balance, BalanceOptions
from fenics_joints.harmonic.continuation import (
    Branch,
    ContinuationSettings,
    check_settings,
    follow,
    solve_at,
)
from fenics_joints.harmonic.frf import fingerprint, telling
from fenics_joints.harmonic.result import (
    Periodic,
    changed_balance,
    check_interval,
    check_sensor,
    slopes_by_parameters,
)
from fenics_joints.interfaces.model import InterfaceModel, inverted_modes
from fenics_joints.progress import Progress

if TYPE_CHECKING:
    from typing_extensions import Unpack

#: Derivative of ln of an amplitude by its decimal logarithm.
_LN10 = float(np.log(10.0))
#: Eigenvalues below this share of trace(K) / trace(M) are rigid-body motion; far above round-off
#: and far below the elastic ones.
_RIGID = 1e-8
#: Directions below this share of the heaviest one's mass per stiffness are without mass: round-off.
_MASSLESS = 1e-12
#: Least frequency of which steps are a share, as a share of the linear one; chosen.
_SLOWEST = 1e-3


@dataclass(frozen=True, kw_only=True, repr=False)
class NonlinearMode(Periodic):
    """A nonlinear mode over its amplitude.

    Attributes:
        problem: The equations that it solves.
        z: Their unknowns at each point, (N, size + 3).
        method: ``epmc`` or ``phase resonance``.
        damping_ratios: Energy that a cycle takes over 4 pi times the largest kinetic energy, (N,).
        modal_amplitudes: sqrt(x1^H M x1) of the first harmonic x1, m kg^1/2, (N,).
        force: Name of the force's place; None without a force.
        force_amplitudes: Amplitude of the force, N, (N,); zero without.
        end: ``"reached"`` at the highest amplitude asked for; ``"stands still"`` if the frequency
            fell to zero before, as where a spring gives way; ``"came back"`` if the branch turned
            and left by the lowest; ``"short of it"`` if no solution was found on a bound.
    """

    problem: FreeMode | PhaseResonance
    z: np.ndarray
    method: str
    damping_ratios: np.ndarray
    modal_amplitudes: np.ndarray
    force: str | None
    force_amplitudes: np.ndarray
    end: str = "reached"

    def __repr__(self) -> str:
        own = super().__repr__()
        return own if self.end == "reached" else f"{own[:-1]}: {self.end})"

    def _repr_html_(self) -> str:
        shown = np.unique(np.linspace(0, len(self.modal_amplitudes) - 1, 8).round().astype(int))
        rows = [
            (
                number(self.modal_amplitudes[i]),
                hertz(self.frequencies_hz[i]),
                percent(self.damping_ratios[i], 3),
            )
            for i in shown
        ]
        head = ("modal amplitude, m kg^1/2", "Hz", "damping ratio")
        return html_table(f"Backbone, {self.method}: {self.end}", head, rows)

    def to_dataframe(self):
        """A ``pandas.DataFrame`` with modal_amplitude (m kg^1/2), displacement_m at the sensor,
        frequency_hz and damping_ratio.

        Raises:
            InputError: If pandas is not installed.
        """
        return dataframe(
            {
                "modal_amplitude": self.modal_amplitudes,
                "displacement_m": self.amplitude(),
                "frequency_hz": self.frequencies_hz,
                "damping_ratio": self.damping_ratios,
            }
        )

    def by_parameters(
        self, change: Callable[[Mapping[str, float]], InterfaceModel], values: Mapping[str, float]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of frequencies, Hz, and damping ratios by parameters, each (N, parameters).

        Of a mode without a force, at the same amplitudes; no point is solved again.

        Args:
            change: The model for values of the parameters.
            values: Present values, none of them zero.

        Raises:
            InputError: Of a mode with a force, or if a value is zero.
            ConvergenceError: Where a point has none.
        """
        problem = self.problem
        if self.force is not None:
            raise InputError("derivatives by parameters: expected a mode without a force.")

        def changed(values: Mapping[str, float]) -> Callable:
            other = copy(problem)
            other.balance = changed_balance(problem.balance, change(values))
            return lambda z: other.evaluate(z, jacobian=False)[0]

        made = slopes_by_parameters(
            lambda z: problem.evaluate(z)[1][:, :-1],
            changed,
            self.z,
            values,
            lambda i: f"the mode at {10 ** self.z[i, -1]:.3g} m",
        )
        omega, zeta = np.array(made)[:, -2:].transpose(1, 0, 2)
        return omega / (2 * np.pi), zeta

    def to_dict(self) -> dict:
        """Everything that people read, for JSON."""
        return {
            **super().to_dict(),
            "method": self.method,
            "damping_ratio": self.damping_ratios.tolist(),
            "modal_amplitude": self.modal_amplitudes.tolist(),
            "force": self.force,
            "force_amplitude_n": self.force_amplitudes.tolist(),
            "end": self.end,
        }


def solve_backbone(
    model: InterfaceModel,
    amplitudes: tuple[float, float] | None = None,
    *,
    at: Sequence[float] | None = None,
    force: str | None = None,
    near: float | None = None,
    sensor: str | None = None,
    settings: ContinuationSettings | None = None,
    initial: NonlinearMode | None = None,
    checkpoint: str | Path | None = None,
    resume: bool = False,
    progress: Progress | None = None,
    **equations: Unpack[BalanceOptions],
) -> NonlinearMode:
    """A nonlinear mode: by the extended periodic motion concept, or with a force at resonance.

    With a force, the frequency and amplitude of it at which the sensor's first harmonic is a
    quarter of a cycle late.

    Args:
        model: The structure.
        amplitudes: Lowest and highest first-harmonic amplitude of displacement at the sensor, m,
            between which the mode is followed.
        at: Instead: amplitudes, m, in any order; each point starts from that of its neighbour.
        force: Place of the force; None for a motion without one.
        near: The mode whose linear frequency, Hz, is nearest; the lowest elastic one by default.
        sensor: Sensor that moves in the mode; the model's first by default.
        settings: As for `solve_harmonic`; scaled arc length is about decades of the amplitude.
        initial: The mode of a near model at the same amplitudes (``at``), to start from.
        checkpoint, resume, progress, equations: As for `solve_harmonic`.

    Raises:
        InputError: For an unknown name, a value out of range, or a sensor that does not move.
        ConvergenceError: If the branch cannot be followed.
    """
    if (amplitudes is None) == (at is None):
        raise InputError("expected either amplitudes = (low, high), m, or at = [amplitudes], m.")
    if initial is not None and not isinstance(initial, NonlinearMode):
        raise wanted("initial", initial, "a NonlinearMode of a similar model, or None")
    if at is None:
        bounds = np.log10(check_interval("amplitudes", amplitudes, "m"))
    else:
        bounds = np.log10(reals("at", at, (None,), "m", above=0))
        if not len(bounds):
            raise InputError("at = []: expected one or more amplitudes, m.")
    if near is not None:
        real("near", near, "Hz", above=0)
    settings = check_settings(settings)
    balance = Balance(model, **equations)
    sensor = check_sensor(model, sensor)
    row = model.row("sensors", sensor)
    mode = _linear_mode(balance, near)
    if force is None:
        problem = FreeMode(balance, row, *mode)
        words = "mode", sensor, near
    else:
        problem = PhaseResonance(balance, row, model.row("forces", force), *mode)
        words = "phase resonance", sensor, force, near
    step = f"{problem.method} of the mode near {problem.omega / (2 * np.pi):.4g} Hz"
    tell = telling(progress, step, lambda z: f"{10 ** z[-1]:.3g} m")

    def first(q: float) -> np.ndarray:
        return np.append(problem.start(), q)

    if at is not None:
        warm = initial is not None and initial.z.shape == (len(bounds), balance.size + 3)
        z = initial.z if warm else None
        branch = solve_at(problem, bounds, first, settings, initial=z, on_point=tell)
        if np.any(branch.z[:, -3] <= 0):
            raise ConvergenceError("the mode stands still below the largest of the amplitudes")
        return _backbone(problem, branch, sensor, force, "reached")
    branch = follow(
        problem,
        first(bounds[0]),
        tuple(bounds),
        settings=settings,
        name=fingerprint(balance, *words, *amplitudes),
        checkpoint=checkpoint,
        resume=resume,
        on_point=tell,
        writes=balance.comm.rank == 0,
    )
    end = _end(branch.z[-1, -1], bounds)
    if np.any(branch.z[:, -3] <= 0):  # beyond it the same motions follow, backwards in time
        branch = branch.first(max(int(np.argmax(branch.z[:, -3] <= 0)), 1))
        end = "stands still"
    if end in ("came back", "short of it"):
        warnings.warn(
            f"the backbone ends ({end}) after {10 ** branch.z[:, -1].max():.3g} m of the "
            f"{amplitudes[1]:.3g} m that were asked for; other harmonics may lead on",
            stacklevel=2,
        )
    return _backbone(problem, branch, sensor, force, end)


def free_mode(balance: Balance, sensor: str, near: float | None = None) -> FreeMode:
    """The equations of a mode without a force, by its amplitude at a sensor.

    Args:
        balance: The harmonic balance.
        sensor: The sensor's name.
        near: The mode whose linear frequency, Hz, is nearest; the lowest elastic one by default.

    Raises:
        InputError: For an unknown sensor, or one that does not move in the mode.
    """
    return FreeMode(balance, balance.model.row("sensors", sensor), *_linear_mode(balance, near))


def _backbone(
    problem: _Mode, branch: Branch, sensor: str, force: str | None, end: str
) -> NonlinearMode:
    balance = problem.balance
    X = np.array([problem.coefficients(z) for z in branch.z])
    omegas, extra = branch.z[:, -3], branch.z[:, -2]
    modal = np.sqrt(np.einsum("pnk,nm,pmk->p", X[..., 1:3], balance.model.M, X[..., 1:3]))
    forces = extra * 10 ** branch.z[:, -1] if force else np.zeros(len(branch))
    damping = extra
    if force:
        work = np.pi * forces * (X[:, :, 2] @ balance.model.row("forces", force))
        damping = work / (2 * np.pi * (omegas * modal) ** 2)
    return NonlinearMode(
        problem=problem,
        z=branch.z,
        balance=balance,
        frequencies_hz=omegas / (2 * np.pi),
        coefficients=X,
        iterations=branch.iterations,
        jacobians=branch.jacobians,
        sensor=sensor,
        method=problem.method,
        damping_ratios=damping,
        modal_amplitudes=modal,
        force=force,
        force_amplitudes=np.abs(forces),
        end=end,
    )


def _end(last: float, bounds: tuple[float, float]) -> str:
    """How a branch ended whose last amplitude has this logarithm."""
    low, high = np.isclose(last, bounds, rtol=0.0, atol=1e-9)
    return "reached" if high else "came back" if low else "short of it"


def _linear_mode(balance: Balance, near: float | None) -> tuple[float, np.ndarray]:
    """Angular frequency and M-normalised shape of a mode at the static state."""
    J = balance.interface_force(balance.rest)[1].reshape(*balance.shape, *balance.shape)
    K, M = balance.model.K + J[:, 1, :, 1], balance.model.M
    try:
        scale, inverse, shapes = inverted_modes(K, M, 1.0)
    except scipy.linalg.LinAlgError as error:
        raise InputError(
            f"M and K at rest: expected positive (semi-)definite matrices ({error})."
        ) from error
    heavy = np.flatnonzero(inverse > _MASSLESS * inverse[0])
    values = 1 / inverse[heavy] - scale
    elastic = np.flatnonzero(values > _RIGID * scale)
    if not len(elastic):
        raise InputError("the model has no elastic mode; expected some stiffness.")
    omegas = np.sqrt(values[elastic])
    i = 0 if near is None else int(np.argmin(np.abs(omegas - 2 * np.pi * near)))
    number = heavy[elastic[i]]
    return float(omegas[i]), shapes[:, number] / np.sqrt(inverse[number])


class _Mode:
    """Harmonic balance of a motion whose amplitude at a sensor is the parameter.

    Unknowns: Y, with X = static + 10^q Y, of order one at all amplitudes; omega; one number of the
    kind of motion; q, the logarithm of the amplitude.
    """

    method = ""

    def __init__(self, balance: Balance, sensor: np.ndarray, omega: float, shape: np.ndarray):
        self.balance, self.sensor, self.omega = balance, sensor, omega
        self.kinked = balance.kinked
        reach = sensor @ shape
        if abs(reach) < 1e-8 * np.linalg.norm(sensor) * np.linalg.norm(shape):
            raise InputError("the sensor does not move in the mode; expected another sensor.")
        self.shape = shape / reach
        self.target = np.array([1.0, 0.0])

    def coefficients(self, z: np.ndarray) -> np.ndarray:
        """X, (n, K)."""
        return self.balance.rest + 10 ** z[-1] * z[:-3].reshape(self.balance.shape)

    def start(self) -> np.ndarray:
        """Unknowns of the linear mode, without the amplitude."""
        Y = np.zeros(self.balance.shape)
        Y[:, 1:3] = self.shape[:, None] * self.target
        return np.concatenate([Y.reshape(-1), [self.omega, self.linear_extra()]])

    def evaluate(self, z: np.ndarray, *, jacobian: bool = True):
        """Residual, over the amplitude, and its derivative."""
        balance, a, omega, extra = self.balance, 10 ** z[-1], z[-3], z[-2]
        Y, X = z[:-3].reshape(balance.shape), self.coefficients(z)
        R, J_X = balance.evaluate(X, omega, jacobian=jacobian)
        r = R.reshape(-1) / a
        ends = self.sensor @ Y[:, 1:3] - self.target
        full = np.concatenate([r - self.extra(Y, omega, extra), ends])
        if not jacobian:
            return full, None
        N = balance.size
        J = np.zeros((N + 2, N + 3))
        # The residual is that of a unit amplitude: R / a.
        J[:N, :N], J[:N, -3] = J_X, balance.by_omega(X, omega).reshape(-1) / a
        J[:N, -1] = _LN10 * (J_X @ Y.reshape(-1) - r)
        self.add_extra(J[:N], Y, omega, extra)
        for i in (0, 1):
            row = np.zeros(balance.shape)
            row[:, 1 + i] = self.sensor
            J[N + i, :N] = row.reshape(-1)
        return full, J

    def scales(self, z: np.ndarray) -> np.ndarray:
        """Size of the motion, a tenth of omega, the extra number's, one decade.

        All at the point itself: a frequency that grows a hundredfold is no long way for the last.
        """
        size = np.linalg.norm(z[:-3]) or 1.0
        omega = max(abs(z[-3]), _SLOWEST * self.omega)
        ends = [0.1 * omega, self.extra_scale(z[-2], omega), 1.0]
        return np.concatenate([np.full(len(z) - 3, size), ends])


class FreeMode(_Mode):
    """The extra number is the damping ratio: M x'' + C x' + K x + f - 2 zeta omega M x' = 0."""

    method = "epmc"

    def __init__(self, balance, sensor, omega, shape):
        super().__init__(balance, sensor, omega, shape)
        self.damping = np.kron(balance.model.M, balance.fourier.derivative)

    def linear_extra(self) -> float:
        m = self.balance.model
        return float(
            self.shape @ m.C @ self.shape / (2 * self.omega * self.shape @ m.M @ self.shape)
        )

    def extra_scale(self, zeta: float, omega: float) -> float:
        return max(abs(zeta), 0.05)

    def extra(self, Y, omega: float, zeta: float) -> np.ndarray:
        velocity = self.balance.model.M @ Y @ self.balance.fourier.derivative.T
        return 2 * zeta * omega**2 * velocity.reshape(-1)

    def add_extra(self, J, Y, omega: float, zeta: float) -> None:
        N = self.balance.size
        J[:, :N] -= 2 * zeta * omega**2 * self.damping
        J[:, -3] -= self.extra(Y, omega, zeta) * 2 / omega
        J[:, -2] -= self.extra(Y, omega, 1.0)


class PhaseResonance(_Mode):
    """The extra number is the force over the amplitude; the motion is a quarter of a cycle late."""

    method = "phase resonance"

    def __init__(self, balance, sensor, force, omega, shape):
        super().__init__(balance, sensor, omega, shape)
        self.force = balance.load(force).reshape(-1)
        self.reach = float(force @ self.shape)
        if abs(self.reach) < 1e-8 * np.linalg.norm(force) * np.linalg.norm(self.shape):
            raise InputError("the force does not drive the mode; expected another place.")
        self.target = np.array([0.0, np.sign(self.reach)])

    def linear_extra(self) -> float:
        C = self.balance.model.C
        return float(self.omega * self.shape @ C @ self.shape / abs(self.reach))

    def extra_scale(self, extra: float, omega: float) -> float:
        modal = omega**2 * float(self.shape @ self.balance.model.M @ self.shape)
        return max(abs(extra), 0.05 * modal / abs(self.reach))

    def extra(self, Y, omega: float, extra: float) -> np.ndarray:
        return extra * self.force

    def add_extra(self, J, Y, omega: float, extra: float) -> None:
        J[:, -2] -= self.force
