"""The verdict in words, and whether held-out data confirm it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence

import numpy as np
from scipy.special import betaincc, betaln

from fenics_joints.diagnosis.effects.effect import Effect
from fenics_joints.diagnosis.evidence.fitted import Fit
from fenics_joints.diagnosis.result import EffectResult
from fenics_joints.diagnosis.shrinkage import Shrinkage
from fenics_joints.diagnosis.thresholds import MISFIT, STRONG
from fenics_joints.formatting import p_value, percent
from fenics_joints.formatting import probability as shown
from fenics_joints.measurements.gap import Gap

#: Verdicts that name a cause: one that held-out data confirm, and one that they do not.
CAUSE, LIKELY = "cause", "likely"
NAMED = (CAUSE, LIKELY)

NO_GAP, UNKNOWN = "no gap", "none of these"
#: Probability that a class must have, of what is left for the library, to be called a cause.
#: [decision: chosen]
_SURE = 0.8
#: Share of the held-out gap beyond noise that a confirmed cause has to close. [decision: chosen:
#: half]
_MOST_OF_IT = 0.5


def decide(
    fits: Sequence[Fit],
    probability: np.ndarray,
    effects: Sequence[EffectResult],
    leader: Fit,
    after: Gap,
    at_once: float | None = None,
    doubtful: Collection[str] = (),
) -> tuple[str, str]:
    """The verdict and a sentence or two that say it.

    ``unknown`` if that is more probable than all others together, or if the best explanation does
    not fit the data within noise and discrepancy. Otherwise, among the others, ``no gap`` if it is
    more probable than not; ``cause`` if a class of effects is probable enough, and more probable
    than not with the unknown counted too; `confirm` may make it a ``likely`` one. ``ambiguous``
    else.

    Args:
        fits: Hypotheses, most probable first.
        probability: Their probabilities.
        effects: Effects with their probability and class.
        leader: The best hypothesis that is not the unknown.
        after: Its gap.
        at_once: Probability of a misfit as large as all effects at once leave
            (`fenics_joints.diagnosis.evidence.linear_fits`); None where it was not looked at.
        doubtful: Classes that held-out data do not confirm, beside others that they do.
    """
    by_label = {}
    for f, p in zip(fits, probability, strict=True):
        by_label[f.hypothesis.label] = by_label.get(f.hypothesis.label, 0.0) + float(p)
    other = by_label.get(UNKNOWN, 0.0)
    listed = 1.0 - other
    if by_label.get(NO_GAP, 0.0) > max(0.5 * listed, other):
        return "no gap", (
            "The baseline model, with its parts within tolerance, explains the test to within "
            "noise: there is no error to explain."
        )
    if other > 0.5 or leader.p_value < MISFIT:
        return "unknown", _no_effect(leader, after, at_once)
    classes = class_probabilities(fits, probability, effects)
    if sure := [name for name in sure_classes(classes, other) if name not in doubtful]:
        said = "; and ".join(f"{_sentence(name)} ({shown(classes[name])})" for name in sure)
        maybe = [n for n, p in classes.items() if p >= (1 - _SURE) * listed and n not in sure]
        tail = f" Perhaps also: {'; '.join(maybe)}." if maybe else ""
        return CAUSE, f"The error comes from {said}.{tail}"
    rated = {**classes, NO_GAP: by_label.get(NO_GAP, 0.0), UNKNOWN: other}
    first = sorted(rated.items(), key=lambda item: -item[1])[:3]
    named = [f"{name} ({shown(p)})" for name, p in first]
    return "ambiguous", f"This test does not decide between {', '.join(named)}."


def confirmed(s: Shrinkage) -> bool:
    """Whether held-out data confirm a cause: the explanation chosen and fitted without these data
    predicts them better than the nominal model and than the best wrong effect, each with 95 %; it
    closes at least half of the gap beyond noise; and one of several causes at least makes the data
    more probable, at 20 to 1 (`unproved` are those that do not)."""
    shrinks = bool(s.folds) and s.after < s.before and s.shrink_interval[0] > 0 and s.claimed
    proves = not s.gains or len(unproved(s)) < len(s.gains)
    return shrinks and s.shrink >= _MOST_OF_IT and proves


def after_held_out(
    fits: Sequence[Fit], probability: np.ndarray, keys: Collection[str], s: Shrinkage
) -> tuple[list[Fit], np.ndarray]:
    """Hypotheses and their probabilities, the most probable first, after the named effects were
    tested on held-out parts.

    Args:
        fits: Hypotheses.
        probability: Their probabilities, (n,).
        keys: Of the effects that are named.
        s: How far the gap shrinks on held-out data.
    """
    named = np.array([any(e.key in keys for e in f.hypothesis.effects) for f in fits])
    won = [fold.won for fold in s.folds if fold.tells]
    weight = np.where(named, held_out_factor(sum(won), len(won)), 1.0) * probability
    probability = weight / weight.sum()
    order = np.argsort(-probability, kind="stable")
    return [fits[i] for i in order], probability[order]


def held_out_factor(won: int, parts: int) -> float:
    """Bayes factor for a named cause from the number of held-out parts that it predicts best; at
    most 1, since parts overlap.

    A right cause wins with a probability between a half and one, all equally likely; a wrong one
    wins every other time.

    Args:
        won: Number of parts that it predicts better than the nominal model and its best rival.
        parts: Number of parts.
    """
    lost = parts - won
    log_right = betaln(won + 1, lost + 1) + np.log(betaincc(won + 1, lost + 1, 0.5))
    return float(min(np.exp(log_right + (parts + 1) * np.log(2.0)), 1.0))


def unproved(s: Shrinkage) -> list[str]:
    """Names of the causes without which held-out data are not much less probable."""
    return [name for name, gain in s.gains.items() if not gain > np.log(STRONG)]


def confirm(verdict: str, summary: str, s: Shrinkage) -> tuple[str, str]:
    """A verdict that names a cause, with what held-out data say of it: ``cause`` if they confirm
    it, ``likely`` if not; other verdicts stay.

    Args:
        verdict: From `decide`.
        summary: Likewise.
        s: How far the gap shrinks on held-out data.
    """
    if verdict not in NAMED:
        return verdict, summary
    if confirmed(s):
        return CAUSE, summary
    return LIKELY, f"{summary} Held-out data do not confirm it: {unconfirmed(s)}."


def with_strangers(verdict: str, summary: str, names: Sequence[str]) -> tuple[str, str]:
    """The verdict if some test modes match none of the model's: "no gap" becomes "unknown"; other
    verdicts stay, for the remaining modes.

    Args:
        verdict: From `confirm`.
        summary: Likewise.
        names: Names of the modes without a match.
    """
    if not names:
        return verdict, summary
    rest = f"{', '.join(names)}, as no mode of the model matches, with or without an effect"
    if verdict != "no gap":
        return verdict, f"{summary} Left out: {rest}."
    return "unknown", f"The baseline model explains all measured modes except {rest}."


def unconfirmed(s: Shrinkage | None) -> str:
    """Why held-out data do not confirm a cause, in words."""
    if s is None or not s.folds or not np.isfinite(s.after):
        return "nothing could be held out"
    if s.after >= s.before:
        return f"their error grows from {percent(s.before)} to {percent(s.after)}"
    if not np.isfinite(s.before):
        return "the baseline model has none of these modes, so there is no error to reduce"
    if not np.isfinite(s.shrink):
        return "the baseline model already predicts them as well as noise allows"
    if s.shrink_interval[0] <= 0:
        return (
            f"the reduction of their error from {percent(s.before)} to {percent(s.after)} may be "
            "due to chance"
        )
    if not s.claimed:
        return "the placebo predicts them nearly as well"
    if s.shrink < _MOST_OF_IT:
        return (
            f"their error falls from {percent(s.before)} to {percent(s.after)} where noise allows "
            f"{percent(s.noise)}: less than half of the possible reduction"
        )
    return f"they are not surely more probable with {' or '.join(unproved(s))} than without"


def doubtful(effects: Sequence[EffectResult], s: Shrinkage | None) -> list[str]:
    """Classes that held-out data do not confirm, beside others that they do.

    Args:
        effects: All effects, the most probable first.
        s: How far the gap shrinks on held-out data.
    """
    if s is None or not confirmed(s):
        return []
    of: dict[str, list[EffectResult]] = {}
    for effect in effects:
        of.setdefault(effect.class_name, []).append(effect)
    return [name for name, members in of.items() if label_of(members) in unproved(s)]


def label_of(members: Sequence[EffectResult]) -> str:
    """The name of a class in `Shrinkage.gains`.

    Args:
        members: Its effects, the most probable first.
    """
    return members[0].name + (" (or a confusable effect)" if len(members) > 1 else "")


def sure_classes(classes: dict[str, float], unknown: float) -> list[str]:
    """The classes that are called causes.

    Args:
        classes: Their probabilities, from `class_probabilities`.
        unknown: That of an unknown cause.
    """
    return [name for name, p in classes.items() if p >= least_sure(unknown)]


def least_sure(unknown: float) -> float:
    """Probability from which a class is called a cause, given that of an unknown cause."""
    return max(_SURE * (1.0 - unknown), 0.5)


def class_probabilities(
    fits: Sequence[Fit], probability: np.ndarray, effects: Sequence[EffectResult]
) -> dict[str, float]:
    """Probability that some member of each class is at work, largest first.

    The sum over the hypotheses that hold a member; these exclude one another.
    """
    named = {(e.name, e.region): e.class_name for e in effects}
    total = {name: 0.0 for name in named.values() if name not in (NO_GAP, UNKNOWN)}
    for f, p in zip(fits, probability, strict=True):
        for name in {named[e.name, e.region] for e in f.hypothesis.effects}:
            total[name] += float(p)
    return dict(sorted(total.items(), key=lambda item: -item[1]))


def _no_effect(leader: Fit, after: Gap, at_once: float | None) -> str:
    """Why no effect of the library is the cause, and whether all of them could be."""
    best = f"{leader.hypothesis.label}, leaves {100 * after.rms:.1f} %"
    p = _p(leader.p_value)
    if leader.p_value < MISFIT:
        words = (
            f"No effect of the library explains the test. The best of them, {best} of error, which "
            f"noise and model error do not explain {p}."
        )
        if at_once is None:
            return words
        if at_once < MISFIT:
            rest = "the cause is of another kind"
            return f"{words} Nor do all effects of the library at once {_p(at_once)}: {rest}."
        rest = "several of them may act together"
        return f"{words} All effects of the library at once may {_p(at_once)}: {rest}."
    return (
        "No effect of the library is as probable as a cause that is not in it. The best of them, "
        f"{best} of error, which noise and model error can explain {p}."
    )


def _p(value: float) -> str:
    """A p-value as ``(p = 0.01)`` or ``(p < 0.001)``."""
    number = p_value(value)
    return f"(p {number if number.startswith('<') else f'= {number}'})"


def _sentence(name: str) -> str:
    return f"one of: {name}" if " or " in name else name


def is_wrong(
    fits: Sequence[Fit],
    leader: Fit,
    touched: Mapping[str, frozenset[str]],
    confusable: Mapping[str, Collection[str]],
) -> Callable[[Fit], bool]:
    """A function that tells whether a hypothesis is a placebo: one without the leader's main cause.

    The main cause is the effect without which the evidence falls most, of those that move
    frequencies, since S* measures these. A placebo holds neither this effect nor one that can stand
    for it, is of its family or acts on the same parameters of the model: a joint that is compliant
    at one place would be no fair placebo for one that is compliant everywhere.

    Args:
        fits: Hypotheses, most probable first.
        leader: The best explanation of the gap.
        touched: The model's parameters that each effect acts on, by its key.
        confusable: The keys of effects that can stand for each, by its key.
    """

    def holds(f: Fit, effect: Effect) -> bool:
        return any(
            e.key in confusable[effect.key]
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
        # Effects of few structures have lower prior odds, which would be unfair.
        fair = bool(own) and not any(e.beside for e in own)
        return fair and (main is None or not holds(f, main))

    return wrong


def several_causes(
    fits: Sequence[Fit],
    probability: np.ndarray,
    effects: Sequence[EffectResult],
    grouped: Mapping[str, str],
    confusable: Mapping[str, Collection[str]],
) -> dict[str, Callable[[Fit], bool]]:
    """The causes of a verdict that names several, by the most probable member's name: functions
    that tell whether a hypothesis holds a member of the cause's class, or an effect that can stand
    for one. Empty for a single cause, which S* confirms.

    Args:
        fits: Hypotheses, most probable first.
        probability: Their probabilities.
        effects: Effects with their probability and class.
        grouped: The class of each effect, by its key.
        confusable: See `is_wrong`.
    """
    rated = class_probabilities(fits, probability, effects)
    other = sum(p for f, p in zip(fits, probability, strict=True) if f.hypothesis.unknown)
    found = {}
    for name in sure_classes(rated, float(other)):
        members = [e for e in effects if e.class_name == name]
        kind = frozenset().union(*(confusable[k] for k, of in grouped.items() if of == name))
        found[label_of(members)] = lambda f, kind=kind: any(
            e.key in kind for e in f.hypothesis.effects
        )
    return found if len(found) > 1 else {}
