"""The two fields of the error in the constitutive relation; see `where.constitutive`.

By sparse matrices and MUMPS for a mesh, by dense ones, the same on every rank, for beams.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np
import scipy.linalg
from petsc4py import PETSc

from fenics_joints.beams.structure import BeamStructure
from fenics_joints.errors import ConvergenceError
from fenics_joints.modal.options import give_room
from fenics_joints.structure import Sensors, Structure

__all__ = ["DenseFields", "SparseFields", "TwoFields"]

_OPTIONS = {
    "ksp_type": "preonly",
    "pc_type": "cholesky",
    "pc_factor_mat_solver_type": "mumps",
    "mat_mumps_icntl_14": "60",
}
_PREFIX = "fenics_joints_constitutive_"
#: Relative residual above which the system is taken to be singular.
_RESIDUAL = 1e-4


class TwoFields(Protocol):
    """The system of one structure, for one measured mode after another."""

    def solve(self, loads, there, omega: float, rho: float) -> list[tuple]:
        """(u, lambda) for each s of ``loads``. Collective.

        Args:
            loads: Measured shapes s, (n_sensors,) each, zero where a sensor was missing.
            there: Which sensors measured, (n_sensors,).
            omega: Measured circular frequency, rad/s.
            rho: Weight of a deviation at the sensors.

        Raises:
            ConvergenceError: If the system is singular.
        """

    def read(self, u) -> np.ndarray:
        """Motion at the sensors, (n_sensors,), equal on all ranks. Collective."""

    def release(self, fields: Sequence[tuple]) -> None:
        """Give back what `solve` returned."""

    def destroy(self) -> None:
        """Give back the matrices."""


def _check(size: float) -> None:
    """Raise if a relative residual is that of a singular system."""
    if not size < _RESIDUAL:
        raise ConvergenceError(
            "the two fields could not be solved for: do the sensors see every mode of the model "
            "near the measured frequency?", f"relative residual {size:.1e}",
        )  # fmt: skip


class DenseFields:
    """See `TwoFields`; matrices and fields are NumPy's."""

    def __init__(
        self, structure: BeamStructure, given: Mapping[str, float] | None, sensors: Sensors,
        gamma: float,
    ):  # fmt: skip
        self.K, self.M = structure.stiffness(given), structure.mass(given)
        self.P, self.gamma = structure.loads(sensors).T, gamma

    def solve(self, loads, there, omega: float, rho: float) -> list[tuple]:
        P = self.P * there[:, None]
        A = self.K - omega**2 * self.M
        B = -self.K / self.gamma - omega**2 / (1 - self.gamma) * self.M
        whole = np.block([[rho * P.T @ P, A], [A, B]])
        # Of u and lambda alike: turns, motions and both fields are of other units.
        scale = 1 / np.sqrt(np.maximum(np.abs(whole).max(axis=0), 1e-300))
        right = np.vstack([rho * P.T @ np.array(loads).T, np.zeros((len(A), len(loads)))])
        try:
            found = scipy.linalg.solve(
                scale[:, None] * whole * scale, scale[:, None] * right, assume_a="sym"
            )
        except scipy.linalg.LinAlgError as error:
            raise ConvergenceError("the two fields could not be solved for", str(error)) from error
        found *= scale[:, None]
        size = np.linalg.norm(scale[:, None] * (whole @ found - right))
        _check(size / np.linalg.norm(scale[:, None] * right))
        n = len(A)
        return [(found[:n, i], found[n:, i]) for i in range(len(loads))]

    def read(self, u: np.ndarray) -> np.ndarray:
        return self.P @ u

    def release(self, fields: Sequence[tuple]) -> None:
        pass

    def destroy(self) -> None:
        pass


