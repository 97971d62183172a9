"""Derivatives of mode shapes by every parameter, from `BatchModes.shape_slope`."""

from __future__ import annotations

import numpy as np

from fenics_joints.reduction.batch_modes import BatchModes, change


def shape_slopes(model, index, given=None) -> tuple[np.ndarray, np.ndarray]:
    """Shapes of some modes of a model of plain arrays, (n_dofs, k), and their derivatives,
    (n_dofs, k, n_parameters)."""
    values, (eigenvalues, vectors) = model.values(given), model.all_modes(given)
    table = {name: np.array([value]) for name, value in values.items()}
    modes = BatchModes(
        model, table, eigenvalues[None], vectors[None], np.array([index]), np.array([True])
    )
    slopes = []
    for name, value in values.items():
        step = 1e-6 * max(abs(value), 1e-3)
        low, high = ({**table, name: table[name] + s} for s in (-step, step))
        slopes.append(modes.shape_slope(change(model, low, high, 2 * step), 0)[0])
    return modes.x[0], np.stack(slopes, axis=-1)
