"""What a plan says: which causes a test could tell apart, which not, and what to measure next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

import fenics_joints
from fenics_joints.diagnosis.effects.effect import Silent
from fenics_joints.diagnosis.evidence.classes import APART
from fenics_joints.diagnosis.plan.added import Addition
from fenics_joints.diagnosis.thresholds import NEGLIGIBLE
from fenics_joints.files import plain

#: Names that a sentence holds at most. [numerical: length of a sentence]
_LISTED = 6


@dataclass(frozen=True)
class PlannedEffect:
    """An effect as the planned test would see it.

    Attributes:
        name: The effect.
        region: Where it acts.
        key: Its unique name.
        describe: What it means.
        size: Its expected size: value of each parameter, SI, by name.
        units: Units of these.
        distance: D from "no gap" at that size.
        least: The same at the size, of the prior's median and one standard deviation either way,
            that shows least.
        most: At the one that shows most.
        letter: Class of effects that the test would not tell apart; empty for one on its own.
    """

    name: str
    region: str
    key: str
    describe: str
    size: dict[str, float]
    units: dict[str, str]
    distance: float
    least: float
    most: float
    letter: str = ""

    @property
    def seen(self) -> bool:
        """Whether the test would see it at its expected size."""
        return self.distance >= APART


@dataclass(frozen=True)
class PlannedClass:
    """Effects that the planned test would not tell apart.

    Attributes:
        letter: A, B, ...
        members: Keys of the effects.
        collinearity: Collinearity index of their signatures; above 20 no size would help.
        combination: The changes that cancel best, in words.
        left: What they leave of the prediction's change, standard deviations.
    """

    letter: str
    members: tuple[str, ...]
    collinearity: float
    combination: str
    left: float


@dataclass(frozen=True, eq=False, repr=False)
class Plan:
    """The answer before any data.

    Attributes:
        title: The case's title.
        condition: Name and unit of the conditions.
        conditions: Their values, (n,).
        mode_names: Names of the modes.
        frequencies_hz: Those of the nominal model, (m,).
        measured: What the test measures: frequencies, damping, shapes.
        noise: Root mean square of the standard deviation of ln f from noise and resolution.
        discrepancy: That of the error of any model.
        effects: The effects, members of a class together, those not seen last.
        distances: D of the row's effect from what the column's can make, (n, n + 1); the last
            column is "no gap".
        taken_for: Mean probability that each effect of the column gets in tests that are simulated
            with the row's at work, of any size that is probable, (n, n + 2); the last columns are
            "no gap" and a cause outside the library. nan where none could be simulated.
        classes: Classes of several effects.
        additions: What further measurements would add, the most telling first.
        silent: Effects that such a test says nothing about.
        model: Facts on the model.
    """

    title: str
    condition: tuple[str, str]
    conditions: np.ndarray
    mode_names: tuple[str, ...]
    frequencies_hz: np.ndarray
    measured: tuple[str, ...]
    noise: float
    discrepancy: float
    effects: list[PlannedEffect]
    distances: np.ndarray
    taken_for: np.ndarray
    classes: list[PlannedClass]
    additions: list[Addition]
    silent: tuple[Silent, ...]
    model: dict

    def __repr__(self) -> str:
        return f"Plan({self.title!r}: {len(self.effects)} causes, {self.n_apart} apart)"

    @property
    def unseen(self) -> list[PlannedEffect]:
        """Effects too small for the test at their expected size."""
        return [e for e in self.effects if not e.seen]

    @property
    def alone(self) -> list[PlannedEffect]:
        """Effects that the test would tell from every other."""
        return [e for e in self.effects if e.seen and not e.letter]

    @property
    def n_apart(self) -> int:
        """How many causes or classes of causes the test would tell apart."""
        return len(self.alone) + len(self.classes)

    def sentences(self) -> tuple[str, str, str]:
        """How many causes it can tell apart; which it cannot; what to measure next."""
        return self._how_many(), self._which_not(), self._what_next()

    def _how_many(self) -> str:
        n, seen = len(self.effects), sum(e.seen for e in self.effects)
        if not seen:
            return f"This test would see none of the {n} causes that the model can have."
        which = f"all {n}" if seen == n else f"{seen} of {n}"
        see = f"This test would see {which} causes that the model can have"
        if seen == 1:
            return f"{see}."
        if self.n_apart == 1:
            return f"{see}, and could tell none of them from all the others."
        if not self.classes:
            return f"{see}, and tell them all apart."
        single = f"{_count(len(self.alone), 'single cause')} and " if self.alone else ""
        groups = _count(len(self.classes), "group")
        return f"{see}, and tell {self.n_apart} apart: {single}{groups} of causes."

    def _which_not(self) -> str:
        said = []
        if self.classes:
            groups = "; ".join(self._listed(c.members) for c in self.classes)
            said.append(f"It could not tell apart {groups}")
        if self.unseen:
            few = self._listed([e.key for e in self.unseen])
            said.append(f"{'it' if said else 'It'} would not see {few} at the expected size")
        if not said:
            return "There are no two that it could not tell apart, and none that it would not see."
        return f"{', and '.join(said)}."

    def _listed(self, keys: Sequence[str]) -> str:
        """Effects in words, those that differ by their region alone under one name."""
        by_name: dict[str, list[str]] = {}
        for e in self.effects:
            if e.key in keys:
                by_name.setdefault(e.name, []).append(e.region)
        often = [e.name for e in self.effects]
        words = [
            f"{name} ({', '.join(regions)})" if often.count(name) > 1 else name
            for name, regions in by_name.items()
        ]
        if len(words) > _LISTED:
            words = [*words[: _LISTED - 1], f"{len(words) - _LISTED + 1} others"]
        return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"

    def _what_next(self) -> str:
        if not (self.classes or self.unseen):
            return "Nothing more need be measured for that."
        best = self.additions[0] if self.additions else None
        if best is None or best.largest < NEGLIGIBLE:
            return "None of the further measurements that were looked at would help."
        seen = sum(e.seen for e in self.effects)
        if best.classes > self.n_apart:
            more = f" and see {best.seen}" if best.seen > seen else ""
            return f"Measure next {best.name}. Then it would tell {best.classes} apart{more}."
        if best.seen > seen:
            return f"Measure next {best.name}. Then it would see {best.seen - seen} more."
        return (
            f"No one further measurement would split them. Most would come from {best.name}: D of "
            f"the undecided pairs would grow by {best.mean:.2f} on average."
        )

    def to_json(self) -> dict:
        """The documented keys of ``diagnose --plan --json``."""
        keys = [e.key for e in self.effects]
        others = [*keys, "no gap"]
        outcomes = [*others, "none of these"]
        rows = list(zip(keys, self.distances.tolist(), strict=True))
        return plain(
            {
                "version": fenics_joints.__version__,
                "title": self.title,
                "summary": " ".join(self.sentences()),
                "apart": self.n_apart,
                "conditions": {
                    "name": self.condition[0],
                    "unit": self.condition[1],
                    "values": self.conditions,
                },
                "modes": self.mode_names,
                "frequencies_hz": self.frequencies_hz,
                "measured": self.measured,
                "noise": self.noise,
                "discrepancy": self.discrepancy,
                "effects": [
                    _row(
                        e,
                        "key",
                        "name",
                        "region",
                        "seen",
                        "size",
                        "distance",
                        distance_least="least",
                        distance_most="most",
                    )
                    | {"class": e.letter or None}
                    for e in self.effects
                ],
                "distance": {key: dict(zip(others, row, strict=True)) for key, row in rows},
                "confusion": {
                    key: None if np.isnan(row).any() else dict(zip(outcomes, row, strict=True))
                    for key, row in zip(keys, self.taken_for.tolist(), strict=True)
                },
                "classes": [
                    _row(c, "members", "collinearity", "combination", "left") | {"class": c.letter}
                    for c in self.classes
                ],
                "additions": [
                    _row(
                        a,
                        "seen",
                        "pair",
                        measurement="name",
                        apart="classes",
                        mean_gain="mean",
                        largest_gain="largest",
                    )
                    for a in self.additions
                ],
                "silent": [_row(s, "effect", "reason") for s in self.silent],
                "model": self.model,
            }
        )


def _row(result: object, *same: str, **named: str) -> dict:
    """Attributes of a result, some under another name."""
    return {key: getattr(result, name) for key, name in ({k: k for k in same} | named).items()}


def _count(n: int, what: str) -> str:
    return f"{n or 'no'} {what}{'' if n == 1 else 's'}"
