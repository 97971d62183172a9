"""Which lines of measured functions say most: where they change most, on flanks and in valleys."""

from __future__ import annotations

import numpy as np
from scipy.signal import find_peaks

from fenics_joints.errors import InputError

#: Share of the lines that is spread evenly over ln f, so that no part of the band is left out.
_EVEN = 0.3
#: A resonance stands out by this in the sum of |H|^2: 6 dB.
_PROMINENCE = np.log(4.0)


def choose_lines(
    frequencies_hz: np.ndarray,
    values: np.ndarray,
    n: int,
    *,
    relative_sd: float | np.ndarray = 0.0,
    allowed: np.ndarray | None = None,
    peaks: bool = True,
) -> np.ndarray:
    """Lines at equal steps along the curve of all ln H: dense on flanks and at antiresonances.

    A step's length is the root mean square over the functions of the change of the complex ln H,
    less what noise alone would make of it; a share of the steps is even in ln f.

    Args:
        frequencies_hz: Lines, Hz, above 0 where allowed, shape (n_f,).
        values: Functions, shape (n_f, n_responses, n_references); nan where not measured.
        n: How many lines; all allowed ones if there are fewer.
        relative_sd: Relative standard deviation, a number or of the values' shape.
        allowed: Which lines may be taken, shape (n_f,), bool; all above 0 Hz by default.
        peaks: Whether lines within the half-power width of a resonance may be taken. They measure
            the damping more than anything else: not if that is not to be found.

    Returns:
        Indices of the lines, ascending.

    Raises:
        InputError: If no line is allowed.
    """
    f = np.asarray(frequencies_hz, dtype=float)
    there = f > 0 if allowed is None else np.asarray(allowed, dtype=bool) & (f > 0)
    if not peaks:
        off = there & ~near_peaks(values)
        there = off if off.any() else there
    index = np.flatnonzero(there)
    if not len(index):
        raise InputError("lines: expected measured lines above 0 Hz that are not held out")
    if len(index) <= n:
        return index
    along = _length(values[index], np.broadcast_to(relative_sd, values.shape)[index])
    even = np.log(f[index] / f[index[0]])
    place = (1 - _EVEN) * along / (along[-1] or 1.0) + _EVEN * even / even[-1]
    return index[_spread(place, n)]


def _length(values: np.ndarray, sd: np.ndarray) -> np.ndarray:
    """Length of the curve of all ln H up to each line."""
    used = np.isfinite(values[0])
    log_h = np.log(np.where(values == 0, np.finfo(float).tiny, values))[:, used]
    sd = sd[:, used]
    step = np.abs(np.exp(1j * np.diff(log_h.imag, axis=0)) - 1) ** 2
    step += np.diff(log_h.real, axis=0) ** 2
    noise = 2 * (sd[1:] ** 2 + sd[:-1] ** 2)
    size = np.sqrt(np.mean(np.maximum(step - noise, 0.0), axis=1))
    return np.concatenate([[0.0], np.cumsum(size)])


def _spread(place: np.ndarray, n: int) -> np.ndarray:
    """n different indices about evenly spaced in an ascending quantity."""
    for count in range(n, len(place) + 1):
        at = np.unique(np.searchsorted(place, np.linspace(0, place[-1], count)))
        if len(at) >= n:
            break
    else:
        at = np.arange(len(place))
    drop = np.linspace(0, len(at) - 1, n).round().astype(int)
    return np.minimum(at[drop], len(place) - 1)


def near_peaks(values: np.ndarray) -> np.ndarray:
    """Which lines lie within the half-power width of a resonance, shape (n_f,), bool.

    Args:
        values: Functions, shape (n_f, n_responses, n_references); nan where not measured.
    """
    energy = np.nansum(np.abs(values) ** 2, axis=(1, 2))
    near = np.zeros(len(energy), dtype=bool)
    positive = np.maximum(energy, np.finfo(float).tiny)
    tops, _ = find_peaks(np.log(positive), prominence=_PROMINENCE)
    for top in tops:
        low = high = int(top)
        while low > 0 and energy[low - 1] > 0.5 * energy[top]:
            low -= 1
        while high < len(energy) - 1 and energy[high + 1] > 0.5 * energy[top]:
            high += 1
        near[low : high + 1] = True
    return near
