"""One model and material as matrices: what a solution, its state and its adjoint share."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from petsc4py import PETSc

from fenics_joints.errors import mapping
from fenics_joints.modal.options import given_options, petsc_defaults
from fenics_joints.preload.conditions import Pairs, Penalty
from fenics_joints.preload.hold import Hold, find_hold
from fenics_joints.preload.interface import Interface
from fenics_joints.preload.jumps import Jumps
from fenics_joints.preload.model import PreloadModel
from fenics_joints.preload.newton import NewtonPreconditioner, set_blocks

#: Of every factorisation.
FACTOR_OPTIONS = {
    "ksp_type": "preonly",
    "pc_factor_mat_solver_type": "mumps",
    "mat_mumps_icntl_14": "40",
}


class PreloadSystem:
    """The stiffness in x, what holds it, its pairs, and the Newton steps' factorisation.

    Args:
        model: The model.
        given: Values of the structure's parameters that differ from their nominal value.
        penalty: Stiffness per area, Pa/m, of contacts that give way; None for such as do not.
        petsc_options: Options of SNES, KSP and PC, without prefix.
        prefix: Options prefix.

    Attributes:
        K: The stiffness in x.
        hold: What holds the free bodies.
        fixed: Global numbers of owned entries held at zero: pins, supports, bubbles.
        pairs: The pairs that this rank owns.
        held: K with those entries held.
        newton: The Newton steps' factorisation, kept for the next solution; None before the first.
    """

    def __init__(
        self,
        model: PreloadModel,
        given: Mapping[str, float] | None,
        penalty: float | None,
        petsc_options: Mapping[str, object] | None,
        prefix: str,
    ):
        self.model = model
        self.given = mapping("given", given, "values by the names of parameters")
        self.petsc_options, self.prefix = given_options(petsc_options), prefix
        self.K = model.stiffness(self.given)
        self.hold: Hold = find_hold(model, self.K)
        self.fixed = self._fixed()
        self.pairs = _pairs(model, self.K, penalty)
        # Held entries: their row is x = 0. Their columns need not go, as x is zero there.
        self.held = self.K.copy()
        self.held.zeroRowsColumns(self.fixed.astype(np.int32), diag=_mean_diagonal(self.K))
        self._left: PETSc.Mat | None = None
        self.newton: NewtonPreconditioner | None = None

    def _fixed(self) -> np.ndarray:
        jumps = self.model.jumps
        numbers = [self.hold.pins, self.model.supported]
        numbers += [jumps.bubbles(c).ravel() for c in jumps.contacts]
        numbers = np.unique(np.concatenate(numbers))
        return numbers[jumps.owned(numbers)]

    def driven(self, forces: Mapping[str, float] | None = None) -> PETSc.Vec | None:
        """Displacements in x of what is moved, and zero elsewhere; None if nothing is."""
        given = self.model.moves(forces)
        if not any(np.any(value) for _, value in given):
            return None
        x = self.K.createVecRight()
        x.set(0.0)
        for numbers, value in given:
            self.model.jumps.put(x.array, numbers, value)
        return x

    def unit_load(self, name: str) -> PETSc.Vec:
        """Derivative of the load in x, with what is moved on its side, by a force or factor."""
        unit = self.model.unit_load(name).copy()
        driven = self.driven(dict.fromkeys(self.model.forces, 0.0) | {name: 1.0})
        if driven is not None:
            unit.axpy(-1.0, self.K * driven)
            driven.destroy()
        return unit

    def preconditioner(self) -> NewtonPreconditioner:
        """That of all solutions, made with the first."""
        if self.newton is None:
            prefix = self.prefix + "held_"
            given = {k[5:]: v for k, v in self.petsc_options.items() if k.startswith("held_")}
            options = {**FACTOR_OPTIONS, "pc_type": "cholesky", **given}
            self.newton = NewtonPreconditioner(self.held, prefix, options)
        return self.newton

    def combine(self, pairs: Pairs, A: np.ndarray, B: np.ndarray, out=None) -> PETSc.Mat:
        """The matrix A K + B, with blocks A and B, (n, gdim, gdim), at the pairs; A is 1 elsewhere.

        Args:
            pairs: The pairs.
            A: Blocks that combine the rows of K.
            B: Blocks that are added.
            out: The matrix of an earlier call, to assemble into.
        """
        rows = self.model.jumps.globals(pairs.numbers)
        if self._left is None:
            self._left = self._identity(rows.shape[1])
        set_blocks(self._left, rows, A, PETSc.InsertMode.INSERT_VALUES)
        out = self._left.matMult(self.held, result=out)
        set_blocks(out, rows, B, PETSc.InsertMode.ADD_VALUES)
        return out

    def factorised(self, J: PETSc.Mat, name: str, options: Mapping[str, object]) -> PETSc.KSP:
        """A solver that has factorised a matrix of `combine`; ``name`` ends its options' prefix."""
        ksp, prefix = PETSc.KSP().create(self.model.comm), f"{self.prefix}{name}_"
        ksp.setOptionsPrefix(prefix)
        ksp.setOperators(J)
        with petsc_defaults(prefix, {**FACTOR_OPTIONS, "pc_type": "lu", **options}):
            ksp.setFromOptions()
            ksp.setUp()
        return ksp

    def _identity(self, gdim: int) -> PETSc.Mat:
        """Identity with room for full blocks at the pairs."""
        left = PETSc.Mat().createAIJ(self.held.getSizes(), nnz=(gdim, 0), comm=self.held.comm)
        low, high = left.getOwnershipRange()
        for i in range(low, high):
            left.setValue(i, i, 1.0)
        return left

    def forget(self) -> None:
        """Free the factorisation; the next solution makes its own. Collective."""
        if self.newton is not None:
            self.newton.free()
        self.newton = None

    def destroy(self) -> None:
        """Free matrices and factorisations. Collective."""
        for owned in (self.K, self.held, self._left):
            if owned is not None:
                owned.destroy()
        self.forget()


