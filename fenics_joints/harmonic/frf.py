"""Nonlinear frequency responses at constant force, and at constant response.

At constant response the unknown is the force that keeps a sensor's amplitude constant, as in a test
with a controlled response: near a resonance the interfaces then move about equally at all
frequencies, and the response is nearly that of a linear structure.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fenics_joints.errors import ConvergenceError, InputError, member, real, reals, wanted
from fenics_joints.harmonic.balance import Balance, BalanceOptions, Load, Loading
from fenics_joints.harmonic.continuation import (
    Branch,
    ContinuationSettings,
    check_settings,
    correct,
    follow,
    locate,
    solve_at,
)
from fenics_joints.harmonic.fourier import KINDS, amplitude_gradient, moving_size
from fenics_joints.harmonic.result import HarmonicResult, check_interval, check_sensor
from fenics_joints.interfaces.model import InterfaceModel
from fenics_joints.progress import Progress

if TYPE_CHECKING:
    from typing_extensions import Unpack


def solve_harmonic(
    model: InterfaceModel,
    force: str,
    amplitude: float,
    band: tuple[float, float] | None = None,
    *,
    at: Sequence[float] | None = None,
    sensor: str | None = None,
    measure: str = "first",
    direction: str = "up",
    more: Sequence[Load] = (),
    power: int = 0,
    settings: ContinuationSettings | None = None,
    initial: HarmonicResult | None = None,
    checkpoint: str | Path | None = None,
    resume: bool = False,
    progress: Progress | None = None,
    **equations: Unpack[BalanceOptions],
) -> HarmonicResult:
    """Steady response to amplitude * cos(w t), over a band or at given frequencies.

    Over a band the branch is followed through its turning points, and the maxima of one sensor's
    amplitude are points of it. A base that shakes is a force too, on the motion relative to it: one
    whose row is -M times the rigid motion, as `reduce_layers` makes of a place without a point. Its
    amplitude is the base's acceleration, m/s2, or with ``power`` 2 its displacement against it, m.

    Args:
        model: The structure.
        force: Place of the force.
        amplitude: Amplitude of the force, N.
        band: Lowest and highest frequency, Hz.
        at: Instead of the band: frequencies, Hz, in any order; each response starts from that of
            its neighbour. They are on one branch unless there is a turning point in between.
        sensor: Whose maxima are found; the model's first by default.
        measure: Amplitude that is largest there: ``first`` harmonic, or ``peak``, half of peak to
            peak.
        direction: ``up`` or ``down`` the band.
        more: Further loads, of any harmonic, phase and place.
        power: Of the frequency, rad/s, that the force is multiplied by, as `Load` has it.
        settings: Steps and tolerances of the continuation.
        initial: Responses of a near model at the same frequencies (``at``), to start from.
        checkpoint: File (HDF5) that the branch is written to as it grows.
        resume: Go on from ``checkpoint`` if it is there; one of another problem is an error.
        progress: Told of every point.
        equations: Options of `Balance`: ``harmonics``, the highest, 5; ``samples`` of a period;
            ``static``, a load, N, (n,), such as a preload, which friction remembers; ``cycles``
            that laws with memory run through; ``comm``, ranks that share the interfaces' points.

    Raises:
        InputError: For an unknown name, or a value out of range.
        ConvergenceError: If the branch cannot be followed; its points so far are the error's
            ``branch``. A resonance without bound is named as such.
    """
    amplitude = real("amplitude", amplitude, "N", above=0)
    if at is not None:
        at = reals("at", at, (None,), "Hz", above=0)
        if not len(at):
            raise InputError("at = []: expected positive frequencies, Hz.")
    if (band is None) == (at is None):
        raise InputError("expected either band = (low, high), Hz, or at = [frequencies], Hz.")
    sensor = check_sensor(model, sensor)
    amplitude_gradient(np.zeros(3), measure)  # raises for an unknown one
    balance = Balance(model, **equations)
    settings = check_settings(settings)
    more = tuple(more)
    loading = Loading.of(balance, (Load(force, amplitude, power=power), *more))
    named = {"force": force, "sensor": sensor, "measure": measure, "more": more, "power": power}
    tell = telling(progress, f"response to {amplitude:g} N at {force}")
    if at is not None:
        omegas = 2 * np.pi * at
        problem = ForcedResponse(balance, loading, float(np.ptp(omegas)) or omegas[0])
        found = solve_at(
            problem,
            omegas,
            lambda omega: first_response(problem, omega, settings),
            settings,
            initial=_starts(balance, initial, at),
            on_point=tell,
        )
        return responses(balance, found, amplitude, **named)
    band = check_band(band, direction)
    problem = ForcedResponse(balance, loading, 2 * np.pi * (band[1] - band[0]))
    branch = follow_band(
        problem,
        lambda omega: first_response(problem, omega, settings),
        band,
        direction,
        words=("force", force, amplitude, *more, power),
        settings=settings,
        checkpoint=checkpoint,
        resume=resume,
        on_point=tell,
    )
    branch = with_maxima(problem, branch, model.row("sensors", sensor), measure, settings)
    return responses(balance, branch, amplitude, **named)


def responses(
    balance: Balance, branch: Branch, amplitude: float | np.ndarray, kind=HarmonicResult, **named
) -> HarmonicResult:
    """The result of a branch whose points are coefficients and omega.

    Args:
        balance: The equations.
        branch: The points; its tangents may be None.
        amplitude: Of the force, N, of all points or each.
        kind: Class of the result.
        named: The result's other attributes; ``of`` is another result that gives place of the
            force, sensor, measure and loads.
    """
    of = named.pop("of", None)
    shared = ("force", "sensor", "measure", "more", "power")
    named = ({} if of is None else {key: getattr(of, key) for key in shared}) | named
    return kind(
        balance=balance,
        frequencies_hz=branch.z[:, -1] / (2 * np.pi),
        coefficients=branch.z[:, :-1].reshape(-1, *balance.shape),
        iterations=branch.iterations,
        jacobians=branch.jacobians,
        force_amplitudes=np.full(len(branch), amplitude, dtype=float),
        tangents=branch.tangents,
        **named,
    )


def check_band(band, direction: str) -> tuple[float, float]:
    """The band, Hz, checked together with the direction of the sweep."""
    member("direction", direction, ("up", "down"))
    return check_interval("band", band, "Hz")


def follow_band(
    problem,
    start: Callable[[float], np.ndarray],
    band: tuple[float, float],
    direction: str,
    *,
    words: Sequence[object],
    **options,
) -> Branch:
    """The branch of a problem over a band, omega being its parameter.

    Args:
        problem: The equations, with their `balance`.
        start: A guess of the first point at its omega, rad/s.
        band: Lowest and highest frequency, Hz.
        direction: ``up`` or ``down`` the band.
        words: What is being solved, for the branch's `fingerprint`.
        options: As for `follow`.

    Raises:
        InputError, ConvergenceError: As `follow`.
    """
    low, high = (2 * np.pi * f for f in band)
    on_point, sizes, reason = options.pop("on_point"), [], None

    def size(z: np.ndarray) -> tuple[float, float]:
        """Frequency and size of the motion at a point."""
        return z[-1], moving_size(z[: problem.balance.size].reshape(problem.balance.shape))

    def grows(z: np.ndarray) -> bool:
        on_point(z)
        sizes.append(size(z))
        return _has_no_bound(sizes, _MOST)

    try:
        branch = follow(
            problem,
            start(low if direction == "up" else high),
            (low, high),
            direction=1 if direction == "up" else -1,
            name=fingerprint(problem.balance, *words, *band, direction),
            writes=problem.balance.comm.rank == 0,
            on_point=grows,
            **options,
        )
        if branch.complete:
            return branch
    except ConvergenceError as error:
        branch, reason = getattr(error, "branch", None), str(error)
        if branch is None or not _has_no_bound([size(z) for z in branch.z], _MUCH):
            raise
    found = ConvergenceError(
        f"the resonance at {branch.z[-1, -1] / (2 * np.pi):.6g} Hz has no bound: the motion grows "
        "for ever, since nothing takes what the force puts in (no damping, or friction that slides "
        "all the way and takes less); expected some damping, or a smaller force",
        reason,
    )
    found.branch = branch
    raise found


#: Growth of the motion over the branch's least at which a resonance has no bound: no damping of a
#: structure allows as much; and the growth from which a branch that stopped was on its way there.
_MOST, _MUCH = 1e9, 1e4
#: Relative change of frequency, while the motion grows tenfold, below which the frequency has a
#: limit; chosen.
_STILL = 1e-3


def _has_no_bound(points: Sequence[tuple[float, float]], most: float) -> bool:
    """Whether a motion grows more than so much, at a frequency that has a limit.

    Args:
        points: Frequency, rad/s, and size of the motion along a branch.
        most: Growth over the least size.
    """
    omegas, sizes = np.array(points).T
    if not sizes[-1] > most * sizes.min():
        return False
    since = int(np.flatnonzero(sizes < 0.1 * sizes[-1])[-1])
    return bool(np.ptp(omegas[since:]) < _STILL * abs(omegas[-1]))


def telling(
    progress: Progress | None,
    text: str,
    where: Callable[[np.ndarray], str] = lambda z: f"{z[-1] / (2 * np.pi):.4g} Hz",
) -> Callable[[np.ndarray], None]:
    """A function that reports every new point to the progress, with its frequency by default."""
    if progress is None:
        return lambda z: None
    progress.step(text)
    return lambda z: progress.advance(1, where(z))


class ForcedResponse:
    """Harmonic balance under a given load, with omega or the load's share as the parameter.

    Args:
        balance: The equations.
        loading: The load.
        width: Notable change of the parameter: of omega, rad/s, or of the share.
        omega: Angular frequency, rad/s, at which the load grows; None for omega as the parameter.
        least: Least size of the motion to scale it by.
    """

    def __init__(
        self,
        balance: Balance,
        loading: Loading,
        width: float,
        *,
        omega: float | None = None,
        least: float = 0.0,
    ):
        self.balance, self.loading, self.width = balance, loading, width
        self.omega, self.least, self.kinked = omega, least, balance.kinked

    def evaluate(self, z: np.ndarray, *, jacobian: bool = True):
        """Residual and its derivative by the coefficients and the parameter."""
        X = z[:-1].reshape(self.balance.shape)
        omega, share = (z[-1], 1.0) if self.omega is None else (self.omega, z[-1])
        load = self.loading.at(omega)
        R, J = self.balance.evaluate(X, omega, share * load, jacobian=jacobian)
        if not jacobian:
            return R.reshape(-1), None
        if self.omega is None:
            last = self.balance.by_omega(X, omega) - self.loading.slope(omega)
        else:
            last = -load
        return R.reshape(-1), np.hstack([J, last.reshape(-1, 1)])

    def scales(self, z: np.ndarray) -> np.ndarray:
        """The motion's size without its mean, and the width."""
        size = max(moving_size(z[:-1].reshape(self.balance.shape)), self.least)
        return np.append(np.full(len(z) - 1, size), self.width)


