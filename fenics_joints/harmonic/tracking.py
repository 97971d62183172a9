"""Folds and superharmonic resonances followed over the force, and where isolas begin and end."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from fenics_joints.errors import ConvergenceError, InputError, member, reals, whole
from fenics_joints.harmonic.bifurcations import FOLD, Bifurcation
from fenics_joints.harmonic.branch import Branch
from fenics_joints.harmonic.continuation import follow, locate
from fenics_joints.harmonic.corrector import Settings, check_settings
from fenics_joints.harmonic.extremes import Condition, Extreme, FoldCondition, PhaseCondition
from fenics_joints.harmonic.frf import ForcedResponse, telling
from fenics_joints.harmonic.loads import Load, Loading
from fenics_joints.harmonic.result import HarmonicResult
from fenics_joints.progress import Progress

CUSP, ISOLA, MERGER = "cusp", "isola", "merger"
#: Second-smallest singular value over the largest below which there are two null vectors.
_TWO = 1e-3
#: Step of second derivatives, relative to the unknowns' scales.
_STEP = 1e-4


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
    settings: Settings | None = None,
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
    made = _responses(Folds, problem, result, branch)
    found = []
    for i, kind in turns:
        force, hz, a = made.force_amplitudes[i], made.frequencies_hz[i], made.amplitude()[i]
        found.append(FoldTurn(kind, i, float(force), float(hz), float(a)))
    return _responses(Folds, problem, result, branch, turns=tuple(found))


def track_resonance(
    result: HarmonicResult,
    harmonic: int,
    forces: tuple[float, float],
    *,
    direction: str = "up",
    settings: Settings | None = None,
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
    return _responses(HarmonicResult, problem, result, branch)


def _extreme(result: HarmonicResult, condition: Condition, forces) -> Extreme:
    """The equations: a share of one is the force of the result."""
    level = _level(result)
    low, high = reals("forces", forces, (2,), "N", above=0).tolist()
    if not low < high or not low <= level <= high:
        raise InputError(
            f"forces = ({low:g}, {high:g}) N: expected low < high, and the result's {level:g} N "
            "between them."
        )
    loads = Load(result.force, level, power=result.power), *result.more
    loading = Loading.of(result.balance, loads)
    widths = float(np.ptp(result.omegas)), (high - low) / level
    return Extreme(result.balance, loading, condition, widths)


def _level(result: HarmonicResult) -> float:
    force = result.force_amplitudes
    if result.tangents is None or np.ptp(force) > 1e-9 * abs(force[0]):
        raise InputError("result: expected a branch at constant force, as solve_harmonic's.")
    return float(force[0])


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
    level = _level(result)
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


def _with_turns(problem: Extreme, branch: Branch, settings) -> tuple[Branch, list]:
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


def _kind(problem: Extreme, z: np.ndarray) -> str:
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
        change = _STEP * scales * null[j]
        bend = (slope(z[:-1] + change) - slope(z[:-1] - change)) / (2 * _STEP)
        Q[:, j] = null @ (w @ bend)
    return ISOLA if np.linalg.det(0.5 * (Q + Q.T)) > 0 else MERGER


def _responses(kind, problem: Extreme, result: HarmonicResult, branch: Branch, **more):
    """The result of a curve's points."""
    balance, z = problem.balance, branch.z
    return kind(
        balance=balance,
        frequencies_hz=z[:, -2] / (2 * np.pi),
        coefficients=z[:, :-2].reshape(-1, *balance.shape),
        iterations=branch.iterations,
        jacobians=branch.jacobians,
        sensor=result.sensor,
        measure=result.measure,
        force=result.force,
        force_amplitudes=z[:, -1] * _level(result),
        more=result.more,
        power=result.power,
        **more,
    )
