"""Complex modes of damped structures: Z(s) x = 0, with Z of `fenics_joints.structure.damping`.

By projection on real modes and residual vectors (`response.modal_basis`), whose error is found;
or on the full model by SLEPc, linearised in the state space (s x, x), for viscous damping. Reduced
models are solved densely.

Z is symmetric, so that left and right vector are one, and

    ds/dp = -x^T dZ/dp x / (x^T dZ/ds x).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from petsc4py import PETSc
from slepc4py import SLEPc

from fenics_joints.errors import ConvergenceError, InputError, flag, member, real, whole
from fenics_joints.modal.modes import SHIFT_SHARE, Modes, solve_modes
from fenics_joints.modal.options import given_options, petsc_defaults
from fenics_joints.response.modal_basis import ModalPencil, extended, modal_pencil, with_terms
from fenics_joints.response.pencil import DampedPencil, check_damped, check_damping
from fenics_joints.response.reduced import reduced_pencil
from fenics_joints.structure import Damped, Damping, Sensors
from fenics_joints.structure.sparse import product

_OPTIONS = {
    "st_type": "sinvert",
    "st_ksp_type": "preonly",
    "st_pc_type": "cholesky",
    "st_pc_factor_mat_solver_type": "mumps",
}
#: Residual above which what the dense solver found is no mode, of a reduced model.
_NO_MODE = 1e-2
#: How often the basis may be widened.
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
        residuals: |A^-1 Z(s) x| / |x| in the norm of energy, A = K - shift M, (n,): what one more
            step would change of the shapes. In the state space SLEPc's relative residuals. Of a
            reduced model |Z(s) x| / |K x| on its modes of energy 1.
        slopes: ds/dp for every parameter, (n, n_parameters); None unless they were asked for.
        shares: Which real modes each is made of: share of each real mode, rigid-body modes first,
            in the shape, in the norm of mass, (n_real, n); None in the state space.
        solver: SLEPc's solver; None of a reduced model.
    """

    structure: Damped
    given: Mapping[str, float]
    eigenvalues: np.ndarray
    shapes: np.ndarray
    residuals: np.ndarray
    slopes: np.ndarray | None = None
    solver: object | None = None
    shares: np.ndarray | None = None

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
    method: str = "projection",
    gradients: bool = False,
    modes: Modes | None = None,
    tolerance: float = 1e-5,
    petsc_options: Mapping[str, object] | None = None,
) -> ComplexModes:
    """Lowest complex modes of a damped structure. Collective.

    Args:
        structure: A structure; or a reduced one or beams, solved densely, for which
            the method, modes and tolerance do not matter.
        given: Values of parameters that differ from their nominal value.
        damping: The damping.
        n_modes: Number of modes, rigid-body modes, which are left out of the result, included.
        method: ``"projection"`` on real modes and residual vectors; or ``"state-space"``, the full
            model by SLEPc's PEP, for Rayleigh and viscous damping only; overdamped motion takes the
            place of modes there.
        gradients: Whether derivatives by the parameters are wanted; by projection only.
        modes: By projection: real modes of the structure at the same values, as for `solve_frf`.
        tolerance: By projection: `residuals` above which the basis is widened by what they lack.
            An eigenvalue's relative error is of the order of its square.
        petsc_options: Options of SLEPc's PEP, without prefix.

    Raises:
        InputError: If a value is out of range or unknown.
        ConvergenceError: If modes were not found.
    """
    member("method", method, ("projection", "state-space"))
    check_damped(structure)
    damping = check_damping(damping)
    n_modes = whole("n_modes", n_modes)
    flag("gradients", gradients)
    real("tolerance", tolerance, above=0)
    if structure.is_dense:
        return _reduced(structure, given, damping, n_modes, gradients)
    pencil = DampedPencil(structure, given, damping)
    try:
        if method == "state-space":
            _check_viscous(pencil.damping, gradients)
            return _state_space(pencil, given, n_modes, petsc_options)
        if modes is None:
            modes = solve_modes(structure, given, n_modes=n_modes)
        lines = modes.frequencies_hz[modes.n_rigid :]
        lines = lines if len(lines) else np.ones(1)
        modal = modal_pencil(pencil, None, lines, modes=modes)
        modal, s, y, residuals = _improved(pencil, modal, tolerance)
        slopes = _slopes(with_terms(modal, pencil), s, y) if gradients else None
    finally:
        pencil.destroy()
    return ComplexModes(
        structure,
        dict(given or {}),
        s,
        modal.basis @ y,
        residuals,
        slopes,
        modes.solver.solver,
        _shares(modal, y),
    )


