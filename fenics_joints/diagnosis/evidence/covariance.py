"""What a test and any model of it may err, together: the covariance of a test's entries."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from fenics_joints.diagnosis.evidence.scales import MEMORY, WITH_FUNCTIONS, Scales, correlation

if TYPE_CHECKING:
    from fenics_joints.diagnosis.evidence.evidence import Evidence

#: Kinds of entries.
FREQUENCY, DAMPING, SHAPE, MASS, STIFFNESS, ANTIRESONANCE, FUNCTION = range(7)
#: Their names.
KINDS = (
    "frequencies",
    "damping",
    "shapes",
    "masses",
    "static stiffness",
    "antiresonances",
    "functions",
)


@dataclass(frozen=True)
class Entries:
    """What each entry of the data is; arrays of shape (N,).

    Attributes:
        kind: `FREQUENCY`, `DAMPING`, `SHAPE`, or one of a single number.
        row: Its condition; 0 for what depends on none, as masses.
        mode: Its mode; 0 for single numbers.
        sensor: Its sensor; -1 but for shapes.
    """

    kind: np.ndarray
    row: np.ndarray
    mode: np.ndarray
    sensor: np.ndarray

    @property
    def of_scalars(self) -> np.ndarray:
        """Which are of no mode and no condition: single numbers of their own."""
        return self.kind >= MASS

    def filled(self, log_f: np.ndarray, shapes: np.ndarray | None) -> np.ndarray:
        """Changes of every entry, (N, k), the same at all rows; nought of other kinds, and of modes
        beyond those that are known.

        Args:
            log_f: Of ln f, (m, k).
            shapes: Of the shapes at the sensors, (n_s, m, k); None for none.
        """
        found = np.zeros((len(self.kind), log_f.shape[1]))
        own = (self.kind == FREQUENCY) & (self.mode < len(log_f))
        found[own] = log_f[self.mode[own]]
        if shapes is not None:
            own = (self.kind == SHAPE) & (self.mode < shapes.shape[1])
            found[own] = shapes[self.sensor[own], self.mode[own]]
        return found


#: Share of the variance of a turn of two modes that is not tied: a third has a hand in what one has
#: of the other. [decision: chosen]
_FREE = 0.1


@dataclass(frozen=True)
class Neighbours:
    """All elastic modes of the nominal model, those that the test lacks among them.

    Attributes:
        log_f: ln of their frequencies, (k,).
        shapes: Mass-normalised, at the sensors, (n_s, k).
        own: Which of them the test's are, (m,).
    """

    log_f: np.ndarray
    shapes: np.ndarray
    own: np.ndarray


#: Modes that an error changes together, each with its change, (n_s,).
Parts = tuple[tuple[int, np.ndarray], ...]


def mode_mixing(
    log_f: np.ndarray,
    shapes: np.ndarray,
    by_mode: np.ndarray,
    least: float,
    near: Neighbours | None = None,
) -> Iterator[Parts]:
    """Errors of shapes by modes nearby, each at one standard deviation.

    An error of the model that is d in ln f of two modes turns them by d / |ln (f_i / f_j)|
    (first-order perturbation; Fox and Kapoor, AIAA J. 6, 1968): half a per cent apart, what one
    has of the other says nothing. Two modes turn by the same angle, since they stay orthogonal:
    what the one gets of the other, that loses of it.

    Args:
        log_f: ln of the measured frequencies, (m,); nan where missing.
        shapes: Measured shapes, (n_s, m), of root mean square 1; nan where missing.
        by_mode: Standard deviation of the model's error in ln f, (m,).
        least: Turn, radians, that other errors of a shape hold already.
        near: The model's modes; None takes those of the test alone, as of one size.
    """
    m = len(log_f)
    there = np.isfinite(log_f) & np.isfinite(shapes).any(axis=0)
    known, sizes, missing = np.nan_to_num(shapes), _sizes(m, near), np.zeros(m)

    def angle(i: int, apart: float) -> float:
        whole = min(by_mode[i] / max(apart, 1e-12), 1.0)
        found = np.sqrt(max(whole**2 - least**2, 0.0))
        missing[i] += found**2 / 2
        return found

    for i in range(m):
        for apart, shape in _lacking(i, there, near):
            if size := angle(i, apart):
                yield ((i, size * shape / sizes[i]),)
        for j in range(i) if there[i] else ():
            apart = abs(log_f[i] - log_f[j])
            if there[j] and (both := (angle(i, apart), angle(j, apart))) != (0.0, 0.0):
                at_i = both[0] * sizes[j] / sizes[i] * known[:, j]
                at_j = both[1] * sizes[i] / sizes[j] * known[:, i]
                tied, free = np.sqrt(1 - _FREE), np.sqrt(_FREE)
                yield (i, tied * at_i), (j, -tied * at_j)
                yield ((i, free * at_i),)
                yield ((j, free * at_j),)
    for i in np.flatnonzero(missing):
        yield ((int(i), min(missing[i], 1.0) * known[:, i]),)


def _sizes(m: int, near: Neighbours | None) -> np.ndarray:
    """Root mean squares of the test's modes at the sensors, mass-normalised, (m,)."""
    return np.ones(m) if near is None else np.sqrt(np.mean(near.shapes[:, near.own] ** 2, axis=0))


