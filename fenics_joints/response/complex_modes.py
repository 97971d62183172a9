"""Complex modes of damped structures: Z(s) x = 0, with Z of `fenics_joints.structure.damping`.

By projection on real modes and residual vectors (`response.modal_basis`), whose error is found; the
basis is widened until that is small. Reduced models are solved densely.

Z is symmetric, so that left and right vector are one, and

    ds/dp = -x^T dZ/dp x / (x^T dZ/ds x).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from scipy.optimize import linear_sum_assignment

from fenics_joints.errors import ConvergenceError, InputError, flag, real, whole
from fenics_joints.modal.modes import Modes, solve_modes
from fenics_joints.response.modal_basis import (
    ModalPencil,
    extended,
    modal_pencil,
    reduced_pencil,
    with_terms,
)
from fenics_joints.response.pencil import DampedPencil, check_damped, check_damping
from fenics_joints.structure import Damped, Damping, Sensors
from fenics_joints.structure.sparse import product

#: Residual above which a solution of the dense solver is no mode of a reduced model: chosen.
_NO_MODE = 1e-2
#: How often the basis may be extended: chosen; a failure is an error.
_ROUNDS = 12


@dataclass(frozen=True, repr=False)
class ComplexModes:
    """Elastic modes that oscillate, of a damped structure, by ascending |s|.

    Attributes:
        structure: The model, full or reduced.
        given: The parameters that differed from their nominal values.
        eigenvalues: s, rad/s, with positive imaginary part, (n,).
        shapes: This rank's rows of the shapes x, complex, (n_local, n), with x^T dZ/ds x = 2 s,
            which makes undamped ones M-normalised; of a reduced model (n_dofs, n).
        residuals: |A^-1 Z(s) x| / |x| in the norm of energy, A = K - shift M, (n,): the
            change of the shapes by one more step. Of a reduced model |Z(s) x| / |K x| on its modes
            of energy 1.
        slopes: ds/dp for every parameter, (n, n_parameters); None unless they were asked for.
        shares: Which real modes each is made of: share of each real mode, rigid-body modes first,
            in the shape, in the norm of mass, (n_real, n).
        solver: SLEPc's solver of the real modes; None of a reduced model.
    """

    structure: Damped
    given: Mapping[str, float]
    eigenvalues: np.ndarray
    shapes: np.ndarray
    residuals: np.ndarray
    slopes: np.ndarray | None
    shares: np.ndarray
    solver: object | None

    def __len__(self) -> int:
        return len(self.eigenvalues)

    def __repr__(self) -> str:
        return (
            f"ComplexModes({len(self)}, to {self.frequencies_hz[-1]:.5g} Hz, damping ratios to "
            f"{self.damping_ratios.max():.3g})"
        )

    @property
    def frequencies_hz(self) -> np.ndarray:
        """|s| / 2 pi, Hz, (n,): that of the undamped mode where damping is proportional."""
        return np.abs(self.eigenvalues) / (2 * np.pi)

    @property
    def damping_ratios(self) -> np.ndarray:
        """-Re s / |s|, (n,); half the loss factor, where that is small."""
        return -self.eigenvalues.real / np.abs(self.eigenvalues)

    def at(self, sensors: Sensors) -> np.ndarray:
        """Shapes at sensors, kg^-1/2, complex, (n_sensors, n). Collective."""
        if self.structure.is_dense:
            return self.structure.observe(self.shapes, sensors)
        return self.structure.comm.allreduce(self.structure.loads(sensors).T @ self.shapes)

    def gradients(self) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of `frequencies_hz` and of `damping_ratios`, each (n, n_parameters).

        Raises:
            InputError: If the modes were found without derivatives.
        """
        if self.slopes is None:
            raise InputError("gradients: expected modes that were found with gradients = True.")
        s, size = self.eigenvalues[:, None], np.abs(self.eigenvalues)[:, None]
        by_size = np.real(np.conj(s) * self.slopes) / size
        ratio = -self.slopes.real / size + s.real * by_size / size**2
        return by_size / (2 * np.pi), ratio


