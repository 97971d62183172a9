"""How a test reads a structure: which frequency it calls which mode, and what its sensors say."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["Sensing"]


@dataclass
class Sensing:
    """What an effect in the test changes, in place.

    Attributes:
        order: The model's mode whose frequency and damping stand in each of the test's columns,
            shape (m,).
        gains: Reading over true motion of each sensor, shape (n_s,).
        shifts: How far each sensor sits from where the case has it, m, along the line of sensors,
            shape (n_s,).
    """

    order: np.ndarray
    gains: np.ndarray
    shifts: np.ndarray

    @classmethod
    def true(cls, n_modes: int, n_sensors: int) -> Sensing:
        """A test without errors."""
        return cls(np.arange(n_modes), np.ones(n_sensors), np.zeros(n_sensors))
