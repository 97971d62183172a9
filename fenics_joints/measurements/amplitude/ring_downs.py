"""A backbone from a free decay: band-pass, analytic signal, windows.

The instantaneous amplitude and phase come from the analytic signal of the band-passed record (what
Londono, Neild and Cooper, J. Sound Vib. 347, 2015, and the methods compared by Jin et al., Mech.
Syst. Signal Process. 146, 2020, rest on). Each window fits a parabola to ln of the amplitude and
one to the phase; their slopes at its middle are -zeta w0 and w0 sqrt(1 - zeta^2). Windows do not
overlap, so that their errors are independent; the ends, where the filter rings, are cut.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import butter, hilbert, sosfiltfilt

from fenics_joints.errors import InputError, reals
from fenics_joints.measurements.amplitude.backbone import MeasuredBackbone

#: Half the band about the strongest line, as a share of its frequency; order of the filter.
_HALF_BAND, _ORDER = 0.2, 4
#: What is cut at the ends, and the shortest window, in units of one over the band's width.
_CUT, _SHORTEST = 2.0, 4.0
#: ln of the amplitude falls by this over a window, unless that makes more windows than this.
_FALL, _MOST = 0.35, 40
#: A window whose amplitude is known less well than this is left out.
_POOR = 0.1
#: Steps of time may differ by this share before the record is put on even ones.
_UNEVEN = 0.01
#: Fewest samples of a record.
_FEWEST = 64


def from_ring_down(
    times: np.ndarray,
    signals: np.ndarray,
    response: str,
    *,
    band: tuple[float, float] | None = None,
    sensor: int = 0,
) -> MeasuredBackbone:
    """Frequency and damping over amplitude from a free decay of one mode or of several apart.

    Several sensors are added up by their shares in the mode, which lowers the noise.

    Args:
        times: s, ascending, (n,).
        signals: Responses in SI units, (n,) or (n, sensors).
        response: ``displacement``, ``velocity`` or ``acceleration``.
        band: Frequencies that hold the mode and no other, Hz; by default a fifth to either side of
            the strongest line.
        sensor: Column whose amplitude is meant.

    Raises:
        InputError: If the record is too short, not of a decay, or the band does not fit it.
    """
    t, y = _even(times, signals)
    dt = t[1] - t[0]
    low, high = _band(y, dt, band)
    width = high - low
    z = _analytic(y, dt, low, high)
    shares = np.linalg.svd(np.vstack([z.real, z.imag]), full_matrices=False)[2][0]
    if not abs(shares[sensor]) > 0:
        raise InputError("the sensor does not move in that band; expected another one")
    q = (z @ shares) * abs(shares[sensor])
    cut = int(np.ceil(_CUT / width / dt))
    first = int(np.argmax(np.abs(q))) + cut
    kept = slice(first, len(q) - cut)
    if len(q) - cut - first < _SHORTEST / width / dt:
        raise InputError(
            f"the decay is {max((len(q) - first) * dt, 0):.3g} s long; expected more than "
            f"{(_SHORTEST + _CUT) / width:.3g} s with a band of {width:.3g} Hz"
        )
    windows = _windows(t[kept], q[kept], width)
    return _backbone(windows, response, (low, high))


def _even(times, signals) -> tuple[np.ndarray, np.ndarray]:
    """The record with even steps, as columns."""
    t = reals("times", times, (None,), "s")
    y = np.asarray(signals, dtype=float)
    y = y[:, None] if y.ndim == 1 else y
    if y.shape[0] != len(t) or not np.isfinite(y).all():
        raise InputError("signals: expected a number for each sensor at each time")
    if len(t) < _FEWEST:
        raise InputError(f"the record has {len(t)} samples; expected {_FEWEST} or more")
    steps = np.diff(t)
    if not np.all(steps > 0):
        i = int(np.argmax(steps <= 0))
        raise InputError(
            f"time goes from {t[i]:.9g} to {t[i + 1]:.9g} s at sample {i + 2}; expected ascending "
            "times"
        )
    if np.ptp(steps) > _UNEVEN * np.median(steps):
        even = np.linspace(t[0], t[-1], int(np.ceil(np.ptp(t) / np.median(steps))) + 1)
        t, y = even, CubicSpline(t, y)(even)
    return np.linspace(t[0], t[-1], len(t)), y - y.mean(axis=0)


def _band(y: np.ndarray, dt: float, band) -> tuple[float, float]:
    nyquist = 0.5 / dt
    if band is None:
        size = np.abs(np.fft.rfft(y, axis=0)).sum(axis=1)
        f = np.fft.rfftfreq(len(y), dt)
        size[f < 4 / (len(y) * dt)] = 0.0
        top = float(f[int(np.argmax(size))])
        band = (1 - _HALF_BAND) * top, (1 + _HALF_BAND) * top
    low, high = band
    if not 0 < low < high < 0.95 * nyquist:
        raise InputError(
            f"band of {low:.4g} to {high:.4g} Hz: expected one between 0 and {0.95 * nyquist:.4g} "
            f"Hz, what {1 / dt:.4g} samples per second can hold"
        )
    return float(low), float(high)


def _analytic(y: np.ndarray, dt: float, low: float, high: float) -> np.ndarray:
    """Analytic signals of the band, (n, sensors)."""
    sos = butter(_ORDER, (low, high), "bandpass", fs=1 / dt, output="sos")
    pad = min(len(y) - 1, int(3 / (high - low) / dt))
    return hilbert(sosfiltfilt(sos, y, axis=0, padlen=pad), axis=0)


def _windows(t: np.ndarray, q: np.ndarray, width: float) -> np.ndarray:
    """Windows over each of which the amplitude falls by the same factor, (n, 7), see `_fitted`."""
    level, phase = np.log(np.abs(q)), np.unwrap(np.angle(q))
    lowest = np.minimum.accumulate(level)
    fall = max(_FALL, (lowest[0] - lowest[-1]) / _MOST)
    shortest, found, start = int(_SHORTEST / width / (t[1] - t[0])), [], 0
    while start < len(t):
        below = np.flatnonzero(lowest[start:] <= lowest[start] - fall)
        end = start + max(int(below[0]) if len(below) else len(t), shortest)
        if end >= len(t):
            break
        found.append(_fitted(t[start:end], level[start:end], phase[start:end], width))
        start = end
    # A last one that the record cuts off may be long enough too.
    if len(t) - start > 2 * shortest:
        found.append(_fitted(t[start:], level[start:], phase[start:], width))
    return np.reshape(found, (-1, 7))


def _fitted(t: np.ndarray, level: np.ndarray, phase: np.ndarray, width: float) -> tuple:
    """ln of the amplitude at the middle, both slopes, what the fit leaves of ln of the amplitude
    and of the phase, the window's length, and how many samples it is worth."""
    half = 0.5 * (t[-1] - t[0])
    x = (t - t[0]) / half - 1
    both = np.column_stack([level, phase])
    c = np.polynomial.polynomial.polyfit(x, both, 2)
    left = both - np.polynomial.polynomial.polyval(x, c).T
    worth = max(2 * half * width, 3.0)
    # Three numbers of each parabola are taken from what the samples are worth.
    rest = np.sqrt(np.mean(left**2, axis=0) * worth / max(worth - 3.0, 0.5))
    return c[0, 0], -c[1, 0] / half, abs(c[1, 1]) / half, *rest, 2 * half, worth


