"""The error of a model with bonded joints, which all modes share.

Clamped faces are always a little compliant, and no layer or bonded patch represents them exactly.
So a part of the error that a case states is of this kind: all joints are compliant, across or along
their planes, enough to lower the frequencies by a part of the stated error. That moves all modes
together and changes their shapes, which many sensors can see; a covariance of independent modes
would take it for a joint that has come loose.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fenics_joints.diagnosis.effects.effect import Effect
from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.diagnosis.evidence.predictions import ManyPredictions
from fenics_joints.diagnosis.where.zone_sensitivity import compliant_joints
from fenics_joints.reduction.prediction import ModalPrediction

#: Root mean square of ln f by compliance across and along, each over the stated discrepancy.
#: [decision: measured on the box of benchmarks/blind, docs/diagnosis-method.md]
SHARE = 0.5
#: ln of the compliance's range, over that of an interface of the prior's median stiffness; steps of
#: its bisection. [numerical: chosen]
_RANGE, _STEPS = (np.log(1e-8), np.log(1e2)), 30

#: Change of ln f, (m, k), and of shapes at the sensors as the test has scaled them, (n_s, m, k) or
#: None.
JointErrors = tuple[np.ndarray, np.ndarray | None]


def joint_errors(
    forward: ModalPrediction,
    evidence: Evidence,
    baseline: Mapping[str, float],
    interfaces: Mapping[str, Mapping[str, float]],
) -> JointErrors | None:
    """Changes by a little compliance of all joints, across their planes and along them, each at one
    standard deviation.

    Args:
        forward: Predicts frequencies and shapes.
        evidence: The test.
        baseline: Parameter values of the nominal model.
        interfaces: For each joint the stiffness of an interface of the expected stiffness, by the
            parameter that it is in series with (`effects.joint.interfaces`).

    Returns:
        The errors; None without joints, or where no compliance moves a frequency.
    """
    found = []
    for key in dict.fromkeys(key for stiffness in interfaces.values() for key in stiffness):
        joints = [joint for joint, stiffness in interfaces.items() if key in stiffness]
        effect = compliant_joints("all joints", joints, interfaces, key)
        change = _change(effect, forward, evidence, baseline)
        if change is not None:
            found.append(change)
    if not found:
        return None
    m, stacked = evidence.shape[1], np.array(found).T
    shapes = None if evidence.shapes is None else stacked[m:].reshape(*evidence.shapes.shape, -1)
    return stacked[:m], shapes


def _change(effect: Effect, forward, evidence: Evidence, baseline) -> np.ndarray | None:
    """Change of ln f and of the shapes, (m,) or (m + n_s m,), at one standard deviation."""
    row, size = evidence.shape_row, SHARE * evidence.discrepancy
    hypothesis = Hypothesis((effect,), conditions=tuple(map(float, evidence.conditions)))

    def z(log_share: float) -> np.ndarray:
        return np.exp([log_share / 3])

    def log_f(log_share: float) -> np.ndarray:
        return forward(hypothesis.values(z(log_share), evidence.conditions[row], baseline, row))[0]

    before, (low, high) = log_f(_RANGE[0]), _RANGE
    for _ in range(_STEPS):
        middle = 0.5 * (low + high)
        moved = np.sqrt(np.mean((log_f(middle) - before) ** 2))
        low, high = (low, middle) if moved > size else (middle, high)
    both = np.array([z(low), z(_RANGE[0])])
    soft, stiff = ManyPredictions(hypothesis, forward, evidence, baseline)(both)[0]
    (n, m), change = evidence.shape, soft - stiff
    own = np.concatenate([change[row * m : (row + 1) * m], _shapes(change, evidence, n * m)])
    # Not finite or all zero: no compliance in the range moves what is measured.
    return own if np.all(np.isfinite(own)) and np.any(own) else None


def _shapes(change: np.ndarray, evidence: Evidence, after: int) -> np.ndarray:
    """A change's entries of shapes, 0 where none was measured, (n_s m,)."""
    if evidence.shapes is None:
        return np.zeros(0)
    own = change[after : after + evidence.shapes.size]
    return np.where(np.isfinite(evidence.shapes).ravel(), own, 0.0)