def solve_complex_modes(
    structure: Damped,
    given: Mapping[str, float] | None = None,
    *,
    damping: Damping,
    n_modes: int = 20,
    gradients: bool = False,
    modes: Modes | None = None,
    tolerance: float = 1e-5,
) -> ComplexModes:
    """Lowest complex modes of a damped structure. Collective.

    Args:
        structure: A structure; or a reduced one or beams, solved densely, for which modes and
            tolerance do not matter.
        given: Values of parameters that differ from their nominal value.
        damping: The damping.
        n_modes: Number of modes, rigid-body modes, which are left out of the result, included.
        gradients: Whether derivatives by the parameters are wanted.
        modes: Real modes of the structure at the same values, as for `solve_frf`.
        tolerance: `residuals` above which they are added to the basis. An eigenvalue's
            relative error is of the order of its square.

    Raises:
        InputError: If a value is out of range or unknown.
        ConvergenceError: If modes were not found.
    """
    check_damped(structure)
    damping = check_damping(damping)
    n_modes = whole("n_modes", n_modes)
    flag("gradients", gradients)
    real("tolerance", tolerance, above=0)
    pencil, solver = DampedPencil(structure, given, damping), None
    try:
        if structure.is_dense:
            whole("n_modes", n_modes, most=structure.n_dofs)
            modal = reduced_pencil(pencil, given)
            s, y, residuals = _reduced(modal, n_modes - modal.modes.n_rigid)
        else:
            if modes is None:
                modes = solve_modes(structure, given, n_modes=n_modes)
            lines = modes.frequencies_hz[modes.n_rigid :]
            lines, solver = lines if len(lines) else np.ones(1), modes.solver.solver
            modal = modal_pencil(pencil, None, lines, modes=modes)
            modal, s, y, residuals = _improved(pencil, modal, tolerance)
        slopes = _slopes(with_terms(modal, pencil), s, y) if gradients else None
    finally:
        pencil.destroy()
    x, shares = modal.basis @ y, _shares(modal, y)
    return ComplexModes(structure, dict(given or {}), s, x, residuals, slopes, shares, solver)


def damping_ratios(
    model: Damped,
    given: Mapping[str, float] | None,
    damping: Damping,
    modes: Modes,
    index: Sequence[int],
    *,
    gradients: bool = False,
) -> tuple[np.ndarray, np.ndarray | None]:
    """Damping ratios of some modes with the model's damping, Jalali et al. 2019, eq. 9. Collective.

    Damping changes the order of the modes, so that each real mode is given the complex one that has
    most of it; no two the same.

    Args:
        model: The model.
        given: Values of parameters that differ from their nominal value.
        damping: The damping.
        modes: The undamped modes at these values, of a `Structure` with a solver that has solved
            nothing else since; as many complex ones are found.
        index: Which of them, m.
        gradients: Whether derivatives are wanted.

    Returns:
        Ratios, (m,), and their derivatives by all of the model's parameters, (m, n_parameters).

    Raises:
        InputError: If a value is out of range.
        ConvergenceError: If modes were not found, or too many are overdamped.
    """
    found = solve_complex_modes(
        model, given, damping=damping, n_modes=len(modes), gradients=gradients, modes=modes
    )
    own = linear_sum_assignment(-found.shares[np.asarray(index)])[1]
    return found.damping_ratios[own], found.gradients()[1][own] if gradients else None