def _backbone(windows: np.ndarray, response: str, band) -> MeasuredBackbone:
    level, decay, turning, _, _, length, worth = windows.T
    sizes, rest = np.exp(level), windows[:, 3:5]
    # Noise of the instruments does not fall with the amplitude.
    floor = np.quantile(rest * sizes[:, None], 0.25, axis=0) if len(sizes) else np.zeros(2)
    rest = np.maximum(rest, floor / sizes[:, None])
    slopes = rest * (np.sqrt(12 / worth) / length)[:, None]
    omega = np.hypot(turning, decay)
    good = (rest < _POOR).all(axis=1) & (decay > 0)
    good &= (omega > 2 * np.pi * band[0]) & (omega < 2 * np.pi * band[1])
    if not good.any():
        raise InputError(
            f"no decay of one mode is seen between {band[0]:.4g} and {band[1]:.4g} Hz; expected a "
            "free decay above the noise, and a band that holds one mode"
        )
    notes = []
    beats = (rest >= _POOR).any(axis=1) & (sizes > 0.1 * sizes.max())
    if beats.any():
        notes.append(
            f"{int(beats.sum())} of {len(sizes)} windows of the decay are left out: their envelope "
            "beats, as with another mode in the band"
        )
    f, zeta = (omega / (2 * np.pi))[good], (decay / omega)[good]
    f_sd, zeta_sd = slopes[good, 1] / (2 * np.pi), (slopes[:, 0] / omega)[good]
    return MeasuredBackbone(
        response,
        sizes[good],
        f,
        np.hypot(np.maximum(f_sd, 1e-9 * f), _averaged(f)),
        zeta,
        np.hypot(np.maximum(zeta_sd, 1e-9), _averaged(zeta)),
        kind="ring-down",
        notes=tuple(notes),
    )


def _averaged(values: np.ndarray) -> np.ndarray:
    """What a mean over each window may be off where its neighbours say that the course bends.

    The mean of a parabola over a window is a 24th of its second difference beside the value at the
    middle; twice that is taken.
    """
    if len(values) < 3:
        return np.zeros(len(values))
    bend = np.abs(np.diff(values, 2)) / 12
    return np.concatenate([bend[:1], bend, bend[-1:]])
