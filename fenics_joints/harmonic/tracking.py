"""Folds and superharmonic resonances followed over the force, and isolas.

One more equation g(X, omega) = 0 beside harmonic balance is true of these responses alone, and one
more unknown, the share of the load, is the parameter along them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from fenics_joints.errors import ConvergenceError, InputError, member, real, whole
from fenics_joints.harmonic.balance import Balance, Loading
from fenics_joints.harmonic.bifurcations import FOLD, Bifurcation
from fenics_joints.harmonic.continuation import (
    Branch,
    ContinuationSettings,
    check_settings,
    correct,
    follow,
    locate,
)
from fenics_joints.harmonic.fourier import moving_size
from fenics_joints.harmonic.frf import (
    Condition,
    ConditionedResponse,
    ForcedResponse,
    check_band,
    responses,
    telling,
    with_maxima,
)
from fenics_joints.harmonic.result import HarmonicResult, check_interval
from fenics_joints.progress import Progress

#: Step of the differences of Jacobians, relative to the motion; chosen.
_JACOBIAN_STEP = 1e-5
#: Share of the interfaces' force below which one of its harmonics is round-off.
_NONE = 1e-10


class FoldCondition(Condition):
    """The residual's derivative by X is singular: the branch turns back in frequency.

    The number is that which a bordered system of equations makes (Govaerts, Numerical Methods for
    Bifurcations of Dynamical Equilibria, 2000, ch. 3), its derivatives from the null vectors and
    differences of the Jacobian along the right one.

    Args:
        balance: The equations.
    """

    by_jacobian = True

    def __init__(self, balance: Balance):
        self.balance = balance
        self._border = None

    def at(self, X: np.ndarray, omega: float, J: np.ndarray) -> None:
        """See `Condition`: the borders are the null vectors there."""
        left, _, right = scipy.linalg.svd(J)
        self._border = left[:, -1], right[-1], float(np.linalg.norm(J, 2))

    def vectors(self, J: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """The number, and the left and the right vector."""
        b, c, size = self._border
        N = len(J)
        B = np.zeros((N + 1, N + 1))
        B[:N, :N], B[:N, N], B[N, :N] = J / size, b, c
        last = np.append(np.zeros(N), 1.0)
        factors = scipy.linalg.lu_factor(B)
        right = scipy.linalg.lu_solve(factors, last)
        left = scipy.linalg.lu_solve(factors, last, trans=1)
        return float(right[N]), left[:N], right[:N]

    def value(self, X: np.ndarray, omega: float, J: np.ndarray) -> tuple[float, np.ndarray, float]:
        """See `Condition`."""
        if self._border is None:
            self.at(X, omega, J)
        g, w, v = self.vectors(J)
        V = v.reshape(X.shape)
        step = _JACOBIAN_STEP * moving_size(X) / max(float(np.abs(V).max()), 1e-300)
        ends = [self.balance.evaluate(X + s * step * V, omega)[1] for s in (1, -1)]
        slopes = [self.balance.by_omega(X + s * step * V, omega) for s in (1, -1)]
        scale = -1 / (2 * step * self._border[2])
        by_X = scale * (w @ (ends[0] - ends[1]))
        by_omega = scale * float(w @ (slopes[0] - slopes[1]).reshape(-1))
        return g, by_X, by_omega


class PhaseCondition(Condition):
    """A harmonic is a quarter of its period behind what the lower ones excite it with.

    Variable phase resonance (Porter and Brake 2024, doi.org/10.1016/j.ymssp.2024.111410, eqs. 9
    to 12): the interfaces' force in that harmonic under the lower harmonics alone does no work
    with the harmonic's displacement, in phase.

    Args:
        balance: The equations.
        harmonic: The harmonic, at least 2 and at most the balance's highest.
    """

    def __init__(self, balance: Balance, harmonic: int):
        self.balance, self.first = balance, balance.fourier.cosine(harmonic)

    def value(self, X: np.ndarray, omega: float, J: np.ndarray) -> tuple[float, np.ndarray, float]:
        """See `Condition`."""
        balance, own = self.balance, slice(self.first, self.first + 2)
        n, K = balance.shape
        low = X.copy()
        low[:, self.first :] = 0
        F, J = balance.interface_force(low, omega)
        force, motion = F[:, own], X[:, own]
        size, reach = np.linalg.norm(force), np.linalg.norm(motion)
        if not size > _NONE * np.linalg.norm(F) or not reach > 0:
            return 0.0, np.zeros(X.size), 0.0
        g = float(np.sum(force * motion)) / (size * reach)
        by_force = motion / (size * reach) - g * force / size**2
        by_X = np.einsum("nk,nkml->ml", by_force, J.reshape(n, K, n, K)[:, own])
        by_X[:, self.first :] = 0
        by_X[:, own] = force / (size * reach) - g * motion / reach**2
        by_omega = float(np.sum(by_force * balance.rates_by_omega(low, omega)[:, own]))
        return g, by_X.reshape(-1), by_omega


# -- curves over the force -------------------------------------------------------------------------


CUSP, ISOLA, MERGER = "cusp", "isola", "merger"
#: Smallest singular value over the median of all below which there are two null vectors; chosen.
_TWO = 1e-3
#: Step of second derivatives, relative to the unknowns' scales; chosen.
_BEND_STEP = 1e-4


@dataclass(frozen=True)
class FoldTurn:
    """Where a curve of folds turns back in force.

    Attributes:
        kind: ``isola``: a closed branch begins, or ends, in this point; ``merger``: two branches
            touch there, as an isola and the main one; ``cusp``: two folds of a branch begin.
        index: Its point of the curve.
        force: Amplitude of the force, N.
        frequency_hz: Hz.
        amplitude: Of the sensor, m.
    """

    kind: str
    index: int
    force: float
    frequency_hz: float
    amplitude: float


@dataclass(frozen=True, kw_only=True, repr=False)
class Folds(HarmonicResult):
    """Folds over the force: responses at which a branch of constant force turns back in frequency.

    Attributes:
        turns: Where they turn back in force: cusps, isolas and mergers.
    """

    turns: tuple[FoldTurn, ...] = ()

    def __repr__(self) -> str:
        F = self.force_amplitudes
        found = ", ".join(f"{t.kind} at {t.force:.4g} N" for t in self.turns)
        return f"Folds({len(self)} folds, {F.min():.4g} to {F.max():.4g} N; {found or 'no turns'})"


def track_folds(
    result: HarmonicResult,
    at: Bifurcation,
    forces: tuple[float, float],
    *,
    direction: str = "up",
    settings: ContinuationSettings | None = None,
    progress: Progress | None = None,
) -> Folds:
    """Follow a fold as the force's amplitude changes: both ends of isolas are on the same curve.

    Args:
        result: A branch at constant force with the fold (`solve_harmonic` over a band).
        at: The fold (`find_bifurcations`).
        forces: Least and largest amplitude of the force, N; that of ``result`` is between.
        direction: ``up`` or ``down`` in force at first.
        settings: As for `solve_harmonic`.
        progress: Told of every point.

    Raises:
        InputError: For another kind of bifurcation, or values that do not fit.
        ConvergenceError: If the folds cannot be followed.
    """
    member("bifurcation", at.kind, (FOLD,))
    settings = check_settings(settings)
    problem = _extreme(result, FoldCondition(result.balance), forces)
    start = np.append(at.coefficients.reshape(-1), [2 * np.pi * at.frequency_hz, 1.0])
    branch = _followed(problem, result, start, forces, direction, settings, progress, "folds")
    branch, turns = _with_turns(problem, branch, settings)
    made = _responses(branch, result, Folds)
    numbers = np.column_stack([made.force_amplitudes, made.frequencies_hz, made.amplitude()])
    return replace(made, turns=tuple(FoldTurn(kind, i, *numbers[i].tolist()) for i, kind in turns))


def track_resonance(
    result: HarmonicResult,
    harmonic: int,
    forces: tuple[float, float],
    *,
    direction: str = "up",
    settings: ContinuationSettings | None = None,
    progress: Progress | None = None,
) -> HarmonicResult:
    """Follow a superharmonic or internal resonance as the force's amplitude changes.

    It is where a higher harmonic is in quadrature with what the lower ones excite it with (variable
    phase resonance, Porter and Brake 2024), whatever the joint's law: near the harmonic's largest
    response to a force.

    Args:
        result: A branch at constant force that passes the resonance (`solve_harmonic`).
        harmonic: The harmonic that resonates, at least 2.
        forces: Least and largest amplitude of the force, N; that of ``result`` is between.
        direction: ``up`` or ``down`` in force at first.
        settings: As for `solve_harmonic`.
        progress: Told of every point.

    Returns:
        Responses at resonance, each under its own force.

    Raises:
        InputError: If the harmonic does not resonate on the branch, or values do not fit.
        ConvergenceError: If the resonance cannot be followed.
    """
    whole("harmonic", harmonic, 2, most=result.balance.fourier.harmonics)
    settings = check_settings(settings)
    condition = PhaseCondition(result.balance, harmonic)
    problem = _extreme(result, condition, forces)
    start = _resonance(result, condition, harmonic)
    words = f"resonance of harmonic {harmonic}"
    branch = _followed(problem, result, start, forces, direction, settings, progress, words)
    return _responses(branch, result)


def _extreme(result: HarmonicResult, condition: Condition, forces) -> ConditionedResponse:
    """The equations: a share of one is the force of the result."""
    level = result.constant_force()
    low, high = check_interval("forces", forces, "N")
    if not low <= level <= high:
        raise InputError(
            f"forces = ({low:g}, {high:g}) N: expected the result's {level:g} N between them."
        )
    loading = Loading.of(result.balance, result.loads(level))
    widths = float(np.ptp(result.omegas)), (high - low) / level
    return ConditionedResponse(result.balance, loading, condition, widths)


def _resonance(result: HarmonicResult, condition: PhaseCondition, harmonic: int) -> np.ndarray:
    """Where the condition changes its sign on a branch, with the largest of that harmonic."""
    own = slice(condition.first, condition.first + 2)
    sizes = np.linalg.norm(result.coefficients[:, :, own], axis=(1, 2))
    pairs = zip(result.coefficients, result.omegas, strict=True)
    g = np.array([condition.value(X, w, None)[0] for X, w in pairs])
    found = np.flatnonzero(g[:-1] * g[1:] < 0)
    if not len(found):
        raise InputError(
            f"harmonic = {harmonic}: it resonates nowhere on the branch; expected another band, or "
            "another harmonic."
        )
    i = max(found, key=lambda i: sizes[i] + sizes[i + 1])
    share = g[i] / (g[i] - g[i + 1])
    z = np.column_stack([result.coefficients.reshape(len(result), -1), result.omegas])
    return np.append((1 - share) * z[i] + share * z[i + 1], 1.0)


def _followed(problem, result, start, forces, direction, settings, progress, words) -> Branch:
    member("direction", direction, ("up", "down"))
    level = result.constant_force()
    tell = telling(progress, words, lambda z: f"{z[-1] * level:.4g} N")
    problem.take(start)

    def on_point(z: np.ndarray) -> None:
        problem.take(z)
        tell(z)

    bounds = float(forces[0]) / level, float(forces[1]) / level
    way = 1 if direction == "up" else -1
    if start[-1] in bounds:
        way = 1 if start[-1] == bounds[0] else -1
    return follow(problem, start, bounds, settings=settings, direction=way, on_point=on_point)


def _with_turns(problem: ConditionedResponse, branch: Branch, settings) -> tuple[Branch, list]:
    """The curve with its turns in force among its points, and which and what they are."""
    turns, i = [], 0
    while i < len(branch) - 1:
        if branch.tangents[i, -1] * branch.tangents[i + 1, -1] < 0:
            problem.take(branch.z[i])
            try:
                branch = locate(problem, branch, i, lambda z, t: float(t[-1]), settings)
                i += 1
            except ConvergenceError:  # at a cusp all that is left is its neighbour
                pass
            turns.append((i, _kind(problem, branch.z[i])))
        i += 1
    return branch, turns


def _kind(problem: ConditionedResponse, z: np.ndarray) -> str:
    """What a turn in force is, by the null space of the equations at this force.

    At a cusp the tangent alone is in it. Otherwise two vectors are, and the second derivatives on
    them say whether responses nearby make a point, or two lines that cross.
    """
    loading = problem.loading.times(z[-1])
    forced = ForcedResponse(problem.balance, loading, problem.widths[0])
    scales = problem.scales(z)[:-1]

    def slope(y: np.ndarray) -> np.ndarray:
        return forced.evaluate(y)[1] * scales

    J = slope(z[:-1])
    left, values, right = scipy.linalg.svd(J)
    w, null = left[:, -1], right[-2:]
    if values[-1] > _TWO * np.median(values):
        return CUSP
    Q = np.empty((2, 2))
    for j in range(2):
        change = _BEND_STEP * scales * null[j]
        bend = (slope(z[:-1] + change) - slope(z[:-1] - change)) / (2 * _BEND_STEP)
        Q[:, j] = null @ (w @ bend)
    return ISOLA if np.linalg.det(0.5 * (Q + Q.T)) > 0 else MERGER


def _responses(branch: Branch, result: HarmonicResult, kind=HarmonicResult) -> HarmonicResult:
    """The result of a curve's points, whose last unknown is the share of the result's force."""
    forces = branch.z[:, -1] * result.constant_force()
    points = replace(branch.without(-1), tangents=None)
    return responses(result.balance, points, forces, kind, of=result)


# -- closed branches -------------------------------------------------------------------------------


#: Default limits of a closed branch, as shares of the folds' lowest and highest frequency; chosen.
_REACH = 0.5, 2.0
#: Distance from a fold to the first point, in scaled unknowns; chosen.
_FIRST_STEP = 1e-3


def solve_isola(
    folds: Folds,
    force: float,
    *,
    band: tuple[float, float] | None = None,
    settings: ContinuationSettings | None = None,
    progress: Progress | None = None,
) -> HarmonicResult:
    """The closed branch of responses to a force, through one of the folds that were tracked.

    Args:
        folds: A curve of folds with an isola on it (`track_folds`).
        force: Amplitude of the force, N.
        band: Lowest and highest frequency, Hz, within which a branch has to close; by default from
            half of the folds' lowest to twice their highest.
        settings: As for `solve_harmonic`.
        progress: Told of every point.

    Returns:
        The responses once round: the last one is the first one again, a fold.

    Raises:
        InputError: If the curve has no fold at this force, or none of a closed branch.
        ConvergenceError: If a branch cannot be followed.
    """
    force, settings = real("force", force, "N", above=0), check_settings(settings)
    hz = folds.frequencies_hz
    band = check_band((_REACH[0] * hz.min(), _REACH[1] * hz.max()) if band is None else band, "up")
    starts = _starts(folds, force)
    if not len(starts):
        F = folds.force_amplitudes
        raise InputError(
            f"force = {force:g} N: the curve has no fold there; expected one between {F.min():g} "
            f"and {F.max():g} N."
        )
    loading = Loading.of(folds.balance, folds.loads(force))
    problem = ForcedResponse(folds.balance, loading, 2 * np.pi * (band[1] - band[0]))
    tell = telling(progress, f"closed branch at {force:g} N")
    for start in starts:
        branch = _round(problem, start, tuple(2 * np.pi * f for f in band), settings, tell)
        if branch is not None:
            break
    else:
        raise InputError(
            f"force = {force:g} N: no branch through these folds closes between {band[0]:.4g} and "
            f"{band[1]:.4g} Hz; expected a force between that of an isola and that of a merger, "
            "or a wider band."
        )
    row = folds.model.row("sensors", folds.sensor)
    branch = with_maxima(problem, branch, row, folds.measure, settings)
    return responses(folds.balance, branch, force, of=folds)


def _starts(folds: Folds, force: float) -> list[np.ndarray]:
    """The folds at a force, between the curve's points."""
    F, found = folds.force_amplitudes, []
    z = np.column_stack([folds.coefficients.reshape(len(folds), -1), folds.omegas])
    for i in np.flatnonzero((F[:-1] - force) * (F[1:] - force) <= 0):
        share = (force - F[i]) / (F[i + 1] - F[i]) if F[i + 1] != F[i] else 0.0
        found.append((1 - share) * z[i] + share * z[i + 1])
    return found


