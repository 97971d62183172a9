"""Branches that leave another at a bifurcation: of broken symmetry, or of twice the period.

At a branch point the equations' derivative has a second null vector beside the tangent, and so it
has at a period doubling once the harmonics of half order are among the unknowns. The new branch
leaves along it (Keller 1977; Krack and Gross, Harmonic Balance for Nonlinear Vibration Problems,
2019, sec. 4.4).
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

import numpy as np
import scipy.linalg

from fenics_joints.errors import ConvergenceError, InputError, member
from fenics_joints.harmonic.balance import Balance
from fenics_joints.harmonic.bifurcations import BRANCH_POINT, DOUBLING, Bifurcation
from fenics_joints.harmonic.branch import Branch
from fenics_joints.harmonic.continuation import follow, orientation
from fenics_joints.harmonic.corrector import NotFound, Point, Settings, check_settings, correct
from fenics_joints.harmonic.frf import ForcedResponse, check_band, responses, telling, with_maxima
from fenics_joints.harmonic.loads import Load, Loading
from fenics_joints.harmonic.result import HarmonicResult
from fenics_joints.progress import Progress

#: How far along the null vector the first point is sought, in scaled unknowns.
_OFF = (0.02, 0.005, 0.1, 1e-3)


def switch_branch(
    result: HarmonicResult,
    at: Bifurcation,
    *,
    band: tuple[float, float] | None = None,
    side: int = 1,
    settings: Settings | None = None,
    progress: Progress | None = None,
) -> HarmonicResult:
    """The branch that leaves another at a branch point or a period doubling.

    It is followed until it leaves the band, or comes back to a branch at another bifurcation: there
    its mirror image begins, the one of the other ``side``, or the same motion a period later.

    Args:
        result: The branch that it leaves (`solve_harmonic` over a band, or this function).
        at: Where (`find_bifurcations`).
        band: Lowest and highest frequency, Hz; those of ``result`` by default.
        side: 1 or -1: to which side of a branch point.
        settings: As for `solve_harmonic`.
        progress: Told of every point.

    Returns:
        Responses from beside the bifurcation on. After a period doubling they take twice as many
        periods of the force as those of ``result``; ``frequencies_hz`` are the force's.

    Raises:
        InputError: For another kind of bifurcation, or values that do not fit.
        ConvergenceError: If there is no new branch, or it cannot be followed.
    """
    member("bifurcation", at.kind, (BRANCH_POINT, DOUBLING))
    if side not in (1, -1):
        raise InputError(f"side = {side!r}: expected 1 or -1.")
    hz = result.frequencies_hz
    low, high = check_band((hz.min(), hz.max()) if band is None else band, "up")
    settings, force = check_settings(settings), float(result.force_amplitudes[0])
    balance, X = _longer(result.balance, at)
    loading = Loading.of(balance, (Load(result.force, force, power=result.power), *result.more))
    problem = ForcedResponse(balance, loading, 2 * np.pi * (high - low))
    z = np.append(X.reshape(-1), 2 * np.pi * at.frequency_hz)
    first, tangent = _first(problem, z, side, settings)
    bounds = (2 * np.pi * low, 2 * np.pi * high)
    tell = telling(progress, f"branch from the {at.kind} at {at.frequency_hz:.4g} Hz")
    branch = _followed(problem, first, tangent, bounds, settings, tell)
    row = result.model.row("sensors", result.sensor)
    branch = with_maxima(problem, branch, row, result.measure, settings)
    return responses(
        balance,
        branch.z,
        branch.iterations,
        branch.jacobians,
        force,
        tangents=branch.tangents,
        force=result.force,
        sensor=result.sensor,
        measure=result.measure,
        more=result.more,
        power=result.power,
    )


def _longer(balance: Balance, at: Bifurcation) -> tuple[Balance, np.ndarray]:
    """The balance of the new branch, and the response at the bifurcation in its harmonics."""
    if at.kind == BRANCH_POINT:
        return balance, at.coefficients
    f = balance.fourier
    longer = Balance(
        balance.model,
        f.harmonics,
        2 * f.samples,
        static=balance.static,
        cycles=balance.cycles,
        periods=2 * f.periods,
        comm=balance.comm,
    )
    X, h = np.zeros(longer.shape), np.arange(1, f.size // 2 + 1)
    X[:, 0] = at.coefficients[:, 0]
    X[:, 4 * h - 1], X[:, 4 * h] = at.coefficients[:, 2 * h - 1], at.coefficients[:, 2 * h]
    return longer, X


def _first(problem: ForcedResponse, z: np.ndarray, side: int, settings: Settings):
    """The new branch's first point, and the scaled direction in which it leaves z."""
    scales = problem.scales(z)
    J = problem.evaluate(z)[1] * scales
    J = J / np.maximum(np.abs(J).max(axis=1, keepdims=True), np.finfo(float).tiny)
    null = scipy.linalg.svd(J)[2][-2:]
    # Of the two null vectors the old branch's tangent is the one that changes omega.
    old = null.T @ null[:, -1]
    size = np.linalg.norm(old)
    across = null[1] if size < 1e-6 else null.T @ np.array([-null[1, -1], null[0, -1]]) / size
    across = side * across * np.sign(across[np.argmax(np.abs(across))])
    for off in _OFF:
        with suppress(NotFound):
            point = correct(problem, z + off * scales * across, across, settings)
            way = (point.z - z) / scales
            if np.linalg.norm(way) < 5 * off:
                return point, across
    raise ConvergenceError(
        f"no branch leaves the one at {z[-1] / (2 * np.pi):.5g} Hz within reach of its null vector"
    )


class _Meeting(ConvergenceError):
    """The branch has passed another one."""


def _followed(
    problem: ForcedResponse,
    first: Point,
    across: np.ndarray,
    bounds,
    settings: Settings,
    tell: Callable[[np.ndarray], object],
) -> Branch:
    """The branch from its first point to a bound, or to where it meets another branch.

    There the determinant of Jacobian and tangent changes its sign.
    """
    scales, last = problem.scales(first.z), None
    tangent = first.direction * np.sign(first.direction @ across)
    sign = orientation(first.jacobian, scales, tangent)

    def met(z: np.ndarray) -> None:
        nonlocal last
        tell(z)
        if last is not None:
            J, scales = problem.evaluate(z)[1], problem.scales(z)
            way = (z - last) / scales
            if orientation(J, scales, way / np.linalg.norm(way)) != sign:
                raise _Meeting("met")
        last = z

    direction = 1 if tangent[-1] > 0 else -1
    steps = replace(settings, step=max(settings.min_step, 0.5 * settings.step))
    try:
        return follow(problem, first.z, bounds, settings=steps, direction=direction, on_point=met)
    except _Meeting as error:
        return replace(error.branch.first(len(error.branch) - 1), complete=True)
