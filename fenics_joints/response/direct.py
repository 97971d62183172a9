"""Direct solutions of Z(s) x = b, Z = A + i B complex symmetric, with real arithmetic.

As the real symmetric system

    [ A  -B ] [Re x]   [ Re b]
    [-B  -A ] [Im x] = [-Im b]

which is [[A, -B], [B, A]] with its second row negated, so that LDL^T serves where LU was needed:
half the memory and time. Real and imaginary part of a degree of freedom stand side by side. Where
nothing is damped B has no entries, and a structure damped in its joints alone is two copies of the
undamped one that are coupled there. The pattern is that of all s: one analysis serves all.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from fenics_joints.errors import ConvergenceError
from fenics_joints.modal.options import give_room, given_options, last_line, petsc_defaults
from fenics_joints.response.modal_basis import Response
from fenics_joints.response.pencil import DampedPencil, Term
from fenics_joints.structure.sparse import dense_block

_PREFIX = "fenics_joints_frf_"
_OPTIONS = {
    "ksp_type": "preonly",
    "pc_type": "cholesky",
    "pc_factor_mat_solver_type": "mumps",
    # Slack in MUMPS's work space, per cent: pivots of an indefinite matrix may be put off.
    "mat_mumps_icntl_14": "60",
}
#: Residual, relative to the right-hand side, above which a solution is none; the error of the
#: response is about as large. Of a free body near 0 Hz, which moves far, it is at least rounding,
#: eps |K| |x|: 1e-6 for plates of 0.7 kg at 3 Hz, 1e-4 at 0.3 Hz.
_ACCURACY = 1e-3


class DynamicStiffness:
    """Z(s) at one s after the other, factorised. Collective.

    Args:
        pencil: The matrices and the damping; modal ratios are left out.
        petsc_options: Options of KSP and PC, without prefix; ``{"pc_type": "lu"}`` for LU. On the
            command line they have the prefix ``fenics_joints_frf_``.
    """

    def __init__(self, pencil: DampedPencil, petsc_options: Mapping[str, object] | None = None):
        self.pencil = pencil
        self._align()
        self._lay_out()
        self._ksp = PETSc.KSP().create(pencil.comm)
        self._ksp.setOptionsPrefix(_PREFIX)
        self._options = {**_OPTIONS, **given_options(petsc_options)}

    @property
    def solver(self) -> PETSc.KSP:
        """PETSc's solver of the real system."""
        return self._ksp

    def destroy(self) -> None:
        """Free the matrix and its factorisation. Collective."""
        self._ksp.destroy(), self._matrix.destroy()

    def _align(self) -> None:
        """Values of K, M and the layers in one pattern."""
        pencil, both = self.pencil, PETSc.Mat.Structure.UNKNOWN_NONZERO_PATTERN
        pattern = pencil.K.copy()
        pattern.axpy(0.0, pencil.M, structure=both)
        self._rows, self._columns, _ = pattern.getValuesCSR()

        def values(A):
            pattern.zeroEntries()
            pattern.axpy(1.0, A, structure=PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
            return pattern.getValuesCSR()[2]

        self._stiff, self._heavy = values(pencil.K), values(pencil.M)
        self._layers = {name: values(A) for name, A in pencil.parts.items()}
        pattern.destroy()

    def _lay_out(self) -> None:
        """Pattern of the real matrix, and where the entries of Z go."""
        count = len(self._columns)
        damping = self.pencil.damping
        coupled = np.full(count, bool(damping.structural or damping.rayleigh[1]))
        if damping.rayleigh[0]:
            coupled |= self._heavy != 0.0
        for values in self._layers.values():
            coupled |= values != 0.0
        self._coupled = coupled
        comm = self.pencil.comm
        self._real = not comm.allreduce(bool(coupled.any()), op=MPI.LOR)
        n = self.pencil.K.getLocalSize()[0]
        if self._real:
            self._width, rows, columns = 1, self._rows, self._columns
        else:
            self._width = 2
            rows, columns = self._doubled(n, coupled)
        sizes = [(self._width * m, self._width * g) for m, g in self.pencil.K.getSizes()]
        self._csr = rows.astype(PETSc.IntType), columns.astype(PETSc.IntType)
        self._matrix = PETSc.Mat().createAIJ(
            sizes, csr=(*self._csr, np.zeros(len(columns))), comm=comm
        )
        self._matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self._matrix.setOption(PETSc.Mat.Option.SYMMETRY_ETERNAL, True)

    def _doubled(self, n: int, coupled: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rows and columns of the real matrix; keeps where A and B go in its values."""
        each = 1 + coupled
        before = np.concatenate([[0], np.cumsum(each)])
        start = before[self._rows]  # entries of one of two equal rows, up to each row
        length = np.diff(start)
        rows = np.concatenate([[0], np.cumsum(np.repeat(length, 2))])
        of = np.repeat(np.arange(n), np.diff(self._rows))
        even = before[:-1] - start[of] + rows[2 * of]
        odd = even + length[of]
        columns = np.empty(rows[-1], dtype=PETSc.IntType)
        # Even rows hold (A, -B), odd ones (-B, -A).
        self._at_A = even, odd + coupled
        self._at_B = (even + 1)[coupled], odd[coupled]
        columns[self._at_A[0]], columns[self._at_A[1]] = 2 * self._columns, 2 * self._columns + 1
        columns[self._at_B[0]] = 2 * self._columns[coupled] + 1
        columns[self._at_B[1]] = 2 * self._columns[coupled]
        return rows, columns

    def factorise(self, s: complex) -> None:
        """Put Z(s) in; the next solution factorises it. Collective.

        Raises:
            ConvergenceError: If it is singular.
        """
        damping = self.pencil.damping
        base = damping.stiffness_factor(s)
        Z = base * self._stiff + damping.mass_factor(s) * self._heavy
        for name, values in self._layers.items():
            Z += (damping.stiffness_factor(s, name) - base) * values
        values = Z.real
        if not self._real:
            values = np.empty(len(self._csr[1]))
            values[self._at_A[0]], values[self._at_A[1]] = Z.real, -Z.real
            values[self._at_B[0]] = values[self._at_B[1]] = -Z.imag[self._coupled]
        self._matrix.setValuesCSR(*self._csr, np.ascontiguousarray(values))
        self._matrix.assemble()
        self._s = s
        self._ksp.setOperators(self._matrix)
        with petsc_defaults(_PREFIX, self._options):
            self._ksp.setFromOptions()
            try:
                self._ksp.setUp()
                give_room(self._ksp)
            except PETSc.Error as error:
                raise self._error(last_line(error)) from error
        if self._ksp.getPC().getFailedReason():
            raise self._error(f"PC failure {self._ksp.getPC().getFailedReason()}")

    def solve(self, load: np.ndarray) -> np.ndarray:
        """x of Z x = b for all columns at once. Collective.

        Args:
            load: This rank's rows of real loads b, (n_local, k).

        Returns:
            This rank's rows of x, complex, (n_local, k).

        Raises:
            ConvergenceError: If the solution is no solution.
        """
        right, left = (dense_block(self._matrix, load.shape[1]) for _ in range(2))
        right.getDenseArray()[:] = 0.0
        right.getDenseArray()[:: self._width] = load
        self._ksp.matSolve(right, left)
        found = left.getDenseArray()
        x = found.astype(complex) if self._real else found[::2] + 1j * found[1::2]
        left.destroy(), right.destroy()
        self._check(x, load)
        return x

    def response(self, lines, loads, reads, gradients: bool = False) -> Response:
        """Receptances at lines, Hz, of this rank's rows of loads and sensors. Collective.

        By the adjoint: one more solution for each sensor, and none for one that stands where a
        force does, gives the derivatives by all parameters.
        """
        comm, n_loads = self.pencil.comm, loads.shape[1]
        terms = list(self.pencil.terms()) if gradients else []
        rights, where = _distinct(comm, np.hstack([loads, reads]) if gradients else loads)
        n = len(self.pencil.structure.parameters)
        values = np.empty((len(lines), reads.shape[1], n_loads), dtype=complex)
        slopes = np.zeros((*values.shape, n), dtype=complex) if gradients else None
        for i, f in enumerate(lines):
            s = 2j * np.pi * f
            self.factorise(s)
            x = self.solve(rights)[:, where]
            u, psi = x[:, :n_loads], x[:, n_loads:]
            values[i] = comm.allreduce(reads.T @ u)
            for term in terms:
                slopes[i, :, :, term.parameter] -= term.factor(s) * _bilinear(comm, term, psi, u)
        for term in terms:
            term.destroy()
        return Response(values, slopes)

    def _check(self, x: np.ndarray, load: np.ndarray) -> None:
        """A singular factorisation leaves infinities or nonsense, not an exception."""
        with np.errstate(invalid="ignore", over="ignore"):
            off = self.pencil.apply(self._s, x) - load
            squares = np.array([np.sum(np.abs(off) ** 2, axis=0), np.sum(load**2, axis=0)])
        squares = self.pencil.comm.allreduce(squares)
        if not np.all(squares[0] <= _ACCURACY**2 * np.maximum(squares[1], np.finfo(float).tiny)):
            raise self._error("the residual is too large")

    def _error(self, reason: str) -> ConvergenceError:
        return ConvergenceError(
            f"the dynamic stiffness at {self._s.imag / (2 * np.pi):g} Hz was not solved: it is "
            "singular or nearly so, as at a resonance without damping, or of a free body near 0 Hz "
            '(where method = "modal" with check = 0 serves).',
            reason,
        )


def _distinct(comm, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Columns without those that are there before, and where each is among them."""
    same = [[np.array_equal(x, y) for y in columns.T] for x in columns.T]
    first = np.argmax(comm.allreduce(np.array(same, dtype=int)) == comm.size, axis=1)
    kept, where = np.unique(first, return_inverse=True)
    return np.ascontiguousarray(columns[:, kept]), where


def _bilinear(comm, term: Term, Y: np.ndarray, X: np.ndarray) -> np.ndarray:
    """y^T A x of complex blocks, without conjugation."""
    real, imag = np.hsplit(term.form @ np.hstack([X.real, X.imag]), 2)
    return comm.allreduce(Y.T @ (real + 1j * imag))