def _lacking(i: int, there: np.ndarray, near: Neighbours | None):
    """How far modes that the test lacks are from one of the test's, in ln f, and their shapes."""
    if near is None:
        return
    measured = set(near.own[there].tolist()) | {int(near.own[i])}
    for k in range(len(near.log_f)):
        if k not in measured:
            yield abs(near.log_f[k] - near.log_f[near.own[i]]), near.shapes[:, k]


#: What an unknown cause may do to each mode on its own: a shift (10 %), a trend with the logarithm
#: of the condition (5 % per factor e), and a bend of it (2 %). [decision: chosen]
UNKNOWN, _TREND, _BEND = 0.10, 0.05, 0.02
#: How much more an unknown cause may do to damping than to a frequency. [decision: chosen]
_UNKNOWN_DAMPING = 10.0
#: What it does to a shape, relative to its root mean square. [decision: chosen]
_UNKNOWN_SHAPE = 0.2
#: Share of the variance of a model's error that is a row's own after a known change: all else is
#: the same before and after, and cancels in what the change shifts. [decision: chosen]
_OF_CHANGE = 0.0025
#: Share of the variance of a model's error in a shape that is each sensor's own. [decision: chosen]
_LOCAL = 0.5
#: Power of the correlation of that, which so reaches a tenth as far: sensors at one place share it.
#: [decision: chosen]
_NARROW = 100


