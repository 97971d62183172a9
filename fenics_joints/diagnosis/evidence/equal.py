"""Hypotheses that are one another in other words, which are weighed once.

"Compliance away from the bolts only" with "compliance at one joint", the other one, is compliance
"graded from zone to zone": the same values of the model at the same prior density. Two causes that
merely look alike in a test are a class (`fenics_joints.diagnosis.evidence.classes`) and stay two.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from fenics_joints.diagnosis.effects.effect import Effect
from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.diagnosis.thresholds import ROUND_OFF

#: Frequencies at which losses are compared, Hz. [numerical: chosen]
_HZ = (30.0, 700.0)
#: Step of derivatives that pair parameters, and points at random that check the pairs. [numerical:
#: chosen]
_STEP, _PROBES = 1e-3, 3


class Known:
    """Hypotheses met so far; says of a further set of effects whether it is one of them.

    Args:
        baseline: Parameter values of the nominal model.
        conditions: Those of the test.
    """

    def __init__(self, baseline: Mapping[str, float], conditions: Iterable[float]):
        self._baseline, self._conditions = dict(baseline), tuple(float(c) for c in conditions)
        self._touched: dict[str, frozenset[str]] = {}
        self._met: dict[tuple, list[tuple[Effect, ...]]] = {}

    def same(self, effects: Sequence[Effect]) -> tuple[Effect, ...] | None:
        """The first set met that is this one in other words; None, and it is met, if none is."""
        effects = tuple(effects)
        if not effects or any(e.sensing is not None for e in effects):
            return None
        alike = self._met.setdefault(self._outline(effects), [])
        for other in alike:
            if equal(effects, other, self._baseline, self._conditions):
                return other
        alike.append(effects)
        return None

    def _outline(self, effects: tuple[Effect, ...]) -> tuple:
        """What two equal sets have in common, found without a comparison of values."""
        priors = sorted(repr(_known(p)) for e in effects for p in e.priors)
        touched = frozenset().union(*(self._touches(e) for e in effects))
        kinds = (
            any(getattr(e, key) for e in effects)
            for key in ("depends_on_condition", "by_level", "loss")
        )
        return tuple(priors), touched, tuple(kinds)

    def _touches(self, effect: Effect) -> frozenset[str]:
        if effect.key not in self._touched:
            self._touched[effect.key] = effect.touches(self._baseline, self._conditions)
        return self._touched[effect.key]


def distinct(
    effects: Iterable[Effect], baseline: Mapping[str, float], conditions: Iterable[float]
) -> tuple[Effect, ...]:
    """Effects without those that are an earlier one in other words, which says so.

    Args:
        effects: The effects.
        baseline: Parameter values of the nominal model.
        conditions: Those of the test.
    """
    known, found = Known(baseline, conditions), {}
    for effect in effects:
        same = known.same((effect,))
        if same is None:
            found[effect.key] = effect
            continue
        first = found[same[0].key]
        words = f"{first.describe} In this test that is also: {effect.key}."
        found[first.key] = replace(first, describe=words.strip())
    return tuple(found.values())


def equal(
    a: Sequence[Effect],
    b: Sequence[Effect],
    baseline: Mapping[str, float],
    conditions: Sequence[float],
) -> bool:
    """Whether two sets of effects make the same of the model, with the same prior.

    They do if their parameters can be paired, each with one of the same prior, so that all values
    and losses are the same at every point: derivatives at the medians pair them, and points at
    random check it.

    Args:
        a: Effects.
        b: Others.
        baseline: Parameter values of the nominal model.
        conditions: Those of the test.
    """
    first, second = Hypothesis(tuple(a)), Hypothesis(tuple(b))
    n = len(first.priors)
    if n != len(second.priors):
        return False

    def made(h: Hypothesis, z: np.ndarray) -> dict:
        return _made(h, z, dict(baseline), conditions)

    pairs = _paired(first, second, made)
    if pairs is None:
        return False
    rng = np.random.default_rng(1)
    for z in rng.uniform(-1.0, 1.0, (_PROBES, n)):
        other = np.zeros(n)
        other[pairs] = z
        if not _close(made(first, z), made(second, other)):
            return False
    return True


def _known(prior) -> tuple:
    return prior.median, prior.spread, prior.unit, prior.log, prior.span, prior.scan, prior.even


def _made(h: Hypothesis, z: np.ndarray, baseline: dict, conditions: Sequence[float]) -> dict:
    """Values and losses at all conditions, by what they are of."""
    found = {}
    for i, c in enumerate(conditions):
        found |= {(i, key): v for key, v in h.values(z, c, baseline).items()}
        for hz in _HZ:
            found |= {(i, hz, key): eta for key, eta in h.losses(z, c, hz).items()}
    return found


def _paired(a: Hypothesis, b: Hypothesis, made) -> list[int] | None:
    """For each parameter of one its place in the other; None if they do not pair."""
    n, steps = len(a.priors), _STEP * np.eye(len(a.priors))
    others, pairs = [made(b, step) for step in steps], []
    for i in range(n):
        moved = made(a, steps[i])
        own = _known(a.priors[i][1])
        free = (j for j in range(n) if j not in pairs and _known(b.priors[j][1]) == own)
        j = next((j for j in free if _close(moved, others[j])), None)
        if j is None:
            return None
        pairs.append(j)
    return pairs


def _close(a: dict, b: dict) -> bool:
    """Whether two sets of values differ by round-off only."""
    if a.keys() != b.keys():
        return False
    return all(abs(a[k] - b[k]) <= ROUND_OFF * max(abs(a[k]), abs(b[k])) for k in a)
