"""The leanest forward whose frequencies are good enough."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fenics_joints.reduction.arrays import ArrayModel
from fenics_joints.reduction.batch import pod
from fenics_joints.reduction.forward import Forward
from fenics_joints.reduction.lean import LeanForward, batched


def lean_forward(
    forward: Forward,
    model: ArrayModel,
    given: Mapping[str, float],
    snapshots: np.ndarray,
    weights: np.ndarray,
    checks: Sequence[Mapping[str, float]],
    limit: float,
    sizes: Sequence[int] = (16, 20, 24, 28, 32, 36, 40, 50, 60, 80, 100),
    beyond: bool = False,
) -> tuple[LeanForward, float]:
    """The leanest forward whose frequencies are good enough.

    Args:
        forward: The reduced model's.
        model: That model.
        given: The most probable parameter values.
        snapshots: Modes of the reduced model, (n_dofs, n).
        weights: Of the snapshots, (n,).
        checks: Parameter values at which frequencies are compared.
        limit: Error of ln f that is good enough.
        sizes: Sizes of the basis to try.
        beyond: Whether the mode after the test's has to be good enough too (`Forward.further`).

    Returns:
        The forward, and its largest error of ln f at the checks: above ``limit`` if even the
        largest basis is not good enough.
    """
    vectors, energies = pod(model, snapshots, weights, given)
    most = int(np.sum(energies > 1e-7 * energies[0]))
    watched = forward.further if beyond else forward
    exact = _log_f(watched, checks)
    tried = [s for s in sizes if 6 + forward.n_test <= s < most] + [most]
    for size in tried:
        lean = LeanForward(forward, model.on(vectors[:, :size]))
        error = frequency_error(lean.further if beyond else lean, checks, exact)
        if error <= limit:
            break
    return lean, error


def frequency_error(lean: LeanForward, checks, exact: np.ndarray) -> float:
    """Largest error of ln f at parameter values; infinite if the lean model lacks a mode."""
    found = lean.log_f_at(checks)
    return float(np.max(np.abs(found - exact))) if np.isfinite(found).all() else np.inf


def _log_f(forward: Forward, wanted: Sequence[Mapping[str, float]]) -> np.ndarray:
    """ln f at several values, (len(wanted), m).

    Raises:
        InputError: If the model lacks a mode there.
    """
    found = batched(forward).log_f_at(wanted)
    if np.isfinite(found).all():
        return found
    return np.array([forward(values)[0] for values in wanted])
