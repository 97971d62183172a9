"""How a test reads a structure: which frequency it calls which mode, and what its sensors say."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fenics_joints.reduction.bends import N_BENDS


@dataclass
class Sensing:
    """What an effect in the test changes, in place.

    Attributes:
        order: The model's mode whose frequency and damping stand in each of the test's columns,
            shape (m,); m itself is the one after those that the test is taken for.
        gains: Reading over true motion of each sensor, shape (n_s,).
        shifts: How far each sensor sits from where the case has it, m, along each of its ways
            (`fenics_joints.reduction.forward.ways_of`), and their `monomials`, m2 and m3: what
            `ArrayModel.shift_rows` are multiplied by, shape (9, n_s). Where there is one way, the
            first row counts.
    """

    order: np.ndarray
    gains: np.ndarray
    shifts: np.ndarray

    @classmethod
    def true(cls, n_modes: int, n_sensors: int) -> Sensing:
        """A test without errors."""
        return cls(np.arange(n_modes), np.ones(n_sensors), np.zeros((2 + N_BENDS, n_sensors)))


def in_order(forward, order: np.ndarray | None, values: Mapping[str, float]):
    """ln f of the test's columns, (m,), and their derivatives, (m, n_parameters).

    Args:
        forward: Predicts frequencies.
        order: See `Sensing`; None for that of the model.
        values: The model's parameter values.
    """
    if order is None:
        return forward(values)
    reach = int(np.max(order)) + 1
    log_f, slope = (forward if reach <= forward.n_test else forward.further)(values)
    return log_f[order], slope[order]
