"""Derivatives of mode shapes by the parameters of the model, exact; close modes as a subspace.

With K x = lambda M x, x^T M x = 1, and a cluster X of the modes whose eigenvalues are close,

    dx_i = w_i + X a_i,    (K - lambda_i M) w_i = -(1 - M X X^T) (dK - lambda_i dM) x_i,
    X^T M w_i = 0

(Nelson, AIAA J. 14, 1976). The a_ji are the shares of the cluster's modes in each other.

A single mode (a cluster of one, a_ii = -x^T dM x / 2) is differentiable. Of modes of equal
eigenvalue only their span is: single shapes jump from one choice to another with the
direction in which the parameters move. Of nearly equal ones single shapes do have derivatives, but
they are of the order of 1 / gap and hold for steps of the order of the gap alone. So all functions
here take modes closer than ``close`` together, and give the derivative of the basis of their span
that turns the least, a = -X^T dM X / 2: X(p) rotated onto X by M(p0)'s polar decomposition. It is
smooth where modes meet and cross, and whatever depends on the span alone (`span_gradients`,
`mac_gradients`) has the derivative that follows from it. `split_modes` gives what single shapes do
along one direction, after the eigenvalue derivatives have told them apart (Dailey, AIAA J. 27,
1989).

The share that w has of the other known modes follows from their eigenvalues. On what is left,
K - lambda M is positive definite, and one Krylov space of (K - shift M)^-1 M, whose factorisation
is that of the modal solution, serves the eigenvalues of all modes (block Lanczos: Grimes, Lewis and
Simon, SIAM J. Matrix Anal. Appl. 15, 1994): a sensor costs as many solutions with few modes as with
many. A dense model is solved directly.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy.linalg
from mpi4py import MPI
from petsc4py import PETSc

from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.modal.modes import SHIFT_SHARE, Modes
from fenics_joints.response.modal_basis import check_modes
from fenics_joints.structure.components import parameter_values
from fenics_joints.structure.points import Sensors
from fenics_joints.structure.sparse import (
    as_columns,
    bordered,
    product,
    slope_products,
    without_zeros,
)

#: Relative distance of eigenvalues below which modes are taken together.
CLOSE = 1e-3
#: Columns that are solved at once.
_COLUMNS = 32
#: Relative step of the second derivatives' central differences, and relative distance below which
#: eigenvalue derivatives are equal.
_STEP, _EQUAL = 1e-4, 1e-5
#: Steps of Lanczos' method, the residual in the norm of energy at which they end, and the share of
#: vectors' energy below which what others leave of it is none: round-off.
_STEPS, _ACCURACY, _DEPENDENT = 300, 1e-10, 1e-14


def clusters(modes: Modes, close: float = CLOSE) -> list[np.ndarray]:
    """Modes in groups whose neighbours are closer than ``close``, rigid-body modes in one.

    Args:
        modes: The modes.
        close: Relative distance of eigenvalues, (lambda_j - lambda_i) / lambda_j.

    Returns:
        Indices of the modes in each group, ascending.
    """
    lam, rigid = modes.eigenvalues, modes.n_rigid
    near = np.diff(lam) <= close * np.abs(lam[1:])
    near[: max(rigid - 1, 0)] = True
    if 0 < rigid < len(lam):
        near[rigid - 1] = False
    return np.split(np.arange(len(lam)), np.flatnonzero(~near) + 1)


def shape_gradients(
    modes: Modes, index: Sequence[int], sensors: Sensors, *, close: float = CLOSE
) -> np.ndarray:
    """Derivatives of M-normalised shapes at sensors, by every parameter. Collective.

    By one solution for each mode and parameter, or for each sensor if those are fewer (the
    adjoint). Without modes in a cluster it is the derivative of the shapes as they are; see the
    head of this module for that of close ones.

    Args:
        modes: Modes of a `Structure`, whose solver has solved nothing else since, or of a
            `ReducedStructure` or `ArrayModel` that knows the sensors.
        index: Modes wanted.
        sensors: Where the shapes are read.
        close: Relative distance of eigenvalues below which modes are a cluster. All of a cluster
            must be among the modes, wanted or not.

    Returns:
        d(shape at sensor)/dp, kg^-1/2 per unit of p, (n_sensors, len(index), n_parameters).

    Raises:
        InputError: For an index out of range, or a solver that has solved something else since.
        ConvergenceError: If a mode beyond those known is as low as a wanted one, or nearly so.
    """
    index = _checked(modes, index)
    work = Complement(modes, close)
    try:
        return _gradients(work, index, _membership(modes, index, close), work.rows(sensors))
    finally:
        work.destroy()


def _gradients(work, index, own, rows) -> np.ndarray:
    modes = work.modes
    X, lam = work.shapes[:, index], modes.eigenvalues[index]
    n, m, n_s = len(modes.model.parameters), len(index), rows.shape[1]
    found = np.zeros((n_s, m, n))
    if n_s < (n if modes.model.is_dense else n * m):
        for some in _some(n_s):
            _adjoint(work, X, lam, own, rows[:, some], found[some])
        return found
    at, forces = work.inner(rows, work.shapes), list(_forces(work, X, lam, own))
    if forces:
        mode = np.tile(np.arange(m), len(forces))
        w = _solve(work, np.hstack([force for _, force, _ in forces]), mode, lam, own)
        read = work.inner(rows, w).reshape(n_s, len(forces), m)
    for i, (p, _, turn) in enumerate(forces):
        found[:, :, p] = at @ turn + read[:, i]
    return found


def _adjoint(work, X, lam, own, rows, found) -> None:
    """Put in the derivatives at a few sensors, (n_s, m, n_parameters): of every parameter only what
    its forms have between the shapes and a basis is needed."""
    modes, at = work.modes, work.inner(rows, work.shapes)
    basis, weights = work.basis(rows, lam, own)
    for p, kind, _, between in slope_products(modes.model.slopes(modes.given), basis, X):
        if kind == "M":
            found[:, :, p] += np.einsum("vsm,vm->sm", weights, between * lam)
            found[:, :, p] += at @ np.where(own, -0.5 * between[: len(modes)], 0.0)
        else:
            found[:, :, p] -= np.einsum("vsm,vm->sm", weights, between)


def _forces(work, X, lam, own, given=None):
    """For every parameter: its index, -(dK - lambda dM) x, and the turning a, (n, m)."""
    for p, stiff, heavy in _changes(work.modes, X, given):
        turn = np.where(own, -0.5 * work.inner(work.shapes, heavy), 0.0)
        yield p, heavy * lam - stiff, turn


def _changes(
    modes: Modes, X: np.ndarray, given=None
) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
    """dK/dp X and dM/dp X of every parameter that has any, with its index, ascending.

    Args:
        modes: The modes.
        X: This rank's rows of vectors, (n_local, k).
        given: Values at which to take them; the modes' own without.
    """
    found: dict[int, dict[str, np.ndarray]] = {}
    for p, kind, _, form in modes.model.slopes(modes.given if given is None else given):
        images = found.setdefault(p, {kind: np.zeros_like(X) for kind in "KM"})
        images[kind] += form @ X
        if not modes.model.is_dense:
            form.destroy()
    for p in sorted(found):
        yield p, found[p]["K"], found[p]["M"]


def _solve(work, rights, mode, lam, own) -> np.ndarray:
    """`solve` of columns that belong to these wanted modes, some at a time."""
    parts = _some(rights.shape[1])
    return np.hstack(
        [work.solve(rights[:, some], lam[mode[some]], own[:, mode[some]]) for some in parts]
    )


def _some(count: int) -> list[slice]:
    """So many columns, some at a time."""
    return [slice(i, min(i + _COLUMNS, count)) for i in range(0, count, _COLUMNS)]


def _membership(modes: Modes, index: np.ndarray, close: float) -> np.ndarray:
    """Which modes are in the cluster of each wanted one, (n, len(index))."""
    label = np.empty(len(modes), dtype=int)
    for number, members in enumerate(clusters(modes, close)):
        label[members] = number
    return label[:, None] == label[index]


def _checked(modes: Modes, index: Sequence[int]) -> np.ndarray:
    found = np.atleast_1d(np.asarray(index, dtype=int))
    if not len(found) or found.min() < 0 or found.max() >= len(modes):
        raise InputError(f"index = {list(index)}: expected modes from 0 to {len(modes) - 1}.")
    return found


# -- what depends on the span alone ----------------------------------------------------------------


def span_gradients(
    modes: Modes, cluster: Sequence[int], sensors: Sensors, *, close: float = CLOSE
) -> tuple[np.ndarray, np.ndarray]:
    """The span of a cluster at sensors, Y Y^T with Y = X at sensors, and its derivatives.

    It does not depend on which shapes were chosen in the span. Collective.

    Args:
        modes: As in `shape_gradients`.
        cluster: A whole cluster, or several.
        sensors: Where the shapes are read.
        close: As in `shape_gradients`.

    Returns:
        Y Y^T, 1/kg, (n_sensors, n_sensors); and (n_sensors, n_sensors, n_parameters).

    Raises:
        InputError: If a mode is closer than ``close`` to one of those that is not among them; or as
            `shape_gradients`.
        ConvergenceError: As `shape_gradients`.
    """
    index = _checked(modes, cluster)
    missing = np.setdiff1d(np.flatnonzero(_membership(modes, index, close).any(axis=1)), index)
    if len(missing):
        raise InputError(
            f"cluster = {index.tolist()}: expected whole clusters, with the modes "
            f"{missing.tolist()}, which are closer than {close:g} to one of them."
        )
    Y, dY = modes.at(sensors)[:, index], shape_gradients(modes, index, sensors, close=close)
    half = np.einsum("smp,tm->stp", dY, Y)
    return Y @ Y.T, half + half.transpose(1, 0, 2)


def mac_gradients(
    modes: Modes,
    index: Sequence[int],
    sensors: Sensors,
    reference: np.ndarray,
    *,
    close: float = CLOSE,
) -> tuple[np.ndarray, np.ndarray]:
    """MAC of modes with reference shapes, and its derivatives by every parameter. Collective.

    Of a mode in a cluster it is the largest MAC that any shape in the cluster's span has (Allemang
    and Brown's MAC for one mode; the cosine squared of the angle to the span for several), which is
    differentiable where the modes meet.

    Args:
        modes: As in `shape_gradients`.
        index: Modes wanted, k of them.
        sensors: Where the shapes are read.
        reference: Real shapes at the sensors, one for each, (n_sensors, k).
        close: As in `shape_gradients`.

    Returns:
        MAC, (k,), and derivatives, (k, n_parameters).

    Raises:
        InputError: If the reference has another shape, or has no motion; or as `shape_gradients`.
        ConvergenceError: As `shape_gradients`.
    """
    index = _checked(modes, index)
    reference = np.asarray(reference, dtype=float)
    if reference.shape != (len(sensors), len(index)) or not np.all(np.any(reference != 0, axis=0)):
        raise InputError(
            f"reference has the shape {reference.shape}: expected {(len(sensors), len(index))}, "
            "a column that is not zero for each mode."
        )
    own = _membership(modes, index, close)
    needed = np.flatnonzero(own.any(axis=1))
    Y, dY = modes.at(sensors)[:, needed], shape_gradients(modes, needed, sensors, close=close)
    values, slopes = np.empty(len(index)), np.empty((len(index), dY.shape[2]))
    for i, r in enumerate(reference.T / np.linalg.norm(reference, axis=0)[:, None]):
        mine = own[needed, i]
        weights = np.linalg.lstsq(Y[:, mine], r, rcond=None)[0]
        off = r - Y[:, mine] @ weights
        values[i] = 1 - off @ off
        # The projection's own change: d|P r|^2 = 2 r^T (1 - P) dY Y^+ r.
        slopes[i] = 2 * np.einsum("s,smp,m->p", off, dY[:, mine], weights)
    return values, slopes


# -- single shapes of a cluster along one direction ------------------------------------------------


@dataclass(frozen=True)
class SplitModes:
    """Modes of a cluster as they part along one direction of the parameters.

    Attributes:
        eigenvalue_slopes: d lambda / dt of each, ascending, (m,).
        shapes: At sensors, kg^-1/2, (n_sensors, m): those in the span that have a derivative.
        slopes: Their derivatives d/dt, (n_sensors, m). Modes that do not part (equal eigenvalue
            slopes) keep the basis that turns the least.
    """

    eigenvalue_slopes: np.ndarray
    shapes: np.ndarray = field(repr=False)
    slopes: np.ndarray = field(repr=False)


def split_modes(
    modes: Modes, cluster: Sequence[int], sensors: Sensors, direction: Mapping[str, float]
) -> SplitModes:
    """Derivatives of single shapes of equal eigenvalue, p = p0 + t direction (Dailey 1989).

    Second derivatives of the matrices along the direction are central differences of exact first
    ones. Collective.

    Args:
        modes: As in `shape_gradients`.
        cluster: Modes of one eigenvalue, all of them.
        sensors: Where the shapes are read.
        direction: Change of the parameters by name, in their units, per unit of t.

    Raises:
        InputError: If a parameter does not exist or does not change, or as `shape_gradients`.
        ConvergenceError: As `shape_gradients`.
    """
    index, names = _checked(modes, cluster), list(modes.model.parameters)
    values = parameter_values(modes.model.parameters, modes.given)
    parameter_values(modes.model.parameters, direction)
    along = np.array([direction.get(name, 0.0) for name in names])
    if not along.any():
        raise InputError(f"direction = {dict(direction)}: expected at least one change.")
    work = Complement(modes, _EQUAL)
    try:
        lam = float(np.mean(modes.eigenvalues[index]))
        images = _along(work, work.shapes[:, index], along)
        F = work.inner(work.shapes[:, index], images[0] - lam * images[1])
        slopes, turn = np.linalg.eigh(0.5 * (F + F.T))
        Z, (stiff, heavy) = work.shapes[:, index] @ turn, (A @ turn for A in images)
        own = np.zeros((len(modes), len(index)), dtype=bool)
        own[index] = True
        w = work.solve(lam * heavy - stiff, np.full(len(index), lam), own)
        bent_K, bent_M = _bends(work, Z, along, np.array(list(values.values())))
        # Rows j, columns i.
        mass = work.inner(Z, heavy)
        top = 0.5 * work.inner(Z, bent_K - lam * bent_M) - mass * slopes
        top += work.inner(stiff - lam * heavy, w)
        part = slopes[None, :] - slopes[:, None]
        same = np.abs(part) <= _EQUAL * np.abs(slopes).max()
        share = np.where(same, -0.5 * mass, top / np.where(same, 1.0, part))
        rows = work.rows(sensors)
        return SplitModes(slopes, work.inner(rows, Z), work.inner(rows, w + Z @ share))
    finally:
        work.destroy()


def _along(work, X, along, given=None) -> tuple[np.ndarray, np.ndarray]:
    """dK/dt X and dM/dt X."""
    stiff, heavy = np.zeros_like(X), np.zeros_like(X)
    for p, by_K, by_M in _changes(work.modes, X, given):
        stiff += along[p] * by_K
        heavy += along[p] * by_M
    return stiff, heavy


def _bends(work, Z, along, values) -> tuple[np.ndarray, np.ndarray]:
    """d2K/dt2 Z and d2M/dt2 Z."""
    moved = along != 0
    sizes = np.where(values[moved] != 0, np.abs(values[moved]), 1.0)
    h, names = _STEP * np.min(sizes / np.abs(along[moved])), list(work.modes.model.parameters)
    after, before = (
        _along(work, Z, along, dict(zip(names, values + step * along, strict=True)))
        for step in (h, -h)
    )
    return tuple((a - b) / (2 * h) for a, b in zip(after, before, strict=True))


# -- (K - lambda M) w = r beside a cluster of known modes ------------------------------------------


class Complement:
    """Modes of a model, and what solves for the rest of its motion beside them. Collective.

    Args:
        modes: Modes; those of a `Structure` with a solver that has solved nothing else since.
        close: Relative distance of eigenvalues within which no mode may be missing.

    Raises:
        InputError: If the solver is missing or has solved something else.

    Attributes:
        modes: The modes.
        shapes: This rank's rows of their shapes, (n_local, n); of a dense model all of them.
    """

    def __init__(self, modes: Modes, close: float):
        self.modes, self.model, self.close = modes, modes.model, close
        if not self.model.is_dense and modes.solver is None:
            raise InputError("modes: expected modes with their solver.")
        self._owned, self.comm = [], MPI.COMM_SELF
        if self.model.is_dense:
            self.shapes = modes.shapes
            self._K, self._M = self.model.stiffness(modes.given), self.model.mass(modes.given)
        else:
            self.shapes, self.comm = as_columns(modes.shapes), self.model.comm
            self._set_up(modes)
            check_modes(self._M, modes, self.shapes)
        self._heavy = product(self._M, self.shapes)

    def _set_up(self, modes: Modes) -> None:
        """M without its zeros, and A = K - shift M, which a direct solver has."""
        M = self.model.mass(modes.given)
        self._M = without_zeros(M)
        M.destroy()
        self._owned.append(self._M)
        self._A = getattr(modes.solver, "shifted", None)
        if self._A is None:
            self._A = self.model.stiffness(modes.given)
            self._A.axpy(-modes.solver.shift, self._M, PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
            self._owned.append(self._A)

    def destroy(self) -> None:
        """Free the matrices. Collective."""
        for A in self._owned:
            A.destroy()

    def rows(self, sensors: Sensors) -> np.ndarray:
        """Rows by which sensors read, as columns: this rank's, (n_local, n_sensors)."""
        if self.model.is_dense:
            return self.model.observe(np.eye(self.model.n_dofs), sensors).T
        return self.model.loads(sensors)

    def inner(self, Y: np.ndarray, X: np.ndarray) -> np.ndarray:
        """Y^T X, equal on all ranks."""
        return self.comm.allreduce(Y.T @ X)

    def solve(self, rights: np.ndarray, eigenvalues: np.ndarray, own: np.ndarray) -> np.ndarray:
        """w of every column.

        Args:
            rights: This rank's rows of r, (n_local, k).
            eigenvalues: lambda of each, (k,).
            own: Which modes are in the cluster of each, (n, k).

        Raises:
            ConvergenceError: If a mode beyond those known is closer than ``close``, or below.
        """
        share = self.inner(self.shapes, rights)
        gap = self.modes.eigenvalues[:, None] - eigenvalues
        weights = np.where(own, 0.0, share / np.where(own, 1.0, gap))
        rest = rights - self._heavy @ share
        if not self.model.is_dense:
            V, y = self._krylov(rest, eigenvalues[:, None])
            return self.shapes @ weights + V @ y[..., 0]
        return self.shapes @ weights + self._direct(rest, eigenvalues, own)

    def basis(
        self, rights: np.ndarray, eigenvalues: np.ndarray, own: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The solution for each column and each eigenvalue, as sums of vectors.

        Args:
            rights: This rank's rows of r, (n_local, k).
            eigenvalues: lambda of m modes, (m,).
            own: Which modes are in the cluster of each, (n, m).

        Returns:
            The vectors, of which the modes are first: this rank's rows, (n_local, n + l); and
            their weights in w of each column and eigenvalue, (n + l, k, m).

        Raises:
            ConvergenceError: As `solve`.
        """
        share = self.inner(self.shapes, rights)
        gap = self.modes.eigenvalues[:, None] - eigenvalues
        weights = (np.where(own, 0.0, 1.0) / np.where(own, 1.0, gap))[:, None] * share[..., None]
        rest = rights - self._heavy @ share
        if self.model.is_dense:
            k, m = rights.shape[1], len(eigenvalues)
            each = np.repeat(eigenvalues, k), np.repeat(own, k, axis=1)
            V = self._direct(np.tile(rest, m), *each)
            y = np.eye(m * k).reshape(m * k, m, k).swapaxes(1, 2)
        else:
            V, y = self._krylov(rest, np.tile(eigenvalues, (rights.shape[1], 1)))
        return np.hstack([self.shapes, V]), np.concatenate([weights, y])

    @cached_property
    def _next_is_near(self) -> bool:
        """Whether a dense model's next mode is as low as the last one known, or nearly so."""
        K, M, last, n = self._K, self._M, self.modes.eigenvalues[-1], len(self.modes)
        shift = (2 * np.pi * SHIFT_SHARE * self.model.dilation_frequency(self.modes.given)) ** 2
        every = scipy.linalg.eigvalsh(M, K + shift * M)[::-1]
        there = n < len(every) and every[n] > 0  # without mass there is none
        return there and 1 / every[n] - shift - last <= self.close * abs(last)

    def _direct(self, r: np.ndarray, eigenvalues: np.ndarray, own: np.ndarray) -> np.ndarray:
        """What a dense model's w have beside the modes, of columns orthogonal to these."""
        if own[-1].any() and self._next_is_near:
            raise _error()
        w, M = np.empty_like(r), self._M
        border = np.abs(self.modes.eigenvalues).max() * self._heavy @ self._heavy.T
        for eigenvalue in np.unique(eigenvalues):
            mine = eigenvalues == eigenvalue
            # The border is a stiffness of the known modes alone, of which r has no share.
            w[:, mine] = np.linalg.solve(self._K - eigenvalue * M + border, r[:, mine])
        return w - self.shapes @ (self._heavy.T @ w)

    def _krylov(self, r: np.ndarray, eigenvalues: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(K - lambda M)^-1 of columns orthogonal to all known modes, by block Lanczos.

        With A = K - shift M and t = lambda - shift it is (I - t A^-1 M)^-1 A^-1 r, and the space of
        A^-1 r, A^-1 M A^-1 r, ... is the same for every lambda.

        Args:
            r: This rank's rows of k columns.
            eigenvalues: Some for each column, (k, q).

        Returns:
            Vectors, orthonormal in A, (n_local, l), and their weights, (l, k, q).
        """
        t = eigenvalues - self.modes.solver.shift
        V, T = r[:, :0], np.zeros((0, 0))
        new, size = self._orthonormal(self._precondition(r), r, V)
        start, goal = size, _ACCURACY * np.sqrt(np.sum(size**2, axis=0))[:, None]
        for _ in range(_STEPS):
            V, forces = np.hstack([V, new]), product(self._M, new)
            T = bordered(T, self.inner(V, forces))
            values, turn = np.linalg.eigh(T)
            # The nearest mode beyond those known is no higher than the lowest on this space.
            least = 1 / max(values[-1], np.finfo(float).tiny) - t if len(values) else np.inf
            if np.any(least <= self.close * np.abs(eigenvalues)):
                raise _error()
            first = turn[: len(start)].T @ start
            y = np.tensordot(turn, first[..., None] / (1 - t * values[:, None, None]), 1)
            last = y[V.shape[1] - new.shape[1] :]
            new, size = self._orthonormal(self._precondition(forces), forces, V)
            # The residual's norm in A^-1.
            off = np.abs(t) * np.linalg.norm(np.tensordot(size, last, 1), axis=0)
            if np.all(off <= goal):
                return V, y
        raise _error()

    def _orthonormal(
        self, W: np.ndarray, forces: np.ndarray, V: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Vectors Q, orthonormal in A to each other and to V, and S with W = Q S + V (...).

        Twice, for what round-off left; the first time the forces stand for A W.
        """
        S = np.eye(W.shape[1])
        for again in (False, True):
            if again:
                forces = product(self._A, W)
            part, own = self.inner(V, forces), self.inner(W, forces)
            size = np.sqrt(np.maximum(np.diag(own), 0.0))
            size[size == 0] = 1.0
            values, turn = np.linalg.eigh((own - part.T @ part) / np.outer(size, size))
            kept = values > _DEPENDENT
            root = np.sqrt(values[kept])
            W = (W - V @ part) @ (turn[:, kept] / size[:, None] / root)
            S = (root[:, None] * turn[:, kept].T * size) @ S
        return W, S

    def _precondition(self, r: np.ndarray) -> np.ndarray:
        z = self.modes.solver.inverse(r)
        return z - self.shapes @ self.inner(self._heavy, z)


def _error() -> ConvergenceError:
    return ConvergenceError(
        "derivatives of a mode shape: a mode beyond those known is as low, or nearly so; ask for "
        "more modes."
    )
