"""Effects that a test cannot tell apart, and effects that it cannot see.

Two hypotheses are D = |W (y_i - y_j)| / 2 apart, half the whitened distance from the prediction of
one to the nearest prediction that the other can make: with Gaussian noise, data of one are then
taken for the other's with probability Phi(-D). With one parameter each, wide priors and a
prediction d standard deviations from the nominal one, D is d sin(alpha) / 2, where alpha is the
angle between the signatures.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from scipy.cluster.hierarchy import DisjointSet

from fenics_joints.diagnosis.effects.effect import Effect
from fenics_joints.diagnosis.evidence.evidence import Evidence
from fenics_joints.diagnosis.evidence.fitted import Fit
from fenics_joints.diagnosis.evidence.linear import whiten
from fenics_joints.diagnosis.thresholds import STRONG

#: 1 % confusion. [decision: convention: Phi(-2.33) = 1 %]
APART = 2.33
#: ln of the Bayes factor up to which the data leave two hypotheses undecided. [decision:
#: convention: decisive, Jeffreys 1961]
UNDECIDED = np.log(100.0)


def confusion(distance: float) -> float:
    """Probability of taking one of two causes for the other at a separation in s.d.: Phi(-D)."""
    return 0.5 * math.erfc(distance / math.sqrt(2.0))


def distance(a: Fit, b: Fit, evidence: Evidence) -> float:
    """D between two fitted hypotheses, the larger of the two from one to the other.

    The nearest prediction is found by one linear refit within the prior. The larger one counts: a
    hypothesis that could imitate another, but not the other it, is told apart.
    """
    return max(_one_way(a, b, evidence), _one_way(b, a, evidence)) / 2


def _one_way(a: Fit, b: Fit, evidence: Evidence) -> float:
    """Whitened distance from a's prediction to the nearest that b can make."""
    lower, used = evidence.at(a.scales).lower(), evidence.fitted
    residual = whiten(lower, (a.predicted - b.predicted)[used])
    slope = whiten(lower, b.jacobian[used])
    # |residual - slope d|^2 + |z + d|^2 - |z|^2: that b gets less probable before the test counts.
    hessian = slope.T @ slope + np.eye(slope.shape[1])
    d = np.linalg.solve(hessian, slope.T @ residual - b.z)
    left = residual - slope @ d
    cost = left @ left + max((b.z + d) @ (b.z + d) - b.z @ b.z, 0.0)
    return float(np.sqrt(cost))


def detectable(
    effects: Sequence[Effect],
    expected: Callable[[Effect, float], np.ndarray],
    without: np.ndarray,
    evidence: Evidence,
) -> dict[str, bool]:
    """Whether the test could see each effect at its expected size on a model without it, by key.

    The expected size is the prior's median or one standard deviation above it, whichever shows
    more; its change of the data is to be twice `APART` standard deviations long.

    Args:
        effects: The effects.
        expected: Gives everything in `Evidence.data`, (N,), with an effect at a size in standard
            deviations of its prior.
        without: The same of the model without it.
        evidence: The test.
    """
    lower, used = evidence.lower(), evidence.fitted
    found = {}
    for effect in effects:
        changes = [whiten(lower, (expected(effect, z) - without)[used]) for z in (0.0, 1.0)]
        # nan: the model then lacks a mode that the test saw, which shows.
        found[effect.key] = not all(np.linalg.norm(change) < 2 * APART for change in changes)
    return found


def confusable_effects(
    fits: Sequence[Fit], probability: Sequence[float], evidence: Evidence
) -> dict[str, frozenset[str]]:
    """Effects that can stand for each other in some hypothesis.

    Two can if hypotheses that differ in them alone, each by itself or beside the rest of the
    leading hypothesis, are too near each other (D < `APART`) and the test does not decide between
    them either (a Bayes factor below 100). And each must be of use: its hypothesis has to be more
    probable than the same without it.

    Args:
        fits: Fitted hypotheses.
        probability: Their posterior probabilities.
        evidence: The test.

    Returns:
        Keys of the effects that can stand for each effect, itself among them, by its key.
    """
    keys = list(dict.fromkeys(e.key for f in fits for e in f.hypothesis.effects))
    # An unknown cause may lead, but no effect can be put in place of one of its own.
    known = [0.0 if f.hypothesis.unknown else p for f, p in zip(fits, probability, strict=True)]
    lead = {e.key for e in fits[int(np.argmax(known))].hypothesis.effects}
    together = DisjointSet(keys)
    weighed = list(zip(fits, probability, strict=True))
    alone = {
        frozenset(e.key for e in f.hypothesis.effects): p
        for f, p in weighed
        if not f.hypothesis.unknown
    }
    for i, (a, p_a) in enumerate(weighed):
        for b, p_b in weighed[:i]:
            swap = _swap(a, b)
            if swap is None or together.connected(*swap):
                continue
            rest = {e.key for e in a.hypothesis.effects} - {swap[0]}
            # By itself, one of several leading effects explains only a part, as others may too.
            if rest - lead or (not rest and len(lead) > 1 and lead & set(swap)):
                continue
            if min(p_a, p_b) <= alone.get(frozenset(rest), 0.0):
                continue  # effects that explain nothing are alike, but no class
            if abs(a.log_evidence - b.log_evidence) > UNDECIDED:
                continue
            if distance(a, b, evidence) < APART:
                together.merge(*swap)
    return {key: frozenset(members) for members in together.subsets() for key in members}


def classes(
    fits: Sequence[Fit], probability: Sequence[float], confusable: Mapping[str, frozenset[str]]
) -> dict[str, str]:
    """Class of every effect: those that can stand for it, without members that are less than a
    twentieth as probable as the likeliest: the test decides against these, and with them a chain of
    neighbours would put most of a library into one class.

    Args:
        fits: Fitted hypotheses.
        probability: Their posterior probabilities.
        confusable: See `confusable_effects`.

    Returns:
        Name of the class by the effect's key: its members' names, joined by " or "; with their
        regions where effects at several places share a name.
    """
    names = labels([e for f in fits for e in f.hypothesis.effects])
    weighed = list(zip(fits, probability, strict=True))
    at_work = {
        key: sum(p for f, p in weighed if any(e.key == key for e in f.hypothesis.effects))
        for key in confusable
    }
    found = {}
    for members in set(confusable.values()):
        best = max(at_work[key] for key in members)
        likely = {key for key in members if at_work[key] * STRONG >= best}
        # In alphabetical order: in that of probability, round-off would decide.
        one = " or ".join(sorted({names[key] for key in likely}))
        found |= {key: one if key in likely else names[key] for key in members}
    return found


def labels(effects: Sequence[Effect]) -> dict[str, str]:
    """A label for each effect, by its key: its name, or the key if several places share that."""
    regions: dict[str, set[str]] = {}
    for effect in effects:
        regions.setdefault(effect.name, set()).add(effect.region)
    return {e.key: e.name if len(regions[e.name]) == 1 else e.key for e in effects}


def _swap(a: Fit, b: Fit) -> tuple[str, str] | None:
    """The two effects by which two hypotheses differ, if they differ by one each."""
    first = {e.key for e in a.hypothesis.effects}
    second = {e.key for e in b.hypothesis.effects}
    only_a, only_b = first - second, second - first
    if len(only_a) == 1 and len(only_b) == 1:
        return only_a.pop(), only_b.pop()
    return None
