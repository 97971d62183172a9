"""Multigrid for ``A = K - shift M`` of a structure, on eight columns at once.

Degree 2 to degree 1, then PETSc's GAMG. On meshes with thin cells and soft layers smoothed
aggregation straight on elements of degree 2 converges slowly. The elements of degree 1 on the same
mesh span a subspace with a quarter of the DOFs, and are assembled anew. GAMG makes the levels below
of it, with the rigid-body motions as the near null space (Vaněk, Mandel and Brezina, Computing 56,
1996). The cycle over its levels is our own, as PETSc's takes one column after the other.

A thin layer that is stiffer than a part bends at little energy, which degree 1 cannot, and holds
its nodes together, which Gauss-Seidel takes one by one. What its stiffness has beyond the part's
therefore resists strains in its plane alone with degree 1. And on the nodes of such joints, a
sheet, A is factorised, and solved before and after the coarse level.

The large level smooths with K alone. A differs from it by what the shift gives the rigid motions,
and these are the matter of the coarse levels.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import ufl
from dolfinx import fem, la
from dolfinx.fem import petsc as fem_petsc
from mpi4py import MPI
from petsc4py import PETSc

from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.meshes.tagged import limits
from fenics_joints.modal.blocks import WIDTH, Rows, SymmetricBlocks
from fenics_joints.modal.options import petsc_defaults
from fenics_joints.modal.rigid import rigid_motions
from fenics_joints.structure.components import Parameter, Region
from fenics_joints.structure.laws import Law
from fenics_joints.structure.points import node_positions
from fenics_joints.structure.sparse import dense_block, row_pieces, vectors_like, without_zeros
from fenics_joints.structure.structure import Structure

_PREFIX = "fenics_joints_iterative_"
_GAMG = {
    "pc_type": "gamg",
    # Aggregates must not reach across a soft layer, nor skip a distance.
    "pc_gamg_threshold": "0.02",
    "pc_gamg_aggressive_coarsening": "0",
}
#: Lowest eigenvalue, of 1, that the smoother is to damp: as PETSc's Chebyshev iteration.
_SMOOTHED = 0.1
#: Steps of Gauss-Seidel before and after the coarse level, on the structure's own level and below.
_STEPS = 2, 1
#: Steps of conjugate gradients on degree 1, which has a tenth of the entries of degree 2.
_COARSE_STEPS = 4


class Multigrid:
    """The preconditioner.

    Args:
        structure: The structure.
        petsc_options: PETSc options without prefix of what solves for degree 1, such as
            ``pc_type``; on the command line they have the prefix ``fenics_joints_iterative_``.

    Attributes:
        solver: PETSc's KSP for degree 1; its operator is A there.
    """

    def __init__(self, structure: Structure, petsc_options: Mapping[str, object]):
        self.structure, self.options = structure, {**_GAMG, **petsc_options}
        self.coarse = structure
        if structure.degree > 1:
            self.coarse = structure.coarser(*_softer_across(structure))
        self.solver: PETSc.KSP | None = None
        self._matrix: PETSc.Mat | None = None
        self._prolongation: Rows | None = None
        self._levels: list[tuple[SymmetricBlocks, Rows]] = []
        self._last: np.ndarray | None = None
        self._joints: StiffJoints | None = None

    def set_up(
        self,
        K: SymmetricBlocks,
        given: Mapping[str, float] | None,
        shift: float,
        joints: StiffJoints | None = None,
    ) -> None:
        """Make the hierarchy for a stiffness, and for the parameters it was assembled with.

        Args:
            K: Stiffness.
            given: Values of parameters that differ from their nominal value.
            shift: The shift.
            joints: Joints stiffer than parts, which are the hierarchy's from now on.

        Raises:
            ConvergenceError: PETSc could not.
        """
        self._forget()
        self._joints = joints
        if self.coarse is not self.structure:
            given = {**(given or {}), **_in_plane(self.structure)}
        self._matrix = self.coarse.stiffness(given)
        M = self.coarse.mass(given)
        self._matrix.axpy(-shift, M, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        M.destroy()
        self._matrix.setOption(PETSc.Mat.Option.SPD, True)
        try:
            self.solver = coarsening(self._matrix, self.coarse, _PREFIX, self.options)
        except PETSc.Error as error:
            raise ConvergenceError("the multigrid of K - shift M failed", str(error)) from error
        if self.coarse is not self.structure:
            if self._prolongation is None:
                whole = prolongation(self.coarse, self.structure)
                self._prolongation = Rows.of(whole)
                whole.destroy()
            self._levels = [(K, self._prolongation)]
        self._take_levels(K)

    def _take_levels(self, K: SymmetricBlocks) -> None:
        """GAMG's levels in blocks, and the inverse on the last one."""
        self._last, first = None, self._matrix
        if self.solver.getPC().getType() != PETSc.PC.Type.GAMG:
            return
        levels = take_levels(self.solver)
        self._matrix = None
        for A, (P, _) in zip([first, *(A for _, A in levels)], levels, strict=False):
            own = SymmetricBlocks(A, A.getBlockSize()) if self._levels else K
            self._levels.append((own, Rows.of(P)))
            A.destroy(), P.destroy()
        A = levels[-1][1] if levels else first
        own = [rows.toarray() for _, rows in row_pieces(A, A.getSize()[0])]
        whole = np.concatenate(A.comm.tompi4py().allgather(np.concatenate(own)))
        low, high = A.getOwnershipRange()
        self._last = np.linalg.pinv(whole, rcond=1e-12, hermitian=True)[low:high]
        A.destroy()

    def __call__(self, B: np.ndarray) -> np.ndarray:
        """One cycle for right-hand sides B, (n_local, 8). Collective."""
        return self._cycle(0, B)

    def _cycle(self, level: int, B: np.ndarray) -> np.ndarray:
        if level == len(self._levels):
            return self._solve_last(B)
        A, P = self._levels[level]
        X, R = _smooth(A, B, _STEPS[min(level, 1)])
        if level == 0 and self._joints is not None:
            self._joints.correct(A, X, R)
        R = P.transposed(R)
        if level == 0 and P is self._prolongation and len(self._levels) > 1:
            E = conjugate_gradients(self._levels[1][0], self._below, R, _COARSE_STEPS)
        else:
            E = self._cycle(level + 1, R)
        E = P @ E
        X += E
        R = B - A @ X
        del E
        if level == 0 and self._joints is not None:
            self._joints.correct(A, X, R)
        Z, _ = _smooth(A, R, _STEPS[min(level, 1)])
        X += Z
        return X

    def _below(self, B: np.ndarray) -> np.ndarray:
        return self._cycle(1, B)

    def _solve_last(self, B: np.ndarray) -> np.ndarray:
        if self._last is not None:
            comm = self.structure.comm
            return self._last @ np.concatenate(comm.allgather(B))
        x, b = self._matrix.createVecs()
        out = np.empty_like(B)
        for j in range(B.shape[1]):
            b.array[:] = B[:, j]
            self.solver.getPC().apply(b, x)
            out[:, j] = x.array_r
        return out

    def _forget(self) -> None:
        for level, (A, P) in enumerate(self._levels):
            if level:
                A.destroy()
            if P is not self._prolongation:
                P.destroy()
        for owned in (self.solver, self._matrix):
            if owned is not None:
                owned.destroy()
        if self._joints is not None:
            self._joints.destroy()
        self._levels, self.solver, self._matrix, self._joints = [], None, None, None

    def destroy(self) -> None:
        """Free everything. Collective."""
        self._forget()
        if self._prolongation is not None:
            self._prolongation.destroy()
            self._prolongation = None


