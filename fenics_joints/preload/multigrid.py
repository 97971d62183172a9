"""Multigrid for bodies in contact: coarsened once, cut off where the contact holds them.

PETSc's smoothed aggregation (GAMG) coarsens the free bodies, each for itself, with the rigid
motions as near null space (Vaněk, Mandel and Brezina, Computing 56, 1996); elements of degree 2
first to degree 1. x = R u brings that to the unknowns of `fenics_joints.structure.jumps`. A Newton
step holds some entries of x: their rows of the finest prolongation are set to zero, so that every
coarse correction keeps the contact exactly, whatever pairs it closes, and the coarse matrices are
P^T A P (truncated multigrid: Gräser and Kornhuber, J. Comput. Math. 27, 2009). That of all but the
rows and columns at contacts is formed once, and theirs are added in each step.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import scipy.sparse
from petsc4py import PETSc

from fenics_joints.machine.memory import give_back
from fenics_joints.modal.multigrid import coarsening, prolongation, take_levels
from fenics_joints.preload.model import PreloadModel
from fenics_joints.preload.stiffness import Stiffness, put_rows
from fenics_joints.structure.jumps import Jumps, alone
from fenics_joints.structure.sparse import filtered
from fenics_joints.structure.structure import Structure

_PREFIX = "fenics_joints_coarsening_"
#: Of GAMG only the prolongations are used, so nothing is solved with the singular matrix.
_COARSENING = {
    "pc_type": "gamg",
    "pc_gamg_threshold": "0.02",
    "mg_levels_ksp_type": "richardson",
    "mg_coarse_pc_type": "none",
}
#: PETSc options of the cycle.
CYCLE = {
    "mg_levels_ksp_type": "richardson",
    "mg_levels_ksp_max_it": "1",
    "mg_levels_pc_type": "sor",
    "mg_coarse_pc_type": "redundant",
    "mg_coarse_redundant_pc_type": "cholesky",
}


class ContactMultigrid:
    """Prolongations of the free bodies, and the coarse matrices of the last Newton step.

    Args:
        model: The bodies and their contacts.
        K: Stiffness of the bodies in u. Its near null space is set.
        given: Values of the structure's parameters, those of K.
    """

    def __init__(self, model: PreloadModel, K: PETSc.Mat, given: Mapping[str, float] | None):
        structure = model.structure
        if structure.degree == 1:
            chain = _coarsenings(structure, K)
        else:
            coarse = structure.coarser()
            K = coarse.stiffness(given)
            chain = [*_coarsenings(coarse, K), prolongation(coarse, structure)]
            K.destroy()
        R = from_displacements(model.jumps)
        #: Prolongations from coarse to fine, of which the finest is that of the present step.
        self.prolongations = [*chain[:-1], alone(R.matMult(chain[-1]), R, chain[-1])]
        self._matrices: list[PETSc.Mat | None] = [None] * len(self.prolongations)
        self._rest = self._near = self._cut = self._change = None

    def _begin(self, K: Stiffness) -> None:
        """The coarse matrix with all held that ever may be, and rows of P that meet the rest."""
        P = self.prolongations[-1]
        near, first = np.diff(K.near.getValuesCSR()[0]) > 0, P.getOwnershipRange()[0]

        def meets(low: int, rows: scipy.sparse.csr_matrix) -> np.ndarray:
            return np.repeat(near[low - first :][: rows.shape[0]], np.diff(rows.indptr))

        self._near = filtered(P, meets)
        self._cut = self._near.copy()
        kept = K.kept(K.entries)
        P.diagonalScale(kept, None)
        kept.destroy()
        self._rest = alone(K.A.ptap(P))
        # With all of its diagonal, where ones may come.
        diagonal = self._rest.getDiagonal()
        self._rest.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
        self._rest.setDiagonal(diagonal)
        diagonal.destroy()
        self._matrices[-1] = self._rest.copy()

    def attach(self, pc: PETSc.PC, K: Stiffness, held: np.ndarray) -> None:
        """Make levels for the present state of a stiffness in x. Collective.

        Args:
            pc: The preconditioner, of PETSc's type ``mg``, before its options are read.
            K: The stiffness.
            held: Local numbers of entries of x that it holds.
        """
        if self._rest is None:
            self._begin(K)
        n = len(self.prolongations)
        if pc.getMGLevels() != n + 1:
            pc.setMGLevels(n + 1)
        same = PETSc.Mat.Structure.SAME_NONZERO_PATTERN
        kept = K.kept(held)
        self._near.copy(self._cut, structure=same)
        self._cut.diagonalScale(kept, None)
        kept.destroy()
        finest = self.prolongations[-1]
        put_rows(self._cut, finest)
        self._change = K.now.ptap(self._cut, result=self._change)
        A = self._matrices[-1]
        self._rest.copy(A, structure=same)
        A.axpy(1.0, self._change, structure=PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
        self._level(pc, n, K.A)
        for level in range(n - 1, 0, -1):
            _without_zero_rows(A)
            self._level(pc, level, A)
            P, known = self.prolongations[level - 1], self._matrices[level - 1]
            A = self._matrices[level - 1] = A.ptap(P, result=known)
        _without_zero_rows(A)
        coarsest = pc.getMGCoarseSolve()
        coarsest.setOperators(A)
        coarsest.destroy()

    def _level(self, pc: PETSc.PC, level: int, A: PETSc.Mat) -> None:
        smoother = pc.getMGSmoother(level)
        smoother.setOperators(A)
        smoother.destroy()
        pc.setMGInterpolation(level, self.prolongations[level - 1])

    def destroy(self) -> None:
        """Free everything. Collective."""
        own = self._rest, self._near, self._cut, self._change
        for owned in (*own, *self.prolongations, *self._matrices):
            if owned is not None:
                owned.destroy()


def _coarsenings(structure: Structure, K: PETSc.Mat) -> list[PETSc.Mat]:
    """Prolongations of a structure's stiffness, from coarse to fine."""
    K.setBlockSize(structure.gdim)
    ksp = coarsening(K, structure, _PREFIX, _COARSENING)
    found = take_levels(ksp)
    ksp.destroy()
    for _, A in found:
        A.destroy()
    give_back()
    return [P for P, _ in reversed(found)]


