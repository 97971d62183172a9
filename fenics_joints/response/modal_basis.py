"""A damped structure on its modes and residual vectors.

The basis is the lowest modes, rigid-body modes among them, and residual vectors: the responses
A^-1 b to the forces and sensors of interest, and A^-1 M A^-1 b, with A = K - sigma M and the shift
sigma below zero of the modal solution, so that a free body needs no other hold. Likewise A^-1 K_c
of the modes and of those, for the layers c with damping of their own, which makes complex modes of
a damped joint accurate where real modes alone are not. They are made orthogonal to the modes. Each
then has its own stiffness and mass (Rayleigh and Ritz), so that the residual varies over the band.

A model of plain arrays is taken on all of its modes, which are found at once: exact on its basis.
There K and M are diagonal, and so is the dynamic stiffness unless a layer has damping of its own;
then a small dense system is solved at each line, many lines in one call of LAPACK.

Derivatives are those of the FRF at a fixed basis, the adjoint's own approximation by it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from petsc4py import PETSc

from fenics_joints.errors import InputError, reals
from fenics_joints.modal.modes import SHIFT_SHARE, Modes, count_rigid, inverted_modes, solve_modes
from fenics_joints.response.pencil import DampedPencil, Term, linear
from fenics_joints.structure.sparse import as_columns, product, project

#: Modes must reach this multiple of the highest line.
_REACH = 1.5
#: Residual vectors that modes and others leave less than this share of their energy are none.
_DEPENDENT = 1e-8
#: Eigenvalues of a layer below this share of its largest are none; layers of damping whose rank is
#: this many times smaller than the basis are a correction of the diagonal, but not where a mode's
#: own share of it is less than that of its terms.
_RANK, _FEW, _SINGULAR = 1e-13, 4, 1e-6
#: Vectors of a model of plain arrays with less than this share of the largest mass over energy have
#: none.
_MASSLESS = 1e-15
#: Lines that are solved at once.
_CHUNK = 256


@dataclass(frozen=True, repr=False)
class Response:
    """Receptances, (n_f, n_sensors, n_excitations); derivatives, (..., n_parameters), or None."""

    values: np.ndarray
    gradients: np.ndarray | None = None


@dataclass(frozen=True, repr=False)
class ModalPencil:
    """K = diag(stiff), M = diag(heavy) and the damping on a basis.

    Attributes:
        modes: The modes.
        basis: This rank's rows of the basis, (n_local, m): the modes, of mass 1, then residual
            vectors of energy 1, which may have no mass at all (those of a massless layer).
        stiff: (m,); exactly zero for rigid-body modes.
        heavy: (m,).
        parts: Stiffness of the damped layers, (m, m), by name.
        pencil: The structure and its damping; its matrices may be gone.
        terms: dZ/dp, their forms as matrices; None unless asked for.
    """

    modes: Modes
    basis: np.ndarray
    stiff: np.ndarray
    heavy: np.ndarray
    parts: Mapping[str, np.ndarray]
    pencil: DampedPencil
    terms: Sequence[Term] | None = None

    def __repr__(self) -> str:
        return f"ModalPencil({len(self.modes)} modes among {len(self.stiff)} vectors)"

    def project(self, columns: np.ndarray) -> np.ndarray:
        """Loads on the basis, (m, k), of this rank's rows (n_local, k). Collective."""
        return self.pencil.comm.allreduce(self.basis.T @ columns)

    # -- matrices ------------------------------------------------------------------------------

    @property
    def eigenvalues(self) -> np.ndarray:
        """(rad/s)^2, of every vector of the basis, (m,); very large for one without mass."""
        return self.stiff / np.maximum(self.heavy, 1e-30)

    @property
    def modal_damping(self) -> np.ndarray:
        """2 zeta omega of every vector of the basis, 1/s, (m,); 0 for residual vectors."""
        return 2 * self.ratios * np.sqrt(self.eigenvalues)

    @property
    def ratios(self) -> np.ndarray:
        """Modal damping ratio of every vector of the basis, (m,)."""
        ratios = np.array([self.pencil.damping.ratios[i] for i in self._ratio_numbers])
        return ratios * self._elastic

    @property
    def _ratio_numbers(self) -> np.ndarray:
        """Which of the damping's ratios every vector of the basis has, (m,)."""
        number = np.arange(len(self.stiff)) - self.modes.n_rigid
        return np.clip(number, 0, len(self.pencil.damping.ratios) - 1)

    @property
    def _elastic(self) -> np.ndarray:
        number = np.arange(len(self.stiff))
        return (number >= self.modes.n_rigid) & (number < len(self.modes))

    def stiffness(self, s: np.ndarray) -> np.ndarray:
        """Z(s), complex, (len(s), m, m)."""
        s = np.asarray(s, dtype=complex)
        Z = self._diagonal(s)[:, :, None] * np.eye(len(self.stiff))
        base = self.pencil.damping.stiffness_factor(s)
        for name, K in self.parts.items():
            Z += (self.pencil.damping.stiffness_factor(s, name) - base)[:, None, None] * K
        return Z

    def _diagonal(self, s: np.ndarray) -> np.ndarray:
        """Z(s) without the layers' own damping, (len(s), m)."""
        whole = np.outer(self.pencil.damping.stiffness_factor(s), self.stiff)
        whole += np.outer(self.pencil.damping.mass_factor(s), self.heavy)
        if self.pencil.damping.is_modal:
            whole += np.outer(s, self.modal_damping)
        return whole

    def solve(self, s: np.ndarray, rights: np.ndarray) -> np.ndarray:
        """Z(s)^-1 of the columns of (m, k), (len(s), m, k)."""
        diagonal = self._diagonal(s)
        if not self.parts:
            return rights / diagonal[:, :, None]
        found = np.empty((len(s), *rights.shape), dtype=complex)
        size = np.abs(self.stiff) + np.abs(s[:, None]) ** 2 * self.heavy
        few = np.all(np.abs(diagonal) > _SINGULAR * size, axis=1) & (self._thin is not None)
        if few.any():
            found[few] = self._corrected(s[few], diagonal[few], rights)
        if not few.all():
            many = np.broadcast_to(rights, (np.sum(~few), *rights.shape))
            found[~few] = np.linalg.solve(self.stiffness(s[~few]), many)
        return found

    @cached_property
    def _thin(self) -> tuple[np.ndarray, tuple[str, ...]] | None:
        """U with U U^T = K of the damped layers, side by side, and the layer of each column.

        None where they have not few columns.
        """
        columns, names = [], []
        for name, K in self.parts.items():
            values, vectors = np.linalg.eigh(K)
            some = values > _RANK * values[-1]
            columns.append(vectors[:, some] * np.sqrt(values[some]))
            names += [name] * int(some.sum())
        return (np.hstack(columns), tuple(names)) if _FEW * len(names) <= len(K) else None

    def _corrected(self, s: np.ndarray, diagonal: np.ndarray, rights: np.ndarray) -> np.ndarray:
        """Z(s)^-1 of columns by Woodbury's formula: the layers' damping is of low rank."""
        U, names = self._thin
        base = self.pencil.damping.stiffness_factor(s)
        factors = {n: self.pencil.damping.stiffness_factor(s, n) - base for n in self.parts}
        f = np.stack([factors[n] for n in names], axis=1)[:, :, None]
        x, y = rights / diagonal[:, :, None], U / diagonal[:, :, None]
        small = np.eye(len(names)) + f * (U.T @ y)
        return x - y @ np.linalg.solve(small, f * (U.T @ x))

    def stiffness_slope(self, s: complex) -> np.ndarray:
        """dZ/ds, complex, (m, m)."""
        damping = self.pencil.damping
        base = damping.stiffness_slope()
        diagonal = base * self.stiff + damping.mass_slope(s) * self.heavy + self.modal_damping
        own = {n: damping.stiffness_slope(n) - base for n in self.parts}
        return np.diag(diagonal) + sum(own[n] * K for n, K in self.parts.items())

    # -- response ------------------------------------------------------------------------------

    def response(self, lines, loads, reads, gradients: bool = False) -> Response:
        """Receptances at lines, Hz, for loads (m, k) and sensors (m, l) on the basis."""
        terms, values, slopes = self.all_terms() if gradients else [], [], []
        for i in range(0, len(lines), _CHUNK):
            s = 2j * np.pi * lines[i : i + _CHUNK]
            x = self.solve(s, np.hstack([loads, reads]) if gradients else loads)
            u, psi = x[..., : loads.shape[1]], x[..., loads.shape[1] :]
            values.append(reads.T @ u)
            if gradients:
                slopes.append(self._slopes(s, psi, u, terms))
        return Response(np.concatenate(values), np.concatenate(slopes) if gradients else None)

    def _slopes(self, s: np.ndarray, psi, u, terms) -> np.ndarray:
        """-psi^T dZ/dp u, (len(s), l, k, n_parameters), of blocks (len(s), m, l) and (.., m, k)."""
        n, m, k = u.shape
        slopes = np.zeros(
            (n, psi.shape[2], k, len(self.pencil.structure.parameters)), dtype=complex
        )
        if not terms:
            return slopes
        # The real forms of all terms times real and imaginary part of u: one real product.
        columns = u.transpose(0, 2, 1)
        columns = np.concatenate([columns.real, columns.imag]).reshape(-1, m)
        images = columns @ np.hstack([t.form.T for t in terms])
        real, imag = images.reshape(2, n, k * len(terms), m)
        turned = psi.transpose(0, 2, 1) @ (real + 1j * imag).transpose(0, 2, 1)
        turned = turned.reshape(n, -1, k, len(terms))
        for i, term in enumerate(terms):
            factor = np.broadcast_to(term.factor(s), s.shape)
            slopes[..., term.parameter] -= factor[:, None, None] * turned[..., i]
        return slopes

    # -- derivatives ---------------------------------------------------------------------------

    def all_terms(self) -> list[Term]:
        """`terms`, and those of modal damping.

        Raises:
            InputError: If the pencil was made without derivatives.
        """
        if self.terms is None:
            raise InputError(
                "gradients: expected a modal pencil that was made with gradients = True."
            )
        return [*self.terms, *self._modal_terms()]

    def _modal_terms(self):
        """Change of C = M f(M^-1 K) with f = 2 zeta sqrt(lambda) of every mode.

        dC = dM f + f[.,.] o (dK - dM lambda) in the modes, f[.,.] the divided differences of f
        (Daleckii and Krein's formula): no difference of eigenvalues stands alone in a denominator,
        so that modes of equal frequency and ratio do no harm.
        """
        if not self.pencil.named.is_modal:
            return
        parameters = list(self.pencil.structure.parameters)
        for i, ratio in enumerate(self.pencil.named.ratios):
            if isinstance(ratio, str):
                own = 2 * np.sqrt(self.eigenvalues) * (self._ratio_numbers == i) * self._elastic
                yield Term(parameters.index(ratio), "D", linear, np.diag(own))
        n, lam, f = len(self.eigenvalues), self.eigenvalues, self.modal_damping
        slope = np.where(lam > 0, self.ratios / np.sqrt(np.where(lam > 0, lam, 1.0)), 0.0)
        gap = lam[:, None] - lam[None, :]
        near = np.abs(gap) <= 1e-9 * (lam[:, None] + lam[None, :])
        divided = np.where(
            near,
            0.5 * (slope[:, None] + slope[None, :]),
            (f[:, None] - f[None, :]) / np.where(near, 1.0, gap),
        )
        for p in {t.parameter for t in self.terms}:
            dK, dM = (
                sum(
                    (t.form for t in self.terms if t.parameter == p and t.kind == kind),
                    np.zeros((n, n)),
                )
                for kind in "KM"
            )
            yield Term(p, "D", linear, dM * f + divided * (dK - dM * lam))


