"""The equation of motion M a + C v + K u + f(u, history) = load, for PETSc's integrators.

One class for the dense matrices of an `InterfaceModel`, one for the sparse ones of a full
finite-element model, whose points are shared out over the ranks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from fenics_joints.errors import InputError
from fenics_joints.interfaces.model import InterfaceModel
from fenics_joints.joint_laws.kernel import LawKernel
from fenics_joints.joint_laws.law import JointLaw

__all__ = ["DenseMotion", "FullModel", "SparseMotion", "SparsePoints", "motion_of", "point_blocks"]


@dataclass(frozen=True)
class SparsePoints:
    """The points of one interface of a full model; as `InterfacePoints`, for this rank's points.

    Attributes:
        name: Name of the joint.
        law: What makes stress of strain.
        rows: Strains by displacement, (P d, n) sparse, point by point.
        weights: Area or volume of this rank's points, (P,).
        n_components: Components of strain, d.
        normal: Whether the first of them is the normal strain.
        points: Positions of this rank's points, m, (P, gdim).
    """

    name: str
    law: JointLaw
    rows: PETSc.Mat
    weights: np.ndarray
    n_components: int
    normal: bool = False
    points: np.ndarray | None = None


@dataclass(frozen=True)
class FullModel:
    """A full finite-element model with nonlinear interfaces.

    Attributes:
        M: Mass, kg.
        K: Stiffness without the interfaces' stress, N/m.
        interfaces: The nonlinear interfaces.
        C: Viscous damping, N s/m; None for none.
        forces: Load per unit force at the places of forces, by name.
        sensors: Rows of displacement at sensors, by name, as vectors.
    """

    M: PETSc.Mat
    K: PETSc.Mat
    interfaces: Sequence[SparsePoints] = ()
    C: PETSc.Mat | None = None
    forces: Mapping[str, PETSc.Vec] = field(default_factory=dict)
    sensors: Mapping[str, PETSc.Vec] = field(default_factory=dict)


def motion_of(model: InterfaceModel | FullModel) -> DenseMotion | SparseMotion:
    """The equation of motion of a model."""
    return DenseMotion(model) if isinstance(model, InterfaceModel) else SparseMotion(model)


class DenseMotion:
    """The motion of a reduced model, the same on every rank."""

    def __init__(self, model: InterfaceModel):
        self.model, self.comm = model, PETSc.COMM_SELF
        self._values = [p.law.values(len(p)) for p in model.interfaces]
        self._kernels = [p.kernel for p in model.interfaces]
        n = model.n_dofs
        self._flat = [p.rows.reshape(-1, n) for p in model.interfaces]
        self._loads = [
            (p.rows * p.weights[:, None, None]).reshape(-1, n).T.copy() for p in model.interfaces
        ]
        self._last = None

    def vector(self) -> PETSc.Vec:
        """A vector of zeros."""
        return PETSc.Vec().createSeq(self.model.n_dofs, comm=self.comm)

    def matrix(self) -> PETSc.Mat:
        """A matrix for `jacobian`."""
        n = self.model.n_dofs
        return PETSc.Mat().createDense((n, n), comm=self.comm)

    def place(self, kind: str, name: str) -> PETSc.Vec:
        """The row of a force or a sensor."""
        return PETSc.Vec().createWithArray(self.model.row(kind, name).copy(), comm=self.comm)

    def rest(self) -> list[np.ndarray]:
        """States of interfaces that never moved."""
        pairs = zip(self._kernels, self._values, strict=True)
        return [kernel.zero_state(*values.shape[:2]) for kernel, values in pairs]

    def step(self, u: PETSc.Vec, states) -> list[tuple]:
        """(strain, stress, new state, tangent) of every interface after a step to u."""
        # A solver asks for residual and Jacobian, and at last the step itself, at the same place.
        place, known = u.array_r, self._last
        if known is not None and known[0] is states and np.array_equal(known[1], place):
            return known[2]
        found = []
        for kernel, values, rows, state in zip(
            self._kernels, self._values, self._flat, states, strict=True
        ):
            strain = (rows @ place).reshape(-1, kernel.d)
            found.append((strain, *kernel.step(strain, state, values)))
        self._last = states, place.copy(), found
        return found

    def residual(self, u, v, a, load, states, out: PETSc.Vec) -> None:
        """M a + C v + K u + f(u, states) - load into ``out``; loads are arrays or None."""
        m = self.model
        r = m.M @ a.array_r + m.C @ v.array_r + m.K @ u.array_r
        for rows, (_, stress, _, _) in zip(self._loads, self.step(u, states), strict=True):
            r += rows @ stress.ravel()
        out.array[:] = r if load is None else r - load.array_r

    def jacobian(self, u, states, shift_v: float, shift_a: float, out: PETSc.Mat) -> None:
        """K + d f/d u + shift_v C + shift_a M into ``out``."""
        m = self.model
        J = m.K + shift_v * m.C + shift_a * m.M
        for rows, points, (_, _, _, tangent) in zip(
            self._loads, m.interfaces, self.step(u, states), strict=True
        ):
            moved = np.matmul(tangent, points.rows).reshape(-1, m.n_dofs)
            J += rows @ moved
        out.getDenseArray()[:] = J
        out.assemble()

    def energy(self, u, v) -> float:
        """Kinetic energy and that of K, J: what interfaces store is not in it."""
        m, x, y = self.model, u.array_r, v.array_r
        return float(0.5 * (y @ m.M @ y + x @ m.K @ x))

    def total(self, local: float) -> float:
        """Sum over ranks."""
        return local

    def weights(self) -> list[np.ndarray]:
        """Weights of every interface's points."""
        return [p.weights for p in self.model.interfaces]


