"""The damping of bolted beams from measured damping ratios, and why the modes' ratios differ.

Damped modes are those of `response.complex_modes` with `BeamStructure.joint_damping`: the
eigenvalues of the state matrix of Jalali et al. 2019, eq. 9.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from fenics_joints.beams.structure import BeamStructure
from fenics_joints.errors import ConvergenceError, InputError, whole
from fenics_joints.measurements.least_squares import LeastSquares
from fenics_joints.modal.modes import solve_modes
from fenics_joints.response.complex_modes import ComplexModes, solve_complex_modes
from fenics_joints.structure.components import number


@dataclass(frozen=True)
class DampingFit:
    """Damping coefficients from measured damping ratios.

    Attributes:
        names: Names of the parameters c.
        values: N m s.
        sd: Standard deviations, for independent errors of the ratios: from the noise, times the
            root of chi2 per degree of freedom where it exceeds 1.
        ratios: The model's damping ratios, shape (m,).
        measured: The measured ones, shape (m,).
    """

    names: tuple[str, ...]
    values: np.ndarray
    sd: np.ndarray
    ratios: np.ndarray = field(repr=False)
    measured: np.ndarray = field(repr=False)


def identify_damping(
    structure: BeamStructure,
    names: Sequence[str],
    ratios: Sequence[float],
    given: Mapping[str, float] | None = None,
    *,
    relative_sd: float | Sequence[float] = 0.1,
) -> DampingFit:
    """The c that makes the lowest modes' damping ratios nearest to measured ones.

    Args:
        structure: The beams.
        names: Parameters c of its joints.
        ratios: Measured damping ratios of the lowest elastic modes, not per cent; nan if missing.
        given: Values of the other parameters, such as k1 and k2 that frequencies gave.
        relative_sd: Their relative standard deviation.

    Raises:
        InputError: If a name is no joint's c, or a ratio not positive.
        ConvergenceError: If the least squares do not converge, or a mode is overdamped.
    """
    names, ratios = tuple(names), np.asarray(ratios, dtype=float)
    of_groups = [c for _, c, _ in structure.slips]
    for name in names:
        if name not in of_groups:
            known = sorted({c for c in of_groups if isinstance(c, str)})
            raise InputError(
                f"{name!r} is not the damping c of a joint: expected one of: "
                f"{', '.join(known) or 'none, all are numbers'}."
            )
    used = np.isfinite(ratios)
    if not used.any() or not np.all(ratios[used] > 0):
        raise InputError(f"ratios = {ratios.tolist()}: expected positive damping ratios.")
    sd = (np.broadcast_to(relative_sd, ratios.shape) * ratios)[used]
    columns = [list(structure.parameters).index(name) for name in names]
    undamped = solve_modes(structure, given, n_modes=min(len(ratios) + 3, structure.n_dofs))
    damping, n_modes = structure.joint_damping(), undamped.n_rigid + len(ratios)

    def solve(x) -> ComplexModes:
        values = {**(given or {}), **dict(zip(names, x.tolist(), strict=True))}
        return solve_complex_modes(
            structure, values, damping=damping, gradients=True, n_modes=n_modes
        )

    def residual(x):
        return (solve(x).damping_ratios - ratios)[used] / sd

    def slope(x):
        return solve(x).gradients()[1][np.ix_(used, columns)] / sd[:, None]

    # Ratios are nearly linear in c: the slope without damping gives the start.
    at_zero = slope(np.zeros(len(names)))
    start = np.linalg.lstsq(at_zero, -residual(np.zeros(len(names))), rcond=None)[0]
    start = np.maximum(start, 1e-3 * np.max(np.abs(start)))
    found = LeastSquares(residual, slope, bounds=(0, np.inf)).solve(start, x_scale=start)
    if found.status <= 0:
        raise ConvergenceError(f"identifying {', '.join(names)} did not converge", found.message)
    # Damping that the joints cannot explain counts as noise.
    excess = max(1.0, 2 * float(found.cost) / max(len(found.fun) - len(names), 1))
    covariance = excess * np.linalg.pinv(found.jac.T @ found.jac)
    return DampingFit(
        names, found.x, np.sqrt(np.diag(covariance)), solve(found.x).damping_ratios, ratios
    )


@dataclass(frozen=True)
class SlipTable:
    """Which modes the joints damp, and why.

    To first order a mode's damping ratio is sum_e c_e (theta_2 - theta_1)_e^2 / (2 omega), over the
    joint elements e and with a mass-normalised shape: what counts is how much the line of the lap
    bends, its curvature (theta_2 - theta_1) / L.

    Attributes:
        frequencies_hz: Of each elastic mode, shape (n,).
        curvature: Root mean square of the curvature over the joints, relative to that over the
            whole structure, shape (n,).
        energy: Share of the strain energy that is in slip, shape (n,).
        ratios: First-order damping ratios, shape (n,).
    """

    frequencies_hz: np.ndarray
    curvature: np.ndarray = field(repr=False)
    energy: np.ndarray = field(repr=False)
    ratios: np.ndarray = field(repr=False)


def slip_table(
    structure: BeamStructure, given: Mapping[str, float] | None = None, *, n_modes: int = 10
) -> SlipTable:
    """Curvature at the joints, energy in slip and first-order damping of each elastic mode.

    Raises:
        InputError: If the structure has no joint, or ``n_modes`` is out of range.
    """
    if not structure.joints:
        raise InputError("joints: expected at least one; beams alone have no damping here.")
    whole("n_modes", n_modes)
    modes = solve_modes(structure, given, n_modes=min(n_modes + 3, structure.n_dofs))
    index = np.arange(modes.n_rigid, modes.n_rigid + n_modes)
    if index[-1] >= len(modes):
        raise InputError(f"n_modes = {n_modes}: expected at most {len(modes) - modes.n_rigid}.")
    x, values, layout = modes.shapes[:, index], structure.values(given), structure.layout
    turns, lengths = np.diff(layout.at_nodes(x)[:, 2], axis=0), np.diff(layout.x)
    lapped = np.repeat(
        [s.joint is not None for s in layout.stretches], [s.n for s in layout.stretches]
    )
    at_joint, overall = (
        np.sqrt(np.sum(turns[some] ** 2 / lengths[some, None], axis=0) / np.sum(lengths[some]))
        for some in (lapped, slice(None))
    )
    omega = np.sqrt(modes.eigenvalues[index])
    slips = [r for r in structure.regions if r.law.name == "slip"]
    energy = sum(
        number(r.properties["k2"], values) * np.sum(x * (r.stiffness[0] @ x), axis=0) for r in slips
    )
    work = np.sum(x * (structure.damping_matrix(given) @ x), axis=0)
    return SlipTable(omega / (2 * np.pi), at_joint / overall, energy / omega**2, work / (2 * omega))
