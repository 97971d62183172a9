"""Effects at work together: which are worth a fit, and their fits."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from fenics_joints.diagnosis.effects.effect import Effect
from fenics_joints.diagnosis.evidence.fitted import Fit
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.diagnosis.evidence.screen import near_best, whitened, with_other
from fenics_joints.diagnosis.exchange import fit_exchanged
from fenics_joints.diagnosis.several import Fits

__all__ = ["fit_together"]

#: Sets that get a quick look with the model; that are fitted in full at most, and how far (in ln)
#: one may be behind the best.
_LOOKS, _MOST, _MARGIN = 100, 24, 8.0
#: How far from the middle of their priors a second look at effects by level is taken from.
_NEARER = 2.0
#: Leading hypotheses that a third effect is put beside.
_LEADERS = 3

#: Effects, and the fit without the last of them.
Set = tuple[tuple[Effect, ...], Fit]


def fit_together(search: Fits, level: Sequence[Fit], known: Sequence[Fit], size: int) -> list[Fit]:
    """Fits of several effects at once that a quick look does not rule out. Collective.

    Args:
        search: Fits hypotheses.
        level: Fits of one effect fewer.
        known: All fits so far.
        size: How many effects.
    """
    sets = _pairs(level) if size == 2 else _beside_leaders(search, level)
    sets = [each for each in sets if search.met.same(each[0]) is None]
    allowed = {frozenset(e.key for e in effects): effects for effects, _ in sets}
    sets = _promising(search, sets, known)
    if not sets:
        return []
    search.progress.step(f"a quick look at {size} effects at a time", len(sets))
    hypotheses = [search.model.hypothesis(effects) for effects, _ in sets]
    looks = _looked(search, hypotheses, sets, search.lowers(known))
    # What an unknown cause does far better than is looked at all the same, for what is a part.
    best = np.max(search.scores([f for f in known if not f.hypothesis.unknown]))
    scores = np.array([value for value, _ in looks]) + search.log_prior(hypotheses)
    # A step that is too long promises too much: what is promised is held against what is fitted,
    # and never against another promise.
    chosen = [i for i in near_best(scores, np.inf, _MOST) if scores[i] > best - _MARGIN]
    search.progress.step(f"fitting {size} effects at a time", len(chosen))
    singles = [f for f in known if len(f.hypothesis.effects) == 1]
    found = search.above(
        [hypotheses[i] for i in chosen],
        [[looks[i][1], *_as_alone(hypotheses[i], looks[i][1], singles)] for i in chosen],
        [sets[i][1] for i in chosen],
    )  # fmt: skip
    lowers = search.lowers([*known, *found])
    return found + fit_exchanged(search, found, singles, allowed, lowers)


def _looked(
    search: Fits, hypotheses: Sequence[Hypothesis], sets: Sequence[Set], lowers
) -> list[tuple[float, np.ndarray]]:
    """A quick look at each set, from the fit without its last effect."""
    starts = [search.start(effects, parent) for effects, parent in sets]
    looks = search.looked(hypotheses, starts, lowers)
    if not search.model.evidence.drifts:
        return looks
    # What grows with the level does so by exponentials: a first step may go far too far.
    nearer = [np.clip(z, -_NEARER, _NEARER) for _, z in looks]
    again = search.looked(hypotheses, nearer, lowers)
    return [max(pair, key=lambda look: look[0]) for pair in zip(looks, again, strict=True)]


def _as_alone(h: Hypothesis, z: np.ndarray, singles: Sequence[Fit]) -> list[np.ndarray]:
    """A point with what acts in steps of the last effect where the fit of that alone has it, in a
    list; empty if nothing does."""
    last = h.effects[-1]
    alone = next((f for f in singles if f.hypothesis.effects == (last,)), None)
    if alone is None or not any(p.scan for p in last.priors):
        return []
    start, z = h.own.stop - len(last.priors), z.copy()
    z[start : h.own.stop] = alone.z[alone.hypothesis.own]
    return [z]


def _pairs(singles: Sequence[Fit]) -> list[Set]:
    """Every two effects of different families, with the better of the two alone."""
    found = []
    for a, b in combinations(singles, 2):
        parent, other = (a, b) if a.log_evidence >= b.log_evidence else (b, a)
        effects = (*parent.hypothesis.effects, *other.hypothesis.effects)
        if _compatible(effects):
            found.append((effects, parent))
    return found


def _beside_leaders(search: Fits, level: Sequence[Fit]) -> list[Set]:
    """The best of a level with one more effect each."""
    found, known = [], set()
    for parent in sorted(level, key=lambda f: -f.log_evidence)[:_LEADERS]:
        for effect in search.model.effects:
            effects = (*parent.hypothesis.effects, effect)
            keys = frozenset(e.key for e in effects)
            if _compatible(effects) and keys not in known:
                known.add(keys)
                found.append((effects, parent))
    return found


def _promising(search: Fits, sets: list[Set], known: Sequence[Fit]) -> list[Set]:
    """Those that are worth a look: by the sum of what the fits alone say, without the model.

    The last effect's signature is taken at its own best fit. What it could explain of what the
    others leave is then a linear problem.
    """
    if len(sets) <= _LOOKS:
        return sets
    evidence, alone = search.model.evidence, {}
    for f in known:
        if len(f.hypothesis.effects) == 1:
            alone[f.hypothesis.effects[0].key] = f
    white = [
        (lower, {id(f): whitened(f, evidence, lower) for f in known})
        for lower in search.lowers(known)
    ]
    gains = []
    for effects, parent in sets:
        other = alone[effects[-1].key]
        both = [with_other(parent, other, seen, lower) for lower, seen in white]
        before, after = np.max(both, axis=0)
        gains.append(parent.log_evidence + after - before)
    hypotheses = [search.model.hypothesis(effects) for effects, _ in sets]
    scores = np.array(gains) + search.log_prior(hypotheses)
    return [sets[i] for i in near_best(scores, np.inf, _LOOKS)]


def _compatible(effects: Sequence[Effect]) -> bool:
    """Whether effects can be at work together, none in place of another."""
    families = [e.family or e.key for e in effects]
    keys = [e.key for e in effects]
    if len(set(families)) < len(families) or len(set(keys)) < len(keys):
        return False
    return not any(a.never_with & {b.name for b in effects if b is not a} for a in effects)
