"""A reduced model on as few vectors as the modes that one test saw ask for."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.linalg

from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.modal import Modes
from fenics_joints.modal.modes import SHIFT_SHARE
from fenics_joints.reduction.adaptive import Points
from fenics_joints.reduction.forward import Forward
from fenics_joints.reduction.sampled import lacking

__all__ = ["condensed"]


def condensed(
    forward: Forward, samples: Points, keep: Callable[[Modes], np.ndarray], share: float
) -> np.ndarray:
    """Vectors that hold the modes of a model at samples, each to its own energy, (n_dofs, k).

    As `fenics_joints.reduction.sampled.SampledBasis`, of a model of plain arrays. Orthonormal in
    the energy of the first sample.

    Args:
        forward: Of the model.
        samples: Parameter values; where the model lacks what the test saw they are passed over.
        keep: Which modes are held, by index.
        share: Share of a mode's energy, in its own sample, that may be lacking.
    """
    model = forward.model
    shift = (2 * np.pi * SHIFT_SHARE * model.scale_hz) ** 2
    basis = np.zeros((model.n_dofs, 0))
    for values in samples:
        try:
            modes, _ = forward.solve(values)
        except (InputError, ConvergenceError):
            continue
        Z, n = np.hstack([basis, modes.shapes[:, keep(modes)]]), basis.shape[1]
        gram = Z.T @ (model.stiffness(values) @ Z + shift * (model.mass(values) @ Z))
        size = np.sqrt(np.diag(gram))
        combine = lacking(gram / np.outer(size, size), n, share) / size[:, None]
        basis = np.hstack([basis, Z @ combine])
    if not basis.shape[1]:
        return np.eye(model.n_dofs)
    energy = model.stiffness(samples[0]) + shift * model.mass(samples[0])
    values, turn = scipy.linalg.eigh(basis.T @ energy @ basis)
    kept = values > 1e-12 * values[-1]
    return basis @ (turn[:, kept] / np.sqrt(values[kept]))
