"""Newton's method for a point of a branch, orthogonal to its tangent or at a given parameter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import scipy.linalg

from fenics_joints.errors import ConvergenceError, InputError, flag, real, wanted, whole

_HALVINGS = 6
#: A Jacobian is kept once a step is below this size, and while each is this much below the last;
#: with a kept one, convergence asks for a step that much below the tolerance.
_NEAR, _CONTRACTION, _KEPT_TOLERANCE = 0.1, 0.4, 0.1


class Problem(Protocol):
    """N equations in N + 1 unknowns, the parameter last.

    One whose attribute ``kinked`` is true has a Jacobian that jumps.
    """

    def evaluate(
        self, z: np.ndarray, *, jacobian: bool = True
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """Residual (N,) and its derivative (N, N + 1), or None, at z (N + 1,)."""

    def scales(self, z: np.ndarray) -> np.ndarray:
        """Size of a notable change of each unknown at z, positive, (N + 1,)."""


@dataclass(frozen=True)
class Settings:
    """How a branch is followed.

    Attributes:
        step: First step, in scaled arc length.
        max_step: Longest step: 0.1 is a tenth of the `Problem.scales`.
        min_step: A step that would have to be shorter ends in an error.
        max_points: Most points of a branch.
        max_iterations: Most Newton iterations of a point.
        wanted_jacobians: Steps grow while Newton's method needs fewer Jacobians.
        keep: Whether Newton's method may keep a Jacobian while its steps fall fast; where a law
            without memory changes branches, as at a stop, it never does.
        tolerance: Last Newton step, relative to the scales, at convergence.
        save_every: Points between two writings of the branch.

    Raises:
        InputError: If a number is out of range.
    """

    step: float = 0.02
    max_step: float = 0.15
    min_step: float = 1e-7
    max_points: int = 2000
    max_iterations: int = 25
    wanted_jacobians: int = 2
    keep: bool = True
    tolerance: float = 1e-6
    save_every: int = 10

    def __post_init__(self):
        for key in ("min_step", "step", "max_step"):
            real(key, getattr(self, key), above=0)
        if not 0 < self.min_step <= self.step <= self.max_step:
            raise InputError(
                f"min_step, step, max_step = {self.min_step}, {self.step}, {self.max_step}: "
                "expected 0 < min_step <= step <= max_step."
            )
        for key in ("max_points", "max_iterations", "wanted_jacobians", "save_every"):
            whole(key, getattr(self, key))
        flag("keep", self.keep)
        if not real("tolerance", self.tolerance, above=0) < 1:
            raise InputError(f"tolerance = {self.tolerance}: expected between 0 and 1.")


def check_settings(settings: Settings | None) -> Settings:
    """The settings, the usual ones without any.

    Raises:
        InputError: If they are something else.
    """
    if settings is not None and not isinstance(settings, Settings):
        raise wanted("settings", settings, "Settings, or None")
    return settings or Settings()


def keeps(problem: Problem, settings: Settings) -> bool:
    """Whether Newton's method may keep a Jacobian of a problem."""
    return settings.keep and not getattr(problem, "kinked", False)


@dataclass(frozen=True)
class Point:
    """A converged point.

    Attributes:
        z: Unknowns and parameter, (N + 1,).
        direction: Tangent of length one in scaled unknowns, (N + 1,).
        scales: Their scales, (N + 1,).
        jacobian: Derivative of the residual, (N, N + 1).
        iterations: Newton steps.
        jacobians: Jacobians among them.
    """

    z: np.ndarray
    direction: np.ndarray
    scales: np.ndarray
    jacobian: np.ndarray
    iterations: int
    jacobians: int

    @property
    def tangent(self) -> np.ndarray:
        """Tangent in the unknowns' own units, (N + 1,)."""
        return self.direction * self.scales


class NotFound(ConvergenceError):
    """A point that Newton's method did not find, and why."""

    def __init__(self, why: str):
        super().__init__(f"Newton's method did not converge: {why}")
        self.why = why


