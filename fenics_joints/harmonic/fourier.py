"""Fourier series in real harmonics: samples, time derivatives, amplitudes.

Coefficients are ordered mean, cos 1, sin 1, cos 2, sin 2, ...; u(t) = c0 + sum a_h cos(h w t) +
b_h sin(h w t).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fenics_joints.errors import InputError, whole

#: Time derivatives by name.
KINDS = {"displacement": 0, "velocity": 1, "acceleration": 2}
#: Definitions of amplitude: that of the first harmonic, or half of peak to peak.
MEASURES = ("first", "peak")
#: Samples per coefficient among which an extreme is sought before Newton's method; chosen.
_EXTREMES = 32


@dataclass(frozen=True)
class Fourier:
    """Real Fourier basis up to harmonic H, and samples of one period.

    A response may take several periods of its force, as after a period doubling. Harmonics and
    omega are the force's then, and the basis has those in between too.

    Args:
        harmonics: H, at least 1.
        samples: T, samples of a period, of the response's if that is longer than the force's.
        periods: Of the force, that one of the response takes.

    Raises:
        InputError: If there are no harmonics, or fewer than 2H + 2 samples.
    """

    harmonics: int
    samples: int
    periods: int = 1

    def __post_init__(self):
        whole("harmonics", self.harmonics)
        least = 2 * self.harmonics * whole("periods", self.periods) + 2
        if whole("samples", self.samples) < least:
            raise InputError(
                f"samples = {self.samples}: expected at least {least} for {self.harmonics} "
                f"harmonics{f' and {self.periods} periods' if self.periods > 1 else ''}."
            )

    @property
    def size(self) -> int:
        """Coefficients of a series, K = 2H + 1; of more periods 2 H periods + 1."""
        return 2 * self.harmonics * self.periods + 1

    @cached_property
    def synthesis(self) -> np.ndarray:
        """From coefficients to samples, (T, K)."""
        return basis(2 * np.pi * np.arange(self.samples) / self.samples, self.size)

    @cached_property
    def derivative(self) -> np.ndarray:
        """Coefficients of du/d(wt) by those of u, (K, K)."""
        return derivative(self.size) / self.periods

    def cosine(self, harmonic: int = 1) -> int:
        """Index of a harmonic's cosine among the coefficients; its sine is the next one."""
        return 2 * harmonic * self.periods - 1


def basis(angles, size: int) -> np.ndarray:
    """Harmonics at the angles w t, (..., K)."""
    angles = np.asarray(angles, dtype=float)[..., None]
    h = np.arange(1, size // 2 + 1)
    values = np.empty((*angles.shape[:-1], size))
    values[..., 0], values[..., 1::2], values[..., 2::2] = (
        1.0,
        np.cos(h * angles),
        np.sin(h * angles),
    )
    return values


def derivative(size: int) -> np.ndarray:
    """Coefficients of du/d(wt) by those of u, (K, K)."""
    G, h = np.zeros((size, size)), np.arange(1, size // 2 + 1)
    G[2 * h - 1, 2 * h], G[2 * h, 2 * h - 1] = h, -h
    return G


def differentiated(c: np.ndarray, omega, kind: str, periods: int = 1) -> np.ndarray:
    """Coefficients (..., K) of a time derivative; omega in rad/s, scalar or (...,).

    Args:
        c: Coefficients.
        omega: Of the force, whose ``periods`` one of the series takes.
        kind: ``displacement``, ``velocity`` or ``acceleration``.
        periods: See `Fourier`.

    Raises:
        InputError: For an unknown kind.
    """
    if kind not in KINDS:
        raise InputError(f"kind = {kind!r}: expected one of: {', '.join(KINDS)}.")
    G = derivative(c.shape[-1]) / periods
    for _ in range(KINDS[kind]):
        c = np.asarray(omega)[..., None] * (c @ G.T)
    return c


def amplitude(c: np.ndarray, measure: str = "first", periods: int = 1) -> np.ndarray:
    """Amplitudes of series (..., K), without their mean.

    Args:
        c: Coefficients.
        measure: ``first``: of the force's first harmonic; ``peak``: half of peak to peak.
        periods: See `Fourier`.

    Raises:
        InputError: For an unknown measure.
    """
    _check_measure(measure)
    if measure == "first":
        return np.hypot(c[..., 2 * periods - 1], c[..., 2 * periods])
    high, low = (np.einsum("...k,...k->...", _extreme(c, s), c) for s in (1, -1))
    return 0.5 * (high - low)


def amplitude_gradient(c: np.ndarray, measure: str = "first", periods: int = 1) -> np.ndarray:
    """Derivatives of amplitudes by the coefficients, (..., K); zero for a series that rests."""
    _check_measure(measure)
    if measure == "first":
        first = slice(2 * periods - 1, 2 * periods + 1)
        size = np.linalg.norm(c[..., first], axis=-1)
        gradient = np.zeros_like(c)
        gradient[..., first] = c[..., first] / np.where(size > 0, size, 1.0)[..., None]
        return gradient
    # The time of an extreme may be held: there the velocity vanishes.
    return 0.5 * (_extreme(c, 1) - _extreme(c, -1))


def moving_size(X: np.ndarray) -> float:
    """Norm of the coefficients (n, K) without the mean; 1 at rest."""
    return float(np.linalg.norm(X[:, 1:])) or 1.0


def _check_measure(measure: str) -> None:
    if measure not in MEASURES:
        raise InputError(f"measure = {measure!r}: expected one of: {', '.join(MEASURES)}.")


def _extreme(c: np.ndarray, sign: int) -> np.ndarray:
    """The basis at the time of the largest (sign 1) or smallest (-1) value, (..., K)."""
    K = c.shape[-1]
    grid = 2 * np.pi * np.arange(_EXTREMES * K) / (_EXTREMES * K)
    angle = grid[np.argmax(sign * (c @ basis(grid, K).T), axis=-1)]
    first, G = c @ derivative(K).T, derivative(K)
    second = first @ G.T
    for _ in range(4):
        at = basis(angle, K)
        slope, bend = (np.einsum("...k,...k->...", at, d) for d in (first, second))
        safe = sign * bend < 0
        move = np.where(safe, -slope / np.where(safe, bend, 1.0), 0.0)
        angle = angle + np.clip(move, -grid[1], grid[1])
    return basis(angle, K)
