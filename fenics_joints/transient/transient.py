"""Time integration of a structure with nonlinear joints, by PETSc's generalised-alpha method.

It is the slow and independent way to what `harmonic` finds, and the way to ring-downs. The joints'
states are carried from step to step, and stress is taken between them by the law's own update.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from petsc4py import PETSc
from scipy.interpolate import CubicSpline

from fenics_joints.errors import ConvergenceError, InputError, capable, real, reals, wanted, whole
from fenics_joints.interfaces.motion import Motion
from fenics_joints.modal.options import given_options, last_line, petsc_defaults, reason_of


@dataclass(frozen=True, repr=False)
class RingDown:
    """Frequency and damping of a free decay, cycle by cycle.

    Attributes:
        amplitudes: Mean of the two peaks that bound each cycle, in the signal's unit, (n,).
        frequencies_hz: One over the cycle's length, (n,).
        damping: Damping ratio from the logarithmic decrement of the cycle, (n,).
    """

    amplitudes: np.ndarray
    frequencies_hz: np.ndarray
    damping: np.ndarray

    def __repr__(self) -> str:
        low, high = self.frequencies_hz.min(), self.frequencies_hz.max()
        return f"RingDown({len(self.amplitudes)} cycles, {low:.4g} to {high:.4g} Hz)"


def ring_down(times, signal) -> RingDown:
    """Frequency and damping of each cycle of a decaying signal of one mode.

    Args:
        times: s, ascending, (n,).
        signal: Displacement, velocity or acceleration that swings about zero, (n,).

    Raises:
        InputError: If there are fewer than three maxima.
    """
    times = reals("times", times, (None,), "s")
    signal = reals("signal", signal, times.shape)
    if len(times) < 2 or not np.all(np.diff(times) > 0):
        raise InputError("times: expected two or more instants, ascending.")
    spline = CubicSpline(times, signal)
    turning = spline.derivative().roots(extrapolate=False)
    tops = turning[spline(turning, 2) < 0]
    heights = spline(tops)
    tops, heights = tops[heights > 0], heights[heights > 0]
    if len(tops) < 3:
        raise InputError(f"the signal has {len(tops)} maxima above zero: expected 3 or more.")
    decrement = np.log(heights[:-1] / heights[1:])
    return RingDown(
        np.sqrt(heights[:-1] * heights[1:]),
        1 / np.diff(tops),
        decrement / np.sqrt(4 * np.pi**2 + decrement**2),
    )


_PREFIX = "fenics_joints_transient_"
_DEFAULTS = {
    "ts_type": "alpha2",
    "ts_alpha_radius": 0.9,
    "ts_adapt_type": "none",
    "snes_rtol": 1e-9,
    "snes_stol": 1e-12,
    "snes_max_it": 30,
    "snes_linesearch_type": "basic",
    "ksp_type": "preonly",
    "pc_type": "lu",
}


@dataclass(frozen=True, repr=False)
class TransientResult:
    """A motion over time.

    Attributes:
        times: s, (n + 1,); the start included.
        displacements: At each sensor by name, m, (n + 1,).
        velocities: Likewise, m/s.
        accelerations: Likewise, m/s2; those of the method, of first order: they belong to a time
            that is (1 - r) / (1 + r) steps away, r being the spectral radius.
        work: Work of the load, J, (n + 1,).
        damped: Work that the viscous damping took, J, (n + 1,).
        joint_work: Work put into each interface's points so far, stored or dissipated, J, (n + 1,),
            by the interface's name.
        energy: Kinetic energy and that of the linear structure, J, (n + 1,).
        final: (u, v, states) at the end, to start the next motion from.
        iterations: Newton iterations in total.
    """

    times: np.ndarray
    displacements: Mapping[str, np.ndarray]
    velocities: Mapping[str, np.ndarray]
    accelerations: Mapping[str, np.ndarray]
    work: np.ndarray
    damped: np.ndarray
    joint_work: Mapping[str, np.ndarray]
    energy: np.ndarray
    final: tuple
    iterations: int

    def __repr__(self) -> str:
        sensors = ", ".join(self.displacements)
        return f"TransientResult({len(self.times) - 1} steps to {self.times[-1]:.4g} s, {sensors})"

    def ring_down(self, sensor: str) -> RingDown:
        """Frequency and damping against amplitude at a sensor, from a free decay."""
        return ring_down(self.times, self.displacements[sensor])


class _Record:
    """The quantities kept of each step."""

    def __init__(self, motion: Motion, sensors: Sequence[str]):
        self.motion = motion
        self.rows = {name: motion.place("sensors", name) for name in sensors}
        self.times, self.energy = [], []
        self.kinds = tuple({name: [] for name in sensors} for _ in range(3))  # u, v, a
        self.works = []  # of the load, of the damping and on each interface, in each step
        self._last = None

    def add(self, t, u, v, a, load, points) -> None:
        """One converged instant; work by the trapezoidal rule."""
        self.times.append(t)
        for kind, vector in zip(self.kinds, (u, v, a), strict=True):
            for name, row in self.rows.items():
                kind[name].append(row.dot(vector))
        self.energy.append(self.motion.energy(u, v))
        now = u.copy(), (load.copy(), self.motion.drag(v)), points
        last_u, last_forces, last_points = self._last or now
        du = u - last_u
        work = [
            0.5 * (old.dot(du) + new.dot(du)) for old, new in zip(last_forces, now[1], strict=True)
        ]
        for p, (e0, f0, *_), (e1, f1, *_) in zip(
            self.motion.interfaces, last_points, points, strict=True
        ):
            done = float((p.weights[:, None] * (f0 + f1) * (e1 - e0)).sum())
            work.append(0.5 * self.motion.total(done))
        self.works.append(work)
        self._last = now

    def result(self, final, iterations) -> TransientResult:
        """All steps as arrays."""
        kinds = [{n: np.array(values) for n, values in kind.items()} for kind in self.kinds]
        work, damped, *joints = np.cumsum(self.works, axis=0).T
        names = [p.name for p in self.motion.interfaces]
        return TransientResult(
            np.array(self.times),
            *kinds,
            work,
            damped,
            dict(zip(names, joints, strict=True)),
            np.array(self.energy),
            final,
            iterations,
        )


def solve_transient(
    model,
    *,
    step: float,
    n_steps: int,
    loads: Mapping[str, Callable[[float], float]] | None = None,
    sensors: Sequence[str] | None = None,
    initial: tuple | None = None,
    start: float = 0.0,
    petsc_options: Mapping[str, object] | None = None,
    progress: Callable[[int], None] | None = None,
) -> TransientResult:
    """Integrate the motion of a model in time.

    Args:
        model: An `InterfaceModel`, or a `FullModel` (collective then).
        step: Time step, s.
        n_steps: Number of steps.
        loads: Force in newtons as a function of time in seconds, by the place's name.
        sensors: Names of the sensors to record; all of the model's by default.
        initial: (u, v, states) to start from, such as another result's ``final``: vectors or
            arrays of the model's size, states as they come; None for a part is rest.
        start: Time at the start, s.
        petsc_options: Options of PETSc's TS, SNES and KSP, without prefix; ``ts_alpha_radius``
            is the spectral radius at infinity, 0.9.
        progress: Called with the number of steps done, after each.

    Raises:
        InputError: For a step or number out of range, an unknown place, or a start that does not
            fit.
        ConvergenceError: If a step does not converge, with PETSc's reason.
    """
    capable("model", model, ("motion", "sensors"), "an InterfaceModel or a FullModel")
    real("step", step, "s", above=0)
    n_steps = whole("n_steps", n_steps)
    real("start", start, "s")
    for name, signal in (loads or {}).items():
        if not callable(signal):
            raise wanted(f"loads[{name!r}]", signal, "a force, N, as a function of time, s")
    if isinstance(sensors, str):
        raise wanted("sensors", sensors, "a list of names")
    run = _Integration(model.motion(), loads or {}, petsc_options)
    record = _Record(run.motion, list(model.sensors if sensors is None else sensors))
    return run.solve(record, initial, start, step, n_steps, progress)


class _Integration:
    """PETSc's TS on one motion. ``solver`` is the TS."""

    def __init__(self, motion: Motion, loads, petsc_options):
        self.motion = motion
        self.places = [(motion.place("forces", name), signal) for name, signal in loads.items()]
        self.load = motion.vector()
        self.states = motion.rest()
        self.solver = ts = PETSc.TS().create(comm=motion.comm)
        ts.setProblemType(PETSc.TS.ProblemType.NONLINEAR)
        ts.setOptionsPrefix(_PREFIX)
        self._residual = motion.vector()
        self._matrix = motion.matrix()
        ts.setI2Function(self._i2function, self._residual)
        ts.setI2Jacobian(self._i2jacobian, self._matrix)
        ts.setExactFinalTime(PETSc.TS.ExactFinalTime.STEPOVER)
        given = given_options(petsc_options)
        with petsc_defaults(_PREFIX, {**_DEFAULTS, **motion.options, **given}):
            ts.setFromOptions()
            ts.getSNES().setFromOptions()
            self._gamma = _newmark_gamma(PETSc.Options(_PREFIX))

    def _loaded(self, t: float) -> PETSc.Vec:
        self.load.set(0.0)
        for row, signal in self.places:
            self.load.axpy(float(signal(t)), row)
        return self.load

    def _i2function(self, ts, t, u, v, a, out) -> None:
        self.motion.residual(u, v, a, self._loaded(t), self.states, out)

    def _i2jacobian(self, ts, t, u, v, a, shift_v, shift_a, J, P) -> None:
        self.motion.jacobian(u, self.states, shift_v, shift_a, P, v)

    def solve(self, record, initial, start, step, n_steps, progress) -> TransientResult:
        if initial is None:
            initial = (None, None, None)
        if not isinstance(initial, tuple | list) or len(initial) != 3:
            raise wanted("initial", initial, "displacements, velocities and states, or None")
        ts, (u, v, states) = self.solver, initial
        u, v = self._start(u), self._start(v)
        if states is not None:
            self.states = states
        acceleration = self._acceleration(u, v, start, step)
        points = self.motion.step(u, self.states, v)
        record.add(start, u, v, acceleration, self._loaded(start), points)
        before, gamma = (v.copy(), acceleration), self._gamma

        def after(ts):
            t, (x, w) = ts.getTime(), ts.getSolution2()
            points = self.motion.step(x, self.states, w)
            self.states = [new for _, _, new, _ in points]
            # Newmark's relation of the velocities gives the acceleration that TS keeps to itself.
            a = w.copy()
            a.axpy(-1.0, before[0])
            a.scale(1 / (gamma * step))
            a.axpy(-(1 - gamma) / gamma, before[1])
            before[0].array[:] = w.array_r
            before[1].array[:] = a.array_r
            record.add(t, x, w, a, self._loaded(t), points)
            if progress is not None:
                progress(ts.getStepNumber())

        ts.setPostStep(after)
        ts.setTime(start)
        ts.setTimeStep(step)
        ts.setMaxSteps(n_steps)
        ts.setMaxTime(np.inf)
        ts.setSolution2(u, v)
        try:
            ts.solve(u)
        except PETSc.Error as error:
            raise self._failed(last_line(error)) from error
        if ts.getConvergedReason() < 0:
            raise self._failed(reason_of(ts))
        u, v = ts.getSolution2()
        return record.result((u.copy(), v.copy(), self.states), ts.getSNESIterations())

    def _failed(self, reason: str) -> ConvergenceError:
        t = self.solver.getTime()
        return ConvergenceError(
            f"time integration stopped at t = {t:.6g} s; try a smaller step", reason
        )

    def _start(self, given) -> PETSc.Vec:
        vector = self.motion.vector()
        if given is not None:
            given = given.array_r if isinstance(given, PETSc.Vec) else reals("initial", given)
            if given.shape != vector.array_r.shape:
                raise InputError(
                    f"initial: a vector has shape {given.shape}: expected {vector.array_r.shape}."
                )
            vector.array[:] = given
        return vector

    def _acceleration(self, u, v, t, step: float) -> PETSc.Vec:
        """M a = load - C v - K u - f(u) at the start."""
        a, r = self.motion.vector(), self.motion.vector()
        self.motion.residual(u, v, a, self._loaded(t), self.states, r)
        r.scale(-1.0)
        return self.motion.acceleration(r, u, self.states, step)