def check_lines(frequencies_hz) -> np.ndarray:
    """Frequencies, Hz, as an array, or an `InputError`."""
    lines = np.atleast_1d(reals("frequencies_hz", frequencies_hz, None, "Hz", above=0))
    if lines.ndim != 1 or not len(lines):
        raise InputError("frequencies_hz: expected at least one, all above 0 and finite, in Hz.")
    return lines


def modal_pencil(
    pencil: DampedPencil,
    loads: np.ndarray | None,
    lines: np.ndarray,
    *,
    modes: Modes | None = None,
    n_modes: int | None = None,
    gradients: bool = False,
) -> ModalPencil:
    """The structure on its modes and on the residual vectors of loads. Collective.

    Args:
        pencil: The matrices and the damping.
        loads: This rank's rows of forces and sensors, (n_local, k); None for none.
        lines: Frequencies of interest, Hz.
        modes: Its modes at the same values; by default they are found.
        n_modes: Their number; by default enough to reach beyond the lines.
        gradients: Whether derivatives are wanted.

    Raises:
        InputError: If the modes are not those of the pencil.
        ConvergenceError: If modes were not found.
    """
    modes = _modes_for(pencil, lines, n_modes) if modes is None else modes
    shapes = as_columns(modes.shapes)
    if modes.solver is None or modes.model is not pencil.structure:
        raise InputError("modes: expected those of this structure, with their solver.")
    check_modes(pencil.M, modes, shapes)
    s, loads = 2j * np.pi * np.median(lines), shapes[:, :0] if loads is None else loads
    modal = _on_basis(pencil, modes, _residual_vectors(pencil, modes, shapes, loads, s))
    return with_terms(modal, pencil) if gradients else modal