class Condition:
    """An equation g(X, omega) = 0 beside harmonic balance.

    Attributes:
        by_jacobian: Whether g is computed from the residual's derivative.
    """

    by_jacobian = False

    def value(
        self, X: np.ndarray, omega: float, J: np.ndarray | None
    ) -> tuple[float, np.ndarray, float]:
        """g and its derivatives by X, (n K,), and by omega; J is the residual's derivative by X."""
        raise NotImplementedError

    def at(self, X: np.ndarray, omega: float, J: np.ndarray) -> None:
        """Take a point of the branch as the present one, where g depends on it."""


class ConditionedResponse:
    """Harmonic balance and a condition; unknowns X, and omega and the load's share in some order.

    The last of them is the parameter.

    Args:
        balance: The equations.
        loading: The load at a share of one.
        condition: The condition.
        widths: Notable changes of omega, rad/s, and of the share.
        last: ``share`` or ``omega``.
    """

    def __init__(
        self,
        balance: Balance,
        loading: Loading,
        condition: Condition,
        widths: tuple[float, float],
        last: str = "share",
    ):
        self.balance, self.loading, self.condition = balance, loading, condition
        self.widths, self.kinked = widths, balance.kinked
        self.omega, self.share = (-2, -1) if last == "share" else (-1, -2)

    def evaluate(self, z: np.ndarray, *, jacobian: bool = True):
        """Residual and its derivative, as `BranchProblem` has it."""
        balance, omega, share = self.balance, z[self.omega], z[self.share]
        X, load = z[:-2].reshape(balance.shape), self.loading.at(omega)
        needed = jacobian or self.condition.by_jacobian
        R, J = balance.evaluate(X, omega, share * load, jacobian=needed)
        g, by_X, by_omega = self.condition.value(X, omega, J)
        R = np.append(R.reshape(-1), g)
        if not jacobian:
            return R, None
        N = balance.size
        found = np.zeros((N + 1, N + 2))
        found[:N, :N], found[N, :N], found[N, self.omega] = J, by_X, by_omega
        by_omega = balance.by_omega(X, omega) - share * self.loading.slope(omega)
        found[:N, self.omega], found[:N, self.share] = by_omega.reshape(-1), -load.reshape(-1)
        return R, found

    def scales(self, z: np.ndarray) -> np.ndarray:
        """The motion's size without its mean, and the widths."""
        size = moving_size(z[:-2].reshape(self.balance.shape))
        found = np.full(len(z), size)
        found[[self.omega, self.share]] = self.widths
        return found

    def take(self, z: np.ndarray) -> None:
        """Take a point as the present one."""
        X = z[:-2].reshape(self.balance.shape)
        self.condition.at(X, z[self.omega], self.balance.evaluate(X, z[self.omega])[1])


