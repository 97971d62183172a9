"""Effects that a test cannot tell apart, and effects that it cannot see.

Two hypotheses are apart by D = |W (y_i - y_j)| / 2, half the whitened distance from the prediction
of one to the nearest that the other can make: with Gaussian noise the data of one are then taken
for the other's with probability Phi(-D). For one parameter each and equal size d of the effect it is
d sin(alpha / 2) with alpha the angle between the signatures.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fenics_joints.diagnosis.effects import Effect
from fenics_joints.diagnosis.inference import Evidence, Fit, Forward, Hypothesis

__all__ = ["APART", "classes", "detectable", "distance"]

#: 1 % confusion.
APART = 2.33


def distance(a: Fit, b: Fit, evidence: Evidence) -> float:
    """D between two fitted hypotheses, the larger of both ways round.

    The nearest prediction is found by one linear refit within the prior. The larger way counts: a
    hypothesis that could mimic another, but not at the values it has, is told apart.
    """
    lower = np.linalg.cholesky(evidence.covariance())
    return max(_one_way(a, b, evidence, lower), _one_way(b, a, evidence, lower)) / 2


def _one_way(a: Fit, b: Fit, evidence: Evidence, lower) -> float:
    """Whitened distance from a's prediction to the nearest that b can make."""
    used = evidence.used
    residual = np.linalg.solve(lower, (a.log_f - b.log_f)[used])
    slope = np.linalg.solve(lower, b.jacobian[used.ravel()])
    if slope.shape[1] == 0:
        return float(np.linalg.norm(residual))
    # |residual - slope d|^2 + |z + d|^2 - |z|^2: what b loses of its prior counts as well.
    hessian = slope.T @ slope + np.eye(slope.shape[1])
    d = np.linalg.solve(hessian, slope.T @ residual - b.z)
    left = residual - slope @ d
    cost = left @ left + max((b.z + d) @ (b.z + d) - b.z @ b.z, 0.0)
    return float(np.sqrt(cost))


def detectable(
    effect: Effect,
    forward: Forward,
    evidence: Evidence,
    baseline: dict[str, float],
    nuisances: Sequence[Effect],
) -> bool:
    """Whether the test could see the effect at its expected size on the nominal model.

    The change of the frequencies by the effect, less what the nuisances can mimic, is at least
    twice `APART` standard deviations long.
    """
    bare, with_it = Hypothesis((), tuple(nuisances)), Hypothesis((effect,), tuple(nuisances))
    change = []
    for condition in evidence.conditions:
        z = np.zeros(len(with_it.priors))
        after = forward(with_it.values(z, condition, baseline))[0]
        before = forward(bare.values(z[: len(bare.priors)], condition, baseline))[0]
        change.append(after - before)
    used = evidence.used
    lower = np.linalg.cholesky(evidence.covariance())
    seen = np.linalg.solve(lower, np.array(change)[used])
    return bool(np.linalg.norm(seen) >= 2 * APART)


def classes(
    fits: Sequence[Fit], probability: Sequence[float], evidence: Evidence
) -> dict[str, str]:
    """Class of every effect: effects that can stand for each other in some hypothesis.

    Two effects are of one class when hypotheses that differ by nothing but them are not apart
    (D < `APART`), be it alone or beside what the leading hypothesis holds.

    Args:
        fits: Fitted hypotheses.
        probability: Their posterior probabilities.
        evidence: The test.

    Returns:
        Name of the class by the effect's key: its members' names, joined by " or ".
    """
    keys = list(dict.fromkeys(e.key for f in fits for e in f.hypothesis.effects))
    names = {e.key: e.name for f in fits for e in f.hypothesis.effects}
    leader = fits[int(np.argmax(probability))]
    lead = {e.key for e in leader.hypothesis.effects}
    parent = {key: key for key in keys}

    def root(key: str) -> str:
        while parent[key] != key:
            key = parent[key]
        return key

    for i, a in enumerate(fits):
        for b in fits[:i]:
            swap = _swap(a, b)
            if swap is None or root(swap[0]) == root(swap[1]):
                continue
            rest = {e.key for e in a.hypothesis.effects} - {swap[0]}
            if rest - lead or (not rest and swap[0] in lead and len(lead) > 1):
                continue
            if distance(a, b, evidence) < APART:
                parent[root(swap[0])] = root(swap[1])
    members: dict[str, list[str]] = {}
    for key in keys:
        members.setdefault(root(key), []).append(names[key])
    return {key: " or ".join(dict.fromkeys(members[root(key)])) for key in keys}


def _swap(a: Fit, b: Fit) -> tuple[str, str] | None:
    """The two effects by which two hypotheses differ, if they differ by one each."""
    first = {e.key for e in a.hypothesis.effects}
    second = {e.key for e in b.hypothesis.effects}
    only_a, only_b = first - second, second - first
    if len(only_a) == 1 and len(only_b) == 1:
        return only_a.pop(), only_b.pop()
    return None
