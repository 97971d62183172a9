"""Loads at several places, of several harmonics, with phases and powers of the frequency."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from fenics_joints.errors import InputError, real, text, whole
from fenics_joints.harmonic.balance import Balance


@dataclass(frozen=True)
class Load:
    """A load amplitude * (harmonic * w)^power * cos(harmonic * w t + phase) at a place.

    Attributes:
        force: Name of the place.
        amplitude: N, with a power N s^power.
        harmonic: Of the frequency.
        phase: rad; a load with a positive one comes earlier.
        power: Of the frequency, rad/s: 2 for an unbalance, kg m, or a base that moves by m.
    """

    force: str
    amplitude: float
    harmonic: int = 1
    phase: float = 0.0
    power: int = 0

    def __post_init__(self):
        text("load.force", self.force)
        real("load.amplitude", self.amplitude, "N")
        real("load.phase", self.phase, "rad")
        whole("load.harmonic", self.harmonic)
        whole("load.power", self.power, -4, most=4)


class Loading:
    """Coefficients (n, K) of loads together, by the frequency.

    Args:
        parts: Coefficients by the power of the frequency that they are multiplied by.
    """

    def __init__(self, parts: dict[int, np.ndarray]):
        self._parts = parts

    @classmethod
    def of(cls, balance: Balance, loads: Iterable[Load]) -> Loading:
        """That of some loads on a model.

        Raises:
            InputError: For an unknown place, or a harmonic that the balance does not have.
        """
        parts = {0: np.zeros(balance.shape)}
        for load in loads:
            h = load.harmonic
            if h > balance.fourier.harmonics:
                raise InputError(
                    f"load.harmonic = {h}: expected at most {balance.fourier.harmonics}, the "
                    "highest of the balance."
                )
            part = parts.setdefault(load.power, np.zeros(balance.shape))
            row = load.amplitude * float(h) ** load.power * balance.model.row("forces", load.force)
            cosine = balance.fourier.cosine(h)
            part[:, cosine] += np.cos(load.phase) * row
            part[:, cosine + 1] -= np.sin(load.phase) * row
        return cls(parts)

    def times(self, share: float) -> Loading:
        """A share of these loads."""
        return Loading({p: share * part for p, part in self._parts.items()})

    def at(self, omega: float) -> np.ndarray:
        """Coefficients at a frequency, rad/s."""
        return sum(omega**p * part for p, part in self._parts.items())

    def slope(self, omega: float) -> np.ndarray:
        """Their derivative by it."""
        return sum(p * float(omega) ** (p - 1) * part for p, part in self._parts.items())


def load_work(
    balance: Balance, loads: Iterable[Load], X: np.ndarray, omegas: np.ndarray
) -> np.ndarray:
    """Work of the loads per cycle, J, (N,), on motions X (N, n, K) at their frequencies (N,)."""
    loading, periods = Loading.of(balance, loads), balance.fourier.periods
    h = np.arange(1, balance.fourier.harmonics * periods + 1) / periods
    F = np.array([loading.at(omega) for omega in omegas])
    along = np.einsum("pnh,pnh->ph", F[:, :, 1::2], X[:, :, 2::2])
    against = np.einsum("pnh,pnh->ph", F[:, :, 2::2], X[:, :, 1::2])
    return np.pi * (along - against) @ h
