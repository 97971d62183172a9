"""What a hypothesis predicts of a test: frequencies, damping, shapes, and their derivatives."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.diagnosis.evidence.many import ManyPredictions
from fenics_joints.diagnosis.evidence.row import RowPrediction
from fenics_joints.diagnosis.evidence.scalars import scalars
from fenics_joints.reduction.forward import Forward
from fenics_joints.reduction.lean import batched

__all__ = ["in_turn", "joined", "predict", "predicted"]


def predict(
    hypothesis: Hypothesis,
    forward: Forward,
    evidence: Evidence,
    z: np.ndarray,
    baseline: dict[str, float],
) -> tuple[np.ndarray, np.ndarray]:
    """Everything in `Evidence.data` as a hypothesis predicts it, held out or not.

    Args:
        hypothesis: The hypothesis.
        forward: Predicts frequencies and shapes.
        evidence: The test.
        z: Parameters in prior standard deviations, shape (d,).
        baseline: Parameter values of the nominal model.

    Returns:
        The prediction, shape (N,), and its derivative by z, shape (N, d).
    """
    found = _together(hypothesis, forward, evidence, z, baseline)
    if found is not None:
        return found
    rows, slopes, shapes, steady = {}, {}, ([], []), {}
    for row, prediction in in_turn(hypothesis, forward, evidence, z, baseline, steady):
        rows[row], slopes[row] = prediction.data, prediction.slopes
        if evidence.shapes is not None and row == evidence.shape_row:
            at, by_z = prediction.shapes(evidence.shapes)
            shapes = [at.ravel()], [by_z.reshape(at.size, len(z))]
    m = evidence.shape[1]
    single, along = scalars(evidence.scalars, hypothesis, z, evidence.conditions, baseline)
    return joined(rows, [*shapes[0], single], m), joined(slopes, [*shapes[1], along], m)


def predicted(
    hypothesis: Hypothesis, forward: Forward, evidence: Evidence, z: np.ndarray, baseline
) -> np.ndarray:
    """The prediction of `predict`, (N,), without its derivatives, which are most of the work."""
    if len(evidence.conditions) > 1:
        found = _together(hypothesis, forward, evidence, z, baseline, slopes=False)
        if found is not None:
            return found[0]
    rows, shapes = {}, []
    for row, prediction in in_turn(hypothesis, forward, evidence, z, baseline, {}):
        rows[row] = prediction.data
        if evidence.shapes is not None and row == evidence.shape_row:
            shapes = [prediction.read_shapes(evidence.shapes).ravel()]
    single, _ = scalars(
        evidence.scalars, hypothesis, z, evidence.conditions, baseline, slopes=False
    )
    return joined(rows, [*shapes, single], evidence.shape[1])


def _together(hypothesis, forward, evidence, z, baseline, slopes: bool = True):
    """`predict` with all conditions solved for at once; None where that cannot be done."""
    if not isinstance(forward, Forward):
        return None  # what stands in for one, such as for a structure that is altered
    many = batched(forward)
    if not many.batches or (hypothesis.senses and evidence.shapes is not None):
        return None  # how shapes follow a sensor's own error is known one by one
    if not hypothesis.varies:
        return None  # all conditions have the same solution
    at_once = ManyPredictions(hypothesis, many, evidence, baseline, held_out=True)
    before = many.calls
    by = range(len(z)) if slopes else ()
    predicted, along = at_once(np.asarray(z, dtype=float)[None], by)
    forward.calls += 0 if many is forward else many.calls - before
    if not np.all(np.isfinite(predicted)):
        return None  # one by one it is looked further for a mode that is not there
    return predicted[0], along[0]


def in_turn(
    hypothesis: Hypothesis, forward: Forward, evidence: Evidence, z: np.ndarray, baseline,
    steady: dict | None = None,
) -> Iterator[tuple[int, RowPrediction]]:
    """Predictions at all conditions, in the order of `Evidence.turns`, by row."""
    found: dict[int, RowPrediction] = {}
    for row, after in evidence.turns:
        if found and not hypothesis.varies:
            found[row] = next(iter(found.values()))
            yield row, found[row]
            continue
        # What stands in for a forward follows none.
        near = found[after] if after is not None and getattr(forward, "follows", False) else None
        condition = evidence.conditions[row]
        found[row] = RowPrediction(hypothesis, forward, z, condition, baseline, row, steady, near)
        yield row, found[row]


def joined(
    rows: Mapping[int, np.ndarray], shapes: Sequence[np.ndarray], m: int
) -> np.ndarray:
    """In the order of `Evidence.data`: frequencies of all conditions, damping of all, the rest.

    Args:
        rows: `RowPrediction.data` of each condition by its row, or its derivatives.
        shapes: What comes behind them: shapes, masses.
        m: Number of modes.
    """
    by_row = np.array([rows[row] for row in sorted(rows)])
    n, size, *more = by_row.shape
    by_kind = by_row.reshape(n, size // m, m, *more).swapaxes(0, 1)
    return np.concatenate([by_kind.reshape(n * size, *more), *shapes])