class Covariance:
    """The covariance of a test's entries, and its factors, with any scales.

    Args:
        test: The test; which kind of scales it has counts, and not their values.
    """

    def __init__(self, test: Evidence):
        self.test = test
        self._steady: dict[bool, np.ndarray] = {}
        self._lowers: dict[tuple[Scales | None, bool], np.ndarray] = {}

    def full(self, scales: Scales | None, unknown: bool = False) -> np.ndarray:
        """Covariance of all entries, measured or not, held out or not, (N, N).

        Args:
            scales: Of the test's kind; None takes what is stated.
            unknown: Whether an unknown cause may be at work.
        """
        if unknown not in self._steady:
            self._steady[unknown] = self._stated(unknown)
        total = self._steady[unknown].copy()
        values = () if scales is None else scales.values
        for scale, part in zip(values, self._parts, strict=False):
            total += scale**2 * part
        return total

    def lower(self, scales: Scales | None, unknown: bool = False) -> np.ndarray:
        """Cholesky factor of that of the fitted entries, (k, k), remembered; see `full`."""
        key = scales, unknown
        if key not in self._lowers:
            used = self.test.fitted
            self._lowers[key] = np.linalg.cholesky(self.full(scales, unknown)[np.ix_(used, used)])
        return self._lowers[key]

    @cached_property
    def _same_mode(self) -> np.ndarray:
        mode = self.test.entries.mode
        return mode[:, None] == mode[None, :]

    @cached_property
    def _parts(self) -> tuple[np.ndarray, ...]:
        """The covariances that `scales` are of, at one: between levels of ln f and ln damping, or
        of what is stated of ln f and of shapes."""
        if self._with_functions:
            return self._of_frequencies, self._of_scalars, self._of_shapes
        if not self.test.drifts:
            return self._of_frequencies, self._of_shapes
        e = self.test.entries
        drift = correlation(self.test.conditions)[np.ix_(e.row, e.row)] * self._same_mode
        return tuple(drift * _blocks(e.kind, *scales) for scales in ((1.0, 0.0), (0.0, 1.0)))

    @property
    def _with_functions(self) -> bool:
        return self.test.scales is not None and self.test.scales.kind == WITH_FUNCTIONS

    @cached_property
    def _of_scalars(self) -> np.ndarray:
        """What single numbers err together."""
        scalars, own = self.test.scalars, self.test.entries.of_scalars
        names = dict.fromkeys(name for scalar in scalars for name in scalar.common)
        common = np.zeros((len(own), len(names)))
        for i, scalar in zip(np.flatnonzero(own), scalars, strict=True):
            common[i] = [scalar.common.get(name, 0.0) for name in names]
        return common @ common.T

    @cached_property
    def _by_mode(self) -> np.ndarray:
        """Standard deviation of the model's error in ln f, as it is stated or found, (m,)."""
        by_mode = np.broadcast_to(self.test.discrepancy, self.test.shape[1])
        if self.test.mesh_error is None:
            return by_mode
        return np.maximum(by_mode, self._of_all_modes(self.test.mesh_error))

    @cached_property
    def _slowly(self) -> np.ndarray:
        """Correlation of a model's error between entries of one mode."""
        row = self.test.entries.row
        slow = _slow(self.test.conditions, self.test.changing)[np.ix_(row, row)] * self._same_mode
        if any(self.test.known):
            changed = np.array([bool(known) for known in self.test.known])[row]
            slow = slow + np.diag(np.where(changed, _OF_CHANGE, 0.0))
        return slow

    @cached_property
    def _of_frequencies(self) -> np.ndarray:
        e = self.test.entries
        return self._slowly * _blocks(e.kind, self._by_mode[e.mode])

    @cached_property
    def _locally(self) -> np.ndarray:
        """Correlation of a model's error between components of one shape."""
        e = self.test.entries
        near = self.test.near if self.test.near is not None else np.eye(len(self.test.shapes))
        local = _LOCAL * near**_NARROW + (1 - _LOCAL) * near
        if self.test.along is not None:
            local = local * self.test.along
        is_shape = e.kind == SHAPE
        pairs = local[np.ix_(e.sensor, e.sensor)] * self._same_mode
        return pairs * np.outer(is_shape, is_shape)

    @cached_property
    def _of_shapes(self) -> np.ndarray:
        if self.test.shapes is None:
            return np.zeros(2 * (len(self.test.entries.kind),))
        least = np.broadcast_to(self.test.shape_error, self.test.shape[1])
        if self.test.mesh_shape is not None:
            least = np.maximum(least, self._of_all_modes(self.test.mesh_shape))
        return self._locally * least[self.test.entries.mode] ** 2

    def _stated(self, unknown: bool) -> np.ndarray:
        """All but what `scales` are of."""
        e = self.test.entries
        total = self._slowly * _blocks(e.kind, 0.0, self.test.damping_scatter)
        if self.test.scales is None or self.test.drifts:
            total = total + self._of_frequencies + self._of_shapes
        if self.test.mesh_common is not None:
            common = self.test.mesh_common
            common = np.pad(common, (0, self.test.shape[1] - len(common)))
            of_mesh = np.where(e.kind == FREQUENCY, common[e.mode], 0.0)
            total = total + np.outer(of_mesh, of_mesh)
        if self.test.joint_f is not None:
            of_joints = e.filled(self.test.joint_f, self.test.joint_shapes)
            total = total + of_joints @ of_joints.T
        if unknown:
            wide = _wide(self.test.conditions)[np.ix_(e.row, e.row)] * self._same_mode
            total = total + wide * _blocks(e.kind, 1.0, _UNKNOWN_DAMPING)
        if self.test.shapes is not None:
            # By what is stated, whatever the scales: what shapes of close modes are off by says
            # little of the frequencies' error.
            turns = self._mode_mixing(self._by_mode)
            total = total + turns @ turns.T
            if unknown:
                total = total + self._locally * _UNKNOWN_SHAPE**2
        if not self._with_functions:
            total = total + self._of_scalars
        if unknown and self.test.scalars:
            wide = np.zeros(len(e.kind))
            wide[e.of_scalars] = [scalar.unknown for scalar in self.test.scalars]
            total = total + np.diag(wide**2)
        return total + np.diag(self.test.noise_sd() ** 2)

    def _of_all_modes(self, error: np.ndarray) -> np.ndarray:
        """Errors by mesh, and the largest of modes that were added since, (m,)."""
        return np.pad(error, (0, self.test.shape[1] - len(error)), mode="maximum")

    def _mode_mixing(self, by_mode: np.ndarray) -> np.ndarray:
        """Errors of shapes by modes nearby, (N, k), see `mode_mixing`."""
        test, columns = self.test, []
        e = test.entries
        found = mode_mixing(
            test.log_f[test.shape_row], test.shapes, by_mode, test.shape_error, test.neighbours
        )
        for parts in found:
            column = np.zeros(len(e.kind))
            for mode, shape in parts:
                own = (e.kind == SHAPE) & (e.mode == mode)
                column[own] = shape[e.sensor[own]]
            columns.append(column)
        return np.array(columns).reshape(-1, len(e.kind)).T


def _blocks(
    kind: np.ndarray, of_frequency: float | np.ndarray, of_damping: float = 0.0
) -> np.ndarray:
    """Products of the scales of frequencies and damping, nought between different kinds."""
    scale = np.where(kind == FREQUENCY, of_frequency, np.where(kind == DAMPING, of_damping, 0.0))
    return np.outer(scale, scale) * (kind[:, None] == kind[None, :])


def _log(conditions: np.ndarray) -> np.ndarray:
    """Centred logarithm of the conditions; zero when they are not all positive."""
    if len(conditions) < 2 or np.any(conditions <= 0):
        return np.zeros(len(conditions))
    return np.log(conditions) - np.mean(np.log(conditions))


def _slow(conditions: np.ndarray, changing: float) -> np.ndarray:
    """Correlation of a model's error between conditions, (n, n)."""
    x = _log(conditions)
    return (1 - changing) + changing * np.exp(-0.5 * ((x[:, None] - x[None, :]) / MEMORY) ** 2)


def _wide(conditions: np.ndarray) -> np.ndarray:
    x = _log(conditions)
    return UNKNOWN**2 + _TREND**2 * np.outer(x, x) + _BEND**2 * np.outer(x**2, x**2)
