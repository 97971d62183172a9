"""What leads with one of its effects exchanged for another that does nearly as well alone.

Pairs are chosen for a fit by a quick look from the better of the two alone, a linear step that may
go astray where an effect works by exponentials or one hides another. But where a and b lead, and c
alone explains much of what a alone does, c and b may do as well; they are fitted from there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fenics_joints.diagnosis.effects.effect import Effect
from fenics_joints.diagnosis.evidence.fitted import Fit
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.diagnosis.evidence.screen import near_best
from fenics_joints.diagnosis.several import Fits

__all__ = ["fit_exchanged"]

#: The best of several effects, and the best of one effect, that are exchanged with each other; how
#: many get fitted, and how far (in ln) one may be behind the best.
_LEADERS, _OTHERS, _MOST, _MARGIN = 3, 5, 6, 8.0


def fit_exchanged(
    search: Fits,
    level: Sequence[Fit],
    singles: Sequence[Fit],
    allowed: Mapping[frozenset[str], tuple[Effect, ...]],
    lowers: Sequence[np.ndarray],
) -> list[Fit]:
    """Fits of leading hypotheses with one effect exchanged, of those that a look bears. Collective.

    Args:
        search: Fits hypotheses.
        level: Fits of several effects at once, all of as many.
        singles: Fits of one effect.
        allowed: Effects that may be together and are not what another hypothesis says in other
            words, by their keys.
        lowers: See `Fits.looked`.
    """
    if not level:
        return []
    done = {frozenset(f.hypothesis.own_of) for f in level}
    others = _best(search, singles, _OTHERS)
    tasks: dict[frozenset[str], tuple[Hypothesis, list[np.ndarray]]] = {}
    for leader in _best(search, level, _LEADERS):
        for gone in leader.hypothesis.effects:
            for other in others:
                stay = [e for e in leader.hypothesis.effects if e is not gone]
                keys = frozenset(e.key for e in (*stay, *other.hypothesis.effects))
                if keys in allowed and keys not in done and keys not in tasks:
                    hypothesis = search.model.hypothesis(allowed[keys])
                    tasks[keys] = hypothesis, _starts(hypothesis, leader, other)
    return _fitted(search, list(tasks.values()), level, lowers) if tasks else []


def _best(search: Fits, fits: Sequence[Fit], most: int) -> list[Fit]:
    return [fits[i] for i in near_best(search.scores(fits), np.inf, most)]


def _starts(hypothesis: Hypothesis, leader: Fit, other: Fit) -> list[np.ndarray]:
    """Each effect as its own fit has it, all else as the leader's; and the new one at its median,
    since alone it may have been stretched to what the others explain."""
    z = leader.z[: hypothesis.own.start]
    for effect in hypothesis.effects:
        at = next(f for f in (leader, other) if effect.key in f.hypothesis.own_of)
        z = np.append(z, at.z[at.hypothesis.own_of[effect.key]])
    for name, group in hypothesis.shared.items():
        own = leader.z[leader.hypothesis.places[name]]
        z = np.append(z, own if len(own) == len(group) else np.zeros(len(group)))
    plain = z.copy()
    plain[hypothesis.own_of[other.hypothesis.effects[0].key]] = 0.0
    return [plain, z]


def _fitted(search: Fits, tasks, level: Sequence[Fit], lowers) -> list[Fit]:
    search.progress.step("a quick look at what leads with one effect exchanged", len(tasks))
    hypotheses = [h for h, _ in tasks]
    several = [(h, z) for h, starts in tasks for z in starts]
    twice = [h for h, _ in several]
    looks = search.looked(twice, [z for _, z in several], lowers)
    looks = search.looked(twice, [z for _, z in looks], lowers)
    values = np.array([value for value, _ in looks]).reshape(len(tasks), -1)
    scores = values.max(axis=1) + search.log_prior(hypotheses)
    best = np.max(search.scores(level))
    chosen = [i for i in near_best(scores, np.inf, _MOST) if scores[i] > best - _MARGIN]
    search.progress.step("fitting what leads with one effect exchanged", len(chosen))
    count = values.shape[1]
    ways = [
        [looks[count * i + int(np.argmax(values[i]))][1], tasks[i][1][0]] for i in chosen
    ]
    return search.fit_all([hypotheses[i] for i in chosen], ways)
