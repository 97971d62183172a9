"""Stability along a branch of responses, its bifurcations, and the branches that leave there.

At a branch point the equations' derivative has a second null vector beside the tangent, and so it
has at a period doubling once the harmonics of half order are among the unknowns. The new branch
leaves along it (Keller 1977; Krack and Gross, Harmonic Balance for Nonlinear Vibration Problems,
2019, sec. 4.4).
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from fenics_joints.errors import ConvergenceError, InputError, member
from fenics_joints.harmonic.balance import Balance, Loading
from fenics_joints.harmonic.continuation import (
    Branch,
    ContinuationSettings,
    NotFound,
    Point,
    check_settings,
    correct,
    follow,
    locate,
    orientation,
)
from fenics_joints.harmonic.fourier import amplitude
from fenics_joints.harmonic.frf import ForcedResponse, check_band, responses, telling, with_maxima
from fenics_joints.harmonic.result import HarmonicResult
from fenics_joints.harmonic.stability import LARGEST, floquet_multipliers, hill_multipliers
from fenics_joints.progress import Progress

#: Kinds of bifurcations.
FOLD, BRANCH_POINT, DOUBLING, TORUS = ("fold", "branch point", "period doubling", "Neimark-Sacker")
#: Imaginary part over size below which a multiplier counts as real; chosen.
_REAL = 1e-3


@dataclass(frozen=True, repr=False, eq=False)
class Bifurcation:
    """A change of stability along a branch.

    Attributes:
        kind: ``fold``, ``branch point``, ``period doubling`` or ``Neimark-Sacker``.
        index: The last point of the branch before it.
        frequency_hz: Its frequency, Hz.
        coefficients: Harmonics of its displacements, m, (n, K).
        amplitude: Amplitude of the result's sensor there, m.
        multiplier: The multiplier that crosses the unit circle.
        unstable: How many multipliers are outside before and after it.
    """

    kind: str
    index: int
    frequency_hz: float
    coefficients: np.ndarray
    amplitude: float
    multiplier: complex
    unstable: tuple[int, int]

    def __repr__(self) -> str:
        return f"Bifurcation({self.kind} at {self.frequency_hz:.5g} Hz, {self.amplitude:.4g} m)"


@dataclass(frozen=True, repr=False)
class Stability:
    """Stability of the responses of a branch.

    Attributes:
        multipliers: The largest Floquet multiplier of each response, complex, (N,).
        unstable: How many are outside the unit circle, (N,).
        bifurcations: Where that number changes, along the branch.
    """

    multipliers: np.ndarray
    unstable: np.ndarray
    bifurcations: tuple[Bifurcation, ...]

    def __repr__(self) -> str:
        kinds = ", ".join(f"{b.kind} at {b.frequency_hz:.5g} Hz" for b in self.bifurcations[:4])
        return f"Stability({len(self.unstable)} responses, {kinds or 'no bifurcations'})"

    @property
    def stable(self) -> np.ndarray:
        """Whether each response is stable, (N,)."""
        return self.unstable == 0


def find_bifurcations(
    result: HarmonicResult,
    *,
    method: str | None = None,
    steps: int | None = None,
    tolerance: float | None = None,
    settings: ContinuationSettings | None = None,
) -> Stability:
    """Floquet multipliers along a branch, and where they cross the unit circle, and how.

    Through +1 a real one leaves at a fold, where the branch turns back in frequency, or at a branch
    point, where the determinant of Jacobian and tangent changes its sign; through -1 at a period
    doubling; a complex pair at a Neimark-Sacker bifurcation. They are found to Newton's tolerance
    on the branch itself. With few harmonics the multipliers, of the motion's true equations, may
    cross beside a fold of the branch.

    Args:
        result: A branch of responses at constant force (`solve_harmonic` over a band).
        method: ``shooting`` (`floquet_multipliers`), by default for models with up to 600
            displacements, velocities and states of laws, or ``hill`` with linearised sliders
            (`hill_multipliers`), for larger ones: folds and branch points are as exact, what
            friction does to disturbances that beat or alternate is approximate.
        steps: As for `floquet_multipliers`.
        tolerance: How far outside the unit circle counts as on it; by default 1e-4, and 0.01 with
            memory, since sliders turn round within a step.
        settings: As for `solve_harmonic`.

    Raises:
        InputError: For responses that are no such branch.
    """
    result.constant_force()
    if tolerance is None:
        memory = any(points.kernel.m for points in result.model.interfaces)
        tolerance = 0.01 if memory else 1e-4
    method = _method(result) if method is None else method
    member("method", method, ("shooting", "hill"))
    search = _Search(result, method, steps, tolerance, check_settings(settings))
    spectra = [search.multipliers(z) for z in search.branch.z]
    unstable = np.array([search.outside(values).sum() for values in spectra])
    points = zip(search.branch.z, search.branch.tangents, strict=True)
    sides = [search.side(z, tangent) for z, tangent in points]
    found = []
    for i in range(len(spectra) - 1):
        found += search.between(i, spectra[i : i + 2], sides[i : i + 2])
    largest = np.array([values[0] for values in spectra])
    return Stability(largest, unstable, tuple(found))


def _method(result: HarmonicResult) -> str:
    """How multipliers are found, by the number of disturbances and what the laws ask for."""
    count, rated = 2 * result.model.n_dofs, False
    for points in result.model.interfaces:
        kernel = points.kernel
        count += len(points) * points.law.n_elements * kernel.m
        rated |= kernel.rated
    return "shooting" if rated or count <= LARGEST else "hill"


class _Search:
    """Multipliers along one branch.

    Attributes:
        branch: The branch, coefficients first and omega last.
    """

    def __init__(self, result, method, steps, tolerance: float, settings: ContinuationSettings):
        self.result, self.balance, self.method = result, result.balance, method
        self.steps, self.edge, self.settings = steps, 1 + tolerance, settings
        loading = Loading.of(self.balance, result.loads(result.constant_force()))
        width = float(np.ptp(result.omegas)) or float(result.omegas[0])
        self.problem = ForcedResponse(self.balance, loading, width)
        flat = result.coefficients.reshape(len(result), -1)
        z = np.column_stack([flat, result.omegas])
        self.branch = Branch(z, result.tangents, result.iterations, result.jacobians, 0.01, True)

    def multipliers(self, z: np.ndarray) -> np.ndarray:
        X = z[:-1].reshape(self.balance.shape)
        if self.method == "hill":
            return hill_multipliers(self.balance, X, z[-1])
        return floquet_multipliers(self.balance, X, z[-1], steps=self.steps)

    def outside(self, values: np.ndarray) -> np.ndarray:
        """How many multipliers are outside: real above 1, real below -1, complex."""
        values = values[np.abs(values) > self.edge]
        real = np.abs(values.imag) <= _REAL * np.abs(values)
        return np.array(
            [np.sum(real & (values.real > 0)), np.sum(real & (values.real < 0)), np.sum(~real)]
        )

    def side(self, z: np.ndarray, tangent: np.ndarray) -> float:
        """Sign of the determinant of Jacobian and tangent."""
        scales = self.problem.scales(z)
        tangent = tangent / scales
        J = self.problem.evaluate(z)[1]
        return orientation(J, scales, tangent / np.linalg.norm(tangent))

    def between(self, i: int, spectra, sides) -> list[Bifurcation]:
        """The bifurcations between points i and i + 1.

        Two real multipliers that meet outside and become a pair, or the other way, change nothing.
        """
        before, after = (self.outside(values) for values in spectra)
        change, kinds = after - before, []
        if np.prod(np.sign(self.branch.tangents[i : i + 2, -1])) < 0:
            kinds.append(FOLD)
        if np.prod(sides) < 0:
            kinds.append(BRANCH_POINT)
        if change[1] % 2:
            kinds.append(DOUBLING)
        if abs(change.sum()) - len(kinds) >= 2:
            kinds.append(TORUS)
        counts = int(before.sum()), int(after.sum())
        return [self.found(i, kind, counts) for kind in kinds]

    def found(self, i: int, kind: str, counts: tuple[int, int]) -> Bifurcation:
        """A bifurcation of a kind between points i and i + 1."""
        if kind == FOLD:
            z = self._located(i, lambda z, tangent: float(tangent[-1]))
        elif kind == BRANCH_POINT:
            z = self._located(i, self._determinant)
        else:
            z = self._located(i, lambda z, tangent: _reach(self.multipliers(z), kind) - self.edge)
        values, row = self.multipliers(z), self.result.model.row("sensors", self.result.sensor)
        X = z[:-1].reshape(self.balance.shape)
        size = amplitude(row @ X, periods=self.balance.fourier.periods)
        return Bifurcation(
            kind,
            int(i),
            float(z[-1] / (2 * np.pi)),
            X,
            float(size),
            _crossing(values, kind),
            counts,
        )

    def _determinant(self, z: np.ndarray, tangent: np.ndarray) -> float:
        """The smallest singular value of Jacobian and tangent, with the determinant's sign."""
        scales = self.problem.scales(z)
        J = self.problem.evaluate(z)[1] * scales
        J = np.vstack([J / np.linalg.norm(J, np.inf), tangent / scales])
        return self.side(z, tangent) * float(np.linalg.svd(J, compute_uv=False)[-1])

    def _located(self, i: int, slope) -> np.ndarray:
        """The point where a number along the branch vanishes; the middle where Newton fails."""
        with suppress(ConvergenceError, InputError, ValueError):
            return locate(self.problem, self.branch, i, slope, self.settings).z[i + 1]
        return 0.5 * (self.branch.z[i] + self.branch.z[i + 1])


