"""Fits taken as linear about where they are: of other data, of simulated tests, of all effects.

How often the library would explain a test that one of its causes made no better than this one.

A chi-square (`Fit.p_value`) knows nothing of choice: of many explanations the best fits better than
one that was named beforehand, so that of a few frequencies any test leaves little, and nothing is
ever odd. So tests of the same conditions, modes and sensors are simulated: a hypothesis of the
library by its probability, its parameters by their priors, errors of model and instrument as
stated. For each the most probable hypothesis is chosen anew, and what that leaves is counted. A
test whose cause is in the library is one of these as good as any, so the share of those that leave
as much is a conformal p-value (Vovk, Gammerman and Shafer, Algorithmic Learning in a Random World,
2005), as far as hypotheses are linear about their fits.

Whether all effects of the library at once could explain a test that no few of them explain.

What is left of the test by its best explanation is weighed against everything that any effect
could add to it, each by its slopes about its own fit and by its prior: the part of the residual
outside the span of all effects together, which no combination of the library can be the cause of.
Data have |r|^2 + |z|^2 at its least as chi-square where effects are linear about their fits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import softmax
from scipy.stats import chi2

from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.fitted import Fit
from fenics_joints.diagnosis.evidence.linear import LinearFit, left_by_stated, log_evidence
from fenics_joints.diagnosis.evidence.localised_unknown import with_localised_unknown
from fenics_joints.diagnosis.evidence.scales import marginalise_scales


def near_best(values: np.ndarray, margin: float, most: int) -> np.ndarray:
    """Indices of the values within a margin of the largest, at most so many, best first."""
    order = np.argsort(-values, kind="stable")
    return order[values[order] > values[order[0]] - margin][:most] if len(order) else order


def near_listed(values: np.ndarray, unknown: np.ndarray, margin: float, most: int) -> np.ndarray:
    """As `near_best`; where nothing but an unknown cause is near, the best of the others, too.

    Args:
        values: Of each.
        unknown: Which are an unknown cause, bool.
        margin: Of the largest, and of the largest of the others.
        most: Number of each at most.
    """
    near, listed = near_best(values, margin, most), np.flatnonzero(~unknown)
    if not unknown[near].all():
        return near
    return np.concatenate([near, listed[near_best(values[listed], margin, most)]])


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
    if evidence.scales is not None:
        tried = evidence.scales.tried()
        best, over = marginalise_scales(
            tried, lambda at: LinearFit.of(near, evidence.at(at)).log_evidence
        )
        if best != near.scales:
            near = _moved_at(found, evidence.at(best))
        if near is None:
            return None
        more, stated = over(near.scales), left_by_stated(near, evidence)
        log_z = near.log_evidence + more
        near = replace(near, log_evidence=log_z, widening=more, stated=stated)
    return with_localised_unknown(near, evidence) if h.unknown else near


def _moved_at(found: Fit, evidence: Evidence) -> Fit | None:
    """`moved` with the test's scales as they are."""
    h, linear = found.hypothesis, LinearFit.of(found, evidence)
    slope = linear.slope
    hessian = slope.T @ slope + np.eye(len(found.z))
    pull = slope.T @ linear.residual + found.z
    step = -np.linalg.solve(hessian, pull)
    z = found.z + step
    if h.at_limit(z).any() or -0.5 * pull @ step > _NEAR or np.max(np.abs(step)) > _STRIDE:
        return None
    left = linear.residual + slope @ step
    return replace(
        found,
        z=z,
        covariance=np.linalg.inv(hessian),
        predicted=found.predicted + found.jacobian @ step,
        log_evidence=log_evidence(left @ left + z @ z, slope, linear.lower),
        misfit=float(left @ left),
        n_data=len(left),
        scales=evidence.scales,
    )


#: Simulated tests; a p-value is no less than one in so many, or than chi-square has it. [numerical:
#: p to 0.1 %]
_COUNT = 999
#: Hypotheses that compete for each, those that are the most probable for the real one. [numerical:
#: chosen for time]
_MOST = 100


def with_simulated(
    fits: Sequence[Fit], score: np.ndarray, evidence: Evidence, *, count: int = _COUNT
) -> list[Fit]:
    """Fits of the library with p-values from simulated tests in place of chi-square's.

    Args:
        fits: All hypotheses, the unknown among them.
        score: ln of the evidence times the prior odds of each.
        evidence: The test.
        count: Number of simulated tests.
    """
    listed = np.flatnonzero([not f.hypothesis.unknown for f in fits])
    near = listed[near_best(np.asarray(score)[listed], np.inf, _MOST)]
    if not len(near) or not evidence.fitted.any():
        return list(fits)
    left = _left([fits[i] for i in near], np.asarray(score)[near], evidence, count)

    def judged(f: Fit) -> Fit:
        if f.hypothesis.unknown:
            return f
        worse = int(np.sum(left >= f.square))
        rank = (1 + worse) / (1 + count)
        return replace(f, simulated=rank if worse else min(rank, f.p_value))

    return [judged(f) for f in fits]


def _left(fits: list[Fit], score: np.ndarray, evidence: Evidence, count: int) -> np.ndarray:
    """What the best of some hypotheses leaves of each simulated test, (count,), as `Fit.square`."""
    best = fits[int(np.argmax(score))]
    # Between levels errors are what the best calls for; of a model all that is stated.
    scales = evidence.scales
    if scales is not None:
        scales = best.scales if evidence.drifts else best.scales.stated
    test, rng = evidence.at(scales), np.random.default_rng(0)
    lines = [LinearFit.of(f, test, test.lower()) for f in fits]
    counts = rng.multinomial(count, softmax(score))
    # Whitened, as their distance from the real one.
    tests = np.hstack([_drawn(line, n, rng) for line, n in zip(lines, counts, strict=True)])
    most, left = np.full(count, -np.inf), np.zeros(count)
    for line, own in zip(lines, score, strict=True):
        square = line.squares(-tests)
        value = own + 0.5 * (line.square - square)
        better = value > most
        most[better], left[better] = value[better], square[better]
    return left + (0.0 if scales is None else scales.squares)


def _drawn(line: LinearFit, n: int, rng: np.random.Generator) -> np.ndarray:
    """Tests that a hypothesis makes, (k, n)."""
    away = rng.standard_normal((len(line.z), n)) - line.z[:, None]
    errors = rng.standard_normal((len(line.residual), n))
    return line.residual[:, None] + line.slope[:, line.free] @ away[line.free] + errors


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
    held = {effect.key for effect in leader.hypothesis.effects}
    others = [
        LinearFit.of(f, test, test.lower()).slope[:, f.hypothesis.own]
        for f in fits
        if not f.hypothesis.unknown
        and len(f.hypothesis.effects) == 1
        and f.hypothesis.effects[0].key not in held
    ]
    all_ = LinearFit.of(leader, test, test.lower()).beside(*others)
    of_scales = 0.0 if scales is None else scales.squares
    return float(chi2.sf(all_.square + of_scales, len(all_.residual)))