def first_response(
    problem: ForcedResponse, omega: float, settings: ContinuationSettings
) -> np.ndarray:
    """A response at omega, (n K + 1,), from the linear one or under a growing load.

    Raises:
        ConvergenceError: If neither converges.
    """
    linear = linear_response(problem.balance, omega, problem.loading.at(omega))
    start = np.append(linear.reshape(-1), omega)
    try:
        return correct(problem, start, None, settings).z
    except ConvergenceError:
        pass
    balance = problem.balance
    growing = ForcedResponse(
        balance, problem.loading, 1.0, omega=omega, least=1e-3 * moving_size(linear)
    )
    share = 0.01
    first = np.append((balance.rest + share * (linear - balance.rest)).reshape(-1), share)
    z = follow(growing, first, (share, 1.0), settings=settings).z[-1]
    return np.append(z[:-1], omega)


def linear_response(balance: Balance, omega: float, load: np.ndarray) -> np.ndarray:
    """Response of the structure linearised at its static state, (n, K)."""
    rest = balance.rest
    R, J = balance.evaluate(rest, omega, load)
    try:
        return rest - np.linalg.solve(J, R.reshape(-1)).reshape(rest.shape)
    except np.linalg.LinAlgError:
        return rest


def with_maxima(problem, branch: Branch, row: np.ndarray, measure: str, settings) -> Branch:
    """The branch with the maxima of a sensor's amplitude among its points.

    Args:
        problem: The equations; the first n K unknowns are the coefficients.
        branch: The branch.
        row: The sensor's row, (n,).
        measure: Amplitude, see `amplitude`.
        settings: As for `follow`.
    """
    balance = problem.balance

    def slope(z: np.ndarray, tangent: np.ndarray) -> float:
        c, change = (row @ v[: balance.size].reshape(balance.shape) for v in (z, tangent))
        return float(amplitude_gradient(c, measure, balance.fourier.periods) @ change)

    return with_extremes(problem, branch, slope, settings)


