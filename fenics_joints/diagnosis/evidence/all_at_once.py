"""Whether all effects of the library at once could explain a test that no few of them explain.

What is left of the test by its best explanation is weighed against everything that any effect
could add to it, each by its slopes about its own fit and by its prior: the part of the residual
outside the span of all effects together, which no combination of the library can be the cause of.
Data have |r|^2 + |z|^2 at its least as chi-square where effects are linear about their fits.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import chi2

from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.fitted import Fit
from fenics_joints.diagnosis.evidence.linear import least_square
from fenics_joints.diagnosis.evidence.screen import whitened


def all_at_once(fits: Sequence[Fit], leader: Fit, evidence: Evidence) -> float:
    """Probability of a misfit as large as all effects at once would leave, if these were at work.

    Args:
        fits: Fits of hypotheses, those of one effect among them.
        leader: The best explanation, to which the effects that it does not hold are added.
        evidence: The test.
    """
    # As for `Fit.square`: of errors that are stated at most all that is stated is there.
    scales = leader.scales
    if scales is not None and not evidence.drifts:
        scales = scales.stated
    test = evidence.at(scales)
    lower = test.lower()
    residual, slope = whitened(leader, test, lower)
    free = [~leader.hypothesis.at_limit(leader.z)]
    held = {effect.key for effect in leader.hypothesis.effects}
    for f in fits:
        h = f.hypothesis
        if not h.unknown and len(h.effects) == 1 and h.effects[0].key not in held:
            slope = np.hstack([slope, whitened(f, test, lower)[1][:, h.own]])
            free.append(np.ones(h.own.stop - h.own.start, dtype=bool))
    z = np.pad(leader.z, (0, slope.shape[1] - len(leader.z)))
    square, _ = least_square(residual, slope, z, np.concatenate(free))
    of_scales = 0.0 if scales is None else scales.squares
    return float(chi2.sf(square + of_scales, len(residual)))
