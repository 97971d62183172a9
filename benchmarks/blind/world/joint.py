"""Stiffness of the interface, point by point: what is done to a joint in a case."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .rigs import Rig
from .whole import BONDED

#: Pa/m where there is no contact: nothing.
OPEN = 1e7


def bolt_force(rig: Rig, torque: float) -> float:
    """N, from N m, with the usual nut factor 0.2."""
    return torque / (0.2 * rig.bolt_diameter)


def series(a, b):
    """Stiffness of two springs one after another."""
    return 1 / (1 / a + 1 / b)


@dataclass
class Joint:
    """What is between the bodies, beyond faces that are as one.

    Attributes:
        uniform: (k_n, k_t, beta) at the highest torque, Pa/m; inf for as one. k ~ torque^beta.
        graded: (k, beta): k (p / p_max)^beta, p_max that at the highest torque.
        cutoff: Pressure, Pa, below which nothing holds.
        loose: Stiffness, Pa/m, where a bolt bears most of the load, by the bolt's number.
        band: (x, half, k): a band across the lap, in shares of the lap, where only k is left.
    """

    uniform: list[tuple[float, float, float]] = field(default_factory=list)
    graded: list[tuple[float, float]] = field(default_factory=list)
    cutoff: list[float] = field(default_factory=list)
    loose: dict[int, float] = field(default_factory=dict)
    band: list[tuple[float, float, float]] = field(default_factory=list)

    def stiffness(self, rig: Rig, points, pressure, torque: float):
        """k_n and k_t at every point, Pa/m.

        Args:
            rig: The rig.
            points: Of the interface, (n, 2).
            pressure: Of each bolt per newton, Pa/N, (n_bolts, n).
            torque: N m.
        """
        top = max(rig.torques)
        p = pressure.sum(axis=0) * bolt_force(rig, torque)
        most = pressure.sum(axis=0).max() * bolt_force(rig, top)
        k_n, k_t = np.full(len(points), BONDED), np.full(len(points), BONDED)
        for n, t, beta in self.uniform:
            factor = (torque / top) ** beta
            k_n, k_t = series(k_n, n * factor), series(k_t, t * factor)
        for k, beta in self.graded:
            local = k * (p / most) ** beta + OPEN if beta > 0 else np.full(len(p), k)
            k_n, k_t = series(k_n, local), series(k_t, local)
        for cutoff in self.cutoff:
            k_n, k_t = (np.where(p > cutoff, k, OPEN) for k in (k_n, k_t))
        nearest = np.argmin(
            [np.hypot(points[:, 0] - b.x, points[:, 1] - b.y) for b in rig.bolts], axis=0
        )
        for bolt, k in self.loose.items():
            at = nearest == bolt
            k_n, k_t = np.where(at, series(k_n, k), k_n), np.where(at, series(k_t, k), k_t)
        x = (points[:, 0] - points[:, 0].min()) / np.ptp(points[:, 0])
        for centre, half, k in self.band:
            at = np.abs(x - centre) < half
            k_n, k_t = np.where(at, series(k_n, k), k_n), np.where(at, series(k_t, k), k_t)
        return k_n, k_t
