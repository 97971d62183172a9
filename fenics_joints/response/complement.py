"""Solutions of (K - lambda M) w = r beside known modes: what derivatives of mode shapes need.

For an eigenvalue lambda the matrix is singular on the mode and on all modes of the same eigenvalue,
and nearly so on close ones: these are the mode's cluster. The solution asked for is the one that
has no share of the cluster (X^T M w = 0), for a right-hand side without its share (r - M X X^T r).

On a full structure the share of the other known modes is known by their eigenvalues. On what is
left, K - lambda M is positive definite, and conjugate gradients with the factorised K - shift M as
preconditioner need few steps, since no eigenvalue below the highest known one is left: one
factorisation, that of the modal solution, serves all modes. A reduced model is solved with the
bordered matrix (Nelson, AIAA J. 14, 1976; with the whole cluster in the border).
"""

from __future__ import annotations

import numpy as np
import scipy.linalg

from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.modal.modes import SHIFT_SHARE, Modes
from fenics_joints.response.modal_basis import check_modes
from fenics_joints.response.pencil import DampedPencil
from fenics_joints.structure.points import Sensors
from fenics_joints.structure.sparse import product

#: Steps of conjugate gradients, and the residual in the norm of energy at which they end.
_STEPS, _ACCURACY = 300, 1e-10


class FullComplement:
    """Modes of a full structure, with the factorisation that found them. Collective.

    Args:
        modes: Modes whose solver has solved nothing else since.
        close: Relative distance of eigenvalues within which no mode may be missing.

    Raises:
        InputError: If the solver has solved something else.

    Attributes:
        modes: The modes.
        shapes: This rank's rows of their shapes, (n_local, n).
    """

    def __init__(self, modes: Modes, close: float):
        self.modes, self.structure, self.close = modes, modes.model, close
        self.comm = self.structure.comm
        self.shapes = np.column_stack([x.array_r for x in modes.shapes])
        self._pencil = DampedPencil(self.structure, modes.given)
        check_modes(self._pencil, modes, self.shapes)
        self._heavy = product(self._pencil.M, self.shapes)

    def destroy(self) -> None:
        """Free the matrices. Collective."""
        self._pencil.destroy()

    def rows(self, sensors: Sensors) -> np.ndarray:
        """Rows by which sensors read, as columns: this rank's, (n_local, n_sensors)."""
        return self.structure.loads(sensors)

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
        return self.shapes @ weights + self._rest(rights - self._heavy @ share, eigenvalues)

    def _rest(self, r: np.ndarray, eigenvalues: np.ndarray) -> np.ndarray:
        """Conjugate gradients of all columns on what is beside all known modes."""
        w, z = np.zeros_like(r), self._precondition(r)
        d, size = z, self._dots(r, z)
        goal, active = _ACCURACY**2 * size, size > 0
        for _ in range(_STEPS):
            if not active.any():
                return self._check(w, eigenvalues)
            q = self._apply(d, eigenvalues)
            bend = self._dots(d, q)
            if np.any(bend[active] <= 0):
                raise _error()
            step = np.where(active, size / np.where(active, bend, 1.0), 0.0)
            w, r = w + step * d, r - step * q
            z = self._precondition(r)
            new = self._dots(r, z)
            d = z + np.where(active, new / np.where(active, size, 1.0), 0.0) * d
            size, active = new, active & (new > goal)
        raise _error()

    def _check(self, w: np.ndarray, eigenvalues: np.ndarray) -> np.ndarray:
        """The solution, unless its Rayleigh quotient bounds an unknown eigenvalue too near."""
        gap = self._dots(w, self._apply(w, eigenvalues))
        near = self.close * np.abs(eigenvalues) * self._dots(w, product(self._pencil.M, w))
        if np.any((gap <= near) & (near > 0)):
            raise _error()
        return w

    def _apply(self, d: np.ndarray, eigenvalues: np.ndarray) -> np.ndarray:
        q = product(self._pencil.K, d) - product(self._pencil.M, d) * eigenvalues
        return q - self._heavy @ self.inner(self.shapes, q)

    def _precondition(self, r: np.ndarray) -> np.ndarray:
        z = self.modes.solver.inverse(r)
        return z - self.shapes @ self.inner(self._heavy, z)

    def _dots(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return self.comm.allreduce(np.sum(a * b, axis=0))


class ReducedComplement:
    """The same of a `ReducedStructure` or `ArrayModel`, whose arrays every rank has whole."""

    def __init__(self, modes: Modes, close: float):
        self.modes, self.model, self.shapes = modes, modes.model, modes.shapes
        self._K, self._M = self.model.stiffness(modes.given), self.model.mass(modes.given)
        shift = (2 * np.pi * SHIFT_SHARE * self.model.dilation_frequency(modes.given)) ** 2
        every = scipy.linalg.eigvalsh(self._M, self._K + shift * self._M)[::-1]
        # The next mode after the last one known; without a mass there is none.
        count, last = len(modes), modes.eigenvalues[-1]
        there = count < len(every) and every[count] > 0
        self._next_is_near = there and 1 / every[count] - shift - last <= close * abs(last)

    def destroy(self) -> None:
        """Nothing to free."""

    def rows(self, sensors: Sensors) -> np.ndarray:
        """Rows by which sensors read, as columns, (n_dofs, n_sensors)."""
        return self.model.observe(np.eye(self.model.n_dofs), sensors).T

    def inner(self, Y: np.ndarray, X: np.ndarray) -> np.ndarray:
        """Y^T X."""
        return Y.T @ X

    def solve(self, rights: np.ndarray, eigenvalues: np.ndarray, own: np.ndarray) -> np.ndarray:
        """See `FullComplement.solve`."""
        if self._next_is_near and own[-1].any():
            raise _error()
        found = np.empty_like(rights)
        shift = abs(self.modes.eigenvalues).max()
        key = np.vstack([eigenvalues, own])
        for column in np.unique(key, axis=1).T:
            mine = np.all(key == column[:, None], axis=0)
            X = self.shapes[:, column[1:].astype(bool)]
            heavy = self._M @ X
            # The border as an added stiffness of the cluster alone: w has no share of it.
            A = self._K - column[0] * self._M + shift * heavy @ heavy.T
            r = rights[:, mine] - heavy @ (X.T @ rights[:, mine])
            w = np.linalg.solve(A, r)
            found[:, mine] = w - X @ (heavy.T @ w)
        return found


def complement(modes: Modes, close: float) -> FullComplement | ReducedComplement:
    """For the model of the modes; see `FullComplement`."""
    if not modes.model.is_dense and modes.solver is None:
        raise InputError("modes: expected modes with their solver.")
    return (ReducedComplement if modes.model.is_dense else FullComplement)(modes, close)


def _error() -> ConvergenceError:
    return ConvergenceError(
        "derivatives of a mode shape: a mode beyond those known is as low, or nearly so; ask for "
        "more modes."
    )
