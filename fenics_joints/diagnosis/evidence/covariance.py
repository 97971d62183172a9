"""What a test and any model of it may err, together: the covariance of a test's entries."""

from __future__ import annotations

from functools import cached_property
from typing import Protocol

import numpy as np

from fenics_joints.diagnosis.evidence.entries import DAMPING, FREQUENCY, SHAPE, Entries
from fenics_joints.diagnosis.evidence.scales import MEMORY, WITH_FUNCTIONS, Scales, correlation
from fenics_joints.diagnosis.evidence.turning import Neighbours, turned

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


class Stated(Protocol):
    """What a test says of itself and of its models; see `Evidence`, which does."""

    conditions: np.ndarray
    log_f: np.ndarray
    discrepancy: float
    changing: float
    scales: Scales | None
    drifts: bool
    damping_scatter: float
    shapes: np.ndarray | None
    shape_row: int
    shape_error: float
    near: np.ndarray | None
    along: np.ndarray | None
    scalars: tuple
    mesh_error: np.ndarray | None
    mesh_common: np.ndarray | None
    mesh_shape: np.ndarray | None
    neighbours: Neighbours | None
    known: tuple
    joint_f: np.ndarray | None
    joint_shapes: np.ndarray | None
    shape: tuple[int, int]
    entries: Entries
    fitted: np.ndarray

    def noise_sd(self) -> np.ndarray:
        """Standard deviation of each entry from the instrument alone, (N,)."""


class Covariance:
    """The covariance of a test's entries, and its factors, with any scales.

    Args:
        test: The test; which kind of scales it has counts, and not their values.
    """

    def __init__(self, test: Stated):
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
        own = np.flatnonzero(self.test.entries.of_scalars)
        common = np.zeros((len(self.test.entries.kind), 0))
        if len(own):
            found = _common_errors(self.test.scalars)
            common = np.zeros((len(common), found.shape[1]))
            common[own] = found
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
            turns = self._turned(self._by_mode)
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

    def _turned(self, by_mode: np.ndarray) -> np.ndarray:
        """Errors of shapes by modes nearby, (N, k), see `turned`."""
        test, columns = self.test, []
        e = test.entries
        found = turned(
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


def _common_errors(measured: tuple) -> np.ndarray:
    """What several single numbers err together, a column for each such error, (k, n_errors)."""
    names = dict.fromkeys(name for scalar in measured for name in scalar.common)
    found = np.zeros((len(measured), len(names)))
    at = {name: j for j, name in enumerate(names)}
    for i, scalar in enumerate(measured):
        for name, change in scalar.common.items():
            found[i, at[name]] = change
    return found


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
