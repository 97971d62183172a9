"""Loads beside the first: at other places, of other harmonics, with phases of their own."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from fenics_joints.errors import InputError, real, text, whole
from fenics_joints.harmonic.balance import Balance

__all__ = ["Load", "load_coefficients", "load_work"]


@dataclass(frozen=True)
class Load:
    """A load amplitude * cos(harmonic * w t + phase) at a place.

    Attributes:
        force: Name of the place.
        amplitude: N.
        harmonic: Of the frequency.
        phase: rad; a load with a positive one comes earlier.
    """

    force: str
    amplitude: float
    harmonic: int = 1
    phase: float = 0.0

    def __post_init__(self):
        text("load.force", self.force)
        real("load.amplitude", self.amplitude, "N")
        real("load.phase", self.phase, "rad")
        whole("load.harmonic", self.harmonic)


def load_coefficients(balance: Balance, loads: Iterable[Load]) -> np.ndarray:
    """Coefficients (n, K) of some loads together.

    Raises:
        InputError: For an unknown place, or a harmonic that the balance does not have.
    """
    found = np.zeros(balance.shape)
    for load in loads:
        if load.harmonic > balance.fourier.harmonics:
            raise InputError(
                f"load.harmonic = {load.harmonic}: expected at most {balance.fourier.harmonics}, "
                "the highest of the balance."
            )
        row = load.amplitude * balance.model.row("forces", load.force)
        found[:, 2 * load.harmonic - 1] += np.cos(load.phase) * row
        found[:, 2 * load.harmonic] -= np.sin(load.phase) * row
    return found


def load_work(balance: Balance, loads: Iterable[Load], X: np.ndarray) -> np.ndarray:
    """Work of the loads per cycle, J, (N,), on motions X (N, n, K)."""
    F, h = load_coefficients(balance, loads), np.arange(1, balance.fourier.harmonics + 1)
    along = np.einsum("nh,pnh->ph", F[:, 1::2], X[:, :, 2::2])
    against = np.einsum("nh,pnh->ph", F[:, 2::2], X[:, :, 1::2])
    return np.pi * (along - against) @ h
