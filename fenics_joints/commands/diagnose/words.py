"""How a diagnosis is read: its leader, its classes of effects, and names for parts of it."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from fenics_joints.diagnosis import Diagnosis, EffectResult, HypothesisResult, Silent
from fenics_joints.diagnosis.effects.rig import MISPLACED, MISSCALED, MISSED, SWAPPED
from fenics_joints.diagnosis.evidence.classes import APART
from fenics_joints.diagnosis.evidence.localised_unknown import LocalisedUnknown
from fenics_joints.diagnosis.location import Location
from fenics_joints.diagnosis.verdict import NAMED, NO_GAP, UNKNOWN, confirmed, doubtful, least_sure
from fenics_joints.diagnosis.where.score_tests import Attribution, ScoreTest
from fenics_joints.diagnosis.where.zone_sensitivity import EXPECTED
from fenics_joints.formatting import (
    condition_value,
    interval,
    number,
    percent,
    point_mm,
    probability,
    quantity,
    spaced,
)
from fenics_joints.report.document import Folded, OnTerminal, Text

#: Verdicts as headings.
VERDICTS = {
    "cause": "Cause found, confirmed on held-out data",
    "likely": "Likely cause, not confirmed on held-out data",
    "no gap": "No error beyond noise",
    "unknown": "Cause unknown",
    "in part": "Cause unknown, or known in part",
    "ambiguous": "Ambiguous",
}
#: The same of causes that the test cannot distinguish from many others.
NARROWED = {
    "cause": "Cause narrowed down to one of {n}, confirmed on held-out data",
    "likely": "Likely one of {n} causes, not confirmed on held-out data",
}
#: Members of a list that a sentence names: more would not be read.
LISTED = 3
#: Probability from which an unknown cause has a place: more probable than not; and standard
#: deviations from which a change there is sure: 5 % by chance.
_HAS_PLACE, _SURELY = 0.5, 2.0


def is_part(d: Diagnosis) -> bool:
    """Whether the best explanation leaves too much to be the cause, and yet predicts held-out data
    better than the baseline model and the placebo."""
    return d.verdict == "unknown" and d.shrinkage is not None and confirmed(d.shrinkage)


def place_words(found: Location, test: ScoreTest) -> str:
    """What most probably changes at a place, and where that is."""
    middle, words = found.middle(test), joined(change_words(test))
    if middle is None:
        return f'"{zone_words(test.zone)}" ({words})'
    return f'"{zone_words(test.region)}" ({words}) near {point_mm(middle)} mm'


def change_words(test: ScoreTest) -> list[str]:
    """Changes of a part that are sure, with their size; of a joint and others the direction."""
    if test.kind != "part":
        way = "softer" if test.kind == "joint" else "softer or heavier"
        return [f"{'stiffer' if test.log_f > 0 else way} than in the model"]
    rows = zip(("stiffness", "mass"), test.change, test.change_sd, ("E", "rho"), strict=False)
    changes = [(abs(mean) / sd, name, EXPECTED[key] * mean) for name, mean, sd, key in rows]
    words = []
    for _, name, change in [row for row in changes if row[0] > _SURELY] or [max(changes)]:
        if abs(change) > np.log(
            2.0
        ):  # a logarithm: first order says no number beyond a factor of 2
            words.append(f"much {'more' if change > 0 else 'less'} {name}")
        else:
            words.append(f"{percent(np.expm1(change), 0, sign=True)} of {name}")
    return words


def point_mass_words(found: LocalisedUnknown) -> str:
    """An unknown cause as a point mass: mass, interval and place; "" if it is none."""
    p = found.point
    if p is None or found.probability < _HAS_PLACE:
        return ""
    grams = [f"{number(1e3 * kg, 2)} g" for kg in (p.kg, p.low, p.high)]
    return (
        f"as a point mass, {grams[0]} (90 % interval {grams[1]} to {grams[2]}) at about "
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


def parameter_words(rows: Iterable[Mapping]) -> str:
    """Fitted parameters with their intervals: ``k_n = 660 GPa/m (510 to 860)``."""
    words = []
    for p in rows:
        value, span = value_words(p)
        unit = value.partition(" ")[2]
        if unit and span.count(" ") == 3:  # the limits have one unit
            span = span.removesuffix(f" {unit}")
        equal = " = " if span else " "
        words.append(f"{parameter_name(p)}{equal}{value}{span and f' ({span})'}")
    return ", ".join(words)


def parameter_name(p: Mapping) -> str:
    """A parameter's name; those of a lap's stiffness by its direction."""
    return re.sub(r"\b(slap|slip)$", lambda found: f"{_WAYS[found[1]]} stiffness", p["name"])


def joined(words: Sequence[str], last: str = "and") -> str:
    """A list in words: ``a, b and c``."""
    words = list(words)
    if len(words) < 2:
        return "".join(words)
    return f"{', '.join(words[:-1])} {last} {words[-1]}"


def shortened(words: Sequence[str], last: str = "and") -> str:
    """The first few of a list, and how many there are besides."""
    words = list(words)
    more = len(words) - LISTED
    if more > 1:
        words = [*words[:LISTED], f"{more} more"]
    return joined(words, last)


def deviation_words(distance: float) -> str:
    """How far apart two predictions are, and whether that distinguishes them."""
    words = f"their predictions differ by up to {distance:.1f} times the noise"
    return words if distance >= APART else f"{words}, and {APART:.1f} times would decide"


def p_value_words(p: float) -> str:
    """How often chance alone makes as large a chi-square."""
    return "p below 0.001" if p < 0.001 else f"p = {number(p, 2)}"


#: Directions of a lap's stiffness, effects and regions whose names are others for people than in
#: case files and JSON.
_WAYS = {"slap": "normal", "slip": "tangential", "slap and slip": "normal and tangential"}
_NAMES = {NO_GAP: "no cause (baseline model within tolerances)", UNKNOWN: "cause outside library"}
_REGIONS = {"away": "outer zone", "near": "inner zone"}


def effect_name(name: str) -> str:
    """An effect's name for people."""
    way = re.sub(
        r"\b(slap and slip|slap|slip)(?= stiffness)", lambda found: _WAYS[found[1]], spaced(name)
    )
    return _NAMES.get(name, way)


