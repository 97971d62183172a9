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

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.special import softmax
from scipy.stats import chi2

from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.fitted import Fit
from fenics_joints.diagnosis.evidence.linear import (
    evidence_about,
    least_square,
    log_evidence,
    whiten,
)
from fenics_joints.diagnosis.evidence.localised_unknown import with_somewhere
from fenics_joints.diagnosis.evidence.scales import Scales, weighed


def whitened(found: Fit, evidence: Evidence, lower: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Residual, (k,), and slopes, (k, d), of a fit in standard deviations of the fitted entries.

    Args:
        found: The fit, to whatever entries.
        evidence: The entries.
        lower: Cholesky factor of their covariance.
    """
    used = evidence.fitted
    both = np.column_stack([(found.predicted - evidence.data)[used], found.jacobian[used]])
    white = whiten(lower, both)
    return white[:, 0], white[:, 1:]


def linear_evidence(found: Fit, evidence: Evidence) -> float:
    """ln of the evidence of other entries of a test, a hypothesis linear about its fit.

    Args:
        found: The fit, to whatever entries.
        evidence: The entries.
    """
    lower = evidence.at(found.scales).lower(found.hypothesis.unknown)
    return evidence_about(*whitened(found, evidence, lower), found.z, lower)


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
    test = evidence.at(scales)
    lower, rng = test.lower(), np.random.default_rng(0)
    lines = [_Line(f, s, test, lower) for f, s in zip(fits, score, strict=True)]
    counts = rng.multinomial(count, softmax(score))
    tests = np.hstack([line.drawn(n, rng) for line, n in zip(lines, counts, strict=True)])
    most, left = np.full(count, -np.inf), np.zeros(count)
    for line in lines:
        square = line.square(tests)
        better = (value := line.offset - 0.5 * square) > most
        most[better], left[better] = value[better], square[better]
    return left + (0.0 if scales is None else scales.squares)


class _Line:
    """A hypothesis linear about its fit, whitened; tests as their distance from the real one.

    Attributes:
        offset: What is to be added to minus half of a test's `square` for ln of the evidence times
            the prior odds, which is so of the real test.
    """

    def __init__(self, found: Fit, score: float, evidence: Evidence, lower: np.ndarray):
        self.residual, self.slope = whitened(found, evidence, lower)
        self.z = found.z
        self.free = ~found.hypothesis.at_limit(found.z)
        slope = self.slope[:, self.free]
        self.root = np.linalg.inv(np.linalg.cholesky(slope.T @ slope + np.eye(slope.shape[1])))
        self.offset = score + 0.5 * self.square(np.zeros((len(lower), 1)))[0]

    def square(self, tests: np.ndarray) -> np.ndarray:
        """Least |r|^2 + |z|^2 of each test, (n,); tests (k, n)."""
        residual = self.residual[:, None] - tests
        pull = self.slope[:, self.free].T @ residual + self.z[self.free][:, None]
        gain = np.sum((self.root @ pull) ** 2, axis=0)
        return np.sum(residual**2, axis=0) + self.z @ self.z - gain

    def drawn(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """Tests that the hypothesis makes, (k, n)."""
        away = rng.standard_normal((len(self.z), n)) - self.z[:, None]
        errors = rng.standard_normal((len(self.residual), n))
        return self.residual[:, None] + self.slope[:, self.free] @ away[self.free] + errors


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