def _round(problem: ForcedResponse, start, bounds, settings, tell) -> Branch | None:
    """The branch from a fold until it comes back to it; None if it leaves the bounds first."""
    scales = problem.scales(start)
    along = scipy.linalg.svd(problem.evaluate(start)[1] * scales)[2][-1]
    fold = correct(problem, start, along, settings)
    along = fold.direction * np.sign(fold.direction @ along)
    first = correct(problem, fold.z + _FIRST_STEP * scales * along, along, settings)
    tangent = first.direction * np.sign(first.direction @ along)
    gone: list[np.ndarray] = []

    def closes(z: np.ndarray) -> bool:
        tell(z)
        gone.append((z - fold.z) / scales)
        if len(gone) < 3:
            return False
        before, now = gone[-2:]
        way = now - before
        share = np.clip(-(before @ way) / (way @ way), 0, 1)
        off = np.linalg.norm(before + share * way)
        return bool(before @ along < 0 <= now @ along and off < 0.3 * np.linalg.norm(way))

    direction = 1 if tangent[-1] > 0 else -1
    branch = follow(
        problem, first.z, bounds, settings=settings, direction=direction, on_point=closes
    )
    if branch.complete:
        return None
    branch, effort = branch.first(len(branch) - 1), (fold.iterations, 0)
    branch = branch.with_point(fold.z, along * scales, effort, settings.step, True)
    return branch.with_inserted(0, fold.z, along * scales, effort)
