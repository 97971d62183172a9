"""Closed branches of responses, which no sweep from the main branch reaches."""

from __future__ import annotations

import numpy as np
import scipy.linalg

from fenics_joints.errors import ConvergenceError, InputError, real
from fenics_joints.harmonic.branch import Branch
from fenics_joints.harmonic.continuation import follow
from fenics_joints.harmonic.corrector import Settings, check_settings, correct
from fenics_joints.harmonic.frf import ForcedResponse, check_band, responses, telling, with_maxima
from fenics_joints.harmonic.loads import Load, Loading
from fenics_joints.harmonic.result import HarmonicResult
from fenics_joints.harmonic.tracking import Folds
from fenics_joints.progress import Progress

#: How far beyond the folds' frequencies a closed branch may reach, as shares of them.
_REACH = 0.5, 2.0
#: Scaled way from a fold to the first point.
_STEP = 1e-3


def solve_isola(
    folds: Folds,
    force: float,
    *,
    band: tuple[float, float] | None = None,
    settings: Settings | None = None,
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
    loads = Load(folds.force, force, power=folds.power), *folds.more
    loading = Loading.of(folds.balance, loads)
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
    return responses(
        folds.balance,
        branch.z,
        branch.iterations,
        branch.jacobians,
        force,
        tangents=branch.tangents,
        force=folds.force,
        sensor=folds.sensor,
        measure=folds.measure,
        more=folds.more,
        power=folds.power,
    )


def _starts(folds: Folds, force: float) -> list[np.ndarray]:
    """The folds at a force, between the curve's points."""
    F, found = folds.force_amplitudes, []
    z = np.column_stack([folds.coefficients.reshape(len(folds), -1), folds.omegas])
    for i in np.flatnonzero((F[:-1] - force) * (F[1:] - force) <= 0):
        share = (force - F[i]) / (F[i + 1] - F[i]) if F[i + 1] != F[i] else 0.0
        found.append((1 - share) * z[i] + share * z[i + 1])
    return found


class _Closed(ConvergenceError):
    """The branch has come round."""


def _round(problem: ForcedResponse, start, bounds, settings, tell) -> Branch | None:
    """The branch from a fold until it comes back to it; None if it leaves the bounds first."""
    scales = problem.scales(start)
    along = scipy.linalg.svd(problem.evaluate(start)[1] * scales)[2][-1]
    fold = correct(problem, start, along, settings)
    along = fold.direction * np.sign(fold.direction @ along)
    first = correct(problem, fold.z + _STEP * scales * along, along, settings)
    tangent = first.direction * np.sign(first.direction @ along)
    gone: list[np.ndarray] = []

    def closes(z: np.ndarray) -> None:
        tell(z)
        gone.append((z - fold.z) / scales)
        if len(gone) < 3:
            return
        before, now = gone[-2:]
        way = now - before
        share = np.clip(-(before @ way) / (way @ way), 0, 1)
        off = np.linalg.norm(before + share * way)
        if before @ along < 0 <= now @ along and off < 0.3 * np.linalg.norm(way):
            raise _Closed("closed")

    direction = 1 if tangent[-1] > 0 else -1
    options = {"settings": settings, "direction": direction, "on_point": closes}
    try:
        follow(problem, first.z, bounds, **options)
    except _Closed as error:
        branch, effort = error.branch.first(len(error.branch) - 1), (fold.iterations, 0)
        branch = branch.with_point(fold.z, along * scales, effort, settings.step, True)
        return branch.with_inserted(0, fold.z, along * scales, effort)
    return None
