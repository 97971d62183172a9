"""What each entry of a test is, and how close modes mix in its shapes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

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
        """Changes of every entry, (N, k), the same at all rows; zero for other kinds of data, and
        for modes beyond the given ones.

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


#: Share of the variance of a rotation of two modes in which both are independent, because a third
#: mode takes part. [decision: chosen]
_FREE = 0.1


@dataclass(frozen=True)
class Neighbours:
    """All elastic modes of the nominal model, also those that the test lacks.

    Attributes:
        log_f: ln of their frequencies, (k,).
        shapes: Mass-normalised, at the sensors, (n_s, k).
        own: Which of them the test's are, (m,).
    """

    log_f: np.ndarray
    shapes: np.ndarray
    own: np.ndarray


#: Modes that one error changes together, each with its change at the sensors, (n_s,).
Parts = tuple[tuple[int, np.ndarray], ...]


def mode_mixing(
    log_f: np.ndarray,
    shapes: np.ndarray,
    by_mode: np.ndarray,
    least: float,
    near: Neighbours | None = None,
) -> Iterator[Parts]:
    """Errors of shapes by modes nearby, each at one standard deviation.

    An error of the model that is d in ln f of two modes rotates them by d / |ln (f_i / f_j)|
    (first-order perturbation; Fox and Kapoor, AIAA J. 6, 1968): half a per cent apart, their
    mixture says nothing of the structure. Both rotate by the same angle, since they stay
    orthogonal.

    Args:
        log_f: ln of the measured frequencies, (m,); nan where missing.
        shapes: Measured shapes, (n_s, m), of root mean square 1; nan where missing.
        by_mode: Standard deviation of the model's error in ln f, (m,).
        least: Angle, radians, that other errors of a shape include already.
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
    """Distances in ln f of modes that the test lacks from one of the test's, and their shapes."""
    if near is None:
        return
    measured = set(near.own[there].tolist()) | {int(near.own[i])}
    for k in range(len(near.log_f)):
        if k not in measured:
            yield abs(near.log_f[k] - near.log_f[near.own[i]]), near.shapes[:, k]


#: Standard deviation of the shift of ln f of each mode by an unknown cause. [decision: chosen]
UNKNOWN = 0.10
