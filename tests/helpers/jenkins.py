"""An oscillator with a Jenkins element, its motion stepped in time and its backbone in closed form.

The backbone is that of the first harmonic: stiffness and loss per cycle of an elastic slider at the
amplitude a (Iwan, J. Appl. Mech. 33, 1966).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Jenkins:
    """Unit mass on a spring, a viscous damper and a slider that holds ``strength`` newtons."""

    hz: float = 80.0
    zeta: float = 5e-4
    share: float = 0.02
    strength: float = 0.1

    @property
    def stiffness(self) -> float:
        """At rest, N/m."""
        return (2 * np.pi * self.hz) ** 2

    @property
    def yields_at(self) -> float:
        """m."""
        return self.strength / (self.share * self.stiffness)

    def backbone(self, a):
        """(frequency in Hz, damping ratio) at amplitudes of displacement, m."""
        ratio = self.yields_at / np.maximum(a, self.yields_at)
        angle = np.arccos(1 - 2 * ratio)
        secant = (angle - 0.5 * np.sin(2 * angle)) / np.pi
        k = self.stiffness * (1 - self.share * (1 - secant))
        loss = 4 * self.strength * np.maximum(a - self.yields_at, 0.0)
        viscous = 2 * self.zeta * 2 * np.pi * self.hz
        f = np.sqrt(k) / (2 * np.pi)
        return f, loss / (2 * np.pi * k * a**2) + viscous / (2 * np.sqrt(k))

    def at_acceleration(self, level, hz) -> np.ndarray:
        """Acceleration over force, 1/kg, complex, where an acceleration, m/s2, is held."""
        w = 2 * np.pi * np.asarray(hz)
        f, zeta = self.backbone(level / w**2)
        own = 2 * np.pi * f
        return -(w**2) / (own**2 - w**2 + 2j * zeta * own * w)

    def motion(self, force, steps: int, dt: float, x: float = 0.0, v: float = 0.0):
        """(times, displacements, accelerations) by central differences.

        Args:
            force: N, at each of the steps, or 0.
            steps: How many.
            dt: s.
            x: Displacement at the start, m.
            v: Velocity, m/s.
        """
        k, kt = self.stiffness * (1 - self.share), self.stiffness * self.share
        c, slider, most = 2 * self.zeta * 2 * np.pi * self.hz, 0.0, self.yields_at
        force = np.broadcast_to(force, steps).tolist()
        xs, accelerations = np.empty(steps), np.empty(steps)
        for i in range(steps):
            slider = min(max(slider, x - most), x + most)
            a = force[i] - k * x - kt * (x - slider) - c * v
            xs[i], accelerations[i] = x, a
            v += a * dt
            x += v * dt
        return dt * np.arange(steps), xs, accelerations

    def held(self, force: float, frequencies) -> np.ndarray:
        """Complex displacement per force, first harmonic, at a steady force, m/N.

        By the describing function, at the largest of the amplitudes that it allows.
        """
        found, a = [], np.geomspace(1e-8, 1e-1, 4001)
        f, zeta = self.backbone(a)
        for hz in frequencies:
            w = 2 * np.pi * hz
            size = np.abs((2 * np.pi * f) ** 2 - w**2 + 4j * np.pi * zeta * f * w)
            more = np.log(a * size / force)
            i = int(np.flatnonzero((more[:-1] < 0) & (more[1:] >= 0))[-1])
            share = -more[i] / (more[i + 1] - more[i])
            own, damped = self.backbone(a[i] * (a[i + 1] / a[i]) ** share)
            found.append(1 / ((2 * np.pi * own) ** 2 - w**2 + 4j * np.pi * damped * own * w))
        return np.array(found)


def table(head: str, *columns) -> str:
    """A table in CSV."""
    rows = (",".join(f"{v:.9g}" for v in row) for row in zip(*columns, strict=True))
    return "\n".join([head, *rows]) + "\n"