def with_extremes(problem, branch: Branch, slope, settings: ContinuationSettings) -> Branch:
    """The branch with the points where a slope along it goes from positive to negative.

    Where Newton's method fails between two points, as it may at a kink, none is inserted.
    """
    slopes = [slope(z, t) for z, t in zip(branch.z, branch.tangents, strict=True)]
    for i in reversed(range(len(branch) - 1)):
        if slopes[i] > 0 > slopes[i + 1]:
            with suppress(ConvergenceError):
                branch = locate(problem, branch, i, slope, settings)
    return branch


def _starts(balance: Balance, initial: HarmonicResult | None, frequencies):
    if initial is None:
        return None
    if not isinstance(initial, HarmonicResult):
        raise wanted("initial", initial, "a HarmonicResult, or None")
    theirs = initial.frequencies_hz
    same = theirs.shape == frequencies.shape and np.allclose(theirs, frequencies, rtol=1e-9, atol=0)
    if not same or initial.coefficients.shape[1:] != balance.shape:
        raise InputError(
            "initial: expected responses at the same frequencies, with as many degrees of freedom "
            "and harmonics."
        )
    flat = initial.coefficients.reshape(len(frequencies), -1)
    return np.column_stack([flat, initial.omegas])


def fingerprint(balance: Balance, *words: object) -> str:
    """What a branch is a solution of: the model's and the request's numbers, as a short text.

    Numbers of the request and of laws may have been computed, and count to six digits. Matrices
    count to the last: a branch is coordinates in their basis.
    """
    told = [f"{w:.6g}" if isinstance(w, float) else str(w) for w in words]
    digest = hashlib.sha256(repr(told).encode())
    model = balance.model
    digest.update(
        repr((balance.fourier.harmonics, balance.fourier.samples, balance.cycles)).encode()
    )
    arrays = [model.M, model.C, model.K, balance.static, *model.forces.values()]
    for points in model.interfaces:
        digest.update(f"{points.law.label} {points.normal}".encode())
        arrays += [points.rows, points.weights]
        digest.update(points.law.values(len(points)).astype(np.float32).tobytes())
    for array in arrays:
        digest.update(np.ascontiguousarray(array, dtype=float).tobytes())
    return f"{words[0]} {digest.hexdigest()[:16]}"


