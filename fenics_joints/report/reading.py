"""How a diagnosis is read, on the page and on the terminal: its leader, its effects by class."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING

from fenics_joints.diagnosis.verdict import UNKNOWN
from fenics_joints.formatting import spaced

if TYPE_CHECKING:
    from fenics_joints.diagnosis.effects.effect import Silent
    from fenics_joints.diagnosis.evidence.nested import Nested
    from fenics_joints.diagnosis.result import Diagnosis, EffectResult, HypothesisResult

__all__ = [
    "EffectClass", "by_effect", "by_reason", "effect_classes", "leading", "named",
    "sampled", "with_place",
]  # fmt: skip


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

    @property
    def size(self) -> int:
        """Number of effects."""
        return len(self.effects)


def leading(d: Diagnosis) -> HypothesisResult | None:
    """The best hypothesis that says what the gap is made of: ``Diagnosis.after`` is its gap."""
    return next((h for h in d.hypotheses if h.label != UNKNOWN), None)


def effect_classes(d: Diagnosis) -> list[EffectClass]:
    """Effects by class, most probable class first.

    The probability of a class is that of all hypotheses that hold one of its effects: since two of
    them may be in one hypothesis, it is not the sum over the effects.
    """
    members: dict[str, list[EffectResult]] = {}
    for effect in d.effects:
        members.setdefault(effect.class_name, []).append(effect)
    rows = []
    for name, effects in members.items():
        keys = {f"{e.name} ({e.region})" if e.region else e.name for e in effects}
        p = sum(h.probability for h in d.hypotheses if keys & {*h.effects, h.label})
        p = min(max([p, *(e.probability for e in effects)]), 1.0)
        rows.append((name, p, tuple(effects)))
    rows.sort(key=lambda row: -row[1])
    letters = iter("ABCDEFGHIJKLMNOPQRSTUVWXYZ")
    return [
        EffectClass(name, next(letters, "*") if len(effects) > 1 else "", p, effects)
        for name, p, effects in rows
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


def sampled(d: Diagnosis, hypothesis: HypothesisResult) -> Nested | None:
    """What nested sampling found of a hypothesis; None where it has Laplace's evidence."""
    return d.nested.get(" + ".join(hypothesis.effects) or hypothesis.label)


def named(hypothesis: HypothesisResult) -> str:
    """A hypothesis by its effects, each with its place where the name does not say it."""
    return " + ".join(with_place(key) for key in hypothesis.effects) or hypothesis.label


def with_place(key: str) -> str:
    """An effect's key, ``name (region)``, in words, the region where the name does not say it."""
    name, bracket, region = spaced(key).rpartition(" (")
    region = region.rstrip(")")
    if not bracket or region in ("joint", "all parts") or region in name:
        return name if bracket else spaced(key)
    return f"{name} ({region})"
