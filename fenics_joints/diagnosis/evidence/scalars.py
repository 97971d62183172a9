"""Single numbers that were measured besides modes, and what a hypothesis predicts of them."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import TYPE_CHECKING, Protocol

import numpy as np

from fenics_joints.diagnosis.thresholds import STEP

if TYPE_CHECKING:
    from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
    from fenics_joints.diagnosis.evidence.signatures import Signatures


Values = Mapping[str, np.ndarray]


class Scalar(Protocol):
    """A positive number, of whose logarithm the model predicts another.

    Attributes:
        name: What it is of.
        kind: Kind of entry (`fenics_joints.diagnosis.evidence.entries`).
        measured: The number, in its SI unit.
        sd: Its relative standard deviation, with what the model leaves out.
        row: The test's row at which it was measured; None if it does not depend on that.
        unknown: What an unknown cause may do to its logarithm, one standard deviation.
        common: What any model of the structure, or the test, errs in it that it errs in others too:
            change of its logarithm by one standard deviation of each such error, by its name.
    """

    name: str
    kind: int
    measured: float
    sd: float
    row: int | None
    unknown: float
    common: Mapping[Hashable, float]

    def log_value(self, values: Mapping[str, float | np.ndarray]) -> float | np.ndarray:
        """ln of what the model has for it; (b,) of parameter values (b,)."""

    def log_slopes(self, values: Values, low: Values, high: Values, width: float) -> np.ndarray:
        """Its derivatives along p directions at b points, (b, p).

        Args:
            values: Parameter values at the points, each (b,).
            low: Those a little less along the directions, (p * b,): all of one, then of the next.
            high: Likewise a little more.
            width: How far these are apart.
        """

    def by_patch(self, patches: Signatures) -> tuple[np.ndarray, np.ndarray]:
        """Its change by the stiffness and by the mass of each patch, of the expected size, (P,)."""


def reach(measured: Sequence[Scalar], hypothesis: Hypothesis) -> list[int]:
    """Which of a hypothesis's parameters may change some of them."""
    rows = {scalar.row for scalar in measured} - {None}
    return [
        j
        for j in range(len(hypothesis.priors))
        if j < hypothesis.own.stop or any(hypothesis.acts(j, row, None) for row in rows)
    ]


def scalars_at(
    measured: Sequence[Scalar],
    hypothesis: Hypothesis,
    z: np.ndarray,
    by: Sequence[int],
    at: Callable[[np.ndarray, int | None], Values],
) -> tuple[np.ndarray, np.ndarray]:
    """Their logarithms as a hypothesis predicts them at many points, (b, k), and derivatives by
    some of z, (b, k, len(by)); nan where the model has one not, as an antiresonance.

    Args:
        measured: The numbers.
        hypothesis: The hypothesis.
        z: Points, (b, d).
        by: Which of z.
        at: Parameter values at points, (n, d), at a row: each (n,).
    """
    found = np.zeros((len(z), len(measured)))
    slope = np.zeros((len(z), len(measured), len(by)))
    matter = set(reach(measured, hypothesis))
    own = [k for k, j in enumerate(by) if j in matter] if measured else []
    steps = np.zeros((len(own), 1, z.shape[1]))
    steps[range(len(own)), 0, [by[k] for k in own]] = STEP
    low, high = ((z + side * steps).reshape(len(own) * len(z), z.shape[1]) for side in (-1, 1))
    for row in dict.fromkeys(scalar.row for scalar in measured):
        values = at(z, row)
        ends = (at(low, row), at(high, row)) if own else None
        for i, scalar in enumerate(measured):
            if scalar.row == row:
                found[:, i] = scalar.log_value(values)
                if own:
                    slope[:, i, own] = scalar.log_slopes(values, *ends, 2 * STEP)
    return found, slope