# -- constant response -----------------------------------------------------------------------------


def solve_constant_response(
    model: InterfaceModel,
    force: str,
    sensor: str | None,
    amplitude: float,
    band: tuple[float, float],
    *,
    kind: str = "displacement",
    direction: str = "up",
    settings: ContinuationSettings | None = None,
    checkpoint: str | Path | None = None,
    resume: bool = False,
    progress: Progress | None = None,
    **equations: Unpack[BalanceOptions],
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
    forces = np.abs(branch.z[:, -2])
    return responses(balance, branch.without(-2), forces, force=force, sensor=sensor)


def _softer(z: np.ndarray, tangent: np.ndarray) -> float:
    """How fast the force's amplitude falls along the branch."""
    return -float(np.sign(z[-2]) * tangent[-2])


class HeldAmplitude(Condition):
    """A sensor's first harmonic has a given amplitude: (|u| omega^order / amplitude)^2 = 1.

    Args:
        sensor: Row of the sensor, (n,).
        amplitude: Amplitude of the sensor's time derivative.
        order: Which time derivative: 0, 1 or 2.
    """

    def __init__(self, sensor: np.ndarray, amplitude: float, order: int):
        self.sensor, self.amplitude, self.order = sensor, amplitude, order

    def value(
        self, X: np.ndarray, omega: float, J: np.ndarray | None
    ) -> tuple[float, np.ndarray, float]:
        """See `Condition`."""
        first = self.sensor @ X[:, 1:3]
        factor = omega ** (2 * self.order) / self.amplitude**2
        square, by_X = factor * float(first @ first), np.zeros(X.shape)
        by_X[:, 1:3] = 2 * factor * np.outer(self.sensor, first)
        return square - 1, by_X.reshape(-1), 2 * self.order / omega * square


class ConstantResponse(ConditionedResponse):
    """Harmonic balance with the force unknown and a sensor's first harmonic given.

    Unknowns: coefficients, force, omega.

    Args:
        balance: The equations.
        force: Row of the force, (n,).
        sensor, amplitude, order: As of `HeldAmplitude`.
        width: Notable change of omega, rad/s.
    """

    def __init__(self, balance: Balance, force, sensor, amplitude: float, order: int, width: float):
        loading = Loading({0: balance.load(force)})
        held = HeldAmplitude(sensor, amplitude, order)
        super().__init__(balance, loading, held, (width, 1.0), last="omega")

    def scales(self, z: np.ndarray) -> np.ndarray:
        """The motion's size, the force and the width."""
        found, held = super().scales(z), self.condition
        # The force that the motion takes away from resonance, so that its zero is no obstacle.
        least = 1e-3 * held.amplitude / (self._compliance * z[-1] ** held.order)
        found[-2] = max(abs(z[-2]), least)
        return found

    def start(self, omega: float, settings: ContinuationSettings) -> np.ndarray:
        """A guess of the response at omega, from the linear one."""
        held = self.condition
        X = linear_response(self.balance, omega, self.loading.at(omega))
        self._compliance = float(np.hypot(*(held.sensor @ X[:, 1:3])))
        if not self._compliance:
            raise InputError("the sensor does not move with the force; expected another sensor.")
        force = held.amplitude / (self._compliance * omega**held.order)
        loading = self.loading.times(force)
        forced = ForcedResponse(self.balance, loading, self.widths[0])
        try:
            X = first_response(forced, omega, settings)[:-1]
        except ConvergenceError:
            X = linear_response(self.balance, omega, loading.at(omega)).reshape(-1)
        return np.concatenate([X, [force, omega]])
