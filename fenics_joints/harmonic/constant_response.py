"""Nonlinear frequency response at constant response: the force that a sensor's amplitude takes.

What a test with a controlled response measures: near a resonance the interfaces then move about
equally at all frequencies, and the response is nearly that of a linear structure.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fenics_joints.errors import ConvergenceError, InputError, member, real
from fenics_joints.harmonic.balance import Balance, Equations
from fenics_joints.harmonic.corrector import Settings, check_settings
from fenics_joints.harmonic.fourier import KINDS, moving_size
from fenics_joints.harmonic.frf import (
    ForcedResponse,
    check_band,
    first_response,
    follow_band,
    linear_response,
    responses,
    telling,
    with_extremes,
)
from fenics_joints.harmonic.loads import Loading
from fenics_joints.harmonic.result import HarmonicResult, check_sensor
from fenics_joints.interfaces.model import InterfaceModel
from fenics_joints.progress import Progress

if TYPE_CHECKING:
    from typing_extensions import Unpack


def solve_constant_response(
    model: InterfaceModel,
    force: str,
    sensor: str | None,
    amplitude: float,
    band: tuple[float, float],
    *,
    kind: str = "displacement",
    direction: str = "up",
    settings: Settings | None = None,
    checkpoint: str | Path | None = None,
    resume: bool = False,
    progress: Progress | None = None,
    **equations: Unpack[Equations],
) -> HarmonicResult:
    """Force that holds the first harmonic at a sensor to an amplitude, over a band.

    The frequencies of least force are points of the branch: the result's `peaks`.

    Args:
        model: The structure.
        force: Place of the force.
        sensor: Sensor; None for the model's first.
        amplitude: Amplitude to hold, in SI units of ``kind``.
        band: Lowest and highest frequency, Hz.
        kind: ``displacement``, ``velocity`` or ``acceleration``.
        direction, settings, checkpoint, resume, progress, equations: As for `solve_harmonic`.

    Raises:
        InputError: For an unknown name, or a value out of range.
        ConvergenceError: If the branch cannot be followed.
    """
    member("kind", kind, KINDS)
    amplitude = real("amplitude", amplitude, f"(of {kind})", above=0)
    band = check_band(band, direction)
    sensor = check_sensor(model, sensor)
    rows = model.row("forces", force), model.row("sensors", sensor)
    balance = Balance(model, **equations)
    settings, width = check_settings(settings), 2 * np.pi * (band[1] - band[0])
    problem = ConstantResponse(balance, *rows, amplitude, KINDS[kind], width)
    branch = follow_band(
        problem,
        lambda omega: problem.start(omega, settings),
        band,
        direction,
        words=("response", force, sensor, amplitude, kind),
        settings=settings,
        checkpoint=checkpoint,
        resume=resume,
        on_point=telling(progress, f"force for {kind} {amplitude:g} at {sensor}"),
    )
    branch = with_extremes(problem, branch, _softer, settings)
    z, tangents = (np.delete(a, -2, axis=1) for a in (branch.z, branch.tangents))
    return responses(
        balance,
        z,
        branch.iterations,
        branch.jacobians,
        np.abs(branch.z[:, -2]),
        tangents=tangents,
        force=force,
        sensor=sensor,
    )


def _softer(z: np.ndarray, tangent: np.ndarray) -> float:
    """How fast the force's amplitude falls along the branch."""
    return -float(np.sign(z[-2]) * tangent[-2])


class ConstantResponse:
    """Harmonic balance with the force unknown and a sensor's first harmonic given.

    Unknowns: coefficients, force, omega.

    Args:
        balance: The equations.
        force: Row of the force, (n,).
        sensor: Row of the sensor, (n,).
        amplitude: Amplitude of the sensor's time derivative.
        order: Which time derivative: 0, 1 or 2.
        width: Notable change of omega, rad/s.
    """

    def __init__(self, balance: Balance, force, sensor, amplitude: float, order: int, width: float):
        self.balance, self.force, self.sensor = balance, force, sensor
        self.amplitude, self.order, self.width = amplitude, order, width
        self.kinked = balance.kinked

    def evaluate(self, z: np.ndarray, *, jacobian: bool = True):
        """Residual and its derivative."""
        X, force, omega = z[:-2].reshape(self.balance.shape), z[-2], z[-1]
        load = self.balance.load(force * self.force)
        R, J_X = self.balance.evaluate(X, omega, load, jacobian=jacobian)
        # (|u| omega^order / amplitude)^2 = 1
        a, b = self.sensor @ X[:, 1:3]
        factor = omega ** (2 * self.order) / self.amplitude**2
        R = np.append(R.reshape(-1), factor * (a**2 + b**2) - 1)
        if not jacobian:
            return R, None
        N = self.balance.size
        J = np.zeros((N + 1, N + 2))
        J[:N, :N], J[:N, -1] = J_X, self.balance.by_omega(X, omega).reshape(-1)
        J[:N, -2] = -self.balance.load(self.force).reshape(-1)
        row = np.zeros(self.balance.shape)
        row[:, 1], row[:, 2] = 2 * factor * a * self.sensor, 2 * factor * b * self.sensor
        J[N, :N] = row.reshape(-1)
        J[N, -1] = 2 * self.order / omega * factor * (a**2 + b**2)
        return R, J

    def scales(self, z: np.ndarray) -> np.ndarray:
        """The motion's size, the force and the width."""
        size = moving_size(z[:-2].reshape(self.balance.shape))
        # The force that the motion takes away from resonance, so that its zero is no obstacle.
        least = 1e-3 * self.amplitude / (self._compliance * z[-1] ** self.order)
        return np.concatenate([np.full(len(z) - 2, size), [max(abs(z[-2]), least), self.width]])

    def start(self, omega: float, settings: Settings) -> np.ndarray:
        """A guess of the response at omega, from the linear one."""
        X = linear_response(self.balance, omega, self.balance.load(self.force))
        a, b = self.sensor @ X[:, 1:3]
        self._compliance = float(np.hypot(a, b))
        if not self._compliance:
            raise InputError("the sensor does not move with the force; expected another sensor.")
        force = self.amplitude / (self._compliance * omega**self.order)
        load = self.balance.load(force * self.force)
        forced = ForcedResponse(self.balance, Loading({0: load}), self.width)
        try:
            X = first_response(forced, omega, settings)[:-1]
        except ConvergenceError:
            X = linear_response(self.balance, omega, load).reshape(-1)
        return np.concatenate([X, [force, omega]])
