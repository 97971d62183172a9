"""How a diagnosis is read, on the page and on the terminal: its leader, its effects by class."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from fenics_joints.commands.diagnose.words import NARROWED, VERDICTS, is_part, joined, shortened
from fenics_joints.diagnosis import Diagnosis, EffectResult, HypothesisResult, Silent
from fenics_joints.diagnosis.effects.rig import MISPLACED, MISSCALED, MISSED, SWAPPED
from fenics_joints.diagnosis.location import Location
from fenics_joints.diagnosis.verdict import NAMED, NO_GAP, UNKNOWN, doubtful, least_sure
from fenics_joints.diagnosis.where.score_tests import LEVEL, Attribution
from fenics_joints.formatting import probability, spaced

#: Share of the gap that is worth a word.
SHARE = 0.1
#: Effects in a class from which on its name is no find.
_LARGE = 6
#: Effects that are no change of the structure but of how it was measured.
_IN_TEST = (MISSCALED, MISPLACED, MISSED, SWAPPED)


@dataclass(frozen=True)
class EffectClass:
    """Effects that the test cannot tell apart, or one that it can.

    Attributes:
        name: The class's name.
        letter: A, B, ... for a class of several; empty for an effect on its own.
        probability: Probability that one of them at least is at work.
        effects: The effects, most probable first.
    """

    name: str
    letter: str
    probability: float
    effects: tuple[EffectResult, ...]


def leading(d: Diagnosis) -> HypothesisResult | None:
    """The best hypothesis that says what the gap is made of: ``Diagnosis.after`` is its gap."""
    return next((h for h in d.hypotheses if h.label != UNKNOWN), None)


def effect_classes(d: Diagnosis) -> list[EffectClass]:
    """Effects by class, most probable class first, with letters for those of several."""
    letters = iter("ABCDEFGHIJKLMNOPQRSTUVWXYZ")
    return [
        EffectClass(name, next(letters, "*") if len(effects) > 1 else "", p, effects)
        for name, p, effects in d.classes
    ]


def by_effect(parameters: list[dict]) -> list[tuple[str, list[dict]]]:
    """Fitted parameters that are no nuisances, with the effect they belong to."""
    own = [p for p in parameters if not p["nuisance"]]
    return [(key, list(rows)) for key, rows in groupby(own, key=lambda p: p["effect"])]


def by_reason(silent: Iterable[Silent]) -> list[tuple[str, list[str]]]:
    """Effects that the test says nothing about, by reason, in the order of both."""
    names: dict[str, list[str]] = {}
    for s in silent:
        names.setdefault(s.reason, []).append(s.effect)
    return list(names.items())


def named(hypothesis: HypothesisResult) -> str:
    """A hypothesis by its effects, each with its place where the name does not say it."""
    if hypothesis.label == NO_GAP:
        return "the nominal model within its tolerances"
    return " + ".join(with_place(key) for key in hypothesis.effects) or hypothesis.label


def with_place(key: str) -> str:
    """An effect's key, ``name (region)``, in words, the region where the name does not say it."""
    name, bracket, region = spaced(key).rpartition(" (")
    region = region.rstrip(")")
    if not bracket or region in ("joint", "all parts") or region in name:
        return name if bracket else spaced(key)
    return f"{name} ({region})"


def in_words(effect: EffectResult) -> str:
    """An effect with its place, where its name does not say that already."""
    return with_place(effect.key)


def along(found: Location, by: str) -> list[Attribution]:
    """What each group of one kind, such as ``mode``, adds to the misfit."""
    return [a for a in found.attribution if a.by == by]


def mesh_error(d: Diagnosis) -> float:
    """Root mean square over the modes of the mesh's own error; 0 where it was not measured."""
    errors = list(d.model.get("mesh_error", {}).values())
    return float(np.sqrt(np.mean(np.square(errors)))) if errors else 0.0


def is_loud(part: Attribution, parts: Sequence[Attribution]) -> bool:
    """Whether a group adds more than chance, all groups of the axis considered (Bonferroni)."""
    return part.p * len(parts) < LEVEL


def heading_of(d: Diagnosis) -> str:
    """The verdict as a heading: a cause is found where at least one class is small."""
    if is_part(d):
        return VERDICTS["in part"]
    fewest = min((len(c.effects) for c in sure_causes(d)), default=0)
    words = NARROWED if fewest >= _LARGE else VERDICTS
    return words.get(d.verdict, d.verdict).format(n=fewest)


def causes(d: Diagnosis) -> list[EffectClass]:
    """The classes of effects, without those that stand for none of them."""
    return [c for c in effect_classes(d) if c.name not in (NO_GAP, UNKNOWN)]


def sure_causes(d: Diagnosis) -> list[EffectClass]:
    """The classes that the verdict calls causes."""
    if d.verdict not in NAMED:
        return []
    least, weak = least_sure(probability_of(d, UNKNOWN)), doubtful(d.effects, d.shrinkage)
    return [c for c in causes(d) if c.probability >= least and c.name not in weak]


def best_without(d: Diagnosis, sure: Sequence[EffectClass]) -> HypothesisResult | None:
    """The best hypothesis that lacks one of some causes."""
    keys = [{e.key for e in c.effects} for c in sure]
    listed = [h for h in d.hypotheses if h.label != UNKNOWN]
    lacking = [h for h in listed if any(not k & set(h.effects) for k in keys)]
    return max(lacking, key=lambda h: h.log_evidence, default=None)


def members_in_words(group: EffectClass) -> str:
    """A class in words, the most probable member first."""
    items = [in_words(e) for e in group.effects]
    if len(items) == 1:
        return items[0]
    return f"{shortened(items, 'or')}, which this test cannot tell apart"


def priors_in_words(group: EffectClass) -> str:
    """What the members of a class had before the test, of what the class had."""
    total = sum(e.odds for e in group.effects)
    if total <= 0 or len({e.odds for e in group.effects}) == 1:
        return "Before the test they were equally likely."
    items = [f"{in_words(e)} {probability(e.odds / total)}" for e in group.effects]
    return f"Before the test: {shortened(items)}."


def probability_of(d: Diagnosis, label: str) -> float:
    """Probability of the hypotheses of one label."""
    return sum(h.probability for h in d.hypotheses if h.label == label)


def in_test(d: Diagnosis) -> str:
    """Whether causes are in the test itself, and where."""
    sure = sure_causes(d)
    inside = [c.effects[0] for c in sure if c.effects[0].name in _IN_TEST]
    if not inside:
        return ""
    places = joined([spaced(e.region) for e in inside])
    only = len(inside) == len(sure)
    return (
        f"in the test, not in the structure: {places}" if only else f"in part in the test: {places}"
    )
