"""An unknown cause as one point mass: its size and place, by a scan over places and sizes.

The size of an unmodelled mass is of interest even if the diagnosis does not look for effects with a
place. In the basis of the nominal model's n modes,

    (diag(lambda) - mu (I + m Phi^T Phi)) y = 0

gives the modes with a mass m at a place where the n shapes have the displacements Phi, (3, n). So
each place and size is a small eigenproblem; the nuisance parameters enter linearly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from scipy.special import logsumexp

from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.fitted import Fit
from fenics_joints.diagnosis.evidence.linear import least_square, whiten
from fenics_joints.diagnosis.thresholds import INTERVAL, STRONG
from fenics_joints.measurements.gap import Pairing
from fenics_joints.modal.modes import Modes
from fenics_joints.structure.points import Sensors

__all__ = ["PointMassFound", "point_mass"]

#: Trial masses as shares of the structure's, with equal probability in ln: all of them at the best
#: places, every fourth elsewhere; and ln of the odds from the best within which a place counts.
#: [numerical: chosen]
_SHARES, _COARSE, _NEAR = np.geomspace(2e-3, 0.5, 49), 4, 8.0


@dataclass(frozen=True)
class PointMassFound:
    """One point mass that would explain a test.

    Attributes:
        kg: Most probable size, kg.
        low: Lower end of the 90 % interval, over all places, kg.
        high: Upper end, kg.
        at: Most probable place, m.
        log_odds: ln of the evidence for a mass over that for none, over all places and sizes.
    """

    kg: float
    low: float
    high: float
    at: tuple[float, ...]
    log_odds: float


def point_mass(
    found: Fit, test: Evidence, modes: Modes, pairing: Pairing, sensors: Sensors | None,
    points: np.ndarray, total: float,
) -> PointMassFound | None:  # fmt: skip
    """The point mass that explains a test best; None if none explains it better than no mass.

    Args:
        found: A fit of the nuisance parameters only.
        test: The test.
        modes: The nominal model's modes.
        pairing: Pairs of test and model modes.
        sensors: Where shapes were measured; None without.
        points: Trial places, m, (n_points, gdim).
        total: The structure's mass, kg.
    """
    test = test.at(found.scales)
    lower, used = test.lower(), test.fitted
    slope = whiten(lower, found.jacobian[used])
    gdim, count = points.shape[1], len(modes)
    ways = Sensors(np.repeat(points, gdim, axis=0), np.tile(np.eye(gdim), (len(points), 1)))
    moves = modes.at(ways).reshape(len(points), gdim, count)
    seen = None if test.shapes is None else modes.at(sensors)
    lam = np.maximum(modes.eigenvalues, 0.0)
    free = ~found.hypothesis.at_limit(found.z)

    def fits(change: np.ndarray | float) -> float:
        """ln of the density at the best nuisance parameters, up to a constant."""
        residual = whiten(lower, (found.predicted + change - test.data)[used])
        return -0.5 * least_square(residual, slope, found.z, free)[0]

    def with_mass(phi: np.ndarray, kg: float) -> float:
        mu, y = scipy.linalg.eigh(np.diag(lam), np.eye(count) + kg * phi.T @ phi)
        which = np.argmax(np.abs(y[pairing.index]), axis=1)
        log_f = 0.5 * np.log(np.maximum(mu[which], 1e-300) / lam[pairing.index])
        shapes = None
        if seen is not None:
            shapes = _turned(test.shapes, seen, pairing.index, y[:, which])[..., None]
        return fits(test.entries.filled(log_f[:, None], shapes)[:, 0])

    sizes, nothing = _SHARES * total, fits(0.0)
    coarse = np.array([[with_mass(phi, kg) for kg in sizes[::_COARSE]] for phi in moves])
    log_odds = float(logsumexp(coarse) - np.log(coarse.size) - nothing)
    if not log_odds > np.log(STRONG):
        return None
    near = np.flatnonzero(coarse.max(axis=1) > coarse.max() - _NEAR)
    score = np.array([[with_mass(moves[i], kg) for kg in sizes] for i in near])
    by_size = np.exp(logsumexp(score, axis=0) - logsumexp(score))
    ends = np.interp([(1 - INTERVAL) / 2, (1 + INTERVAL) / 2], np.cumsum(by_size), sizes)
    place = near[int(np.argmax(logsumexp(score, axis=1)))]
    best = float(np.exp(np.sum(by_size * np.log(sizes))))
    if ends[1] >= sizes[-2]:
        return None  # half of the structure's mass: no attached mass
    low, high = min(ends[0], best), max(ends[1], best)
    return PointMassFound(best, float(low), float(high), tuple(points[place].tolist()), log_odds)


def _turned(measured, seen: np.ndarray, index: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Changes of shapes at the sensors, (n_s, m), as the measured ones are scaled."""
    there = np.isfinite(measured)
    t = np.where(there, measured, 0.0)
    scaled = []
    for x in (seen[:, index], seen @ y):
        x = np.where(there, x, 0.0)
        scaled.append(x * np.sum(x * t, axis=0) / np.maximum(np.sum(x**2, axis=0), 1e-300))
    return scaled[1] - scaled[0]