def zone_words(name: str) -> str:
    """A region, or a joint's zone: ``away_b3_r2`` is ``outer zone, bolt 3, ring 2``.

    That of a lap of beams: ``lap_s2`` is ``lap, stretch 2``.
    """
    lap = re.fullmatch(r"(.+)_s(\d+)", name)
    if lap:
        return f"{spaced(lap[1])}, stretch {lap[2]}"
    match = re.fullmatch(r"(.+?)(?:_b(\w+?))?_r(\d+)", name)
    if not match:
        return _REGIONS.get(name, spaced(name))
    joint, bolt, ring = match.groups()
    joint = _REGIONS.get(joint, spaced(joint))
    return ", ".join([joint, *([f"bolt {bolt}"] if bolt else []), f"ring {ring}"])


def group_words(part: Attribution, unit: str) -> str:
    """A group of data in words: a condition has its unit."""
    if part.by != "condition":
        return part.label
    try:
        return condition_value(float(part.label), unit)
    except ValueError:
        return part.label


#: Share of the error, or probability, from which a sentence mentions it. Chosen: only words depend
#: on it.
SHARE = 0.1
#: Effects from which on a class is narrowed down and not found. Chosen: only a heading depends on
#: it.
_LARGE = 6
#: Effects that change the measurement and not the structure.
_IN_TEST = (MISSCALED, MISPLACED, MISSED, SWAPPED)


@dataclass(frozen=True)
class EffectClass:
    """Effects that the test cannot distinguish, or a single one.

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
    """The best hypothesis inside the library: ``Diagnosis.after`` is its error."""
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


def silent_blocks(silent: Iterable[Silent]) -> list:
    """Effects that a test says nothing about, by reason; folded away on the page."""
    names: dict[str, list[str]] = {}
    for s in silent:
        names.setdefault(s.reason, []).append(effect_name(s.effect))
    lines = [
        Text(f"This test cannot show {joined(some, 'or')}: {reason}.", "note")
        for reason, some in names.items()
    ]
    title = "Effects that this test cannot show"
    return [OnTerminal(lines), Folded(title, lines, "silent")] if lines else []


def named(hypothesis: HypothesisResult) -> str:
    """A hypothesis by its effects, each with its place where the name does not say it."""
    if hypothesis.label == NO_GAP:
        return "the baseline model within its tolerances"
    return " + ".join(map(with_place, hypothesis.effects)) or effect_name(hypothesis.label)


def with_place(key: str) -> str:
    """An effect's key, ``name (region)``, in words, the region where the name does not say it."""
    name, bracket, region = key.rpartition(" (")
    if not bracket:
        return effect_name(key)
    name, region = effect_name(name), region.rstrip(")")
    if region in ("joint", "all parts") or spaced(region) in name:
        return name
    return f"{name} ({zone_words(region)})"


def along(found: Location, by: str) -> list[Attribution]:
    """What each group of one kind, such as ``mode``, adds to chi-square."""
    return [a for a in found.attribution if a.by == by]


def mesh_error(d: Diagnosis) -> float:
    """Root mean square over the modes of the mesh's own error; 0 where it was not measured."""
    errors = list(d.model.get("mesh_error", {}).values())
    return float(np.sqrt(np.mean(np.square(errors)))) if errors else 0.0


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


#: What effects of a kind, by their names, have in common.
_KINDS = {
    r"(joint (.* )?compliance|compliance (at|away)|contact (lost|area)).*": (
        "The joint is more compliant than modelled"
    ),
    r"(two |three )?loose bolts?": "A bolt is loose, or several",
    r"(.* )?(modulus|density|thickness|width|mass)( error.*)?": (
        "Mass or stiffness of the structure differs from the model"
    ),
    r"sensor mis.*": "A sensor reads wrongly or is in a wrong place",
}


def kind_words(group: EffectClass) -> str:
    """What the members of a class have in common, as a sentence without its end; "" if nothing."""
    for pattern, words in _KINDS.items():
        if all(re.fullmatch(pattern, e.name) for e in group.effects):
            return words
    return ""


def members_in_words(group: EffectClass) -> str:
    """A class in words, the most probable member first."""
    if len(group.effects) == 1:
        return with_place(group.effects[0].key)
    items = [f"{with_place(e.key)} ({probability(e.probability)})" for e in group.effects]
    letter = f" (class {group.letter})" if group.letter else ""
    few = {2: "two", 3: "three", 4: "four", 5: "five"}.get(len(items), len(items))
    return f"this test cannot distinguish {few} effects{letter}: {shortened(items)}"


def priors_in_words(group: EffectClass) -> str:
    """What the members of a class had before the test, of what the class had."""
    total = sum(e.odds for e in group.effects)
    if total <= 0 or len({e.odds for e in group.effects}) == 1:
        return "Before the test they were equally likely."
    items = [f"{with_place(e.key)} {probability(e.odds / total)}" for e in group.effects]
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
        f"in the test, not in the structure: {places}" if only else f"partly in the test: {places}"
    )
