"""Where measured shapes contradict a model of beams; see `diagnosis.where.constitutive`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import scipy.linalg

from fenics_joints.beams import BeamStructure
from fenics_joints.beams.boxes import BeamCells
from fenics_joints.beams.cells import JOINT_KEYS, cell_energies
from fenics_joints.diagnosis.where.constitutive import ConstitutiveError, TwoFields, check_measured
from fenics_joints.diagnosis.where.patches import Patches
from fenics_joints.errors import ConvergenceError
from fenics_joints.structure.points import Sensors

__all__ = ["beam_constitutive_error"]

#: Relative residual above which the system is taken to be singular.
_RESIDUAL = 1e-4


class _DenseTwoFields(TwoFields):
    """The same system with dense matrices, equal on every rank."""

    def __init__(self, structure, cells, names, region, given, sensors, gamma):
        self.structure, self.given, self.gamma, self.sensors = structure, given, gamma, sensors
        self.cells, self.names, self.region = cells, names, region
        self.K, self.M = structure.stiffness(given), structure.mass(given)
        self.P = structure.rows(sensors)

    def _solve(self, loads, there, omega: float, rho: float) -> list[tuple]:
        P = self.P * there[:, None]
        A = self.K - omega**2 * self.M
        B = -self.K / self.gamma - omega**2 / (1 - self.gamma) * self.M
        whole = np.block([[rho * P.T @ P, A], [A, B]])
        # Of u and lambda alike: turns, motions and both fields are of other units.
        scale = 1 / np.sqrt(np.maximum(np.abs(whole).max(axis=0), 1e-300))
        right = np.vstack([rho * P.T @ np.array(loads).T, np.zeros((len(A), len(loads)))])
        try:
            found = scipy.linalg.solve(
                scale[:, None] * whole * scale, scale[:, None] * right, assume_a="sym"
            )
        except scipy.linalg.LinAlgError as error:
            raise ConvergenceError("the two fields could not be solved for", str(error)) from error
        found *= scale[:, None]
        size = np.linalg.norm(scale[:, None] * (whole @ found - right))
        size /= np.linalg.norm(scale[:, None] * right)
        if not size < _RESIDUAL:
            raise ConvergenceError(
                "the two fields could not be solved for: do the sensors see every mode of the "
                "model near the measured frequency?", f"relative residual {size:.1e}",
            )  # fmt: skip
        n = len(A)
        return [(found[:n, i], found[n:, i]) for i in range(len(loads))]

    def _release(self, fields) -> None:
        pass

    def _read(self, u: np.ndarray) -> np.ndarray:
        return self.P @ u

    def _energies(self, x: np.ndarray, omega: float, split: Patches):
        found = cell_energies(self.structure, self.cells, x[:, None], self.given)
        stiff = sum(found[key] for key in ("E", *JOINT_KEYS))[:, 0]
        heavy = omega**2 * found["rho"][:, 0]
        n = len(self.names)
        by_region = (np.bincount(self.region, values, n) for values in (stiff, heavy))
        return (*by_region, np.bincount(split.number, stiff, len(split)))


def beam_constitutive_error(
    structure: BeamStructure,
    cells: BeamCells,
    labels: Sequence[str],
    given: Mapping[str, float],
    shapes: np.ndarray,
    frequencies_hz: Sequence[float],
    sensors: Sensors,
    split: Patches,
    *,
    gamma: float = 0.5,
    noise: float = 0.02,
    draws: int = 8,
) -> ConstitutiveError:
    """Where the laws must be violated for beams to move as measured.

    Args:
        structure: The beams.
        cells: Their cells.
        labels: Region of each cell.
        given: Values of parameters that differ from their nominal value.
        shapes: Measured shapes, (n_sensors, m); nan where a sensor was missing.
        frequencies_hz: Measured frequencies, (m,).
        sensors: Where and in which direction they were measured.
        split: Patches to report as well.
        gamma: See `constitutive_error`.
        noise: Likewise.
        draws: Likewise.

    Raises:
        InputError: If shapes, frequencies and sensors do not agree, or a value is out of range.
        ConvergenceError: If the system is singular: sensors that miss a mode at its frequency.
    """
    shapes, hz = np.asarray(shapes, dtype=float), np.asarray(frequencies_hz, dtype=float)
    check_measured(shapes, hz, sensors, gamma, noise)
    names = tuple(dict.fromkeys(labels))
    region = np.array([names.index(label) for label in labels])
    system = _DenseTwoFields(structure, cells, names, region, given, sensors, gamma)
    pairs = zip(shapes.T, 2 * np.pi * hz, strict=True)
    modes = [system.mode(s, omega, noise, split, draws) for s, omega in pairs]
    tables = {key: np.array([mode[key] for mode in modes]).T for key in modes[0]}
    volume = np.bincount(region, cells.volume)
    return ConstitutiveError(
        hz, regions=names, volume=volume / volume.sum(), patches=split.names,
        patch_volume=split.volume / volume.sum(), **tables,
    )  # fmt: skip