def _reduced(model, given, damping: Damping, n_modes: int, gradients: bool) -> ComplexModes:
    """Complex modes of a reduced model, exact on its basis."""
    if not 1 <= n_modes <= model.n_dofs:
        raise InputError(f"n_modes = {n_modes}: expected 1 to {model.n_dofs}, the basis' size.")
    modal = reduced_pencil(model, given, damping, gradients=gradients)
    s, y = _projected(modal, n_modes - modal.modes.n_rigid)
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
    slopes = _slopes(modal, s, y) if gradients else None
    return ComplexModes(
        model, dict(given or {}), s, modal.basis @ y, residuals, slopes, shares=_shares(modal, y)
    )


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
    damping, elastic = modal.damping, slice(modal.modes.n_rigid, None)
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
    n, alpha = len(K), modal.damping.rayleigh[0]
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
    if modal.named.is_modal:
        heavy = product(pencil.M, modal.basis)
        off += heavy @ (modal.modal_damping[:, None] * s * y)
    change = inverse(np.ascontiguousarray(off.real)) + 1j * inverse(np.ascontiguousarray(off.imag))
    # |A^-1 r|_A^2 = r^H A^-1 r
    top = pencil.comm.allreduce(np.real(np.sum(off.conj() * change, axis=0)))
    shift = modal.modes.solver.shift
    below = np.sum(np.abs(y) ** 2 * (modal.stiff - shift * modal.heavy)[:, None], axis=0)
    return np.sqrt(np.maximum(top, 0.0) / below), change / np.sqrt(below)


def _slopes(modal: ModalPencil, s: np.ndarray, y: np.ndarray) -> np.ndarray:
    found = np.zeros((len(s), len(modal.parameters)), dtype=complex)
    for term in modal.all_terms():
        changes = np.sum(y * (term.form @ y), axis=0)
        found[:, term.parameter] -= np.array([term.factor(x) for x in s]) * changes / (2 * s)
    return found


# -- the full model in the state space ---------------------------------------------------------


def _check_viscous(damping: Damping, gradients: bool) -> None:
    hysteretic = damping.structural or any(damping.hysteretic.values())
    if hysteretic or damping.is_modal or gradients:
        raise InputError(
            'method = "state-space": expected Rayleigh and viscous damping only, and no gradients; '
            'method = "projection" takes all.'
        )


def _state_space(pencil: DampedPencil, given, n_modes: int, petsc_options) -> ComplexModes:
    """The pairs nearest to a positive real number, where K + sigma C + sigma^2 M is definite."""
    structure = pencil.structure
    K, M, C = pencil.K, pencil.M, pencil.viscous()
    sigma = 2 * np.pi * SHIFT_SHARE * structure.dilation_frequency(given)
    pep, prefix = SLEPc.PEP().create(structure.comm), "fenics_joints_complex_"
    pep.setOptionsPrefix(prefix)
    pep.setOperators([K, C, M])
    # Krylov-Schur on the companion form. After many restarts SLEPc's default, TOAR, reports modes
    # as converged that miss the tolerance by a factor of 20 or so, depending on the processor.
    pep.setType(SLEPc.PEP.Type.LINEAR)
    pep.setProblemType(SLEPc.PEP.ProblemType.GENERAL)
    pep.setScale(SLEPc.PEP.Scale.SCALAR)
    pep.setDimensions(2 * n_modes, max(4 * n_modes, 2 * n_modes + 20))
    pep.setWhichEigenpairs(SLEPc.PEP.Which.TARGET_MAGNITUDE)
    pep.setTarget(sigma)
    pep.setTolerances(1e-10)
    with petsc_defaults(prefix, {**_OPTIONS, **given_options(petsc_options)}):
        pep.setFromOptions()
        try:
            pep.solve()
        except PETSc.Error as error:
            raise ConvergenceError("SLEPc did not solve Z(s) x = 0", str(error)) from error
    if pep.getConverged() < 2 * n_modes:
        raise ConvergenceError(f"{pep.getConverged() // 2} of {n_modes} modes converged.")
    s, shapes, residuals = _pairs(pep, K, 0.3 * sigma)
    for i, x in enumerate(s):
        turned = pencil.apply_slope(x, shapes[:, i : i + 1])[:, 0]
        shapes[:, i] *= np.sqrt(2 * x / structure.comm.allreduce(shapes[:, i] @ turned))
    C.destroy()
    return ComplexModes(structure, dict(given or {}), s, shapes, residuals, None, pep)


def _pairs(pep: SLEPc.PEP, K: PETSc.Mat, least: float) -> tuple[np.ndarray, ...]:
    """Eigenvalues with Im s > 0 beyond the rigid-body modes', vectors, errors; by ascending |s|."""
    real, imag = K.createVecs()
    s, shapes, errors = [], [], []
    for i in range(pep.getConverged()):
        value = pep.getEigenpair(i, real, imag)
        if value.imag > 1e-9 * abs(value) and abs(value) > least:
            s.append(value)
            shapes.append(real.array_r + 1j * imag.array_r)
            errors.append(pep.computeError(i))
    if not s:
        raise ConvergenceError("no elastic mode oscillates among those found: ask for more modes.")
    order = np.argsort(np.abs(s))
    return np.array(s)[order], np.column_stack(shapes)[:, order], np.array(errors)[order]
