"""How probable it is that what explains a test is a cause outside the library that looks the same.

The evidence of an unknown cause that may do anything (`Evidence.covariance`) says when nothing in
the library fits. But a crack can look like a softer part, a cable like an added mass: then a
listed effect fits, and no evidence tells. How often that happens is a matter of experience. It is
taken from simulated tests whose cause is known, as a logistic function of how well the best
explanation fits: 117 cases, 21 of them of causes outside the library. Where a test comes from
elsewhere, so may the rate. ``python -m benchmarks.blind calibrate`` makes such numbers from a check
that was opened; these are from two versions of the diagnosis (benchmarks/blind/README.md).

Data held out say more than a fit can. Where a cause was named in 126 opened cases, it was right in
50 of 62 that held-out data confirmed and in 39 of 64 that they did not, whatever the fit's own
misfit; two-thirds of the wrong ones were outside the library. So what is left for another cause
follows from that, once it is known (`after_held_out`).
"""

from __future__ import annotations

import numpy as np
from scipy.special import expit

__all__ = ["WEIGHTS", "WRONG", "after_held_out", "look_alike", "misfit_in_nats"]

#: Intercept, and weight of `misfit_in_nats`. [decision: fitted to 117 opened cases,
#: benchmarks/blind]
WEIGHTS = (-2.08, 0.36)
#: Share of named causes that were wrong: those that held-out data confirmed, and the others. With
#: one more right and one more wrong (Laplace's rule of succession). [decision: counted in 126
#: opened cases, benchmarks/blind]
WRONG = {True: 13 / 64, False: 26 / 66}
#: Misfit beyond which more says no more. [decision: chosen]
_MOST = 10.0


def misfit_in_nats(p_value: float) -> float:
    """-ln of the probability of a misfit as large as that of the best explanation, 0 to 10.

    Args:
        p_value: See `fenics_joints.diagnosis.evidence.inference.Fit.p_value`.
    """
    return float(min(-np.log(max(p_value, 1e-300)), _MOST))


def look_alike(p_value: float) -> float:
    """Probability that the cause is outside the library although the best of it explains the test.

    Args:
        p_value: Of the most probable hypothesis but for the unknown.
    """
    return float(expit(WEIGHTS[0] + WEIGHTS[1] * misfit_in_nats(p_value)))


def after_held_out(
    probability: np.ndarray, unknown: np.ndarray, p_value: float, confirmed: bool
) -> np.ndarray:
    """Probabilities of hypotheses, where a cause is named, with what held-out data say of it.

    Args:
        probability: With `look_alike` of the leader for a cause outside the library, (n,).
        unknown: Mask of the hypotheses of such a cause, (n,).
        p_value: See `look_alike`.
        confirmed: Whether held-out data confirm what is named.
    """
    left = (1 - WRONG[confirmed]) / (1 - look_alike(p_value))
    found = np.where(unknown, 0.0, probability * left)
    return found + np.where(unknown, (1 - found.sum()) / max(unknown.sum(), 1), 0.0)