def _reach(values: np.ndarray, kind: str) -> float:
    """How far out the multiplier is that crosses at a bifurcation."""
    real = np.abs(values.imag) <= _REAL * np.abs(values)
    if kind == TORUS:
        return float(np.abs(values[~real]).max(initial=0.0))
    return float(-values[real].real.min(initial=0.0))


def _crossing(values: np.ndarray, kind: str) -> complex:
    """The multiplier that is known to cross at a bifurcation."""
    if kind == TORUS:
        pairs = values[np.abs(values.imag) > _REAL * np.abs(values)]
        if len(pairs):
            return complex(pairs[np.argmin(np.abs(np.abs(pairs) - 1))])
    return complex(values[np.argmin(np.abs(values - (-1 if kind == DOUBLING else 1)))])


# -- branches that leave ---------------------------------------------------------------------------


#: Distances along the null vector, in scaled unknowns, at which the first point is tried; chosen.
_OFF = (0.02, 0.005, 0.1, 1e-3)


def switch_branch(
    result: HarmonicResult,
    at: Bifurcation,
    *,
    band: tuple[float, float] | None = None,
    side: int = 1,
    settings: ContinuationSettings | None = None,
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
    balance, X = _in_longer_period(result.balance, at)
    loading = Loading.of(balance, result.loads(force))
    problem = ForcedResponse(balance, loading, 2 * np.pi * (high - low))
    z = np.append(X.reshape(-1), 2 * np.pi * at.frequency_hz)
    first, tangent = _first_point(problem, z, side, settings)
    bounds = (2 * np.pi * low, 2 * np.pi * high)
    tell = telling(progress, f"branch from the {at.kind} at {at.frequency_hz:.4g} Hz")
    branch = _followed(problem, first, tangent, bounds, settings, tell)
    row = result.model.row("sensors", result.sensor)
    branch = with_maxima(problem, branch, row, result.measure, settings)
    return responses(balance, branch, force, of=result)


def _in_longer_period(balance: Balance, at: Bifurcation) -> tuple[Balance, np.ndarray]:
    """The balance of the new branch, and the response at the bifurcation in its harmonics."""
    if at.kind == BRANCH_POINT:
        return balance, at.coefficients
    f = balance.fourier
    longer = balance.changed(samples=2 * f.samples, periods=2 * f.periods)
    X, h = np.zeros(longer.shape), np.arange(1, f.size // 2 + 1)
    X[:, 0] = at.coefficients[:, 0]
    X[:, 4 * h - 1], X[:, 4 * h] = at.coefficients[:, 2 * h - 1], at.coefficients[:, 2 * h]
    return longer, X


def _first_point(problem: ForcedResponse, z: np.ndarray, side: int, settings: ContinuationSettings):
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


def _followed(
    problem: ForcedResponse,
    first: Point,
    across: np.ndarray,
    bounds,
    settings: ContinuationSettings,
    tell: Callable[[np.ndarray], object],
) -> Branch:
    """The branch from its first point to a bound, or to where it meets another branch.

    There the determinant of Jacobian and tangent changes its sign.
    """
    scales, last = problem.scales(first.z), None
    tangent = first.direction * np.sign(first.direction @ across)
    sign = orientation(first.jacobian, scales, tangent)

    def met(z: np.ndarray) -> bool:
        nonlocal last
        tell(z)
        before, last = last, z
        if before is None:
            return False
        J, scales = problem.evaluate(z)[1], problem.scales(z)
        way = (z - before) / scales
        return orientation(J, scales, way / np.linalg.norm(way)) != sign

    direction = 1 if tangent[-1] > 0 else -1
    steps = replace(settings, step=max(settings.min_step, 0.5 * settings.step))
    branch = follow(problem, first.z, bounds, settings=steps, direction=direction, on_point=met)
    return branch if branch.complete else replace(branch.first(len(branch) - 1), complete=True)
