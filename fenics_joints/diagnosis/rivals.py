"""Which explanations held-out data set against the one that is named: wrong ones, and those that
lack a cause of it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence

import numpy as np

from fenics_joints.diagnosis.effects.effect import Effect
from fenics_joints.diagnosis.evidence.fitted import Fit
from fenics_joints.diagnosis.result import EffectResult
from fenics_joints.diagnosis.verdict import class_probabilities, label_of, sure_classes


def is_wrong(
    fits: Sequence[Fit],
    leader: Fit,
    touched: Mapping[str, frozenset[str]],
    alike: Mapping[str, Collection[str]],
) -> Callable[[Fit], bool]:
    """Says whether a hypothesis is a placebo: it has nothing of the leader's main cause.

    The main cause is the effect without which the evidence falls most, of those that move
    frequencies, which S* is of (beside one that only damps, the other is no placebo), and all that
    can stand for it. Of its kind are also effects of its family, and what acts on the same
    parameters of the model: a joint that gives way at one place is no fair placebo for one that
    gives way.

    Args:
        fits: Hypotheses, most probable first.
        leader: The best that says what the gap is made of.
        touched: The model's parameters that each effect acts on, by its key.
        alike: The keys of effects that can stand for each, by its key.
    """

    def holds(f: Fit, effect: Effect) -> bool:
        return any(
            e.key in alike[effect.key]
            or (e.family and e.family == effect.family)
            or touched[e.key] & touched[effect.key]
            for e in f.hypothesis.effects
        )

    known = [f for f in fits if not f.hypothesis.unknown]
    effects = leader.hypothesis.effects
    main = min(
        [e for e in effects if touched[e.key] or e.sensing is not None] or effects,
        key=lambda e: max((f.log_evidence for f in known if not holds(f, e)), default=-np.inf),
        default=None,
    )

    def wrong(f: Fit) -> bool:
        own = f.hypothesis.effects
        # What few structures have did not have the same chance.
        fair = bool(own) and not any(e.beside for e in own)
        return fair and (main is None or not holds(f, main))

    return wrong


def several_causes(
    fits: Sequence[Fit],
    probability: np.ndarray,
    effects: Sequence[EffectResult],
    grouped: Mapping[str, str],
    alike: Mapping[str, Collection[str]],
) -> dict[str, Callable[[Fit], bool]]:
    """Several causes that are called so, each as whether a hypothesis holds one of its class, or
    what can stand for one and is no member since it is rarer; by the most probable member's name.
    A single one is S*'s to confirm.

    Args:
        fits: Hypotheses, most probable first.
        probability: Their probabilities.
        effects: Effects with their probability and class.
        grouped: The class of each effect, by its key.
        alike: See `is_wrong`.
    """
    rated = class_probabilities(fits, probability, effects)
    other = sum(p for f, p in zip(fits, probability, strict=True) if f.hypothesis.unknown)
    found = {}
    for name in sure_classes(rated, float(other)):
        members = [e for e in effects if e.class_name == name]
        kind = frozenset().union(*(alike[k] for k, of in grouped.items() if of == name))
        found[label_of(members)] = lambda f, kind=kind: any(
            e.key in kind for e in f.hypothesis.effects
        )
    return found if len(found) > 1 else {}
