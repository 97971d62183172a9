"""Slip and opening of the interface at an amplitude of vibration: equivalent linear springs."""

from __future__ import annotations

import numpy as np


def slip(k: np.ndarray, motion: np.ndarray, limit: np.ndarray):
    """A spring and a slider in series (Jenkins), at an amplitude; first harmonic.

    Args:
        k: Stiffness at rest, Pa/m, (n,).
        motion: Amplitude of the relative motion, m, (n,).
        limit: Shear at which it slides, Pa, (n,).

    Returns:
        Equivalent stiffness, Pa/m, and energy lost in a cycle, J/m2 (Caughey 1960).
    """
    yields = np.maximum(limit, 1e-12) / k
    over = np.maximum(motion / yields, 1.0)
    theta = np.arccos(1 - 2 / over)
    factor = (theta - np.sin(2 * theta) / 2) / np.pi
    lost = 4 * k * yields * np.maximum(motion - yields, 0.0)
    return k * factor, lost


def gapping(k: np.ndarray, motion: np.ndarray, pressure: np.ndarray) -> np.ndarray:
    """A spring that opens when what pulls on it exceeds the pressure; first harmonic, no loss.

    A joint rocks: while one edge of it closes the other opens, and the next half cycle it is the
    other way round. So either half cycle has its share of open faces, and the force is cut at the
    pressure in both.

    Args:
        k: Stiffness while closed, Pa/m, (n,).
        motion: Amplitude of the opening, m, (n,).
        pressure: At rest, Pa, (n,).
    """
    ratio = np.minimum(np.maximum(pressure, 1e-12) / np.maximum(k * motion, 1e-30), 1.0)
    return k * 2 / np.pi * (np.arcsin(ratio) + ratio * np.sqrt(1 - ratio**2))
