"""Full finite-element models with nonlinear interfaces, whose points are shared over the ranks."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from petsc4py import PETSc

from fenics_joints.errors import ConvergenceError
from fenics_joints.interfaces.motion import LawPoints, Motion, named, named_points
from fenics_joints.interfaces.rigid import FreeMotions, no_motions
from fenics_joints.modal.eigensolver import EigenSolver
from fenics_joints.modal.options import reason_of

#: Modes that are asked of the eigensolver.
_MODES = 12
_SUBSET = PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN


@dataclass(frozen=True, repr=False)
class SparsePoints(LawPoints):
    """`LawPoints` of this rank, whose rows are a matrix, (P d, n), point by point.

    Attributes:
        n_components: Components of strain, d.
    """

    n_components: int = field(kw_only=True)


@dataclass(frozen=True, repr=False)
class FullModel:
    """A full finite-element model with nonlinear interfaces.

    Attributes:
        M: Mass, kg.
        K: Stiffness without the interfaces' stress, N/m.
        interfaces: The nonlinear interfaces.
        C: Viscous damping, N s/m; None for none.
        forces: Load per unit force at the places of forces, by name.
        sensors: Rows of displacement at sensors, by name, as vectors.
        free: Rigid motions that nothing resists; None for none.
    """

    M: PETSc.Mat
    K: PETSc.Mat
    interfaces: Sequence[SparsePoints] = ()
    C: PETSc.Mat | None = None
    forces: Mapping[str, PETSc.Vec] = field(default_factory=dict)
    sensors: Mapping[str, PETSc.Vec] = field(default_factory=dict)
    free: FreeMotions | None = None

    def __repr__(self) -> str:
        n = self.M.getSize()[0]
        return f"FullModel({n} DOFs, {named_points(self.interfaces)})"

    def motion(self) -> SparseMotion:
        """The equation of motion."""
        return SparseMotion(self)


class SparseMotion(Motion):
    """The motion of a full model, shared out over the ranks."""

    options: ClassVar[Mapping[str, object]] = {"pc_factor_mat_solver_type": "mumps"}

    def __init__(self, model: FullModel):
        super().__init__(model.interfaces, model.M.comm)
        self.model = model
        self._strains = [p.rows.createVecLeft() for p in model.interfaces]
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

    def free(self) -> FreeMotions:
        """Rigid motions that nothing resists."""
        n_local = self.model.M.getLocalSize()[0]
        return self.model.free or no_motions(n_local, self.comm.tompi4py())

    def place(self, kind: str, name: str) -> PETSc.Vec:
        """The row of a force or a sensor."""
        return named(getattr(self.model, kind), kind, name)

    def _strain(self, i: int, u: PETSc.Vec) -> np.ndarray:
        self.interfaces[i].rows.mult(u, self._strains[i])
        return self._strains[i].array_r.copy()

    def residual(self, u, v, a, load, states, out: PETSc.Vec) -> None:
        """M a + C v + K u + f(u, states) - load into ``out``. Collective."""
        m = self.model
        m.M.mult(a, out)
        m.K.multAdd(u, out, out)
        if m.C is not None:
            m.C.multAdd(v, out, out)
        for p, work, (_, stress, _, _) in zip(
            m.interfaces, self._strains, self.step(u, states, v), strict=True
        ):
            work.array[:] = (p.weights[:, None] * stress).ravel()
            p.rows.multTranspose(work, self._work)
            out.axpy(1.0, self._work)
        out.axpy(-1.0, load)

    def jacobian(self, u, states, shift_v: float, shift_a: float, out: PETSc.Mat, v=None) -> None:
        """K + d f/d u + shift_v C + shift_a M into ``out``, at the velocity v. Collective."""
        m = self.model
        out.zeroEntries()
        out.axpy(1.0, m.K, structure=_SUBSET)
        out.axpy(shift_a, m.M, structure=_SUBSET)
        if m.C is not None:
            out.axpy(shift_v, m.C, structure=_SUBSET)
        for p, block, (_, _, _, tangent) in zip(
            m.interfaces, self._blocks, self.step(u, states, v, shift_v), strict=True
        ):
            _fill(block, p.weights[:, None, None] * tangent)
            product = block.ptap(p.rows)
            out.axpy(1.0, product, structure=_SUBSET)
            product.destroy()
        out.assemble()

    def energy(self, u, v) -> float:
        """Kinetic energy and that of K, J: what interfaces store is not in it. Collective."""
        self.model.M.mult(v, self._work)
        kinetic = v.dot(self._work)
        self.model.K.mult(u, self._work)
        return 0.5 * float(kinetic + u.dot(self._work))

    def inertia(self, a: PETSc.Vec) -> PETSc.Vec:
        """See `Motion.inertia`."""
        found = self.vector()
        self.model.M.mult(a, found)
        return found

    def elastic_modes(self, K: PETSc.Mat) -> tuple[np.ndarray, Callable[[int], PETSc.Vec]]:
        """See `Motion.elastic_modes`."""
        found, n = EigenSolver(_MODES).solve(K, self.model.M), len(self.free())
        return found.values[n:], lambda i: found.shapes[n + i]

    def drag(self, v: PETSc.Vec) -> PETSc.Vec:
        found = self.vector()
        if self.model.C is not None:
            self.model.C.mult(v, found)
        return found

    def acceleration(self, force: PETSc.Vec, u: PETSc.Vec, states, step: float) -> PETSc.Vec:
        """See `Motion.acceleration`.

        Degrees of freedom without mass, as in a layer, have no acceleration of their own; as much
        stiffness as a step of a thousandth of the first would bring ties them to the others.
        """
        a, A, share = self.vector(), self.matrix(), (1e-3 * step) ** 2
        self.jacobian(u, states, 0.0, 1.0, A)
        A.scale(share)
        A.axpy(1 - share, self.model.M, _SUBSET)
        ksp = PETSc.KSP().create(comm=self.comm)
        ksp.setOperators(A)
        ksp.setType("preonly")
        ksp.getPC().setType("lu")
        ksp.getPC().setFactorSolverType("mumps")
        ksp.solve(force, a)
        if ksp.getConvergedReason() < 0:
            raise ConvergenceError("the acceleration at the start was not found", reason_of(ksp))
        ksp.destroy(), A.destroy()
        return a


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