def from_displacements(jumps: Jumps) -> PETSc.Mat:
    """R with x = R u: jumps from the displacements of both sides, other governed entries zero.

    An inverse of T where no side of a contact is governed by another; near it otherwise.
    """
    low, high = jumps.range
    indptr, columns, _ = jumps.T.getValuesCSR()
    lone = np.flatnonzero(np.diff(indptr) == 1)
    same = lone[columns[indptr[lone]] == lone + low]
    rows, columns, frames = [same], [same + low], [np.ones(len(same))]
    turned = [frames[0]]
    for c in jumps.contacts:
        numbers = jumps.numbers(c)
        mine = jumps.owned(numbers[:, 0])
        at, F = numbers[mine], c.frames[mine]
        i, j = np.broadcast_arrays(at[:, :, None] - low, at[:, None, :])
        rows.append(i.ravel()), columns.append(j.ravel())
        frames.append(F.ravel()), turned.append(F.transpose(0, 2, 1).ravel())
    i, j = np.concatenate(rows), np.concatenate(columns)
    own, n = high - low, jumps.n_local
    every = np.arange(own)
    # u = E x + (T - B) R u where B has a governed entry's own frame: R = D (1 + B - T E).
    D = _sparse(jumps, n, own, i, j, np.concatenate(frames))
    E = _sparse(jumps, n, own, every, every + low, np.ones(own))
    left = _sparse(
        jumps,
        own,
        own,
        np.concatenate([every, i]),
        np.concatenate([every + low, j]),
        np.concatenate([np.ones(own), *turned]),
    )
    right = jumps.T.matMult(E)
    left.axpy(-1.0, right, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
    return alone(D.matMult(left), D, E, left, right)


def _sparse(jumps: Jumps, n_rows: int, n_columns: int, i, j, values) -> PETSc.Mat:
    """A matrix from this rank's rows, local, and global columns."""
    A = scipy.sparse.csr_matrix((values, (i, j)), shape=(n_rows, jumps.n))
    sizes = ((n_rows, None), (n_columns, None))
    csr = (A.indptr.astype(PETSc.IntType), A.indices.astype(PETSc.IntType), A.data)
    return PETSc.Mat().createAIJ(sizes, csr=csr, comm=jumps.comm)


def _without_zero_rows(A: PETSc.Mat) -> None:
    """Put a one, times a stiffness, where a coarse function is zero, as on a support."""
    diagonal = A.getDiagonal()
    zero = np.flatnonzero(diagonal.array_r <= np.finfo(float).eps * diagonal.max()[1])
    if A.comm.tompi4py().allreduce(len(zero)):
        diagonal.array[zero] = diagonal.max()[1]
        A.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
        A.setDiagonal(diagonal)
    diagonal.destroy()
