"""Multigrid for ``A = K - shift M`` of a structure: degree 2 to degree 1, then PETSc's GAMG.

On meshes with thin cells and soft layers, smoothed aggregation straight on elements of degree 2
converges slowly. The elements of degree 1 on the same mesh span a subspace with a quarter of the
DOFs, and are assembled anew, so the large matrix only smooths: symmetric Gauss-Seidel needs no
more of it than one triangle. GAMG works on the small one, with the rigid-body motions as the near
null space (Vaněk, Mandel and Brezina, Computing 56, 1996).
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations

import numpy as np
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from mpi4py import MPI
from petsc4py import PETSc

from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.meshes.tagged import limits
from fenics_joints.modal.options import given_options, petsc_defaults
from fenics_joints.structure.sparse import vectors_like, without_zeros
from fenics_joints.structure.structure import Structure

_GAMG = {
    # Aggregates must not reach across a soft layer, nor skip a distance.
    "pc_gamg_threshold": "0.02",
    "pc_gamg_aggressive_coarsening": "0",
}
#: Options of two levels of degree. Some steps of CG on the coarse level cost little: it has a
#: tenth of the entries.
_TWO_LEVELS = {
    "pc_type": "mg",
    "mg_levels_ksp_type": "chebyshev",
    "mg_levels_ksp_max_it": "2",
    "mg_levels_pc_type": "sor",
    "mg_coarse_ksp_type": "cg",
    "mg_coarse_ksp_max_it": "4",
    "mg_coarse_pc_type": "gamg",
    **{f"mg_coarse_{key}": value for key, value in _GAMG.items()},
}
_ONE_LEVEL = {"pc_type": "gamg", **_GAMG}


class Multigrid:
    """The preconditioner, as a PETSc KSP that applies it once.

    Args:
        structure: The structure.
        petsc_options: PETSc options without prefix, such as ``mg_coarse_pc_type``.
        prefix: Their prefix, so that the command line can set the same options.

    Attributes:
        solver: The KSP; its operator is A.
    """

    def __init__(
        self,
        structure: Structure,
        petsc_options: Mapping[str, object] | None = None,
        prefix: str = "fenics_joints_iterative_",
    ):
        self.structure, self.prefix = structure, prefix
        self.coarse = structure.coarser() if structure.degree > 1 else None
        ours = _ONE_LEVEL if self.coarse is None else _TWO_LEVELS
        self.options = {**ours, **given_options(petsc_options)}
        self.solver: PETSc.KSP | None = None
        self._prolongation = self._matrix = None

    def set_up(self, A: PETSc.Mat, given: Mapping[str, float] | None, shift: float) -> None:
        """Make the hierarchy for A, and for the parameters that it was assembled with.

        Raises:
            ConvergenceError: PETSc could not.
        """
        self._forget()
        self.solver = PETSc.KSP().create(A.comm)
        self.solver.setOptionsPrefix(self.prefix)
        self.solver.setType(PETSc.KSP.Type.PREONLY)
        self.solver.setOperators(A)
        pc = self.solver.getPC()
        try:
            with petsc_defaults(self.prefix, self.options):
                # The levels come before the other options, which are theirs.
                pc.setType(PETSc.Options(self.prefix).getString("pc_type"))
                if self.coarse is None:
                    _set_near_null_space(A, self.structure)
                elif pc.getType() == PETSc.PC.Type.MG:
                    self._two_levels(pc, A, given, shift)
                self.solver.setFromOptions()
                self.solver.setUp()
        except PETSc.Error as error:
            raise ConvergenceError("the multigrid of K - shift M failed", str(error)) from error

    def _two_levels(self, pc, A, given, shift) -> None:
        if self._prolongation is None:
            self._prolongation = _prolongation(self.coarse, self.structure)
        self._matrix = self.coarse.stiffness(given)
        M = self.coarse.mass(given)
        self._matrix.axpy(-shift, M, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        self._matrix.setOption(PETSc.Mat.Option.SPD, True)
        M.destroy()
        _set_near_null_space(self._matrix, self.coarse)
        pc.setMGLevels(2)
        pc.setMGInterpolation(1, self._prolongation)
        pc.getMGCoarseSolve().setOperators(self._matrix)
        pc.getMGSmoother(1).setOperators(A)

    @property
    def entries(self) -> int:
        """Entries of the matrices that the hierarchy adds to A, on all ranks; an estimate."""
        pc, levels = self.solver.getPC(), []
        if pc.getType() == PETSc.PC.Type.MG:
            levels += [self._prolongation, self._matrix]
            pc = pc.getMGCoarseSolve().getPC()
        if pc.getType() == PETSc.PC.Type.GAMG:
            for i in range(pc.getMGLevels() - 1):
                levels += [pc.getMGSmoother(i).getOperators()[0], pc.getMGInterpolation(i + 1)]
        return int(sum(A.getInfo()["nz_used"] for A in levels))

    def _forget(self) -> None:
        for owned in (self.solver, self._matrix):
            if owned is not None:
                owned.destroy()
        self.solver = self._matrix = None

    def destroy(self) -> None:
        """Free everything. Collective."""
        self._forget()
        if self._prolongation is not None:
            self._prolongation.destroy()
            self._prolongation = None


def rigid_motions(structure: Structure) -> np.ndarray:
    """Rigid-body motions, zero at held DOFs, shape (n_local, 3 or 6).

    Translations of 1 m, and rotations about the mesh's centre with 1 m at half its size.
    """
    gdim, (low, high) = structure.gdim, limits(structure.tagged)
    centre, half = (low + high) / 2, np.max(high - low) / 2
    still, axes = np.zeros((gdim, gdim)), np.eye(gdim)
    motions = [(axis, still) for axis in axes]
    for a, b in combinations(axes, 2):
        motions.append((still[0], (np.outer(b, a) - np.outer(a, b)) / half))
    held = structure.held_dofs[: structure.n_local]
    R, u = np.empty((len(held), len(motions))), fem.Function(structure.V)
    for column, (shift, turn) in enumerate(motions):
        u.interpolate(
            lambda x, shift=shift, turn=turn: shift[:, None] + turn @ (x[:gdim] - centre[:, None])
        )
        R[:, column] = np.where(held, 0.0, u.x.array[: len(held)])
    return R


def to_upper_half(A: PETSc.Mat) -> None:
    """Keep the upper triangle of a symmetric matrix alone, in PETSc's SBAIJ format.

    In blocks of 3 x 3 it would be smaller, but PETSc has no Gauss-Seidel there.
    """
    A.setBlockSize(1)
    A.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    A.convert(PETSc.Mat.Type.SBAIJ)  # in place


def _prolongation(coarse: Structure, fine: Structure) -> PETSc.Mat:
    """Interpolation from degree 1 to degree 2 of displacements, zero at held DOFs of both."""
    P = fem_petsc.interpolation_matrix(coarse.V, fine.V)
    P.assemble()
    left, right = P.createVecLeft(), P.createVecRight()
    left.array[:], right.array[:] = (
        ~structure.held_dofs[: structure.n_local] for structure in (fine, coarse)
    )
    P.diagonalScale(left, right)
    lean = without_zeros(P)
    P.destroy()
    return lean


def _set_near_null_space(A: PETSc.Mat, structure: Structure) -> None:
    """Tell GAMG the rigid-body motions."""
    comm = structure.comm
    R = rigid_motions(structure)
    squares = comm.allreduce(R.T @ R, op=MPI.SUM)
    s, Q = np.linalg.eigh(squares)
    if not len(s) or s[-1] <= 0.0:
        raise InputError("supports: expected ones that leave some DOF free.")
    good = s > 1e-12 * s[-1]
    R = R @ (Q[:, good] / np.sqrt(s[good]))
    vectors = vectors_like(A.createVecRight(), R.T)
    space = PETSc.NullSpace().create(vectors=vectors, comm=A.comm)
    A.setNearNullSpace(space)
    space.destroy()
    for vector in vectors:
        vector.destroy()