class StiffJoints:
    """A on the nodes of joints that are stiffer than a part, all other nodes at rest. Collective.

    Args:
        rows: Which of this rank's DOFs these are, (n_local,).
        K: Stiffness; not kept.
        M_own: Mass of these DOFs, see `own`; not kept.
        shift: The shift.
    """

    def __init__(self, rows: np.ndarray, K: PETSc.Mat, M_own: PETSc.Mat, shift: float):
        self._rows = np.flatnonzero(rows)
        A = self.own(rows, K)
        A.axpy(-shift, M_own, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        A.setOption(PETSc.Mat.Option.SPD, True)
        self._ksp = PETSc.KSP().create(A.comm)
        self._ksp.setType(PETSc.KSP.Type.PREONLY)
        self._ksp.setOperators(A)
        self._ksp.getPC().setType(PETSc.PC.Type.CHOLESKY)
        self._ksp.getPC().setFactorSolverType("mumps")
        self._ksp.setUp()
        self._right, self._left = (dense_block(A, WIDTH) for _ in range(2))
        A.destroy()

    @staticmethod
    def own(rows: np.ndarray, A: PETSc.Mat) -> PETSc.Mat:
        """The rows and columns of these DOFs of a matrix."""
        numbers = np.flatnonzero(rows) + A.getOwnershipRange()[0]
        chosen = PETSc.IS().createGeneral(numbers.astype(PETSc.IntType), comm=A.comm)
        found = A.createSubMatrix(chosen, chosen)
        chosen.destroy()
        return found

    @staticmethod
    def rows(structure: Structure) -> np.ndarray:
        """Which of this rank's DOFs they are with the properties of now, (n_local,)."""
        share = _in_plane(structure)
        marked = fem.Function(structure.V)
        blocks = marked.x.array.reshape(-1, structure.gdim)
        for region, cells in structure.field.regions:
            if share.get(_name(region), 0.0) > 0.0:
                blocks[structure.V.dofmap.list[cells]] = 1.0
        marked.x.scatter_reverse(la.InsertMode.add)
        return marked.x.array[: structure.n_local] > 0.0

    def correct(self, A: SymmetricBlocks, X: np.ndarray, R: np.ndarray) -> None:
        """Solve for the residuals R of X there, and change both, in place."""
        self._right.getDenseArray()[:] = R[self._rows]
        self._ksp.matSolve(self._right, self._left)
        D = np.zeros_like(X)
        D[self._rows] = self._left.getDenseArray()
        X += D
        R -= A @ D

    def destroy(self) -> None:
        """Free it."""
        for owned in (self._right, self._left, self._ksp):
            owned.destroy()


def _name(region: Region) -> str:
    """Of the parameter of degree 1: the share of a joint's stiffness for strains in its plane."""
    return f"{region.name}.in_plane"


def _in_plane(structure: Structure) -> dict[str, float]:
    """These shares with the properties of now: what is beyond the softest part's stiffness."""
    terms = [
        np.max(np.abs(region.law.stiffness_terms(structure.field.means(i))))
        for i, region in enumerate(structure.regions)
    ]
    pairs = list(zip(structure.regions, terms, strict=True))
    least = min((t for region, t in pairs if not region.is_joint), default=np.inf)
    return {_name(r): 1.0 - least / t if t > least else 0.0 for r, t in pairs if r.is_joint}


def _softer_across(structure: Structure) -> tuple[list[Region], list[Parameter]]:
    """Regions whose joints have shares of their stiffness for strains in the plane alone, and the
    parameters of these shares."""
    regions, shares = [], []
    for region in structure.regions:
        if region.is_joint:
            shares.append(Parameter(_name(region), 0.0, log=False))
            properties = {**region.properties, "in_plane": _name(region)}
            region = replace(region, law=_softened(region.law), properties=properties)
        regions.append(region)
    return regions, shares


def _softened(law: Law) -> Law:
    """A joint's law with the property ``in_plane``."""

    def stiffness(u, v, q, normal, dx) -> ufl.Form:
        whole = law.stiffness(u, v, q, normal, dx)
        P = ufl.Identity(len(normal)) - ufl.outer(normal, normal)
        flat = ufl.replace(whole, {ufl.grad(w): P * ufl.grad(w) * P for w in (u, v)})
        parts = (1 - q["in_plane"], whole), (q["in_plane"], flat)
        return sum(
            (ufl.Form([i.reconstruct(c * i.integrand()) for i in f.integrals()]) for c, f in parts),
            ufl.Form([]),
        )

    def terms(q) -> np.ndarray:
        share, own = np.asarray(q["in_plane"]), law.stiffness_terms(q)
        return np.concatenate([(1 - share) * own, share * own])

    return replace(
        law,
        properties=(*law.properties, "in_plane"),
        stiffness=stiffness,
        stiffness_terms=terms,
        samples=tuple({**q, "in_plane": share} for share in (0.0, 1.0) for q in law.samples),
        check=lambda name, q: law.check(name, {key: q[key] for key in law.properties}),
    )


def _smooth(A: SymmetricBlocks, B: np.ndarray, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Chebyshev iteration with Gauss-Seidel from zero: the solutions X, and B - A X.

    Residuals follow the recurrence of the solutions, as Gauss-Seidel gives its own.
    """
    middle, half = (1 + _SMOOTHED) / 2, (1 - _SMOOTHED) / 2
    X, S = A.gauss_seidel(B)
    X /= middle
    S /= middle
    R = S
    R += (1 - 1 / middle) * B
    rho = half / middle
    old = 0.0, B
    for step in range(1, steps):
        before, rho = rho, 1 / (2 * middle / half - rho)
        a, c = rho * before, 2 * rho / half
        Z, S = A.gauss_seidel(R)
        Z *= c
        Z += (1 + a) * X
        Z -= a * old[0]
        S *= c
        S += (1 + a - c) * R
        S -= a * old[1]
        old = (X, R) if step + 1 < steps else old
        X, R = Z, S
    return X, R


def conjugate_gradients(
    A: Callable, precondition: Callable, B: np.ndarray, steps: int, tol: float = 0.0
) -> np.ndarray:
    """``A^-1 B`` for several columns, each by itself. Collective.

    Args:
        A: Has ``@`` and ``comm``.
        precondition: Approximate inverse of A.
        B: This rank's rows, (n_local, k).
        steps: Most steps.
        tol: Residual, in the preconditioner's norm over B's, at which all columns are done.

    Raises:
        ConvergenceError: Above zero ``tol``, and not reached.
    """

    def dots(left, right):
        return A.comm.allreduce(np.einsum("ij,ij->j", left, right))

    X, R = np.zeros_like(B), B.copy()
    P, before, first = np.zeros_like(B), 1.0, None
    for _ in range(steps):
        Z = precondition(R)
        now = dots(R, Z)
        first = now if first is None else first
        if np.all(np.abs(now) <= tol**2 * np.abs(first)):
            return X
        P *= now / before
        P += Z
        before = np.where(now == 0.0, 1.0, now)
        AP = A @ P
        length = dots(P, AP)
        step = now / np.where(length == 0.0, 1.0, length)
        X += P * step
        AP *= step
        R -= AP
    if tol:
        raise ConvergenceError(f"conjugate gradients did not converge in {steps} steps")
    return X


def structure_motions(structure: Structure) -> np.ndarray:
    """Rigid-body motions, zero at held DOFs, shape (n_local, 3 or 6).

    Translations of 1 m, and rotations about the mesh's centre with 1 m at half its size.
    """
    low, high = limits(structure.tagged)
    owned = structure.n_local // structure.gdim
    x = node_positions(structure.V)[:owned] - (low + high) / 2
    R = rigid_motions(x / (np.max(high - low) / 2)).reshape(-1, structure.n_local).T
    R[structure.held_dofs[: structure.n_local]] = 0.0
    return R


def prolongation(coarse: Structure, fine: Structure) -> PETSc.Mat:
    """Interpolation from degree 1 to degree 2 of displacements, zero at held DOFs of both."""
    P = fem_petsc.interpolation_matrix(coarse.V, fine.V)
    P.assemble()
    if coarse.ties is not None:
        whole, P = P, P.matMult(coarse.ties.T)
        whole.destroy()
    left, right = P.createVecLeft(), P.createVecRight()
    left.array[:], right.array[:] = (
        ~structure.held_dofs[: structure.n_local] for structure in (fine, coarse)
    )
    P.diagonalScale(left, right)
    lean = without_zeros(P)
    P.destroy()
    return lean


def coarsening(
    A: PETSc.Mat, structure: Structure, prefix: str, options: Mapping[str, object]
) -> PETSc.KSP:
    """A solver whose preconditioner, GAMG by its options, has made its levels. Collective."""
    set_near_null_space(A, structure)
    ksp = PETSc.KSP().create(A.comm)
    ksp.setOptionsPrefix(prefix)
    ksp.setType(PETSc.KSP.Type.PREONLY)
    ksp.setOperators(A)
    with petsc_defaults(prefix, options):
        ksp.setFromOptions()
        ksp.setUp()
    return ksp


def take_levels(ksp: PETSc.KSP) -> list[tuple[PETSc.Mat, PETSc.Mat]]:
    """GAMG's levels, which the solver loses, from fine to coarse: a prolongation, the matrix below.

    They are the caller's to destroy. Collective.
    """
    pc, levels = ksp.getPC(), []
    for level in range(pc.getMGLevels() - 1, 0, -1):
        below = pc.getMGSmoother(level - 1)
        other, A = below.getOperators()
        levels.append((pc.getMGInterpolation(level), A))
        # What PETSc hands out is let go by hand: Python's collector cannot do it on several ranks.
        below.destroy(), other.destroy()
    ksp.reset()
    pc.destroy()
    return levels


def set_near_null_space(A: PETSc.Mat, structure: Structure) -> None:
    """Tell GAMG the rigid-body motions."""
    comm = structure.comm
    R = structure_motions(structure)
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
