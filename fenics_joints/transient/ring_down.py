"""Frequency and damping against amplitude, from a free decay."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from fenics_joints.errors import InputError, reals


@dataclass(frozen=True, repr=False)
class RingDown:
    """What a free decay says, cycle by cycle.

    Attributes:
        amplitudes: Mean of the two peaks that bound each cycle, in the signal's unit, (n,).
        frequencies_hz: One over the cycle's length, (n,).
        damping: Damping ratio from the logarithmic decrement of the cycle, (n,).
    """

    amplitudes: np.ndarray
    frequencies_hz: np.ndarray
    damping: np.ndarray

    def __repr__(self) -> str:
        low, high = self.frequencies_hz.min(), self.frequencies_hz.max()
        return f"RingDown({len(self.amplitudes)} cycles, {low:.4g} to {high:.4g} Hz)"


def ring_down(times, signal) -> RingDown:
    """Frequency and damping of each cycle of a decaying signal of one mode.

    Args:
        times: s, ascending, (n,).
        signal: Displacement, velocity or acceleration that swings about zero, (n,).

    Raises:
        InputError: If there are fewer than three maxima.
    """
    times = reals("times", times, (None,), "s")
    signal = reals("signal", signal, times.shape)
    if len(times) < 2 or not np.all(np.diff(times) > 0):
        raise InputError("times: expected two or more instants, ascending.")
    spline = CubicSpline(times, signal)
    turning = spline.derivative().roots(extrapolate=False)
    tops = turning[spline(turning, 2) < 0]
    heights = spline(tops)
    tops, heights = tops[heights > 0], heights[heights > 0]
    if len(tops) < 3:
        raise InputError(f"the signal has {len(tops)} maxima above zero: expected 3 or more.")
    decrement = np.log(heights[:-1] / heights[1:])
    return RingDown(
        np.sqrt(heights[:-1] * heights[1:]),
        1 / np.diff(tops),
        decrement / np.sqrt(4 * np.pi**2 + decrement**2),
    )