def _newmark_gamma(options: PETSc.Options) -> float:
    """Newmark's gamma of generalised alpha, as PETSc takes it from its options.

    From the spectral radius r: alpha_m = (2 - r) / (1 + r), alpha_f = 1 / (1 + r), gamma = 1/2 +
    alpha_m - alpha_f (Chung and Hulbert, J. Appl. Mech. 60, 1993). PETSc tells of this type what
    it solved, but not its parameters.
    """
    radius = options.getReal("ts_alpha_radius", 1.0)
    return options.getReal("ts_alpha_gamma", 0.5 + (1 - radius) / (1 + radius))


# -- steady states ---------------------------------------------------------------------------------


def steady_harmonics(times, signal, frequency: float, harmonics: int = 1) -> np.ndarray:
    """Harmonics of a signal over its last whole period, by least squares.

    Args:
        times: s, evenly spaced.
        signal: Values there.
        frequency: Hz.
        harmonics: Number of harmonics, H.

    Returns:
        Mean, then cosine and sine of each harmonic, (2 H + 1,).
    """
    times = reals("times", times, (None,), "s")
    signal = reals("signal", signal, times.shape)
    real("frequency", frequency, "Hz", above=0)
    whole("harmonics", harmonics)
    if not len(times):
        raise wanted("times", times, "at least one period")
    inside = times > times[-1] - (1 + 1e-9) / frequency
    t, y = times[inside], np.asarray(signal)[inside]
    columns = [np.ones_like(t)]
    for h in range(1, harmonics + 1):
        phase = 2 * np.pi * h * frequency * t
        columns += [np.cos(phase), np.sin(phase)]
    return np.linalg.lstsq(np.column_stack(columns), y, rcond=None)[0]


