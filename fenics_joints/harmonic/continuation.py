"""A branch of solutions of N equations in N + 1 unknowns, followed by its arc length.

Predictor along the tangent, Newton's method orthogonal to it (pseudo-arc-length continuation,
Keller 1977), in unknowns that are made dimensionless anew at every point. The last unknown is the
parameter that is bounded; nothing else distinguishes it, so turning points are points like others.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np
import scipy.linalg
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import brentq

from fenics_joints.errors import ConvergenceError, InputError, flag, real, wanted, whole
from fenics_joints.files import check_writable
from fenics_joints.reduction.files import read_model, register, write_model

# -- Newton's method -------------------------------------------------------------------------------


#: Trial lengths of a Newton step, each half of the last; chosen.
_HALVINGS = 6
#: A Jacobian is kept once a step is below the first, in the unknowns' scales, and while each step
#: is below the second times the last; with a kept one, a step has to be below the third times the
#: tolerance. Chosen for time: a Jacobian is worth many residuals.
_NEAR, _CONTRACTION, _KEPT_TOLERANCE = 0.1, 0.4, 0.1


class BranchProblem(Protocol):
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
class ContinuationSettings:
    """How a branch is followed.

    Attributes:
        step: First step, in scaled arc length.
        max_step: Longest step: 0.1 is a tenth of the `BranchProblem.scales`.
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


def check_settings(settings: ContinuationSettings | None) -> ContinuationSettings:
    """The settings, the usual ones without any.

    Raises:
        InputError: If they are something else.
    """
    if settings is not None and not isinstance(settings, ContinuationSettings):
        raise wanted("settings", settings, "ContinuationSettings, or None")
    return settings or ContinuationSettings()


def keeps(problem: BranchProblem, settings: ContinuationSettings) -> bool:
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

    def towards(self, way: np.ndarray, scales: np.ndarray) -> np.ndarray:
        """`tangent`, or its opposite if that points in a direction of scaled unknowns."""
        return self.tangent if self.tangent / scales @ way >= 0 else -self.tangent


class NotFound(ConvergenceError):
    """A point that Newton's method did not find, and why."""

    def __init__(self, why: str):
        super().__init__(f"Newton's method did not converge: {why}")
        self.why = why


