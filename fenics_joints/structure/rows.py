"""Displacement of a reduced basis at points: forces and responses of a model without a mesh."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from fenics_joints.errors import InputError
from fenics_joints.structure.points import Sensors

#: Points nearer than this share of the extent of all are one.
_SAME = 1e-9


@dataclass(frozen=True)
class PlaceRows:
    """The whole displacement at points, so that any direction there can be read or loaded.

    Attributes:
        points: Positions, m, (k, gdim).
        rows: Displacement of every vector of the basis there, (k, gdim, n).
    """

    points: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    rows: np.ndarray = field(default_factory=lambda: np.zeros((0, 3, 0)))

    def has(self, sensors: Sensors) -> bool:
        """Whether all these sensors stand at the points."""
        return not np.any(self._index(sensors) < 0)

    def at(self, sensors: Sensors, what: str = "sensor") -> np.ndarray:
        """Components along the sensors' directions, (n_sensors, n).

        Raises:
            InputError: If a sensor stands at none of the points; ``what`` is its name there.
        """
        index = self._index(sensors)
        if np.any(index < 0):
            lost = sensors.points[int(np.argmax(index < 0))]
            raise InputError(
                f"{what} at {lost.tolist()} m: expected one of the {len(self.points)} places that "
                "the reduced model was made with, see ReducedStructure.arrays."
            )
        gdim = self.points.shape[1]
        return np.einsum("kgn,kg->kn", self.rows[index], sensors.directions[:, :gdim])

    def on(self, basis: np.ndarray) -> PlaceRows:
        """The same on fewer vectors, which are the columns of ``basis``."""
        return replace(self, rows=self.rows @ basis)

    def _index(self, sensors: Sensors) -> np.ndarray:
        """The point of each sensor, or -1, (n_sensors,)."""
        known = self.points
        if not len(known):
            return np.full(len(sensors), -1)
        apart = np.abs(sensors.points[:, None, : known.shape[1]] - known).max(axis=2)
        near = np.argmin(apart, axis=1)
        found = apart[np.arange(len(near)), near] <= _SAME * (1e-3 + np.ptp(known, axis=0).max())
        return np.where(found, near, -1)