def extended(modal: ModalPencil, pencil: DampedPencil, columns: np.ndarray) -> ModalPencil:
    """The structure on a basis with more vectors, this rank's rows (n_local, k). Collective."""
    count = len(modal.modes)
    shapes, rest = modal.basis[:, :count], modal.basis[:, count:]
    more = np.hstack([rest, _beside(pencil, modal.modes, shapes, columns)])
    return _on_basis(pencil, modal.modes, _orthonormal(pencil, modal.modes, more))


def with_terms(modal: ModalPencil, pencil: DampedPencil) -> ModalPencil:
    """The same with derivatives by the parameters. Collective."""
    return replace(modal, terms=list(pencil.terms(modal.basis)))


def _on_basis(pencil: DampedPencil, modes: Modes, rest: np.ndarray) -> ModalPencil:
    """The structure on modes and residual vectors that are orthonormal in A and beside them."""
    shapes = as_columns(modes.shapes)
    basis, stiff, heavy = _ritz(pencil, modes, shapes, rest)
    parts = {name: project(A, basis) for name, A in pencil.parts.items()}
    return ModalPencil(modes, basis, stiff, heavy, parts, pencil)


def reduced_pencil(pencil: DampedPencil, given, *, gradients: bool = False) -> ModalPencil:
    """A model of plain arrays on all of its modes, with its damping.

    Those with mass are M-normalised; those without, of massless layers, have energy 1.

    Args:
        pencil: The matrices and the damping; modal ratios, too.
        given: Values of parameters that differ from their nominal value.
        gradients: Whether derivatives by the parameters are wanted.

    Returns:
        The modes; their ``basis`` is in the coordinates of the model.

    Raises:
        InputError: If a region is graded and derivatives are wanted.
        ConvergenceError: If the matrices are singular.
    """
    model = pencil.structure
    shift_hz = SHIFT_SHARE * model.dilation_frequency(given)
    shift = (2 * np.pi * shift_hz) ** 2
    inverse, vectors = inverted_modes(pencil.K, pencil.M, shift)
    massive = inverse > _MASSLESS * inverse[0]
    scale = np.where(massive, inverse, 1.0)
    stiff, basis = np.where(massive, 1 / scale - shift, 1.0), vectors / np.sqrt(scale)
    n_rigid = count_rigid(stiff[massive], shift_hz)  # a massless one has energy 1, near 0 too
    stiff[:n_rigid] = 0.0
    modes = Modes(model, dict(given or {}), stiff[massive], basis[:, massive], n_rigid)
    parts = {name: project(A, basis) for name, A in pencil.parts.items()}
    modal = ModalPencil(modes, basis, stiff, massive.astype(float), parts, pencil)
    return with_terms(modal, pencil) if gradients else modal


