"""An unknown cause that has a place: a change of stiffness and mass somewhere, or a point mass.

*A change somewhere.* Most causes outside the library have a place all the same: a lining, a
filling, a hole, a part of another material. So ln of the stiffness and of the mass of every patch
of the structure are a Gaussian random field before the test, smooth over a length and of a size
that are not known. All data are linear in it (`fenics_joints.diagnosis.evidence.signatures`), so
that the evidence is in closed form for each length and size, and is summed over these. The
alternative is a covariance with independent changes of all modes, which ignores that a change at
one place moves all frequencies and turns all shapes together.

*A point mass*: its size and place, by a scan over both. Its size is of interest even if the
diagnosis looks for no effects with a place. In the basis of the nominal model's n modes,

    (diag(lambda) - mu (I + m Phi^T Phi)) y = 0

gives the modes with a mass m at a point at which the n shapes have the displacements Phi, (3, n).
So each place and size is a small eigenproblem; nuisance parameters enter linearly.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.linalg import block_diag
from scipy.special import logsumexp

from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.fitted import Fit
from fenics_joints.diagnosis.evidence.linear import LinearFit, log_constant, marginal, whiten
from fenics_joints.diagnosis.evidence.signatures import LENGTHS
from fenics_joints.diagnosis.thresholds import INTERVAL, STRONG
from fenics_joints.measurements.gap import ALIKE, Pairing
from fenics_joints.modal.modes import Modes
from fenics_joints.structure.points import Sensors

#: Trial masses as shares of the structure's, with equal probability in ln: all of them at the best
#: places, every fourth elsewhere; and ln of the odds from the best within which a place counts.
#: [numerical: chosen]
_SHARES, _COARSE, _NEAR = np.geomspace(2e-3, 0.5, 49), 4, 8.0

#: Eigenvalue, over the largest, below which a mode is rigid. [numerical: round-off]
_ELASTIC = 1e-9


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
    found: Fit,
    test: Evidence,
    modes: Modes,
    pairing: Pairing,
    sensors: Sensors | None,
    points: np.ndarray,
    total: float,
) -> PointMassFound | None:
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
    gdim, count = points.shape[1], len(modes)
    ways = Sensors(np.repeat(points, gdim, axis=0), np.tile(np.eye(gdim), (len(points), 1)))
    moves = modes.at(ways).reshape(len(points), gdim, count)
    seen = None if test.shapes is None else modes.at(sensors)
    scan = PointScan(found, test.at(found.scales), modes.eigenvalues, pairing, seen)
    sizes, nothing = _SHARES * total, scan.nothing
    coarse = np.array([scan.attached(phi, sizes[::_COARSE]) for phi in moves])
    log_odds = float(logsumexp(coarse) - np.log(coarse.size) - nothing)
    if not log_odds > np.log(STRONG):
        return None
    near = np.flatnonzero(coarse.max(axis=1) > coarse.max() - _NEAR)
    score = np.array([scan.attached(moves[i], sizes) for i in near])
    by_size = np.exp(logsumexp(score, axis=0) - logsumexp(score))
    ends = np.interp([(1 - INTERVAL) / 2, (1 + INTERVAL) / 2], np.cumsum(by_size), sizes)
    place = near[int(np.argmax(logsumexp(score, axis=1)))]
    best = float(np.exp(np.sum(by_size * np.log(sizes))))
    if ends[1] >= sizes[-2]:
        return None  # half of the structure's mass: no attached mass
    low, high = min(ends[0], best), max(ends[1], best)
    return PointMassFound(best, float(low), float(high), tuple(points[place].tolist()), log_odds)


class PointScan:
    """How well an attachment at a point explains a test, in the modes of a model.

    Args:
        found: A prediction without it, its slopes by what is uncertain, and at which z: a `Fit`.
        test: The test, at its scales.
        eigenvalues: Of the model's modes, (n,).
        pairing: Which of them the test's are. The test's modes that are unlike theirs are sought
            among all that have something attached, by their shapes.
        seen: Their displacements at the sensors, (n_s, n); None without shapes.
    """

    def __init__(
        self, found, test: Evidence, eigenvalues, pairing: Pairing, seen: np.ndarray | None
    ):
        self.test, self.index, self.seen = test, pairing.index, seen
        known = seen is not None and pairing.mac is not None
        self.lost = np.flatnonzero(pairing.mac < ALIKE) if known else np.zeros(0, dtype=int)
        self.lam, self.lower, self.used = np.maximum(eigenvalues, 0.0), test.lower(), test.fitted
        self.linear = LinearFit.of(found, test, self.lower)
        self.nothing = -0.5 * self.linear.square

    def attached(self, phi: np.ndarray, kg=0.0, k=0.0, hz: float | None = None) -> np.ndarray:
        """ln of the density with something attached, up to a constant, (b,).

        Args:
            phi: What the modes move the point, (gdim, n).
            kg: Masses, (b,).
            k: Springs to the ground in each direction, (b, gdim).
            hz: Frequency of the masses on springs of their own; None: they are rigidly attached.
        """
        n, gdim = len(self.lam), len(phi)
        kg, k = np.atleast_1d(kg), np.atleast_2d(k)
        b = max(len(kg), len(k))
        kg, k = np.broadcast_to(kg, b), np.broadcast_to(k, (b, gdim))
        if hz is None:
            M = np.eye(n) + kg[:, None, None] * (phi.T @ phi)
            K = np.diag(self.lam) + (phi.T * k[:, None]) @ phi
            back = np.linalg.inv(np.linalg.cholesky(M))
            mu, y = np.linalg.eigh(back @ K @ back.transpose(0, 2, 1))
            y = back.transpose(0, 2, 1) @ y
        else:
            square, K = (2 * np.pi * hz) ** 2, np.zeros((len(kg), n + gdim, n + gdim))
            K[:, :n, :n] = np.diag(self.lam) + square * kg[:, None, None] * (phi.T @ phi)
            K[:, n:, :n] = -square * np.sqrt(kg)[:, None, None] * phi
            K[:, n:, n:] = square * np.eye(gdim)
            mu, y = np.linalg.eigh(K)
            y = y[:, :n]
        which = np.argmax(np.abs(y[:, self.index]), axis=2)
        if len(self.lost):
            which[:, self.lost] = self._likest(mu, y)
        found = np.take_along_axis(mu, which, axis=1)
        log_f = 0.5 * np.log(np.maximum(found, 1e-300) / self.lam[self.index])
        shapes = None
        if self.seen is not None:
            own = np.take_along_axis(y, which[:, None], axis=2)
            shapes = _shape_change(self.test.shapes, self.seen, self.index, own).transpose(1, 2, 0)
        changes = self.test.entries.filled(log_f.T, shapes)[self.used]
        return -0.5 * self.linear.squares(whiten(self.lower, changes))

    def _likest(self, mu: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Modes with the attachment whose shapes are most like those of the test's modes that no
        mode without it is like."""
        measured = self.test.shapes[:, self.lost]
        there = np.isfinite(measured)
        t, x = np.where(there, measured, 0.0), self.seen @ y
        both = (x.transpose(0, 2, 1) @ t) ** 2
        size = (x**2).transpose(0, 2, 1) @ there
        elastic = (mu > _ELASTIC * self.lam.max())[:, :, None]
        return np.argmax(np.where(elastic, both / np.maximum(size, 1e-300), 0.0), axis=1)


