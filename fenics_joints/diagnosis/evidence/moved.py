"""A fit to a part of the data that it was made of, where that is near."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.fitted import Fit
from fenics_joints.diagnosis.evidence.linear import evidence_about, least_square, log_evidence
from fenics_joints.diagnosis.evidence.scales import Scales, weighed
from fenics_joints.diagnosis.evidence.screen import whitened
from fenics_joints.diagnosis.evidence.somewhere import with_somewhere

#: Gain, in nats, and step, in prior standard deviations, up to which a fit to a part of the data is
#: linear about that to all of them: what is bent in between is a small part of that gain.
#: [numerical: chosen]
_NEAR, _STRIDE = 0.3, 0.5


def moved(found: Fit, evidence: Evidence) -> Fit | None:
    """A fit to other data of the same test, linear about what it is; None where that is too far.

    Args:
        found: The fit, to all data.
        evidence: A part of them.
    """
    h = found.hypothesis
    if evidence.drifts or any(p.scan for _, p in h.priors) or not len(found.z):
        return None
    near = _moved_at(found, evidence.at(found.scales))
    if near is None:
        return None
    if evidence.scales is None:
        return with_somewhere(near, evidence) if h.unknown else near
    best, over = weighed(evidence.scales.tried(), partial(_linear, near, evidence))
    if best != near.scales:
        near = _moved_at(found, evidence.at(best))
    if near is None:
        return None
    near = _over_all(near, evidence, over)
    return with_somewhere(near, evidence) if h.unknown else near


def _moved_at(found: Fit, evidence: Evidence) -> Fit | None:
    """`moved` with the test's scales as they are."""
    h, z = found.hypothesis, found.z
    lower = evidence.lower(h.unknown)
    residual, slope = whitened(found, evidence, lower)
    hessian = slope.T @ slope + np.eye(len(z))
    pull = slope.T @ residual + z
    step = -np.linalg.solve(hessian, pull)
    if h.at_limit(z + step).any() or -0.5 * pull @ step > _NEAR or np.max(np.abs(step)) > _STRIDE:
        return None
    left, z = residual + slope @ step, z + step
    return replace(
        found,
        z=z,
        covariance=np.linalg.inv(hessian),
        predicted=found.predicted + found.jacobian @ step,
        log_evidence=log_evidence(left @ left + z @ z, hessian, lower),
        misfit=float(left @ left),
        n_data=len(left),
        at_bound=(),
        scales=evidence.scales,
    )


def _linear(found: Fit, evidence: Evidence, scales: Scales) -> float:
    """ln of the evidence with some standard deviations, linear about a fit."""
    lower = evidence.at(scales).lower(found.hypothesis.unknown)
    free = ~found.hypothesis.at_limit(found.z)
    return evidence_about(*whitened(found, evidence, lower), found.z, lower, free)


def _over_all(found: Fit, evidence: Evidence, over: Callable[[Scales], float]) -> Fit:
    """A fit with the evidence of all scales, and with what it would leave by what is stated."""
    widening, stated = over(found.scales), None
    if not evidence.drifts:
        scales = found.scales.stated
        lower = evidence.at(scales).lower(found.hypothesis.unknown)
        free = ~found.hypothesis.at_limit(found.z)
        stated = least_square(*whitened(found, evidence, lower), found.z, free)[0] + scales.squares
    return replace(
        found, log_evidence=found.log_evidence + widening, widening=widening, stated=stated
    )