def _modes_for(pencil: DampedPencil, lines, n_modes: int | None) -> Modes:
    """Modes: ``n_modes``, or as many as reach beyond the lines."""
    count = n_modes or 16
    while True:
        modes = solve_modes(pencil.structure, pencil.values, n_modes=count)
        enough = modes.frequencies_hz[-1] >= _REACH * lines.max()
        if n_modes is not None or enough or 2 * count > pencil.structure.n_dofs:
            return modes
        modes.solver.destroy()
        count *= 2


def check_modes(M: PETSc.Mat, modes: Modes, shapes: np.ndarray) -> None:
    """Refuse modes of other values, or whose solver has since solved something else."""
    last, lam = shapes[:, -1:], modes.eigenvalues[-1]
    off = last - modes.solver.inverse((lam - modes.solver.shift) * product(M, last))
    own = np.diag(project(M, np.hstack([off, last])))
    if not (own[0] <= 1e-6 and abs(own[1] - 1) <= 1e-6):
        raise InputError(
            "modes: expected those of the structure at the same values of its parameters, from a "
            "solver that has solved nothing else since."
        )


def _layer_forces(pencil: DampedPencil, s: complex, X: np.ndarray) -> np.ndarray:
    """Forces of the layers' own damping at s in displacements, this rank's rows, (n_local, k)."""
    if not pencil.parts or not X.shape[1]:
        return X[:, :0]
    base = pencil.damping.stiffness_factor(s)
    own = {n: abs(pencil.damping.stiffness_factor(s, n) - base) for n in pencil.parts}
    return sum(own[n] * product(A, X) for n, A in pencil.parts.items())