def _shape_change(measured, seen: np.ndarray, index: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Changes of shapes at the sensors, (b, n_s, m), as the measured ones are scaled."""
    there = np.isfinite(measured)
    t = np.where(there, measured, 0.0)
    scaled = []
    for x in (seen[:, index], seen @ y):
        x = np.where(there, x, 0.0)
        size = np.maximum(np.sum(x**2, axis=-2, keepdims=True), 1e-300)
        scaled.append(x * np.sum(x * t, axis=-2, keepdims=True) / size)
    return scaled[1] - scaled[0]


#: Standard deviations of ln E and ln rho of a patch, relative to those that signatures are of, each
#: with its prior probability. [decision: chosen]
_SIZES = ((1 / 3, 0.25), (1.0, 0.5), (3.0, 0.25))
#: Whether stiffness changes, and mass: either, or both. [decision: all there are]
_KINDS = ((1.0, 0.0), (0.0, 1.0), (1.0, 1.0))
#: Prior probability that an unknown cause has a place, and does not move modes independently.
#: [decision: indifference]
_PLACED = 0.5


@dataclass(frozen=True)
class LocalisedUnknown:
    """An unknown cause that has a place; `fenics_joints.diagnosis.location` says where.

    Attributes:
        probability: That the unknown cause is of this kind, if there is one.
        point: The one point mass that explains the test best; None if none does.
    """

    probability: float
    point: PointMassFound | None = None


def _localised(residual: np.ndarray, slope: np.ndarray, test: Evidence, tried) -> np.ndarray:
    """ln of the evidence of each test, (t,), if the unknown cause has a place.

    Args:
        residual: Predictions less data where all parameters but those at a limit are 0, of t tests,
            (k, t).
        slope: Derivatives by the parameters that are not at a limit, (k, p).
        test: Has the metric.
        tried: Scales with ln of their weights; see `Scales.tried`.
    """
    t, own, scores = residual.shape[1], slope.shape[1], []
    # The patches' changes are the same at all scales.
    columns = [column[test.fitted] for column in test.patch_columns()]
    for scales, weight in tried:
        lower = test.at(scales).lower()
        white = whiten(lower, np.column_stack([residual, slope, *columns]))
        r, fixed, patches = np.split(white, [t, t + own], axis=1)
        for kind, (size, b), length in product(_KINDS, _SIZES, LENGTHS):
            root = size * test.signatures.root(length)
            root = block_diag(*(on * root for on in (*kind, kind[0])[: len(columns)]))
            more = weight + np.log(b / (len(_KINDS) * len(LENGTHS))) - log_constant(lower)
            scores.append(more + marginal(r, np.hstack([fixed, patches @ root])))
    return logsumexp(scores, axis=0)


def with_localised_unknown(found: Fit, test: Evidence) -> Fit:
    """A fit of an unknown cause with the evidence of both kinds: a change somewhere, and one that
    moves each mode independently; unchanged where the test has no signatures.

    Args:
        found: The fit of an unknown cause of the second kind.
        test: The test.
    """
    if test.signatures is None:
        return found
    used, free = test.fitted, ~found.hypothesis.at_limit(found.z)
    slope, residual = found.jacobian[used], (found.predicted - test.data)[used]
    residual = residual - slope[:, free] @ found.z[free]
    tried = [(None, 0.0)] if test.scales is None else test.scales.tried()
    placed = float(_localised(residual[:, None], slope[:, free], test, tried)[0]) + np.log(_PLACED)
    placed -= 0.5 * float(found.z[~free] @ found.z[~free])
    both = float(np.logaddexp(found.log_evidence + np.log(1 - _PLACED), placed))
    return replace(found, log_evidence=both, placed=float(np.exp(placed - both)))


def unknown_evidence(
    predicted: np.ndarray, slope: np.ndarray, data: np.ndarray, test: Evidence
) -> np.ndarray:
    """ln of the evidence of an unknown cause for other data of a test's entries, (t,).

    Args:
        predicted: By the nominal model, (k,).
        slope: Derivatives by what is uncertain in any case, (k, p).
        data: The data, (t, k).
        test: The test, whose scales are taken.
    """
    lower = test.lower(unknown=True)
    white = whiten(lower, np.column_stack([predicted[:, None] - data.T, slope]))
    residual, wide = white[:, : len(data)], white[:, len(data) :]
    anything = marginal(residual, wide) - log_constant(lower)
    if test.signatures is None:
        return anything
    placed = _localised(predicted[:, None] - data.T, slope, test, [(None, 0.0)])
    return np.logaddexp(anything + np.log(1 - _PLACED), placed + np.log(_PLACED))
