"""Frequency and damping of a mode over its amplitude from static loads: a cheap backbone.

Quasi-static modal analysis: a load M phi alpha, the inertia of the mode phi, grows from the state
of rest, preload included. With q = phi^T M u, omega^2 = alpha / q, and the loop of a cycle, by
Masing's rule or by loads that go to and fro, has the energy that damping takes (Festjens,
Chevallier and Dion, J. Sound Vib. 332, 2013; Lacayo and Allen, Mech. Syst. Signal Process. 118,
2019). No harmonics and no frequencies are in it: one static solution for each amplitude, of models
of any size. The load stays that of the mode at rest, so that modes which the joint couples are
missed; `solve_backbone` has them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from petsc4py import PETSc

from fenics_joints.errors import ConvergenceError, InputError, real, whole
from fenics_joints.harmonic.result import check_interval
from fenics_joints.interfaces import FullModel, InterfaceModel
from fenics_joints.interfaces.loading import Statics
from fenics_joints.interfaces.motion import Motion
from fenics_joints.modal.options import given_options, reason_of

#: Decades below the lowest amplitude at which the load begins; chosen.
_BEFORE = 1.0
#: How often a step is halved that finds no equilibrium, or in which the joint gives way; chosen.
_HALVINGS = 6
#: Options of PETSc's SNES.
_OPTIONS = {"snes_rtol": 1e-10, "snes_linesearch_type": "bt"}


@dataclass(frozen=True, kw_only=True, repr=False)
class StaticBackbone:
    """A mode over its amplitude, from static loads.

    Attributes:
        frequencies_hz: Frequency by the secant stiffness, Hz, (N,).
        damping_ratios: Energy of a cycle, in joints and viscous damping, over 2 pi (omega q)^2,
            (N,).
        modal_amplitudes: q, m kg^1/2, (N,).
        loads: alpha, m kg^1/2 / s^2, (N,).
        energies: Energy that the joints take in a cycle, J, (N,).
        sensor: Sensor of the amplitudes.
        amplitudes: Displacement at the sensor, m, (N,).
        end: ``"reached"`` at the highest amplitude asked for, or ``"gives way"`` where the joint
            carries no larger load.
        method: ``quasi-static``.
    """

    frequencies_hz: np.ndarray
    damping_ratios: np.ndarray
    modal_amplitudes: np.ndarray
    loads: np.ndarray
    energies: np.ndarray
    sensor: str
    amplitudes: np.ndarray
    end: str
    method: str = "quasi-static"

    def __len__(self) -> int:
        return len(self.frequencies_hz)

    def __repr__(self) -> str:
        low, high = self.frequencies_hz.min(), self.frequencies_hz.max()
        return f"StaticBackbone({len(self)} loads, {low:.4g} to {high:.4g} Hz, at {self.sensor})"

    def amplitude(self) -> np.ndarray:
        """Amplitude of displacement at the sensor, m, (N,), as `NonlinearMode.amplitude` has it."""
        return self.amplitudes

    def to_dict(self) -> dict:
        """For JSON; the keys that `NonlinearMode` has mean the same."""
        return {
            "method": self.method,
            "sensor": self.sensor,
            "frequency_hz": self.frequencies_hz.tolist(),
            "damping_ratio": self.damping_ratios.tolist(),
            "modal_amplitude": self.modal_amplitudes.tolist(),
            "amplitude_m": self.amplitudes.tolist(),
            "energy_j": self.energies.tolist(),
            "end": self.end,
        }


def solve_static_backbone(
    model: FullModel | InterfaceModel,
    amplitudes: tuple[float, float],
    *,
    near: float | None = None,
    sensor: str | None = None,
    per_decade: int = 20,
    loop_steps: int = 0,
    static: np.ndarray | PETSc.Vec | None = None,
    petsc_options: Mapping[str, object] | None = None,
) -> StaticBackbone:
    """A mode over its amplitude by quasi-static modal analysis. Collective for a full model.

    Args:
        model: The structure, reduced or in full.
        amplitudes: Lowest and highest amplitude of displacement at the sensor, m.
        near: The mode whose frequency, Hz, is nearest; the lowest elastic one by default.
        sensor: Sensor that moves in the mode; the model's first by default.
        per_decade: Loads in a decade of amplitude.
        loop_steps: Steps of half a loop that is gone through at every load. With 0 the loops are
            the first loading's by Masing's rule, which neither contacts whose pressure changes nor
            laws with a nonlinear spring obey.
        static: Static load, N, (n,), that joints bear before; None for none.
        petsc_options: Options of PETSc's SNES and KSP, without prefix.

    Raises:
        InputError: For an unknown name, a value out of range, or a sensor that does not move.
        ConvergenceError: If not even the first load has an equilibrium, or Masing's rule cannot
            hold.
    """
    low, high = check_interval("amplitudes", amplitudes, "m")
    if near is not None:
        real("near", near, "Hz", above=0)
    per_decade, loop_steps = whole("per_decade", per_decade), whole("loop_steps", loop_steps, 0)
    if not model.sensors:
        raise InputError("sensors: the model has none; expected at least one.")
    sensor = next(iter(model.sensors)) if sensor is None else sensor
    path = _Path(model, near, static, {**_OPTIONS, **given_options(petsc_options)})
    row = path.motion.place("sensors", sensor)
    reach = row.dot(path.shape)
    if reach < 0:  # of the two directions of a mode, that in which the sensor moves on
        path.turn()
        reach = -reach
    if reach < 1e-8 * row.norm() * path.shape.norm():
        raise InputError("the sensor does not move in the mode; expected another sensor.")
    first = path.omega2 * low / reach * 10**-_BEFORE
    points, end = _load(path, row, first, (low, high), 10 ** (1 / per_decade), loop_steps)
    path.destroy()
    return _backbone(points, path.omega2, sensor, end, low)


class _Path:
    """Equilibria under a growing load of a mode's inertia, from the state under a static load.

    Attributes:
        motion, statics: The structure and its equilibrium.
        omega2, shape: Eigenvalue, (rad/s)^2, and M-normalised shape at the start.
    """

    def __init__(self, model, near: float | None, static, options: Mapping[str, object]):
        self.motion = model.motion()
        self.statics = Statics(self.motion, options)
        self._static = self.motion.vector()
        if static is not None:
            self._static.array[:] = static.array_r if isinstance(static, PETSc.Vec) else static
            self._static.copy(self.statics.load)
            if self.statics.solve() is None:
                raise ConvergenceError(
                    "static load: no equilibrium was found", reason_of(self.statics.solver)
                )
            self.statics.keep()
        self.begin = self.statics.u.copy()
        K = self.motion.matrix()
        self.motion.jacobian(self.begin, self.statics.states, 0.0, 0.0, K)
        self.omega2, self.shape = _mode(self.motion, K, near)
        K.destroy()
        self.inertia = self.motion.inertia(self.shape)

    def turn(self) -> None:
        """Load the other way."""
        self.shape.scale(-1.0)
        self.inertia.scale(-1.0)

    def go(self, alpha: float, guess: PETSc.Vec) -> bool:
        """Equilibrium at a load, from a guess of the displacement; whether there is one."""
        s = self.statics
        guess.copy(s.u)
        self._static.copy(s.load)
        s.load.axpy(alpha, self.inertia)
        return s.solve() is not None

    def moved(self) -> PETSc.Vec:
        """Displacement since the start; the caller frees it."""
        found = self.statics.u.copy()
        found.axpy(-1.0, self.begin)
        return found

    def q(self) -> float:
        """Modal amplitude since the start."""
        moved = self.moved()
        q = moved.dot(self.inertia)
        moved.destroy()
        return float(q)

    def guess(self, alpha: float, last: float) -> PETSc.Vec:
        """Displacement at a load by that at the last one, or by the mode; the caller frees it."""
        found = self.begin.copy()
        if last:
            moved = self.moved()
            found.axpy(alpha / last, moved)
            moved.destroy()
        else:
            found.axpy(alpha / self.omega2, self.shape)
        return found

    def destroy(self) -> None:
        self.statics.destroy()


def _load(path: _Path, row, alpha: float, amplitudes, ratio: float, loop_steps: int):
    """Points of the path, and how it ended.

    A point is (alpha, q of the first loading, q, amplitude at the sensor, drag, energy of a loop).
    Drag is u^T C u of the displacement; the energy is None without loops. With loops the other
    numbers are of half the way from one end to the other.
    """
    low, high = amplitudes
    points, last, step, halvings = [], 0.0, ratio, 0
    while True:
        before, guess = path.statics.u.copy(), path.guess(alpha, last)
        found = path.go(alpha, guess)
        guess.destroy()
        if not found and not points:
            raise ConvergenceError(
                f"the static response to the load of {alpha:g} was not found; expected lower "
                "amplitudes",
                reason_of(path.statics.solver),
            )
        q = path.q() if found else np.inf
        # Where the joint gives way the motion grows faster than the load, or is anything.
        if points and not points[-1][1] < q < points[-1][1] * ratio**2:
            before.copy(path.statics.u)
            if halvings == _HALVINGS:
                return points, "gives way"
            halvings, step = halvings + 1, np.sqrt(step)
            alpha = last * step
            continue
        before.destroy()
        path.statics.keep()
        moved, energy = path.moved(), None
        if loop_steps and abs(row.dot(moved)) >= low:
            moved.destroy()
            energy, moved = _loop(path, alpha, loop_steps)
        drag = path.motion.drag(moved)
        size = abs(row.dot(moved))
        points.append((alpha, q, moved.dot(path.inertia), size, moved.dot(drag), energy))
        moved.destroy(), drag.destroy()
        if size >= high:
            return points, "reached"
        last, alpha = alpha, alpha * step


def _loop(path: _Path, alpha: float, steps: int) -> tuple[float, PETSc.Vec]:
    """A cycle of the load: its energy, by the trapezoidal rule, and half the way between its ends.

    All is put back after it; the caller frees the vector.
    """
    s = path.statics
    top, states, s.scale = s.u.copy(), [state.copy() for state in s.states], s.load.norm()
    loads = alpha * np.linspace(1, -1, steps + 1)
    loads, q, low = np.concatenate([loads, -loads[1:]]), [path.q()], None
    for i, load in enumerate(loads[1:], 1):
        guess = s.u.copy()
        found = path.go(load, guess)
        guess.destroy()
        if not found:
            raise ConvergenceError(
                f"a loop of the load {alpha:g} was not closed; expected more loop_steps",
                reason_of(s.solver),
            )
        s.keep()
        q.append(path.q())
        low = s.u.copy() if i == steps else low
    half = s.u.copy()
    half.axpy(-1.0, low)
    half.scale(0.5)
    top.copy(s.u)
    top.destroy(), low.destroy()
    s.states, s.scale = states, 0.0
    return float(np.sum(0.5 * (loads[1:] + loads[:-1]) * np.diff(q))), half


#: Share of a cycle's work below which a loop that makes energy is round-off. [numerical: chosen]
_HARDENS = 1e-3


def _backbone(points, omega2: float, sensor: str, end: str, low: float) -> StaticBackbone:
    """Frequency and damping of the points of a path, those below the lowest amplitude left out."""
    looped = [point for point in points if point[-1] is not None]
    alpha, first, q, size, drag, energy = np.array(looped or points, dtype=float).T
    if not looped:
        keep = size >= low * (1 - 1e-9)
        energy = _masing(alpha, first, omega2)[keep]
        alpha, q, size, drag = (v[keep] for v in (alpha, q, size, drag))
    omega = np.sqrt(alpha / q)
    if not looped and np.any(energy < -_HARDENS * alpha * q):
        raise ConvergenceError(
            "Masing's rule gives a loop that makes energy, as of a law that grows stiffer: "
            "expected loop_steps above 0, such as 40"
        )
    taken = energy + np.pi * omega * drag
    return StaticBackbone(
        frequencies_hz=omega / (2 * np.pi),
        damping_ratios=taken / (2 * np.pi * alpha * q),
        modal_amplitudes=q,
        loads=alpha,
        energies=energy,
        sensor=sensor,
        amplitudes=size,
        end=end,
    )


def _masing(alpha: np.ndarray, q: np.ndarray, omega2: float) -> np.ndarray:
    """Energy of Masing's loops of a first loading: 8 int alpha dq - 4 alpha q.

    Of what the load falls short of a straight line, so that small loops do not cancel; between two
    points, and before the first, that is a power of q, as slip makes it.
    """
    short = omega2 * q - alpha
    rise, fall = np.log(q[1:] / q[:-1]), short[1:] / np.where(short[:-1] > 0, short[:-1], np.nan)
    with np.errstate(invalid="ignore", divide="ignore"):
        power = np.log(fall) / rise
    power = np.where(np.isfinite(power) & (power > 0), power, 1.0)
    steps = np.append(short[0] * q[0], short[1:] * q[1:] - short[:-1] * q[:-1])
    steps /= np.append(power[:1], power) + 1 if len(q) > 1 else 2.0
    straight = power == 1.0
    steps[1:][straight] = (0.5 * (short[1:] + short[:-1]) * np.diff(q))[straight]
    return 4 * short * q - 8 * np.cumsum(steps)


def _mode(motion: Motion, K: PETSc.Mat, near: float | None) -> tuple[float, PETSc.Vec]:
    """Eigenvalue and shape of the elastic mode nearest to a frequency. Collective."""
    values, shape = motion.elastic_modes(K)
    if not len(values) or values.max() <= 0:
        raise InputError("the model has no elastic mode; expected some stiffness.")
    hz = np.sqrt(np.maximum(values, 0.0)) / (2 * np.pi)
    i = 0 if near is None else int(np.argmin(np.abs(hz - near)))
    return float(values[i]), shape(i)