def correct(
    problem: Problem,
    z: np.ndarray,
    normal: np.ndarray | None,
    settings: Settings,
    kept: np.ndarray | None = None,
) -> Point:
    """Newton's method from z, in the plane through z with a scaled normal.

    A Jacobian, worth many residuals, is kept while the steps fall fast.

    Args:
        problem: The equations.
        z: Start, (N + 1,).
        normal: Scaled normal of the plane, (N + 1,); None holds the parameter.
        settings: Tolerance and most iterations.
        kept: Jacobian of a near point, to start with.

    Raises:
        ConvergenceError: If it does not converge.
    """
    scales = problem.scales(z)
    if normal is None:
        normal = np.zeros(len(z))
        normal[-1] = 1.0
    keep = keeps(problem, settings)
    fresh = kept is None or not keep
    R, J = _evaluate(problem, z, jacobian=fresh)
    jacobians, last = int(fresh), np.inf
    J = J if fresh else kept
    weights = 1 / np.maximum(np.abs(J * scales).max(axis=1), np.finfo(float).tiny)
    factors = _factors(J, scales, weights, normal)
    for iteration in range(1, settings.max_iterations + 1):
        move = scales * _backsubstitute(factors, np.append(-weights * R, 0.0))
        size = np.linalg.norm(move / scales)
        # A kept Jacobian's steps fall by a factor, those of a fresh one are squared.
        if size <= settings.tolerance * (1.0 if fresh else _KEPT_TOLERANCE):
            return _converged(problem, z + move, normal, scales, weights, iteration, jacobians)
        if keep and size <= min(_CONTRACTION * last, _NEAR):
            z, last, fresh = z + move, size, False
            R = _evaluate(problem, z, jacobian=False)[0]
            continue
        if fresh:
            z = _line_search(problem, z, move, weights, R)
        R, J = _evaluate(problem, z)
        factors = _factors(J, scales, weights, normal)
        jacobians, last, fresh = jacobians + 1, np.inf, True
    raise NotFound(
        f"the last of {settings.max_iterations} steps was {size:.2g} of the unknowns' scales"
    )


def _converged(problem, z, normal, scales, weights, iterations, jacobians) -> Point:
    J = _evaluate(problem, z)[1]
    factors = _factors(J, scales, weights, normal)
    tangent = _backsubstitute(factors, np.append(np.zeros(len(J)), 1.0))
    tangent = tangent / np.linalg.norm(tangent)
    return Point(z, tangent, scales, J, iterations, jacobians + 1)


def _line_search(problem, z, move, weights, R):
    """The first of ever shorter steps that does not let the residual grow."""
    error, best = np.linalg.norm(weights * R), None
    for halving in range(_HALVINGS):
        trial = z + move * 0.5**halving
        try:
            R = _evaluate(problem, trial, jacobian=False)[0]
        except NotFound:
            continue
        new = np.linalg.norm(weights * R)
        if best is None or new < best[1]:
            best = trial, new
        # A full step may raise a residual of very different parts and yet be right.
        if new <= (2.0 if halving == 0 else 1.0) * error:
            break
    if best is None:
        raise NotFound("the residual is not finite")
    return best[0]


def _evaluate(problem, z, *, jacobian: bool = True):
    R, J = problem.evaluate(z, jacobian=jacobian)
    if not np.isfinite(R).all() or (jacobian and not np.isfinite(J).all()):
        raise NotFound("the residual is not finite")
    return R, J


def _factors(J, scales, weights, normal):
    A = np.vstack([weights[:, None] * J * scales, normal])
    lu, pivots, singular = scipy.linalg.lapack.dgetrf(A)
    if singular:
        raise NotFound("the Jacobian is singular")
    return lu, pivots


def _backsubstitute(factors, right):
    found = scipy.linalg.lu_solve(factors, right, check_finite=False)
    if not np.isfinite(found).all():
        raise NotFound("the Jacobian is singular")
    return found