def _reduced(modal: ModalPencil, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """s, vectors on the basis and residuals of a reduced model, exact on its basis."""
    s, y = _projected(modal, count)
    off = np.einsum("nij,jn->in", modal.stiffness(s), y)
    energy = np.sqrt(np.maximum(modal.stiff, 1e-300))[:, None]
    residuals = np.linalg.norm(off / np.maximum(energy, energy.max() * 1e-8), axis=0)
    residuals = residuals / np.linalg.norm(energy * y, axis=0)
    if residuals.max() > _NO_MODE:
        raise ConvergenceError(
            f"{int(np.sum(residuals <= _NO_MODE))} of {len(s)} elastic modes were found: the "
            "others are overdamped by orders of magnitude",
            f"the largest residual is {residuals.max():.1e}",
        )
    return s, y, residuals


def _shares(modal: ModalPencil, y: np.ndarray) -> np.ndarray:
    size = np.abs(y[: len(modal.modes)]) ** 2
    return size / np.sum(size, axis=0)


def _projected(modal: ModalPencil, count: int | None = None) -> tuple[np.ndarray, np.ndarray]:
    """s, (n,), and vectors on the basis, (m, n), of ``count`` modes; by default all elastic ones.

    Rigid-body modes are uncoupled from all others.
    """
    rigid = modal.modes.n_rigid
    count = len(modal.modes) - rigid if count is None else count
    if count < 1:
        raise InputError(
            f"n_modes = {rigid + count}: expected more than the {rigid} rigid-body modes that are "
            "among them"
        )
    s, x = (_coupled if modal.parts else _uncoupled)(modal)
    waves = np.flatnonzero(s.imag > 1e-9 * np.abs(s))
    order = waves[np.argsort(np.abs(s[waves]))][:count]
    if len(order) < count:
        raise ConvergenceError(
            f"{len(order)} of {count} elastic modes oscillate: the others are overdamped."
        )
    s, y = s[order], np.vstack([np.zeros((rigid, count)), x[:, order]])
    for i in range(count):
        y[:, i] *= np.sqrt(2 * s[i] / (y[:, i] @ modal.stiffness_slope(s[i]) @ y[:, i]))
    return s, y


def _uncoupled(modal: ModalPencil) -> tuple[np.ndarray, np.ndarray]:
    """s and vectors of the elastic modes where real modes are not coupled: a quadratic for each."""
    damping, elastic = modal.pencil.damping, slice(modal.modes.n_rigid, None)
    stiff, heavy = modal.stiff[elastic], modal.heavy[elastic]
    massive = heavy > 0
    stiff, heavy = stiff[massive], heavy[massive]
    half = (
        0.5
        * (
            damping.stiffness_slope() * stiff
            + damping.mass_slope(0.0) * heavy
            + modal.modal_damping[elastic][massive]
        )
        / heavy
    )
    root = np.sqrt(half**2 - damping.stiffness_factor(0.0) * stiff / heavy + 0j)
    root = np.where(root.imag < 0, -root, root)
    return root - half, np.eye(len(massive), dtype=complex)[:, massive]


def _coupled(modal: ModalPencil) -> tuple[np.ndarray, np.ndarray]:
    """s and vectors beside the rigid-body modes, by a state matrix.

    K + s C + s^2 M has a stiffness that can be inverted, and with z = 1/s it does not matter that
    some of it has no mass.
    """
    rigid = modal.modes.n_rigid
    K = modal.stiffness(np.zeros(1))[0][rigid:, rigid:]
    C = modal.stiffness_slope(0.0)[rigid:, rigid:]
    M = np.diag(modal.heavy[rigid:])
    n, alpha = len(K), modal.pencil.damping.rayleigh[0]
    if not np.any(C - alpha * M):
        # K x = lambda M x with s^2 + alpha s + lambda = 0: no state space.
        z, vectors = scipy.linalg.eig(np.linalg.solve(K, M))
        good = np.abs(z) > 1e-12 * np.abs(z).max()
        root = np.sqrt(0.25 * alpha**2 - 1 / z[good] + 0j)
        return np.where(root.imag < 0, -root, root) - 0.5 * alpha, vectors[:, good]
    # (z^2 K + z C + M) x = 0, with z in units of the first mode's.
    unit = 1 / np.sqrt(modal.eigenvalues[rigid])
    state = np.zeros((2 * n, 2 * n), dtype=complex)
    state[:n, n:] = np.eye(n)
    state[n:, :n] = -np.linalg.solve(K, M) / unit**2
    state[n:, n:] = -np.linalg.solve(K, C) / unit
    z, vectors = scipy.linalg.eig(state)
    good = np.abs(z) > 1e-12
    return 1 / (z[good] * unit), vectors[:n, good]


def _improved(pencil: DampedPencil, modal: ModalPencil, tolerance: float):
    """The modes on a basis that is widened by their residuals (Davidson's method).

    Returns:
        The structure on that basis, s, the vectors on the basis and their residuals.
    """
    for _ in range(_ROUNDS):
        s, y = _projected(modal)
        residuals, change = _residuals(pencil, modal, s, y)
        late = residuals > tolerance
        if not late.any():
            return modal, s, y, residuals
        modal = extended(modal, pencil, np.hstack([change[:, late].real, change[:, late].imag]))
    raise ConvergenceError(
        f"{int(np.sum(~late))} of {len(s)} complex modes converged: "
        f"the largest residual is {residuals.max():.1e}",
        "rounds exhausted: ask for fewer modes, or allow a larger tolerance",
    )


def _residuals(pencil: DampedPencil, modal: ModalPencil, s, y) -> tuple[np.ndarray, np.ndarray]:
    """Relative residuals, (n,), and this rank's rows of A^-1 Z x over |x|, (n_local, n)."""
    shapes, inverse = modal.basis @ y, modal.modes.solver.inverse
    off = np.column_stack([pencil.apply(x, shapes[:, i : i + 1])[:, 0] for i, x in enumerate(s)])
    if modal.pencil.named.is_modal:
        heavy = product(pencil.M, modal.basis)
        off += heavy @ (modal.modal_damping[:, None] * s * y)
    change = inverse(np.ascontiguousarray(off.real)) + 1j * inverse(np.ascontiguousarray(off.imag))
    # |A^-1 r|_A^2 = r^H A^-1 r
    top = pencil.comm.allreduce(np.real(np.sum(off.conj() * change, axis=0)))
    shift = modal.modes.solver.shift
    below = np.sum(np.abs(y) ** 2 * (modal.stiff - shift * modal.heavy)[:, None], axis=0)
    return np.sqrt(np.maximum(top, 0.0) / below), change / np.sqrt(below)


def _slopes(modal: ModalPencil, s: np.ndarray, y: np.ndarray) -> np.ndarray:
    found = np.zeros((len(s), len(modal.pencil.structure.parameters)), dtype=complex)
    for term in modal.all_terms():
        changes = np.sum(y * (term.form @ y), axis=0)
        found[:, term.parameter] -= np.array([term.factor(x) for x in s]) * changes / (2 * s)
    return found