def stepped_sine(
    model,
    force: str,
    amplitude: float,
    frequencies: Sequence[float],
    *,
    sensor: str,
    steps_per_period: int = 100,
    tolerance: float = 1e-3,
    max_periods: int = 400,
    harmonics: int = 5,
    initial: tuple | None = None,
    petsc_options: Mapping[str, object] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Steady responses to a sinusoidal force at one frequency after another, as a test makes them.

    Each frequency starts from the motion that the last one left, and ends when the first harmonic
    of the sensor's displacement changes by less than ``tolerance`` over ten periods.

    Args:
        model: An `InterfaceModel` or `FullModel`.
        force: Place of the force.
        amplitude: Of the force, N; it acts as amplitude * cos(omega t).
        frequencies: Hz.
        sensor: Name of the sensor.
        steps_per_period: Time steps per period.
        tolerance: Relative change over ten periods at which a response counts as steady.
        max_periods: Periods after which one gives up.
        harmonics: Harmonics of the answer.
        initial: As in `solve_transient`.
        petsc_options: As in `solve_transient`.

    Returns:
        (harmonics of the displacement, m, (n, 2 H + 1), as `steady_harmonics`; periods that each
        frequency took, (n,)).

    Raises:
        ConvergenceError: If a response does not become steady.
    """
    real("amplitude", amplitude, "N", above=0)
    frequencies = reals("frequencies", frequencies, (None,), "Hz", above=0).tolist()
    whole("steps_per_period", steps_per_period)
    real("tolerance", tolerance, above=0)
    found, periods = [], []
    for frequency in frequencies:
        last, now, count = None, None, 0
        while last is None or np.abs(now - last).max() > tolerance * np.abs(now).max():
            if count >= max_periods:
                raise ConvergenceError(
                    f"the response at {frequency:g} Hz is not steady after {count} periods; "
                    "expected more damping, or give more max_periods"
                )
            run = solve_transient(
                model,
                step=1 / frequency / steps_per_period,
                n_steps=10 * steps_per_period,
                loads={force: lambda t, w=2 * np.pi * frequency: amplitude * np.cos(w * t)},
                sensors=[sensor],
                initial=initial,
                petsc_options=petsc_options,
            )
            initial, count, last = run.final, count + 10, now
            now = steady_harmonics(run.times, run.displacements[sensor], frequency, harmonics)
        found.append(now)
        periods.append(count)
    return np.array(found), np.array(periods)
