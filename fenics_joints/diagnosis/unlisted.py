"""How probable it is that what explains a test is a cause outside the library that looks the same.

The evidence of an unknown cause that may do anything (`Evidence.covariance`) says when nothing in
the library fits. But a crack can look like a softer part, a cable like an added mass: then a
listed effect fits, and no evidence tells. How often that happens is a matter of experience. It is
taken from tests with a known cause, inside the library and outside, as a logistic function of three
signs of strain in the best explanation. ``python -m benchmarks.blind calibrate`` makes it anew.
"""

from __future__ import annotations

import numpy as np
from scipy.special import expit

from fenics_joints.diagnosis.inference import Fit

__all__ = ["WEIGHTS", "look_alike", "strain"]

#: Intercept and weights of `strain`: 117 diagnoses, 21 of them of causes outside the library.
WEIGHTS = (-2.61, 0.26, 0.48, 0.38)
#: What counts at most: -ln of the p-value, and a departure in standard deviations.
_MOST_UNLIKELY, _FARTHEST = 10.0, 4.0


def strain(p_value: float, departures: np.ndarray, n_effects: int) -> np.ndarray:
    """Signs that an explanation had to be forced, shape (4,), the first of them 1.

    Args:
        p_value: Of the misfit, see `Fit.p_value`.
        departures: Of what is free in any explanation (tolerances, tightenings, damping at rest),
            in standard deviations of its prior, (k,).
        n_effects: How many effects it takes.
    """
    unlikely = min(-np.log(max(p_value, 1e-300)), _MOST_UNLIKELY)
    farthest = min(float(np.max(np.abs(departures), initial=0.0)), _FARTHEST)
    return np.array([1.0, unlikely, farthest, float(n_effects)])


def look_alike(leader: Fit) -> float:
    """Probability that the cause is none of the library's although the leader explains the test.

    Args:
        leader: The most probable hypothesis but for the unknown.
    """
    hypothesis = leader.hypothesis
    departures = np.delete(leader.z, hypothesis.own_columns)
    return float(expit(strain(leader.p_value, departures, len(hypothesis.effects)) @ WEIGHTS))
