"""Single numbers that were measured besides modes, and what a hypothesis predicts of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Protocol

import numpy as np

if TYPE_CHECKING:
    from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
    from fenics_joints.diagnosis.evidence.signatures import Signatures

__all__ = ["Scalar", "reach", "scalars"]

_STEP = 1e-5


class Scalar(Protocol):
    """A positive number, of whose logarithm the model predicts another.

    Attributes:
        name: What it is of.
        kind: Kind of entry (`fenics_joints.diagnosis.evidence.entries`).
        measured: The number, in its SI unit.
        sd: Its relative standard deviation, with what the model leaves out.
        row: The test's row at which it was measured; None if it does not depend on that.
        unknown: What an unknown cause may do to its logarithm, one standard deviation.
    """

    name: str
    kind: int
    measured: float
    sd: float
    row: int | None
    unknown: float

    def log_value(self, values: Mapping[str, float | np.ndarray]) -> float | np.ndarray:
        """ln of what the model has for it; (b,) of parameter values (b,)."""

    def by_patch(self, patches: Signatures) -> tuple[np.ndarray, np.ndarray]:
        """Its change by the stiffness and by the mass of each patch, of the expected size, (P,)."""


def reach(measured: Sequence[Scalar], hypothesis: Hypothesis) -> list[int]:
    """Which of a hypothesis's parameters may change some of them."""
    rows = {scalar.row for scalar in measured} - {None}
    return [
        j for j in range(len(hypothesis.priors))
        if j < hypothesis.own.stop or any(hypothesis.acts(j, row, None) for row in rows)
    ]  # fmt: skip


def scalars(
    measured: Sequence[Scalar],
    hypothesis: Hypothesis,
    z: np.ndarray,
    conditions: np.ndarray,
    baseline: dict[str, float],
    *,
    slopes: bool = True,
) -> tuple[np.ndarray, np.ndarray]:
    """Their logarithms as a hypothesis predicts them, (k,), and the derivatives by z, (k, d).

    Args:
        measured: The numbers.
        hypothesis: The hypothesis.
        z: Parameters in prior standard deviations, (d,).
        conditions: The test's.
        baseline: Parameter values of the nominal model.
        slopes: Whether derivatives are wanted; they are zero otherwise.
    """

    def at(z) -> np.ndarray:
        values = {
            row: hypothesis.values(z, conditions[row or 0], baseline, row)
            for row in dict.fromkeys(scalar.row for scalar in measured)
        }
        return np.array([scalar.log_value(values[scalar.row]) for scalar in measured])

    by_z = np.zeros((len(measured), len(z)))
    for j in reach(measured, hypothesis) if measured and slopes else ():
        step = np.zeros(len(z))
        step[j] = _STEP
        by_z[:, j] = (at(z + step) - at(z - step)) / (2 * _STEP)
    return at(z), by_z
