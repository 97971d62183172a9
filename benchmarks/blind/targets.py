"""What was asked of the diagnosis beside what it reached."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from benchmarks.blind.score import APART


@dataclass(frozen=True)
class Target:
    """A row of the table.

    Attributes:
        what: The score in words.
        asked: What was asked: a number that it must reach, or stay below.
        at_least: Whether larger is better.
        value: What was reached; None without cases.
        low, high: Its 95 % interval.
        n: Cases it rests on.
        percent: Whether it is a share.
    """

    what: str
    asked: float
    at_least: bool
    value: float | None
    low: float | None
    high: float | None
    n: int
    percent: bool = True

    @property
    def outcome(self) -> str:
        """``shown`` if the whole interval does, ``reached``, ``missed``, or ``no cases``."""
        if self.value is None:
            return "no cases"
        if not self._meets(self.value):
            return "missed"
        return "shown" if self._meets(self.low if self.at_least else self.high) else "reached"

    def _meets(self, x: float) -> bool:
        return x >= self.asked if self.at_least else x <= self.asked

    def to_json(self) -> dict:
        """Keys what, asked, at_least, value, low, high, n, outcome."""
        return {
            "what": self.what,
            "asked": self.asked,
            "at_least": self.at_least,
            "value": self.value,
            "low": self.low,
            "high": self.high,
            "n": self.n,
            "outcome": self.outcome,
        }


def targets(summary: Mapping, world: str = "first") -> list[Target]:
    """The table, from `score.summary`, by what was asked of the world's check."""
    return _fifth(summary) if world == "calculix" else _first(summary)


def _first(summary: Mapping) -> list[Target]:
    apart, shrink = summary["single_apart"], summary["shrinkage"]
    said = f"single effects with D ≥ {APART}"
    return [
        _rate(f"{said}: cause first", 0.90, apart["top1_cause"]),
        _rate(f"{said}: class first", 0.90, apart["top1_class"]),
        _rate(f"{said}: cause among the first two", 0.97, apart["top2_cause"]),
        _rate(f"{said}: class among the first two", 0.97, apart["top2_class"]),
        _rate("no effect: any verdict but “no gap”", 0.03, summary["none"]["alarm"], False),
        _rate("unknown caught, at 5 % false", 0.80, summary["unknown"]["caught"]),
        _error("expected calibration error, by cause", summary["calibration"]["cause"]),
        _error("expected calibration error, by class", summary["calibration"]["class"]),
        _median("S* on held-out data, median", 0.8, shrink["s"]),
        _median("S* above the placebo's, median", 0.0, shrink["excess"]),
    ]


def _fifth(summary: Mapping) -> list[Target]:
    """Of the check whose D counts the model's error, and whose classes count while small."""
    apart, shrink, unknown = summary["single_apart"], summary["shrinkage"], summary["unknown"]
    said = f"D ≥ {APART}"
    held = shrink["predicted_covered"]
    return [
        _rate(f"single effects with {said}: class first", 0.90, apart["top1_class"]),
        _rate(f"single effects with {said}: class among the first two", 0.97, apart["top2_class"]),
        _rate(f"single effects with {said}: cause by its own name", 0.75, apart["top1_cause"]),
        _rate(f"unknown causes with {said} caught, at 5 % false", 0.70, unknown["caught_apart"]),
        _rate("no effect: any verdict but “no gap”", 0.03, summary["none"]["alarm"], False),
        _above_chance(
            "calibration error above a perfect forecaster's", 0.03, summary["calibration"]["class"]
        ),
        _median("S* on held-out data, median", 0.80, shrink["s"]),
        _rate("S* above the placebo's", 0.90, shrink["above_placebo"]),
        _rate("stated 90 % intervals that held, at least", 0.87, held),
        _rate("stated 90 % intervals that held, at most", 0.93, held, False),
    ]


def _rate(what: str, asked: float, rate: Mapping, at_least: bool = True) -> Target:
    return Target(what, asked, at_least, rate["value"], rate["low"], rate["high"], rate["n"])


def _error(what: str, found: Mapping | None) -> Target:
    if found is None:
        return Target(what, 0.05, False, None, None, None, 0, False)
    return Target(what, 0.05, False, found["ece"], found["low"], found["high"], found["n"], False)


def _above_chance(what: str, asked: float, found: Mapping | None) -> Target:
    if found is None:
        return Target(what, asked, False, None, None, None, 0, False)
    value, low, high = (max(found[k] - found["by_chance"], 0.0) for k in ("ece", "low", "high"))
    return Target(what, asked, False, value, low, high, found["n"], False)


def _median(what: str, asked: float, found: Mapping) -> Target:
    return Target(
        what, asked, True, found["median"], found["low"], found["high"], found["n"], False
    )