def correct(
    problem: BranchProblem,
    z: np.ndarray,
    normal: np.ndarray | None,
    settings: ContinuationSettings,
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
    weights = _weights(J, scales)
    factors = _factors(J, scales, normal, weights)
    for iteration in range(1, settings.max_iterations + 1):
        move = scales * _backsubstitute(factors, np.append(-weights * R, 0.0))
        size = np.linalg.norm(move / scales)
        # A kept Jacobian's steps fall by a factor, those of a fresh one are squared.
        if size <= settings.tolerance * (1.0 if fresh else _KEPT_TOLERANCE):
            J = _evaluate(problem, z + move)[1]
            tangent = _tangent(J, scales, normal)
            return Point(z + move, tangent, scales, J, iteration, jacobians + 1)
        if keep and size <= min(_CONTRACTION * last, _NEAR):
            z, last, fresh = z + move, size, False
            R = _evaluate(problem, z, jacobian=False)[0]
            continue
        if fresh:
            z = _line_search(problem, z, move, weights, R)
        R, J = _evaluate(problem, z)
        factors = _factors(J, scales, normal, weights)
        jacobians, last, fresh = jacobians + 1, np.inf, True
    raise NotFound(
        f"the last of {settings.max_iterations} steps was {size:.2g} of the unknowns' scales"
    )


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


def _weights(J, scales) -> np.ndarray:
    """Factors that bring the largest entry of each row of the scaled Jacobian to 1, (N,)."""
    return 1 / np.maximum(np.abs(J * scales).max(axis=1), np.finfo(float).tiny)


def _bordered(J, scales, last, weights=None) -> np.ndarray:
    """The scaled Jacobian, its rows weighted, above one more row, (N + 1, N + 1)."""
    weights = _weights(J, scales) if weights is None else weights
    return np.vstack([weights[:, None] * J * scales, last])


def _factors(J, scales, last, weights=None):
    lu, pivots, singular = scipy.linalg.lapack.dgetrf(_bordered(J, scales, last, weights))
    if singular:
        raise NotFound("the Jacobian is singular")
    return lu, pivots


def _backsubstitute(factors, right):
    found = scipy.linalg.lu_solve(factors, right, check_finite=False)
    if not np.isfinite(found).all():
        raise NotFound("the Jacobian is singular")
    return found


def _tangent(J, scales, normal) -> np.ndarray:
    """The tangent of length one in scaled unknowns that is along a normal, (N + 1,)."""
    found = _backsubstitute(_factors(J, scales, normal), np.append(np.zeros(len(J)), 1.0))
    return found / np.linalg.norm(found)


def orientation(J: np.ndarray, scales: np.ndarray, direction: np.ndarray) -> float:
    """Sign of the determinant of Jacobian and scaled direction: along a branch it changes where
    another one crosses it."""
    return float(np.linalg.slogdet(_bordered(J, scales, direction))[0])


# -- points of a branch, and their file ------------------------------------------------------------


@dataclass(frozen=True, repr=False)
class Branch:
    """Points of a branch, in the order in which they were found.

    Attributes:
        z: Unknowns and, last, the parameter, (points, N + 1).
        tangents: Tangent of the branch at each point, of any length, (points, N + 1); None where
            the points are not followed.
        iterations: Newton steps that each point took, (points,).
        jacobians: Jacobians that they took, (points,).
        step: Next step, in scaled arc length.
        complete: Whether the branch has reached a bound.
    """

    z: np.ndarray
    tangents: np.ndarray | None
    iterations: np.ndarray
    jacobians: np.ndarray
    step: float
    complete: bool

    def __len__(self) -> int:
        return len(self.z)

    def __repr__(self) -> str:
        first, last = self.z[0, -1], self.z[-1, -1]
        return f"Branch({len(self)} points, parameter {first:.4g} to {last:.4g})"

    def without(self, column: int) -> Branch:
        """Its points without one of the unknowns."""
        z, tangents = (np.delete(a, column, axis=1) for a in (self.z, self.tangents))
        return replace(self, z=z, tangents=tangents)

    def first(self, n: int) -> Branch:
        """Its first ``n`` points."""
        keys = ("z", "tangents", "iterations", "jacobians")
        return replace(self, **{key: getattr(self, key)[:n] for key in keys})

    def with_point(self, z, tangent, effort, step: float, complete: bool) -> Branch:
        """The branch with one more point; effort: (Newton steps, Jacobians)."""
        longer = self.with_inserted(len(self), z, tangent, effort)
        return replace(longer, step=step, complete=complete)

    def with_inserted(self, i: int, z, tangent, effort) -> Branch:
        """The branch with a new point ``i``."""
        return replace(
            self,
            z=np.insert(self.z, i, z, axis=0),
            tangents=np.insert(self.tangents, i, tangent, axis=0),
            iterations=np.insert(self.iterations, i, effort[0]),
            jacobians=np.insert(self.jacobians, i, effort[1]),
        )


register(Branch)
_FORMAT = "fenics_joints branch"


def load_branch(path: str | Path, name: str = "") -> Branch | None:
    """A branch from the file that `follow` writes; None if there is no such file.

    Raises:
        InputError: If the file is not one of a branch of that name: a branch may be hours of work,
            so it is not replaced unasked.
    """
    if not Path(path).exists():
        return None
    try:
        return read_model(path, _FORMAT, Branch, name)
    except InputError as error:
        raise InputError(
            f"{error}; expected a branch of {name!r}: delete the file to compute the branch anew, "
            "or choose another one"
        ) from error


# -- from point to point ---------------------------------------------------------------------------


#: Distance of the predictor from the branch, as a share of the step, above which steps shrink;
#: twice as much is refused. Chosen.
_FAR = 0.3
#: Cosine of the angle between neighbouring tangents that steps aim at; chosen.
_STRAIGHT = 0.8
#: Share of the longest step below which a sharp turn is a kink, as where sliding begins; chosen.
_KINK = 0.02
#: How far ahead, in scaled arc length, the tangent past a kink is taken, and the shares of the step
#: that are tried along it; chosen.
_AHEAD, _SHARES = (1e-5, 1e-4, 1e-3, 1e-2), (10.0, 1.0)
#: Most points that the search for an extreme takes; nothing depends on it.
_SECANTS = 12
#: How often the way from one value of the parameter to the next is halved; chosen.
_PARTS = 7


def follow(
    problem: BranchProblem,
    start: np.ndarray,
    bounds: tuple[float, float],
    *,
    settings: ContinuationSettings | None = None,
    direction: int = 1,
    checkpoint: str | Path | None = None,
    resume: bool = False,
    name: str = "",
    on_point: Callable[[np.ndarray], object] = lambda z: None,
    writes: bool = True,
) -> Branch:
    """Follow a branch until its parameter leaves the bounds.

    The last point is on a bound, unless Newton's method fails there: then a step short of it.

    Args:
        problem: The equations.
        start: Guess of the first point; its parameter is held.
        bounds: Lower and upper bound of the parameter.
        settings: Steps and tolerances.
        direction: 1 if the parameter is to grow at first, -1 if it is to fall.
        checkpoint: File (HDF5) that the branch is written to as it grows.
        resume: Go on from ``checkpoint`` if it is there.
        name: What is being solved, kept in the file: one of another name is not gone on from.
        on_point: Called with every new point; True ends the branch there, not complete, and a
            ConvergenceError says why it cannot go on.
        writes: Whether this rank writes the file.

    Raises:
        InputError: For bounds, a direction or a file that do not fit.
        ConvergenceError: If no step is short enough, or the points do not suffice; the points so
            far are its ``branch``.
    """
    settings = settings or ContinuationSettings()
    low, high = bounds
    if not low < high or not low <= start[-1] <= high:
        raise InputError(
            f"bounds = {bounds}: expected lower < upper, and the start ({start[-1]:.6g}) between."
        )
    if direction not in (1, -1):
        raise InputError(f"direction = {direction}: expected 1 or -1.")
    if checkpoint is not None:
        check_writable(checkpoint, "checkpoint")
    branch = load_branch(checkpoint, name) if resume and checkpoint is not None else None
    kept = None
    if branch is None:
        branch, kept = _first_point(problem, start, direction, settings)
        on_point(branch.z[-1])
    while not branch.complete:
        if len(branch) >= settings.max_points:
            _save(checkpoint, branch, name, writes)
            raise _stopped(branch, f"it has {len(branch)} points (max_points)")
        try:
            branch, kept = _grown(problem, branch, bounds, settings, kept)
        except NotFound as failure:
            _save(checkpoint, branch, name, writes)
            raise _stopped(branch, failure.why) from None
        try:
            if on_point(branch.z[-1]) is True:
                return replace(branch, complete=False)
        except ConvergenceError as error:  # it may have seen that there is no end
            error.branch = branch
            raise
        if branch.complete or len(branch) % settings.save_every == 0:
            _save(checkpoint, branch, name, writes)
    return branch


def _save(path, branch, name, writes) -> None:
    if path is not None and writes:
        write_model(branch, path, _FORMAT, name)


def _stopped(branch: Branch, why: str) -> ConvergenceError:
    error = ConvergenceError(
        f"the branch stopped at its point {len(branch)}, parameter {branch.z[-1, -1]:.6g}: {why}"
    )
    error.branch = branch
    return error


def _first_point(problem, start, direction, settings):
    try:
        point = correct(problem, start, None, settings)
    except NotFound as failure:
        raise ConvergenceError(f"no first point of the branch: {failure.why}") from None
    effort = np.array([[point.iterations, point.jacobians]])
    tangent = direction * point.tangent
    return Branch(point.z[None], tangent[None], *effort.T, settings.step, False), point.jacobian


def _grown(problem, branch: Branch, bounds, settings, kept):
    """The branch with one more point, by ever shorter steps if need be, and its Jacobian."""
    z, physical = branch.z[-1], branch.tangents[-1]
    scales, step = problem.scales(z), branch.step
    direction = physical / scales
    direction = direction / np.linalg.norm(direction)
    why = ""
    while step >= settings.min_step:
        small = step <= _KINK * settings.max_step
        try:
            point = correct(problem, z + step * scales * direction, direction, settings, kept)
            why = _doubt(problem, point, z, scales, direction, step, small)
        except NotFound as failure:
            why = failure.why
        if why and small:
            around = _around(problem, z, scales, direction, step, settings)
            if around is not None:
                point, direction = around
                why = ""
        if not why:
            break
        step /= 2
    else:
        raise NotFound(
            f"no step down to {settings.min_step:.1g} led on ({why}); more samples may "
            "help, or some stiffness that is left when a joint slides"
        )
    new, tangent = point.z, point.towards(direction, scales)
    low, high = bounds
    if not low <= new[-1] <= high:
        bound = high if new[-1] > high else low
        return _ended(problem, branch, point, tangent, bound, settings, scales), None
    # Steps shrink ahead of bends and grow where Newton's method is quick.
    turn = np.dot(tangent / scales, direction) / np.linalg.norm(tangent / scales)
    off = np.linalg.norm((new - z) / scales - step * direction) / step
    # Two are needed to see convergence if none is kept.
    needed = point.jacobians - 2 * (not keeps(problem, settings))
    grow = 2.0 * settings.wanted_jacobians / max(settings.wanted_jacobians, needed)
    grow = min(grow, 0.5 * _FAR / max(off, 1e-3), ((1 - _STRAIGHT) / max(1 - turn, 1e-6)) ** 0.5)
    step = min(step * float(np.clip(grow, 0.4, 2.0)), settings.max_step)
    effort = point.iterations, point.jacobians
    step = max(step, settings.min_step)
    return branch.with_point(new, tangent, effort, step, False), point.jacobian


def _doubt(problem, point: Point, z, scales, direction, step, small: bool) -> str:
    """Why a point is not to be trusted; empty if it is. If the step is small already, the branch
    has a kink, beyond which the point may be one that the branch came by."""
    tangent = point.tangent / scales
    tangent = tangent / np.linalg.norm(tangent)
    along = float(tangent @ direction)
    if not small and abs(along) < 0.5:
        return "the branch turns too sharply"
    off = np.linalg.norm((point.z - z) / scales - step * direction)
    if off > (20 if small else 2 * _FAR) * step:
        return "the predictor is too far off"
    if abs(along) > 0.5:
        return ""
    before = orientation(_evaluate(problem, z)[1], scales, direction)
    after = orientation(point.jacobian, scales, tangent * np.sign(along))
    return "" if before == after else "the branch turns back at a kink"


def _around(problem, z, scales, direction, step, settings):
    """A point on the other side of a kink, and the direction to it; None if it is not found.

    Where a stop is met the branch may have a corner, even one sharper than a right angle, so that
    no plane across its old direction has a point of the branch beyond the corner. So the tangent is
    taken ahead, past the corner. Its sense follows from the sign of the determinant of Jacobian and
    tangent, which a corner does not change: thus the branch does not run back on itself.
    """
    with suppress(NotFound):
        sign = orientation(_evaluate(problem, z)[1], scales, direction)
        for ahead, share in ((a, s) for a in _AHEAD for s in _SHARES):
            J = _evaluate(problem, z + ahead * scales * direction)[1]
            with suppress(NotFound):
                normal = _tangent(J, scales, direction)
                normal = normal * sign * orientation(J, scales, normal)
                start = z + share * step * scales * normal
                point = correct(problem, start, normal, settings)
                tangent = point.direction * np.sign(point.direction @ normal)
                forward = orientation(point.jacobian, scales, tangent) == sign
                way = (point.z - z) / scales
                straight = way @ normal > 0.5 * np.linalg.norm(way)
                if forward and straight and tangent @ normal > 0.5:
                    return point, normal
    return None


def _ended(problem, branch, beyond: Point, tangent, bound, settings, scales) -> Branch:
    """The branch with its last point, on a bound; a step short of it if that is not found."""
    cubic = _cubic(branch.z[-1], branch.tangents[-1], beyond.z, tangent, scales)
    start = cubic(brentq(lambda s: cubic(s)[-1] - bound, 0.0, 1.0))
    start[-1] = bound
    try:
        point = correct(problem, start, None, settings, beyond.jacobian)
    except NotFound:
        return replace(branch, complete=True)
    last = point.towards(tangent / scales, scales)
    return branch.with_point(point.z, last, (point.iterations, point.jacobians), branch.step, True)


def _cubic(a, ta, b, tb, scales) -> CubicHermiteSpline:
    """The cubic between two points of a branch with its tangents there, from 0 to 1."""
    length = np.linalg.norm((b - a) / scales)
    slopes = [t * length / np.linalg.norm(t / scales) for t in (ta, tb)]
    return CubicHermiteSpline([0.0, 1.0], [a, b], slopes)


def locate(
    problem: BranchProblem,
    branch: Branch,
    i: int,
    slope: Callable[[np.ndarray, np.ndarray], float],
    settings: ContinuationSettings | None = None,
    *,
    tolerance: float = 1e-6,
) -> Branch:
    """Insert the point between points i and i + 1 where a slope along the branch vanishes.

    Args:
        problem: The equations.
        branch: The branch.
        i: The slope has different signs at points i and i + 1.
        slope: Derivative along the branch of what is extreme, from a point and its tangent.
        settings: As for `follow`.
        tolerance: Of the slope, relative to that at the ends.

    Raises:
        InputError: If the slope has the same sign at both.
        ConvergenceError: If the corrector fails between the two points.
    """
    settings = settings or ContinuationSettings()
    a, b = branch.z[i], branch.z[i + 1]
    scales = problem.scales(a)
    ta, tb = (t / np.linalg.norm(t / scales) for t in branch.tangents[i : i + 2])
    normal = (b - a) / scales
    normal = normal / np.linalg.norm(normal)
    cubic = _cubic(a, ta, b, tb, scales)
    ends = {0.0: slope(a, ta), 1.0: slope(b, tb)}
    if not ends[0.0] * ends[1.0] < 0:
        raise InputError(f"the slope has the same sign at points {i} and {i + 1}.")
    size, found = max(map(abs, ends.values())), None

    def at(s: float) -> float:
        """Slope at the branch's point beside the cubic's; zero once it is small enough."""
        nonlocal found
        if s in ends:
            return ends[s]
        point = correct(problem, cubic(s), normal, settings, found and found[0].jacobian)
        tangent = point.towards(normal, scales) / np.linalg.norm(point.tangent / scales)
        found, f = (point, tangent), slope(point.z, tangent)
        return 0.0 if abs(f) <= tolerance * size else f

    brentq(at, 0.0, 1.0, xtol=1e-9, maxiter=_SECANTS, disp=False)
    point, tangent = found
    return branch.with_inserted(i + 1, point.z, tangent, (point.iterations, point.jacobians))


# -- points at given values of the parameter -------------------------------------------------------


def solve_at(
    problem: BranchProblem,
    parameters: np.ndarray,
    first: Callable[[float], np.ndarray],
    settings: ContinuationSettings,
    *,
    initial: np.ndarray | None = None,
    on_point: Callable[[np.ndarray], object] = lambda z: None,
) -> Branch:
    """Solutions at given values of the parameter, each from that at the next lower value.

    Args:
        problem: The equations.
        parameters: The values, in any order, (n,).
        first: A guess of the solution at a value of the parameter, for the lowest one and where the
            others' neighbours do not lead there.
        settings: Tolerances.
        initial: Guesses of all solutions that are tried first, (n, N + 1); None for none.
        on_point: Called with every solution.

    Returns:
        The solutions in the order of the parameters, without tangents.

    Raises:
        ConvergenceError: If one is not found.
    """
    found, last = {}, None
    for i in np.argsort(parameters, kind="stable").tolist():
        value, point = parameters[i], None
        if initial is not None:
            point = _tried(problem, np.append(initial[i][:-1], value), settings)
        if point is None and last is not None:
            point = _stepped(problem, last, value, settings)
        if point is None:
            point = correct(problem, first(value), None, settings)
        found[i] = last = point
        on_point(point.z)
    points = [found[i] for i in range(len(found))]
    effort = np.array([(point.iterations, point.jacobians) for point in points])
    return Branch(np.array([point.z for point in points]), None, *effort.T, 0.0, True)


def _tried(problem, start, settings, kept=None) -> Point | None:
    try:
        return correct(problem, start, None, settings, kept)
    except NotFound:
        return None


def _stepped(problem, last: Point, value: float, settings) -> Point | None:
    """From one solution to that at another value of the parameter, by ever shorter steps."""
    step = whole = value - last.z[-1]
    while abs(step) >= 2.0**-_PARTS * abs(whole):
        z, t = last.z, last.tangent
        step = min(step, value - z[-1])
        guess = z + t * (step / t[-1]) if t[-1] else z + 0.0
        guess[-1] = value if step == value - z[-1] else z[-1] + step
        found = _tried(problem, guess, settings, last.jacobian)
        if found is None:
            step /= 2
            continue
        last = found
        if last.z[-1] == value:
            return last
    return None
