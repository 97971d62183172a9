"""Modes of a small model at several parameter values, and which of them are the test's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from fenics_joints.errors import InputError
from fenics_joints.modal.modes import solve_modes
from fenics_joints.reduction.forward import Forward
from fenics_joints.reduction.lean import batched


class SeenAt(NamedTuple):
    """Modes of a model at parameter values, and which of them are the test's.

    Attributes:
        shapes: As columns, (n_dofs, n_modes).
        index: The test's, (n_test,); (0,) where they are not all there.
        log_f: ln f of these, (n_test,); nan where they are not all there.
    """

    shapes: np.ndarray
    index: np.ndarray
    log_f: np.ndarray


def seen_modes_at(forward: Forward, wanted: Sequence[Mapping[str, float]]) -> list[SeenAt]:
    """`modes_at` each of several values, and which of them are the test's.

    Args:
        forward: Of the reduced model.
        wanted: Parameter values.
    """
    many = batched(forward)
    if many.batches:
        table = {name: np.array([values[name] for values in wanted]) for name in wanted[0]}
        try:
            modes = many.many(table, every=False)
            most = np.maximum(modes.index.max(axis=1) + 1, many.n_modes)
            each = zip(modes.vectors, most, modes.index, modes.log_f, strict=True)
            return [
                SeenAt(x[:, :n], index, log_f) if good else _seen_modes(forward, values)
                for good, values, (x, n, index, log_f) in zip(modes.good, wanted, each, strict=True)
            ]
        except (InputError, np.linalg.LinAlgError):
            pass  # one of them is beyond a law's limit
    return [_seen_modes(forward, values) for values in wanted]


def _seen_modes(forward: Forward, values) -> SeenAt:
    try:
        modes, pairing = forward.solve(values)
    except InputError:
        nothing = np.full(forward.n_test, np.nan)
        return SeenAt(modes_at(forward, values), np.zeros(0, dtype=int), nothing)
    log_f = np.log(modes.frequencies_hz[pairing.index])
    return SeenAt(modes.shapes, pairing.index, log_f)


def modes_at(forward: Forward, values: Mapping[str, float]) -> np.ndarray:
    """Modes of the reduced model, as many as the test's ask for, shape (n_dofs, n_modes)."""
    try:
        return forward.solve(values)[0].shapes
    except InputError:
        own = {name: values[name] for name in forward.model.parameters}
        return solve_modes(forward.model, own, n_modes=forward.n_modes).shapes
