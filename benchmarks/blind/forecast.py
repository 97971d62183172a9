"""What a diagnosis says, as probabilities that can be scored, at three levels of detail.

``effect``: cause and region, one of the library's effects. ``cause``: its name, wherever it acts.
``class``: what the diagnosis itself declared inseparable in this test.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from benchmarks.blind.matching import same_cause, same_region
from benchmarks.blind.weights import weights_of

NONE, UNKNOWN = "no gap", "none of these"
LEVELS = ("effect", "cause", "class")
#: Members of a class, and its share of the prior odds, up to which it is an answer.
_MEMBERS, _SHARE = 5, 0.2


@dataclass(frozen=True)
class Forecast:
    """The JSON of ``fenics-joints diagnose``, read for scoring; empty if the diagnosis failed.

    Attributes:
        diagnosis: The JSON; None if there is none.
    """

    diagnosis: Mapping | None

    @property
    def verdict(self) -> str:
        """``cause``, ``no gap``, ``unknown``, ``ambiguous``, or ``failed``."""
        return "failed" if self.diagnosis is None else self.diagnosis["verdict"]

    @cached_property
    def effects(self) -> dict[str, dict]:
        """The library's effects by their keys."""
        rows = [] if self.diagnosis is None else self.diagnosis["effects"]
        return {
            key(row["name"], row["region"]): row
            for row in rows
            if row["name"] not in (NONE, UNKNOWN)
        }

    def label(self, name: str, level: str) -> str:
        """What an effect, by its key, is called at a level; outcomes without effect are kept."""
        row = self.effects.get(name)
        if row is None or level == "effect":
            return name
        return row["name"] if level == "cause" else row["class"]

    @cached_property
    def hypotheses(self) -> list[tuple[tuple[str, ...], float]]:
        """Outcomes that exclude one another: keys of the effects (or no gap, or none of these)."""
        if self.diagnosis is None:
            return []
        found = []
        rows = self.diagnosis["hypotheses"]
        for row, weight in zip(rows, weights_of(self.diagnosis), strict=True):
            if row["label"] in (NONE, UNKNOWN):
                members = (row["label"],)
            elif "effects" in row:
                members = tuple(row["effects"])
            else:
                members = tuple(self._by_name(name) for name in row["label"].split(" + "))
            found.append((members, float(weight)))
        total = sum(p for _, p in found)
        return [(members, p / total) for members, p in found] if total > 0 else []

    def _by_name(self, name: str) -> str:
        """Key of the effect with that name; the most probable one's if there are several."""
        rows = [(row["probability"], k) for k, row in self.effects.items() if row["name"] == name]
        return max(rows)[1] if rows else name

    def shares(self, level: str) -> dict[str, float]:
        """Probabilities that sum to 1 over outcomes; a hypothesis of several effects is divided."""
        found: dict[str, float] = {}
        for members, p in self.hypotheses:
            for member in members:
                label = self.label(member, level)
                found[label] = found.get(label, 0.0) + p / len(members)
        return found

    def marginals(self, level: str) -> dict[str, float]:
        """Probability that a thing is at work, alone or not: sums of the hypotheses with it."""
        found: dict[str, float] = {}
        for members, p in self.hypotheses:
            for label in {self.label(member, level) for member in members}:
                found[label] = found.get(label, 0.0) + p
        return found

    def accepted(self, effect: Mapping, level: str, *, region: bool = True) -> set[str]:
        """Labels that are right when an effect of the world is at work.

        Args:
            effect: Its ``name`` and ``region``.
            level: One of `LEVELS`.
            region: Whether the region must be right too; never asked of the level ``cause``.
        """
        region = region and level != "cause"
        return {
            self.label(k, level)
            for k, row in self.effects.items()
            if same_cause(effect["name"], row["name"])
            and (not region or same_region(effect["region"], row["region"]))
        }

    def says_little(self, class_name: str) -> bool:
        """Whether a class holds more than five effects and more than a fifth of the prior odds."""
        odds = {key: row.get("odds") or 0.0 for key, row in self.effects.items()}
        own = sum(odds[key] for key, row in self.effects.items() if row["class"] == class_name)
        large = own > _SHARE * sum(odds.values()) or not any(odds.values())
        return self.members(class_name) > _MEMBERS and large

    def members(self, class_name: str) -> int:
        """Number of effects in a class; 1 for no gap and none of these."""
        return sum(row["class"] == class_name for row in self.effects.values()) or 1


def key(name: str, region: str) -> str:
    """The key that the diagnosis gives an effect."""
    return f"{name} ({region})" if region else name
