"""Nonlinear frequency response to a harmonic force of constant amplitude."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fenics_joints.errors import ConvergenceError, InputError, member, real, reals, wanted
from fenics_joints.harmonic.balance import Balance, Equations
from fenics_joints.harmonic.branch import Branch
from fenics_joints.harmonic.continuation import follow, locate
from fenics_joints.harmonic.corrector import Settings, check_settings, correct
from fenics_joints.harmonic.fourier import amplitude_gradient, moving_size
from fenics_joints.harmonic.loads import Load, Loading
from fenics_joints.harmonic.result import HarmonicResult, check_sensor
from fenics_joints.harmonic.unbounded import BoundWatch, unbounded
from fenics_joints.interfaces.model import InterfaceModel
from fenics_joints.progress import Progress

if TYPE_CHECKING:
    from typing_extensions import Unpack


_HALVINGS = 7


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
    settings: Settings | None = None,
    initial: HarmonicResult | None = None,
    checkpoint: str | Path | None = None,
    resume: bool = False,
    progress: Progress | None = None,
    **equations: Unpack[Equations],
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
        checkpoint: File (npz) that the branch is written to as it grows.
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
        found = _at_frequencies(balance, loading, at, settings, initial, tell)
        return responses(balance, *found, amplitude, **named)
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
    return responses(
        balance,
        branch.z,
        branch.iterations,
        branch.jacobians,
        amplitude,
        tangents=branch.tangents,
        **named,
    )


def responses(balance: Balance, z, iterations, jacobians, amplitude, **named) -> HarmonicResult:
    """The result of points z, coefficients first and omega last, under a force, N, or one each."""
    return HarmonicResult(
        balance=balance,
        frequencies_hz=z[:, -1] / (2 * np.pi),
        coefficients=z[:, :-1].reshape(-1, *balance.shape),
        iterations=iterations,
        jacobians=jacobians,
        force_amplitudes=np.full(len(z), amplitude, dtype=float),
        **named,
    )


def check_band(band, direction: str) -> tuple[float, float]:
    """A band of frequencies, Hz, and which way it is gone through, or an `InputError`."""
    low, high = reals("band", band, (2,), "Hz", above=0).tolist()
    if not low < high:
        raise InputError(f"band = ({low}, {high}): expected 0 < low < high, Hz.")
    member("direction", direction, ("up", "down"))
    return low, high


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
    watch = BoundWatch(problem.balance.shape, options.pop("on_point"))
    try:
        return follow(
            problem,
            start(low if direction == "up" else high),
            (low, high),
            direction=1 if direction == "up" else -1,
            name=fingerprint(problem.balance, *words, *band, direction),
            writes=problem.balance.comm.rank == 0,
            on_point=watch,
            **options,
        )
    except ConvergenceError as error:
        raise unbounded(error, problem.balance.shape) from error


def telling(
    progress: Progress | None,
    text: str,
    where: Callable[[np.ndarray], str] = lambda z: f"{z[-1] / (2 * np.pi):.4g} Hz",
) -> Callable[[np.ndarray], None]:
    """What tells the progress of every new point, and where it is; of omega by default."""
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


def first_response(problem: ForcedResponse, omega: float, settings: Settings) -> np.ndarray:
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


def with_extremes(problem, branch: Branch, slope, settings: Settings) -> Branch:
    """The branch with the points where a slope along it goes from positive to negative.

    Where Newton's method fails between two points, as it may at a kink, they have to do.
    """
    slopes = [slope(z, t) for z, t in zip(branch.z, branch.tangents, strict=True)]
    for i in reversed(range(len(branch) - 1)):
        if slopes[i] > 0 > slopes[i + 1]:
            with suppress(ConvergenceError):
                branch = locate(problem, branch, i, slope, settings)
    return branch


def _at_frequencies(balance, loading, at, settings, initial, tell):
    """Responses at given frequencies, each from that of the frequency below it.

    Returns:
        (points, coefficients and omega, (N, n K + 1); Newton steps; Jacobians that each took).
    """
    frequencies = np.asarray(at, dtype=float)
    starts = _starts(balance, initial, frequencies)
    omegas = 2 * np.pi * frequencies
    order = np.argsort(omegas)
    problem = ForcedResponse(balance, loading, float(np.ptp(omegas)) or omegas[0])
    z = np.empty((len(omegas), balance.size + 1))
    iterations, jacobians = np.zeros((2, len(omegas)), dtype=int)
    last = None
    for i in order:
        found = None
        if starts is not None:
            found = _tried(problem, np.append(starts[i], omegas[i]), settings)
        if found is None and last is not None:
            found = _stepped(problem, last, omegas[i], settings)
        if found is None:
            found = correct(problem, first_response(problem, omegas[i], settings), None, settings)
        last = found
        z[i], iterations[i], jacobians[i] = last.z, last.iterations, last.jacobians
        tell(z[i])
    return z, iterations, jacobians


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
    return initial.coefficients.reshape(len(frequencies), -1)


def _tried(problem, start, settings, kept=None):
    try:
        return correct(problem, start, None, settings, kept)
    except ConvergenceError:
        return None


def _stepped(problem, last, omega: float, settings):
    """From the response at one frequency to that at another, by ever shorter steps."""
    step = whole = omega - last.z[-1]
    while abs(step) >= 2.0**-_HALVINGS * abs(whole):
        z, t = last.z, last.tangent
        step = min(step, omega - z[-1])
        guess = z + t * (step / t[-1]) if t[-1] else z + 0.0
        guess[-1] = omega if step == omega - z[-1] else z[-1] + step
        found = _tried(problem, guess, settings, last.jacobian)
        if found is None:
            step /= 2
            continue
        last = found
        if last.z[-1] == omega:
            return last
    return None


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