def _residual_vectors(pencil: DampedPencil, modes: Modes, shapes, loads, s: complex) -> np.ndarray:
    """Residual vectors, orthonormal in A = K - shift M; this rank's rows, (n_local, k).

    First A^-1 b and A^-1 K_c phi, then A^-1 M and A^-1 K_c of those: by Neumann's series, what
    Z(s)^-1 b has beside the modes to second order in (w / w_next)^2 and in the loss factors.
    """
    first = _responses(pencil, modes, shapes, loads)
    elastic = shapes[:, modes.n_rigid :]
    layer = _responses(pencil, modes, shapes, _layer_forces(pencil, s, elastic))
    level = np.hstack([first, layer])
    forces = np.hstack([product(pencil.M, first), _layer_forces(pencil, s, level)])
    rest = np.hstack([level, _responses(pencil, modes, shapes, forces)])
    return _orthonormal(pencil, modes, rest)


def _orthonormal(pencil: DampedPencil, modes: Modes, rest: np.ndarray) -> np.ndarray:
    """Orthonormal in A, without the dependent ones."""
    values, vectors = np.linalg.eigh(_energy(pencil, modes, rest))
    keep = values > _DEPENDENT
    return rest @ (vectors[:, keep] / np.sqrt(values[keep]))


def _responses(pencil: DampedPencil, modes: Modes, shapes, forces) -> np.ndarray:
    """A^-1 f without the modes' share, each of energy 1; without those that are nothing else."""
    size = np.sqrt(pencil.comm.allreduce(np.sum(forces**2, axis=0)))
    forces = forces[:, size > 0] / size[size > 0]
    if not forces.shape[1]:
        return forces
    return _beside(pencil, modes, shapes, modes.solver.inverse(forces))


def _beside(pencil: DampedPencil, modes: Modes, shapes, whole: np.ndarray) -> np.ndarray:
    """Vectors without the modes' share, each of energy 1; without those that are nothing else."""
    rest, heavy = whole, product(pencil.M, shapes)
    for _ in range(2):
        rest = rest - shapes @ pencil.comm.allreduce(heavy.T @ rest)
    before, after = (np.diag(_energy(pencil, modes, X)) for X in (whole, rest))
    kept = after > _DEPENDENT * before
    return rest[:, kept] / np.sqrt(after[kept])


def _energy(pencil: DampedPencil, modes: Modes, X: np.ndarray) -> np.ndarray:
    """X^T A X, equal on all ranks."""
    return project(pencil.K, X) - modes.solver.shift * project(pencil.M, X)


def _ritz(pencil: DampedPencil, modes: Modes, shapes, rest) -> tuple[np.ndarray, ...]:
    """The modes, and the residual vectors made into modes of energy 1; their stiffness and mass."""
    lam = modes.eigenvalues.copy()
    lam[: modes.n_rigid] = 0.0
    # In A = K - shift M they are orthonormal already.
    mass, vectors = np.linalg.eigh(project(pencil.M, rest))
    mass, vectors = np.maximum(mass, 0.0)[::-1], vectors[:, ::-1]
    basis = np.hstack([shapes, rest @ vectors])
    stiff = np.concatenate([lam, 1 + modes.solver.shift * mass])
    return basis, stiff, np.concatenate([np.ones(len(lam)), mass])