def _pairs(model: PreloadModel, K: PETSc.Mat, penalty: float | None) -> Pairs:
    """The pairs that this rank owns."""
    jumps = model.jumps
    diagonal = K.getDiagonal()
    columns = {key: [] for key in ("numbers", "gap", "friction", "scale", "areas")}
    for contact, c in zip(model.contacts, jumps.contacts, strict=True):
        numbers = jumps.numbers(c)
        mine = jumps.owned(numbers[:, 0])
        columns["numbers"].append(jumps.local(numbers[mine]))
        columns["gap"].append(c.gap[mine])
        columns["friction"].append(np.full(mine.sum(), contact.friction))
        columns["scale"].append(_stiffness_at(jumps, diagonal, c)[mine])
        columns["areas"].append(c.areas[mine])
    arrays = {key: np.concatenate(parts) for key, parts in columns.items()}
    arrays["slip"] = np.zeros((len(arrays["gap"]), jumps.gdim - 1))
    return Pairs(**arrays) if penalty is None else Penalty(**arrays, stiffness=penalty)


def _stiffness_at(jumps: Jumps, diagonal: PETSc.Vec, c: Interface) -> np.ndarray:
    """Stiffness, N/m, (n,), of the two bodies at each pair in series, from K's diagonal in x.

    An entry of the lower body moves both bodies, a jump the upper one alone; without pairs of
    vertices that of the upper one has to do.
    """
    upper = jumps.gather(diagonal, jumps.entries(c.upper)).mean(axis=1)
    if c.coupling is not None or not len(c.lower):
        return upper
    both = jumps.gather(diagonal, jumps.entries(c.lower)).mean(axis=1)
    lower = both - upper
    return np.where(lower > 0, upper * lower / np.where(lower > 0, both, 1.0), upper)


def _mean_diagonal(K: PETSc.Mat) -> float:
    diagonal = K.getDiagonal()
    return diagonal.sum() / diagonal.getSize()
