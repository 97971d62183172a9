"""Frequency response functions of a structure, full or reduced, and their derivatives.

H_ij(w) = c_i^T Z(i w)^-1 b_j for a sensor c_i and a unit force b_j, with the dynamic stiffness Z of
`fenics_joints.structure.damping`. By the adjoint,

    dH_ij/dp = -psi_i^T dZ/dp u_j,    Z u_j = b_j,   Z psi_i = c_i  (Z is symmetric),

so that one more solution for each sensor, and none for one that stands where a force does, gives
the derivatives by all parameters.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from fenics_joints.errors import InputError, flag, member, wanted, whole
from fenics_joints.files import dataframe
from fenics_joints.modal.modes import Modes
from fenics_joints.response.direct import DynamicStiffness
from fenics_joints.response.modal_basis import (
    ModalPencil,
    check_lines,
    modal_pencil,
    reduced_pencil,
)
from fenics_joints.response.pencil import DampedPencil, check_damped, check_damping
from fenics_joints.response.units import KINDS, MOTION, checked_kind
from fenics_joints.structure import Damped, Damping, Sensors
from fenics_joints.structure.sparse import product


@dataclass(frozen=True, repr=False)
class FRF:
    """Frequency response functions.

    Attributes:
        frequencies_hz: Lines, Hz, (n_f,).
        values: Responses per unit force, complex, (n_f, n_sensors, n_excitations); the time factor
            is exp(+i w t). In `unit`.
        kind: ``"receptance"``, ``"mobility"`` or ``"accelerance"``.
        sensors: Where and in which direction the response is read.
        excitation: Where and in which direction the forces act.
        method: ``"direct"`` or ``"modal"``.
        given: The parameters that differed from their nominal values.
        slopes: `gradients`; None unless they were asked for.
        error: By modes: |H - H_direct| / |H_direct|, (n_checked, n_sensors, n_excitations).
        error_hz: Lines at which that was found, Hz, (n_checked,).
        solver: PETSc's KSP of the direct solution; by modes the `EigenSolver`'s SLEPc EPS. None of
            a reduced model.
        modal: The structure on its modes and residual vectors, or the reduced model on its modes;
            None for a direct solution of the full one.
    """

    frequencies_hz: np.ndarray
    values: np.ndarray
    kind: str
    sensors: Sensors
    excitation: Sensors
    method: str
    given: Mapping[str, float]
    slopes: np.ndarray | None = None
    error: np.ndarray | None = None
    error_hz: np.ndarray | None = None
    solver: object | None = None
    modal: ModalPencil | None = None

    def __repr__(self) -> str:
        lines, shape = self.frequencies_hz, " x ".join(map(str, self.values.shape))
        return (
            f"FRF({self.kind} in {self.unit}, {shape} (lines, sensors, forces), "
            f"{lines[0]:.5g} to {lines[-1]:.5g} Hz, {self.method})"
        )

    @property
    def gradients(self) -> np.ndarray:
        """Derivatives of the values by every parameter of the model, complex, (n_f, n_sensors,
        n_excitations, n_parameters).

        Raises:
            InputError: If the functions were found without them.
        """
        if self.slopes is None:
            raise InputError("gradients: expected functions that were found with gradients = True.")
        return self.slopes

    @property
    def unit(self) -> str:
        """Unit of the values, such as ``m/s2/N``."""
        return f"{MOTION[self.kind]}/N"

    def to_dataframe(self):
        """A ``pandas.DataFrame`` with a row for each line: frequency_hz and complex columns
        ``sensor i, force j`` (from 1), in `unit`.

        Raises:
            InputError: If pandas is not installed.
        """
        columns = {
            f"sensor {i + 1}, force {j + 1}": self.values[:, i, j]
            for i, j in np.ndindex(self.values.shape[1:])
        }
        return dataframe({"frequency_hz": self.frequencies_hz, **columns})

    def to(self, kind: str) -> FRF:
        """The same response as another kind.

        Raises:
            InputError: For an unknown kind.
        """
        power = KINDS[checked_kind(kind)] - KINDS[self.kind]
        factor = (2j * np.pi * self.frequencies_hz) ** power
        slopes = None if self.slopes is None else self.slopes * factor[:, None, None, None]
        return replace(self, kind=kind, values=self.values * factor[:, None, None], slopes=slopes)


def solve_frf(
    model: Damped,
    given: Mapping[str, float] | None = None,
    *,
    frequencies_hz: ArrayLike,
    excitation: Sensors,
    sensors: Sensors,
    damping: Damping | None = None,
    kind: str = "receptance",
    method: str = "direct",
    gradients: bool = False,
    modes: Modes | None = None,
    n_modes: int | None = None,
    check: int = 3,
    petsc_options: Mapping[str, object] | None = None,
) -> FRF:
    """FRFs at sensors under unit forces. Collective.

    Args:
        model: A structure; or a reduced one or beams, whose FRFs are found by
            `fenics_joints.response.modal_basis`, on all of its modes, with either method.
        given: Values of parameters that differ from their nominal value.
        frequencies_hz: Lines, Hz, above 0, (n_f,).
        excitation: Points and directions of the forces.
        sensors: Points and directions of the responses.
        damping: The damping; without it a direct solution fails at a resonance.
        kind: ``"receptance"``, ``"mobility"`` or ``"accelerance"``.
        method: Of a full model; ``"direct"``: one factorisation for each line. ``"modal"``: on
            modes, rigid-body modes among them, and residual vectors for the forces and sensors: see
            `fenics_joints.response.modal_basis`.
        gradients: Whether the derivatives by all parameters are wanted, those that the damping
            names among them.
        modes: By modes: modes of the structure at the same values, with the solver that found them
            and has solved nothing else since.
        n_modes: By modes: their number; by default enough to reach half as high again as the lines.
        check: By modes: number of lines at which the error against a direct solution is found.
            Each costs as much as a line of the direct solution; 0 for none.
        petsc_options: Options of the direct solver, without prefix.

    Raises:
        InputError: If a value is out of range or unknown, or a point outside the mesh.
        ConvergenceError: If the system is singular at a line, or the modes were not found.
    """
    lines = check_lines(frequencies_hz)
    power = KINDS[checked_kind(kind)]
    member("method", method, ("direct", "modal"))
    damping = check_damping(damping)
    check_damped(model)
    for key, places in (("excitation", excitation), ("sensors", sensors)):
        if not isinstance(places, Sensors) or not len(places):
            raise wanted(key, places, "Sensors, at least one")
    flag("gradients", gradients)
    whole("check", check, 0)
    if n_modes is not None:
        whole("n_modes", n_modes)
    if not model.is_dense and method == "direct" and damping.is_modal:
        raise InputError('damping.modal: expected method = "modal", or damping without ratios.')
    pencil = DampedPencil(model, given, damping)
    loads, reads = model.loads(excitation, "excitation"), model.loads(sensors)
    modal, checks = None, {}
    try:
        if model.is_dense:
            modal = reduced_pencil(pencil, given, gradients=gradients)
        elif method == "modal":
            both, many = np.hstack([loads, reads]), {"modes": modes, "n_modes": n_modes}
            modal = modal_pencil(pencil, both, lines, gradients=gradients, **many)
        if modal is None:
            direct = DynamicStiffness(pencil, petsc_options)
            found, solver = direct.response(lines, loads, reads, gradients), direct.solver
        else:
            found = modal.response(lines, modal.project(loads), modal.project(reads), gradients)
            solver = None if model.is_dense else modal.modes.solver.solver
            if check and not model.is_dense:
                checks = _errors(modal, lines, found.values, loads, reads, check, petsc_options)
    finally:
        pencil.destroy()
    frf = FRF(
        lines,
        found.values,
        "receptance",
        sensors,
        excitation,
        method,
        dict(given or {}),
        found.gradients,
        solver=solver,
        modal=modal,
        **checks,
    )
    return frf.to(kind) if power else frf


def _errors(
    modal: ModalPencil, lines, values, loads, reads, check, petsc_options
) -> dict[str, np.ndarray]:
    """Error of the response by modes at a few lines, from the lowest to the highest."""
    pencil = modal.pencil
    stiffness, comm = DynamicStiffness(pencil, petsc_options), pencil.comm
    some = np.unique(np.linspace(0, len(lines) - 1, min(check, len(lines))).round().astype(int))
    damped = modal.modal_damping > 0
    forces = product(pencil.M, modal.basis[:, damped])
    exact = np.empty((len(some), *values.shape[1:]), dtype=complex)
    for i, f in enumerate(lines[some]):
        s = 2j * np.pi * f
        stiffness.factorise(s)
        x = stiffness.solve(np.hstack([loads, forces]))
        x, y = x[:, : loads.shape[1]], x[:, loads.shape[1] :]
        if damped.any():
            # Modal damping is s (M phi) 2 zeta omega (M phi)^T: Woodbury's formula.
            small = np.diag(1 / (s * modal.modal_damping[damped])) + comm.allreduce(forces.T @ y)
            x = x - y @ np.linalg.solve(small, comm.allreduce(forces.T @ x))
        exact[i] = comm.allreduce(reads.T @ x)
    stiffness.destroy()
    size = np.abs(exact)
    error = np.abs(values[some] - exact) / np.where(size > 0, size, 1.0)
    return {"error": error, "error_hz": lines[some]}