class SparseFields:
    """See `TwoFields`; fields are vectors laid out like the rows of K."""

    def __init__(
        self, structure: Structure, given: Mapping[str, float] | None, sensors: Sensors,
        gamma: float,
    ):  # fmt: skip
        self.K, self.M = structure.stiffness(given), structure.mass(given)
        self.comm, self.gamma = structure.comm, gamma
        self.P = self._rows(structure.loads(sensors))
        self.diagonal = PETSc.Mat().createAIJ(self.K.getSizes(), nnz=1, comm=self.K.comm)
        self.diagonal.setDiagonal(self.K.createVecRight())
        self.diagonal.assemble()

    def destroy(self) -> None:
        for matrix in (self.K, self.M, self.P, self.diagonal):
            matrix.destroy()

    def _rows(self, loads: np.ndarray) -> PETSc.Mat:
        """Displacement at the sensors by the DOFs; all rows on rank 0.

        Args:
            loads: This rank's rows of the loads that are its transpose, (n_local, n_sensors).
        """
        n, first = loads.shape[1], self.K.getOwnershipRange()[0]
        most = int(self.comm.allreduce(np.count_nonzero(loads, axis=0)).max(initial=1))
        P = PETSc.Mat().createAIJ(
            [(n if self.comm.rank == 0 else 0, n), self.K.getSizes()[1]], nnz=(most, most),
            comm=self.K.comm,
        )  # fmt: skip
        for i, column in enumerate(loads.T):
            dofs = np.flatnonzero(column)
            P.setValues([i], (first + dofs).astype(PETSc.IntType), column[dofs])
        P.assemble()
        return P

    def release(self, fields: Sequence[tuple]) -> None:
        for vector in (v for pair in fields for v in pair):
            vector.destroy()

    def solve(self, loads, there, omega: float, rho: float) -> list[tuple]:
        W, whole = self._matrix(there, omega, rho)
        ksp = self._factorised(whole)
        load, solution = whole.createVecRight(), whole.createVecRight()
        right, image = self.P.createVecLeft(), self.P.createVecRight()
        n, found = image.getLocalSize(), []
        for s in loads:
            right.array[:] = rho * s if self.comm.rank == 0 else []
            W.multTranspose(right, image)
            load.array[:n], load.array[n:] = image.array_r, 0.0
            ksp.solve(load, solution)
            self._checked(ksp, whole, load, solution)
            pair = image.duplicate(), image.duplicate()
            pair[0].array[:], pair[1].array[:] = solution.array_r[:n], solution.array_r[n:]
            found.append(pair)
        for owned in (ksp, W, whole, load, solution, right, image):
            owned.destroy()
        return found

    def _matrix(self, there, omega: float, rho: float) -> tuple[PETSc.Mat, PETSc.Mat]:
        """The sensors' rows, zero where one was missing, and the matrix of both fields."""
        W = self.P.duplicate(copy=True)
        kept = self.P.createVecLeft()
        kept.array[:] = there if self.comm.rank == 0 else []
        W.diagonalScale(kept, None)
        PtP = self.P.transposeMatMult(W)
        PtP.scale(rho)
        # The Cholesky of several ranks needs every entry of the diagonal to be stored, zero or not.
        any_pattern = PETSc.Mat.Structure.UNKNOWN_NONZERO_PATTERN
        PtP.axpy(1.0, self.diagonal, any_pattern)
        A, B = self.K.duplicate(copy=True), self.K.duplicate(copy=True)
        A.axpy(-(omega**2), self.M, any_pattern)
        B.scale(-1 / self.gamma)
        B.axpy(-(omega**2) / (1 - self.gamma), self.M, any_pattern)
        whole = PETSc.Mat().createNest([[PtP, A], [A, B]], comm=self.K.comm)
        whole.assemble()
        whole.convert("aij")
        whole.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        for owned in (kept, PtP, A, B):
            owned.destroy()
        return W, whole

    def _factorised(self, A: PETSc.Mat) -> PETSc.KSP:
        """A direct solver; our options stand back behind the command line's."""
        options = PETSc.Options(_PREFIX)
        ours = {key: value for key, value in _OPTIONS.items() if not options.hasName(key)}
        for key, value in ours.items():
            options.setValue(key, value)
        ksp = PETSc.KSP().create(A.comm)
        try:
            ksp.setOptionsPrefix(_PREFIX)
            ksp.setOperators(A)
            ksp.setFromOptions()
            ksp.setUp()
            give_room(ksp)
        except PETSc.Error as error:
            raise ConvergenceError("the two fields could not be solved for", str(error)) from error
        finally:
            for key in ours:
                options.delValue(key)
        return ksp

    @staticmethod
    def _checked(ksp: PETSc.KSP, A: PETSc.Mat, load: PETSc.Vec, solution: PETSc.Vec) -> None:
        residual = load.duplicate()
        A.mult(solution, residual)
        residual.axpy(-1.0, load)
        size = residual.norm() / max(load.norm(), 1e-300)
        residual.destroy()
        _check(size if ksp.getConvergedReason() >= 0 else np.inf)

    def read(self, u: PETSc.Vec) -> np.ndarray:
        out = self.P.createVecLeft()
        self.P.mult(u, out)
        found = self.comm.bcast(out.array_r.copy(), root=0)
        out.destroy()
        return found