class SparseMotion:
    """The motion of a full model, shared out over the ranks."""

    def __init__(self, model: FullModel):
        self.model, self.comm = model, model.M.comm
        self._kernels = [
            LawKernel.of(p.law, p.n_components - p.normal, p.normal) for p in model.interfaces
        ]
        self._values = [p.law.values(len(p.weights)) for p in model.interfaces]
        self._strain = [p.rows.createVecLeft() for p in model.interfaces]
        self._blocks = [
            point_blocks(p, np.ones((len(p.weights), p.n_components, p.n_components)))
            for p in model.interfaces
        ]
        self._work = model.M.createVecLeft()

    def vector(self) -> PETSc.Vec:
        """A vector of zeros."""
        return self.model.M.createVecLeft()

    def matrix(self) -> PETSc.Mat:
        """A matrix for `jacobian`, with room for the interfaces' tangents."""
        A = self.model.K.copy()
        A.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
        self._add(A, 1.0, self.model.M)
        if self.model.C is not None:
            self._add(A, 1.0, self.model.C)
        for p, block in zip(self.model.interfaces, self._blocks, strict=True):
            product = block.ptap(p.rows)
            self._add(A, 1.0, product)
            product.destroy()
        return A

    @staticmethod
    def _add(A: PETSc.Mat, factor: float, B: PETSc.Mat) -> None:
        A.axpy(factor, B, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)

    def place(self, kind: str, name: str) -> PETSc.Vec:
        """The row of a force or a sensor."""
        places = getattr(self.model, kind)
        if name not in places:
            known = ", ".join(places) or "none"
            raise InputError(f"{kind}: no {name!r}; expected one of: {known}.")
        return places[name]

    def rest(self) -> list[np.ndarray]:
        """States of interfaces that never moved, of this rank's points."""
        pairs = zip(self._kernels, self._values, strict=True)
        return [kernel.zero_state(*values.shape[:2]) for kernel, values in pairs]

    def step(self, u: PETSc.Vec, states) -> list[tuple]:
        """(strain, stress, new state, tangent) of this rank's points after a step to u."""
        found = []
        for p, kernel, values, work, state in zip(
            self.model.interfaces, self._kernels, self._values, self._strain, states, strict=True
        ):
            p.rows.mult(u, work)
            strain = work.array_r.reshape(-1, kernel.d).copy()
            found.append((strain, *kernel.step(strain, state, values)))
        return found

    def residual(self, u, v, a, load, states, out: PETSc.Vec) -> None:
        """M a + C v + K u + f(u, states) - load into ``out``. Collective."""
        m = self.model
        m.M.mult(a, out)
        m.K.multAdd(u, out, out)
        if m.C is not None:
            m.C.multAdd(v, out, out)
        for p, work, (_, stress, _, _) in zip(
            m.interfaces, self._strain, self.step(u, states), strict=True
        ):
            work.array[:] = (p.weights[:, None] * stress).ravel()
            p.rows.multTranspose(work, self._work)
            out.axpy(1.0, self._work)
        if load is not None:
            out.axpy(-1.0, load)

    def jacobian(self, u, states, shift_v: float, shift_a: float, out: PETSc.Mat) -> None:
        """K + d f/d u + shift_v C + shift_a M into ``out``. Collective."""
        m = self.model
        out.zeroEntries()
        subset = PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN
        out.axpy(1.0, m.K, structure=subset)
        out.axpy(shift_a, m.M, structure=subset)
        if m.C is not None:
            out.axpy(shift_v, m.C, structure=subset)
        for p, block, (_, _, _, tangent) in zip(
            m.interfaces, self._blocks, self.step(u, states), strict=True
        ):
            _fill(block, p.weights[:, None, None] * tangent)
            product = block.ptap(p.rows)
            out.axpy(1.0, product, structure=subset)
            product.destroy()
        out.assemble()

    def energy(self, u, v) -> float:
        """Kinetic energy and that of K, J: what interfaces store is not in it. Collective."""
        self.model.M.mult(v, self._work)
        kinetic = v.dot(self._work)
        self.model.K.mult(u, self._work)
        return 0.5 * float(kinetic + u.dot(self._work))

    def total(self, local: float) -> float:
        """Sum over ranks. Collective."""
        return self.comm.tompi4py().allreduce(local, op=MPI.SUM)

    def weights(self) -> list[np.ndarray]:
        """Weights of this rank's points, for every interface."""
        return [p.weights for p in self.model.interfaces]


def point_blocks(p: SparsePoints, blocks: np.ndarray) -> PETSc.Mat:
    """Matrix of one dense block, (d, d), for each of this rank's points, laid out as the rows."""
    sizes = p.rows.getSizes()[0]
    matrix = PETSc.Mat().createAIJ((sizes, sizes), nnz=(p.n_components, 0), comm=p.rows.comm)
    _fill(matrix, blocks)
    return matrix


def _fill(block: PETSc.Mat, tangents: np.ndarray) -> None:
    first, _ = block.getOwnershipRange()
    d = tangents.shape[1]
    for i, values in enumerate(tangents):
        at = np.arange(first + i * d, first + (i + 1) * d, dtype=PETSc.IntType)
        block.setValues(at, at, values)
    block.assemble()
