"""What a posterior says of modes that no fit has seen, by the full model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from fenics_joints.case import Case, build_structure
from fenics_joints.errors import InputError
from fenics_joints.measurements.gap import pair_modes
from fenics_joints.modal.modes import solve_modes
from fenics_joints.progress import Progress


@dataclass(frozen=True, eq=False)
class HeldModes:
    """Modes kept from the likelihood.

    Attributes:
        mode_names: Names, m of them.
        measured_hz: Shape (m,).
        measured_sd: Relative standard deviation of the test's noise, (m,).
        predicted_hz: Draws, (n, m), without those at which the model lacks a mode, or which are
            beyond a law's limit.
    """

    mode_names: tuple[str, ...]
    measured_hz: np.ndarray
    measured_sd: np.ndarray
    predicted_hz: np.ndarray


def predict_held(
    case: Case,
    row: int,
    n_fitted: int,
    points: Sequence[Mapping[str, float]],
    log_sd: np.ndarray | float,
    comm: MPI.Intracomm,
    progress: Progress | None = None,
    seed: int = 0,
) -> HeldModes:
    """Frequencies of the test's modes above those that were fitted. Collective.

    Args:
        case: The case.
        row: Which of the test's conditions.
        n_fitted: Number of modes in the likelihood, the lowest of the test's.
        points: All values of the model, a draw of the posterior each.
        log_sd: Standard deviation of a frequency about the model's, for each point or all.
        comm: Communicator.
        progress: Told after each point.
        seed: Of the scatter about the model.

    Raises:
        InputError: If the model has these modes at none of the points.
    """
    data, full = case.measurements(), build_structure(case, comm)
    n_test, n_modes = len(data.mode_names), max(case.diagnose.n_modes, len(data.mode_names))
    start = {**case.nominal(), **case.start()}
    first = pair_modes(
        solve_modes(full, start, n_modes=n_modes), n_test, data.sensors, reference=data.shapes
    )
    reference, found = first.shapes if data.shapes is None else data.shapes, []
    for values in points:
        if progress is not None:
            progress.advance()
        try:
            modes = solve_modes(full, values, n_modes=n_modes)
            index = pair_modes(modes, n_test, data.sensors, reference=reference).index
        except InputError:
            found.append(np.full(n_test - n_fitted, np.nan))
            continue
        found.append(modes.frequencies_hz[index[n_fitted:]])
    scatter = np.random.default_rng([seed, 9]).standard_normal(np.shape(found))
    log_f = np.log(found) + np.broadcast_to(log_sd, len(found))[:, None] * scatter
    there = np.all(np.isfinite(log_f), axis=1)
    if not there.any():
        raise InputError(f"{case.path}: the model has the held modes at no draw of the posterior.")
    return HeldModes(
        data.mode_names[n_fitted:],
        data.frequencies_hz[row, n_fitted:],
        data.log_sd()[row, n_fitted:],
        np.exp(log_f[there]),
    )
