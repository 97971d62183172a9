"""Parts of sentences: lists, ratios, p-values, names of zones and of groups of data."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from fenics_joints.diagnosis.evidence.localised_unknown import LocalisedUnknown
from fenics_joints.diagnosis.location import Location
from fenics_joints.diagnosis.result import Diagnosis
from fenics_joints.diagnosis.verdict import confirmed
from fenics_joints.diagnosis.where.score_tests import Attribution, ScoreTest
from fenics_joints.diagnosis.where.zone_sensitivity import EXPECTED
from fenics_joints.formatting import (
    LEAST,
    MOST,
    condition_value,
    error_percent,
    interval,
    number,
    percent,
    point_mm,
    quantity,
    spaced,
)

#: Verdicts as headings.
VERDICTS = {
    "cause": "Cause found, confirmed on held-out data",
    "likely": "Likely cause, not confirmed on held-out data",
    "no gap": "No gap",
    "unknown": "Cause unknown",
    "in part": "Cause unknown, or known in part",
    "ambiguous": "Ambiguous",
}
#: The same of causes that the test cannot tell from many others.
NARROWED = {
    "cause": "Cause narrowed down to one of {n}, confirmed on held-out data",
    "likely": "Likely one of {n} causes, not confirmed on held-out data",
}
#: Members of a list that are worth a word.
NAMED = 3
#: Probability from which an unknown cause has a place; and standard deviations from which a change
#: there is one.
_HAS_PLACE, _SURELY = 0.5, 2.0


def is_part(d: Diagnosis) -> bool:
    """Whether the best explanation leaves too much to be the cause, and yet predicts held-out data
    better than the nominal model and the best wrong effect."""
    return d.verdict == "unknown" and d.shrinkage is not None and confirmed(d.shrinkage)


def place_words(found: Location, test: ScoreTest) -> str:
    """What most probably changes at a place, and where that is."""
    middle = found.middle(test)
    name = f'"{zone_words(test.region if middle is not None else test.zone)}"'
    words = joined(change_words(test))
    if middle is not None:
        return f"{name}, {words} near {point_mm(middle)} mm"
    return f"{name}, {words}"


def change_words(test: ScoreTest) -> list[str]:
    """What surely changes at a place, and by how much; of what is no part, which way."""
    if test.kind != "part":
        way = "softer" if test.kind == "joint" else "softer or heavier"
        return [f"{'stiffer' if test.log_f > 0 else way} than in the model"]
    rows = zip(("stiffness", "mass"), test.change, test.change_sd, ("E", "rho"), strict=False)
    changes = [(abs(mean) / sd, name, EXPECTED[key] * mean) for name, mean, sd, key in rows]
    sure = [row for row in changes if row[0] > _SURELY] or [max(changes)]
    return [_amount(name, mean) for _, name, mean in sure]


def _amount(name: str, change: float) -> str:
    """A change of a logarithm; beyond a factor of two first order says no number."""
    if abs(change) > np.log(2.0):
        return f"much {'more' if change > 0 else 'less'} {name}"
    return f"{percent(np.expm1(change), 0, sign=True)} of {name}"


def point_mass_words(found: LocalisedUnknown) -> str:
    """Mass, interval and place of an unknown cause as one point mass; "" if it is none."""
    p = found.point
    if p is None or found.probability < _HAS_PLACE:
        return ""
    grams = [f"{number(1e3 * kg, 2)} g" for kg in (p.kg, p.low, p.high)]
    return (
        f"as one point mass {grams[0]}, 90 % interval {grams[1]} to {grams[2]}, at about "
        f"{point_mm(p.at)} mm"
    )


def attached_words(parameters: Sequence[dict]) -> str:
    """How heavy something is and where, by an effect's parameters; "" if it has no place."""
    at = next((p["at"] for p in parameters if p.get("at")), "")
    kg = next((p["value"] for p in parameters if p["name"] == "mass"), None)
    grams = "" if kg is None else f"about {number(1e3 * kg, 2)} g "
    return f"{grams}near {at}" if at else ""


def value_words(p: Mapping) -> tuple[str, str]:
    """A fitted parameter's value and its interval; a place is said in words and has none, and of
    what the test does not identify neither is said."""
    if p.get("at"):
        return p["at"], ""
    if not p.get("identified", True):
        return "not identified", ""
    return quantity(p["value"], p["unit"]), interval(p["low"], p["high"], p["unit"])


def joined(words: Sequence[str], last: str = "and") -> str:
    """A list in words: ``a, b and c``."""
    words = list(words)
    if len(words) < 2:
        return "".join(words)
    return f"{', '.join(words[:-1])} {last} {words[-1]}"


def shortened(words: Sequence[str], last: str = "and") -> str:
    """The first few of a list, and how many there are besides."""
    words = list(words)
    more = len(words) - NAMED
    if more > 1:
        words = [*words[:NAMED], f"{more} more"]
    return joined(words, last)


def chance_words(p: float) -> str:
    """How often chance alone makes as much."""
    return "less than once in a thousand" if p < 1e-3 else f"p = {number(p, 2)}"


def times_words(ratio: float) -> str:
    """A ratio of two probabilities: ``12 times``; no larger than that of those that are shown."""
    most = round(MOST / LEAST)
    return f"{number(ratio, 2)} times" if ratio <= most else f"more than {most} times"


def share_words(x: float) -> str:
    """A share in whole per cent."""
    return percent(x, 0)


def sentence(text: str) -> str:
    """A text as a sentence: a capital, and a full stop."""
    return f"{text[:1].upper()}{text[1:]}."


def from_to(before: float, after: float) -> str:
    """Two gaps: ``from 5.00 % to 1.00 %``."""
    return f"from {error_percent(before)} to {error_percent(after)}"


def p_value_words(p: float) -> str:
    """A p-value of a misfit."""
    return "p below 0.001" if p < 0.001 else f"p = {number(p, 2)}"


def zone_words(name: str) -> str:
    """A joint's zone in words: ``away_b3_r2`` is ``away, bolt 3, ring 2``.

    That of a lap of beams: ``lap_s2`` is ``lap, stretch 2``.
    """
    lap = re.fullmatch(r"(.+)_s(\d+)", name)
    if lap:
        return f"{spaced(lap[1])}, stretch {lap[2]}"
    match = re.fullmatch(r"(.+?)(?:_b(\w+?))?_r(\d+)", name)
    if not match:
        return spaced(name)
    joint, bolt, ring = match.groups()
    return ", ".join([spaced(joint), *([f"bolt {bolt}"] if bolt else []), f"ring {ring}"])


def group_words(part: Attribution, unit: str) -> str:
    """A group of data in words: a condition has its unit."""
    if part.by != "condition":
        return part.label
    try:
        return condition_value(float(part.label), unit)
    except ValueError:
        return part.label
