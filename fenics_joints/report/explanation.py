"""A diagnosis in words: three sentences, what stands behind them, and what to doubt.

Every number is one of the `Diagnosis`; nothing is computed here but ratios of them.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from fenics_joints.diagnosis.effects.rig import MISPLACED, MISSCALED, MISSED, SWAPPED
from fenics_joints.diagnosis.verdict import NO_GAP, UNKNOWN, least_sure
from fenics_joints.formatting import (
    condition_value,
    interval,
    number,
    percent,
    probability,
    quantity,
    spaced,
)
from fenics_joints.report.reading import (
    EffectClass,
    by_effect,
    effect_classes,
    leading,
    named,
    with_place,
)

if TYPE_CHECKING:
    from fenics_joints.diagnosis.location import Location
    from fenics_joints.diagnosis.result import Diagnosis, EffectResult, HypothesisResult
    from fenics_joints.diagnosis.shrinkage import Shrinkage
    from fenics_joints.diagnosis.where.zone_tests import Attribution, ZoneTest

__all__ = ["Explanation", "Point", "explain", "group_words", "in_words", "zone_words"]

#: Probability of a look-alike that is not worth a word.
_REMOTE = 0.01
#: Effects that are no change of the structure but of how it was measured.
_IN_TEST = (MISSCALED, MISPLACED, MISSED, SWAPPED)
#: Adjusted p below which a test says more than chance.
_LEVEL = 0.05
#: Shares of the gap, and members of a list, that are worth a word.
_SHARE, _NAMED = 0.1, 3
#: A nuisance further from its expected value, in standard deviations, is a doubt.
_FAR = 2.0
#: A p-value above this says that the stated noise and model error are too large.
_TOO_GOOD = 0.999
#: Of ten intervals of 90 %, seven hold with 99 % if they are right.
_COVERAGE = 0.7
#: Of what noise lets go, so much should be gone for a cause to be the whole of it.
_HALF = 0.5
_COUNT = {2: "two", 3: "three"}


@dataclass(frozen=True)
class Point:
    """One question on a diagnosis, and its answer with the numbers."""

    question: str
    answer: str


@dataclass(frozen=True)
class Explanation:
    """A diagnosis in words.

    Attributes:
        where: Where the model is wrong, one sentence.
        which: Which effect causes it, and what rivals it.
        how_far: How far the gap shrinks on data that were held out.
        points: The same in more words, question by question.
        doubts: What speaks against taking the answer at its word.
    """

    where: str
    which: str
    how_far: str
    points: tuple[Point, ...]
    doubts: tuple[str, ...]

    @property
    def sentences(self) -> tuple[tuple[str, str], ...]:
        """The three sentences with their headings."""
        return ("Where", self.where), ("Which", self.which), ("How far", self.how_far)

    def to_json(self) -> dict:
        """Texts only."""
        return {
            "where": self.where,
            "which": self.which,
            "how_far": self.how_far,
            "points": {point.question: point.answer for point in self.points},
            "doubts": list(self.doubts),
        }


def explain(d: Diagnosis) -> Explanation:
    """Put a diagnosis into words."""
    questions = (
        ("Is there more than chance?", _beyond_chance(d)),
        ("In which data?", _in_which_data(d)),
        ("In which part?", _in_which_part(d)),
        ("What was fitted?", _fitted(d)),
        ("Why this and not another?", _why(d)),
        ("What can these data not tell?", _not_told(d)),
        ("Does it predict?", _predicts(d)),
    )
    points = tuple(Point(question, answer) for question, answer in questions if answer)
    return Explanation(_where(d), _which(d), _how_far(d), points, tuple(_doubts(d)))


# -- words -----------------------------------------------------------------------------------------


def in_words(effect: EffectResult) -> str:
    """An effect with its place, where its name does not say that already."""
    return with_place(_key(effect))


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


def _joined(words: Sequence[str], last: str = "and") -> str:
    words = list(words)
    if len(words) < 2:
        return "".join(words)
    return f"{', '.join(words[:-1])} {last} {words[-1]}"


def _shortened(words: Sequence[str], last: str = "and") -> str:
    """The first few of a list, and how many there are besides."""
    words = list(words)
    more = len(words) - _NAMED
    if more > 1:
        words = [*words[:_NAMED], f"{more} more"]
    return _joined(words, last)


def _chance(p: float) -> str:
    return "less than one in a million" if p < 1e-6 else f"p = {number(p, 2)}"


def _times(ratio: float) -> str:
    return f"{number(ratio, 2)} times" if ratio < 1e6 else "over a million times"


def _share(x: float) -> str:
    return percent(x, 0)


def _range(pair: tuple[float, float]) -> str:
    """An interval of S*, in per cent of what could go."""
    return f"{100 * pair[0]:.0f} to {100 * pair[1]:.0f} %"


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}."


# -- where -----------------------------------------------------------------------------------------


def _where(d: Diagnosis) -> str:
    found = d.location
    if d.verdict == NO_GAP:
        if found is None:
            return "Nowhere: there is no gap beyond noise and tolerances."
        return (
            "Nowhere beyond chance: noise, tolerances and the error of any model would make a "
            f"misfit of {found.n_data}, and there is one of {found.misfit:.0f}."
        )
    if found is None:
        return _sentence(_by_shares(d) or "no region explains a tenth of the gap")
    kinds = _kinds(found)
    words = [_in_test(d), kinds, _by_tests(found)]
    if not kinds or "frequencies" in kinds.partition(", not")[0]:
        words.append(_by_shares(d))
    return _sentence("; ".join(w for w in words if w))


def _in_test(d: Diagnosis) -> str:
    """Whether causes are in the test itself, and where."""
    sure = _sure(d)
    inside = [c.effects[0] for c in sure if c.effects[0].name in _IN_TEST]
    if not inside:
        return ""
    places = _joined([spaced(e.region) for e in inside])
    only = len(inside) == len(sure)
    return (
        f"in the test, not in the structure: {places}" if only else f"in part in the test: {places}"
    )


def _sure(d: Diagnosis) -> list[EffectClass]:
    """The classes that the verdict calls causes."""
    least = least_sure(_probability_of(d, UNKNOWN))
    return [c for c in _causes(d) if c.probability >= least] if d.verdict == "cause" else []


def _kinds(found: Location) -> str:
    """Which kinds of data the misfit is in, if it is not in all of them."""
    parts = _along(found, "kind")
    loud = [a.label for a in parts if _is_loud(a, parts)]
    quiet = [a.label for a in parts if not _is_loud(a, parts)]
    if not loud or not quiet:
        return ""
    return f"the misfit is in the {_joined(loud)}, not in the {_joined(quiet, 'or')}"


def _along(found: Location, by: str) -> list[Attribution]:
    return [a for a in found.attribution if a.by == by]


def _is_loud(part: Attribution, parts: Sequence[Attribution]) -> bool:
    """Whether a group adds more than chance, all groups of the axis considered (Bonferroni)."""
    return part.p * len(parts) < _LEVEL


def _by_tests(found: Location) -> str:
    tests = sorted((t for t in found.regions if t.dof), key=lambda t: -t.share)
    telling = [t for t in tests if t.p_adjusted < _LEVEL]
    if not telling:
        return "no region of the model explains more than chance"
    alone = [t for t in telling if t.rest_p >= _LEVEL]
    if not alone:
        first = telling[0]
        return (
            f"no change of one region alone explains it, at most {_share(first.share)} of the "
            f"misfit, which {spaced(first.zone)} could make"
        )
    first, others = alone[0], alone[1:]
    words = (
        f"a change in {spaced(first.zone)} alone would explain {_share(first.share)} of the "
        f"misfit, by chance {_chance(first.p_adjusted)}"
    )
    if others:
        names = [f"{spaced(t.zone)} ({_share(t.share)})" for t in others]
        words += f", but so would one in {_shortened(names, 'or')}"
    return words


def _by_shares(d: Diagnosis) -> str:
    """What the leading explanation makes of the gap in frequency, region by region."""
    shares = [z for z in d.where if z.region != "unexplained" and z.share >= _SHARE]
    if not shares:
        return ""
    items = [f"{_share(z.share)} in {spaced(z.region)}" for z in shares]
    return f"of the gap in frequency the leading explanation puts {_shortened(items)}"


# -- which -----------------------------------------------------------------------------------------


def _causes(d: Diagnosis) -> list[EffectClass]:
    return [c for c in effect_classes(d) if c.name not in (NO_GAP, UNKNOWN)]


def _which(d: Diagnosis) -> str:
    say = {NO_GAP: _no_cause, "unknown": _unknown, "cause": _cause}
    return _sentence(say.get(d.verdict, _undecided)(d))


def _look_alike(d: Diagnosis) -> str:
    """What is left for causes outside the library, where that is not the answer itself."""
    p = _probability_of(d, UNKNOWN)
    if p < _REMOTE:
        return ""
    return f"; {probability(p)} is left for a cause outside the library"


def _no_cause(d: Diagnosis) -> str:
    p = _probability_of(d, NO_GAP)
    words = f"none is needed: the nominal model within its tolerances has {probability(p)}"
    causes = _causes(d)
    if not causes:
        return words + _look_alike(d)
    most = f"the most probable cause, {_members(causes[0])}, {probability(causes[0].probability)}"
    return f"{words}, {most}{_look_alike(d)}"


def _unknown(d: Diagnosis) -> str:
    lead, n = leading(d), sum(len(c.effects) for c in _causes(d))
    words = f"none of the {n} effects that were considered explains the test"
    if lead is not None:
        words += (
            f": the best, {named(lead)}, leaves a gap of {percent(lead.gap)} and would give "
            f"such a misfit with {_p_value(lead.p_value)}"
        )
    return f"{words}; that it is something else has {probability(_probability_of(d, UNKNOWN))}"


def _cause(d: Diagnosis) -> str:
    sure = _sure(d)
    if not sure:
        return _undecided(d)
    words = "; and ".join(f"{_members(c)}, {probability(c.probability)}" for c in sure)
    several = f"{_COUNT.get(len(sure), len(sure))} causes: " if len(sure) > 1 else ""
    rival = _rival(d, sure)
    return several + words + _look_alike(d) + (f"; {rival}" if rival else "")


def _rival(d: Diagnosis, sure: Sequence[EffectClass]) -> str:
    """The best hypothesis that lacks one of the causes."""
    lead, other = leading(d), _best_without(d, sure)
    if lead is None or other is None:
        return ""
    ratio = lead.probability / max(other.probability, 1e-300)
    return f"the closest rival, {named(other)}, is {_times(ratio)} less probable"


def _best_without(d: Diagnosis, sure: Sequence[EffectClass]) -> HypothesisResult | None:
    keys = [{_key(e) for e in c.effects} for c in sure]
    listed = [h for h in d.hypotheses if h.label != UNKNOWN]
    lacking = [h for h in listed if any(not k & set(h.effects) for k in keys)]
    return max(lacking, key=lambda h: h.log_evidence, default=None)


def _key(effect: EffectResult) -> str:
    return f"{effect.name} ({effect.region})" if effect.region else effect.name


def _undecided(d: Diagnosis) -> str:
    rows = [c for c in effect_classes(d) if c.probability >= 0.02][: _NAMED + 1]
    items = [f"{_members(c)} ({probability(c.probability)})" for c in rows]
    return f"undecided between {_joined(items)}" if items else "undecided"


def _members(group: EffectClass) -> str:
    """A class in words, its members with their probabilities if there are several."""
    if len(group.effects) == 1:
        return in_words(group.effects[0])
    items = [
        f"{in_words(e)} ({probability(e.probability)})"
        for e in sorted(group.effects, key=lambda e: -e.probability)
    ]
    return f"{_shortened(items, 'or')}, which this test cannot tell apart"


def _probability_of(d: Diagnosis, label: str) -> float:
    return sum(h.probability for h in d.hypotheses if h.label == label)


def _p_value(p: float) -> str:
    return "p below 0.001" if p < 0.001 else f"p = {number(p, 2)}"


# -- how far ---------------------------------------------------------------------------------------


def _how_far(d: Diagnosis) -> str:
    s = d.shrinkage
    if s is None or not s.folds:
        if not np.isfinite(d.heldout_after):
            fitted = _from_to(d.before.rms, d.after.rms)
            return f"Nothing could be held out; fitted, the gap goes {fitted}."
        return f"On held-out data the gap goes {_from_to(d.heldout_before, d.heldout_after)}."
    words = f"On held-out data the gap goes {_from_to(s.before, s.after)}"
    if not np.isfinite(s.shrink):
        return f"{words}; the nominal model is already as good as noise allows."
    words += f": {_shrunk(s)}"
    gain = 100 * s.excess
    if s.claimed:
        words += f", {gain:.0f} points more than the best wrong effect ({_points(s)})"
    elif np.isfinite(gain):
        words += f", which is not surely more than the best wrong effect ({_points(s)} points)"
    stated = sum(f.covered for f in s.folds)
    return f"{words}; {stated} of {len(s.folds)} folds ended in the interval stated before."


def _from_to(before: float, after: float) -> str:
    return f"from {percent(before)} to {percent(after)}"


def _shrunk(s: Shrinkage) -> str:
    share = f"{100 * abs(s.shrink):.0f} %"
    ends = f"90 %: {_range(s.shrink_interval)}"
    if s.shrink < 0:
        return f"it grows, by {share} of what noise would let go ({ends})"
    return f"{share} of what noise lets go is gone (S*, {ends})"


def _points(s: Shrinkage) -> str:
    low, high = s.excess_interval
    return f"90 %: {100 * low:.0f} to {100 * high:.0f}"


# -- the questions ---------------------------------------------------------------------------------


def _beyond_chance(d: Diagnosis) -> str:
    found = d.location
    if found is None:
        return ""
    words = (
        f"The nominal model misses the {found.n_data} data by a squared misfit of "
        f"{found.misfit:.0f}, in standard deviations of noise, tolerances and model error; "
        f"chance alone makes about {found.n_data}."
    )
    kinds = [f"{a.label} {a.chi2:.0f} for {a.expected}" for a in _along(found, "kind")]
    return f"{words} By kind: {', '.join(kinds)}." if len(kinds) > 1 else words


def _in_which_data(d: Diagnosis) -> str:
    if d.location is None:
        return ""
    words = []
    for by, many in (("mode", "modes"), ("condition", f"values of the {d.condition[0]}")):
        parts = _along(d.location, by)
        loud = sorted((a for a in parts if _is_loud(a, parts)), key=lambda a: -a.chi2)
        if not parts:
            continue
        labels = _joined([group_words(a, d.condition[1]) for a in loud])
        if not loud:
            words.append(f"None of {len(parts)} {many} misfits by more than chance.")
        elif len(loud) == len(parts) > 1:
            words.append(
                f"All {len(parts)} {many} misfit by more than chance, most of them "
                f"{group_words(loud[0], d.condition[1])}."
            )
        else:
            words.append(f"Of {len(parts)} {many} these misfit by more than chance: {labels}.")
    return " ".join(words)


def group_words(part: Attribution, unit: str) -> str:
    """A group of data in words: a condition has its unit."""
    if part.by != "condition":
        return part.label
    try:
        return condition_value(float(part.label), unit)
    except ValueError:
        return part.label


def _in_which_part(d: Diagnosis) -> str:
    found = d.location
    if found is None or d.verdict == NO_GAP:
        return ""
    needed = [
        t for t in found.regions if t.minmax_dof and t.separable and t.minmax_p_adjusted < _LEVEL
    ]
    words = []
    if _in_test(d):
        words.append("What a region seems to ask for may be the echo of what is wrong in the test.")
    elif needed:
        names = _joined([spaced(t.zone) for t in needed])
        words.append(f"Whatever the other regions do, the test asks for a change in {names}.")
    else:
        words.append("No region is needed whatever the others do.")
    words.append(_finer(found))
    return " ".join(w for w in words if w)


def _finer(found: Location) -> str:
    """The zone of a joint and the patch of the mesh that explain most."""
    whole = {t.zone for t in found.regions}
    zones = [t for t in found.zones if t.zone not in whole and t.p_adjusted < _LEVEL]
    words = []
    if zones:
        best = max(zones, key=lambda t: t.share)
        alike = f", {_alike(best)}" if best.alike else ""
        words.append(f"Of the joints' zones {zone_words(best.zone)} explains most{alike}.")
    patches = found.patches
    if patches is None:
        return " ".join(words)
    of = "the beams" if patches.side_view else "the mesh"
    n, several = int(patches.significant.sum()), int(patches.sufficient.sum())
    if n:
        best = int(np.argmax(np.where(patches.significant, patches.share, -1.0)))
        at = ", ".join(f"{1e3 * x:.0f}" for x in patches.middle[best])
        words.append(
            f"Of {len(patches.tests)} patches of {of} {n} explain more than chance and "
            f"{several} could each be the only one; most does the one at ({at}) mm in "
            f"{zone_words(patches.region[best])}."
        )
    else:
        words.append(f"None of {len(patches.tests)} patches of {of} explains more than chance.")
    return " ".join(words)


def _alike(test: ZoneTest) -> str:
    names = [zone_words(name) for name in test.alike]
    more = [f"{len(names) - _NAMED} more"] if len(names) > _NAMED else []
    return f"which this test does not tell from {'; '.join([*names[:_NAMED], *more])}"


def _fitted(d: Diagnosis) -> str:
    lead = leading(d)
    if lead is None or not by_effect(lead.parameters):
        return ""
    items = [
        f"{p['name']} = {quantity(p['value'], p['unit'])} "
        f"({interval(p['low'], p['high'], p['unit'])})"
        for _, rows in by_effect(lead.parameters) for p in rows
    ]  # fmt: skip
    more = f" and {len(items) - 2 * _NAMED} more" if len(items) > 2 * _NAMED else ""
    return (
        f"{_sentence(named(lead))[:-1]}: {', '.join(items[: 2 * _NAMED])}{more}, with 68 % "
        f"intervals. The gap goes {_from_to(d.before.rms, d.after.rms)}, noise is "
        f"{percent(d.noise)}, and a misfit as large as what is left would come about with "
        f"{_p_value(lead.p_value)}."
    )


def _why(d: Diagnosis) -> str:
    lead = leading(d)
    if lead is None:
        return ""
    words, sure = [], _sure(d)
    for group in sure:
        other = _best_without(d, [group])
        if other is None:
            continue
        without = f" without {in_words(group.effects[0])}" if len(sure) > 1 else ""
        words.append(
            f"The best explanation{without}, {named(other)}, leaves {percent(other.gap)} "
            f"({_p_value(other.p_value)}), and its ln evidence is "
            f"{lead.log_evidence - other.log_evidence:.1f} lower."
        )
    return " ".join(words)


def _not_told(d: Diagnosis) -> str:
    words = []
    for group in _causes(d):
        if len(group.effects) > 1 and group.probability >= _SHARE:
            names = _shortened([in_words(e) for e in group.effects], "or")
            words.append(f"Which of its class it is: {names}.")
    for s in d.separations:
        words.append(
            f"What would split {spaced(s.class_name)}: {s.measurement} ({s.distance:.1f} s.d.)."
        )
    unseen = [e for c in _causes(d) for e in c.effects if not e.detectable]
    if unseen:
        names = _shortened([in_words(e) for e in unseen])
        words.append(f"Too small to be seen at their expected size: {names}.")
    if d.silent:
        names = _shortened([spaced(s.effect) for s in d.silent])
        words.append(f"Nothing at all is said of {names}.")
    return " ".join(words)


def _predicts(d: Diagnosis) -> str:
    s, words = d.shrinkage, []
    if s is not None and s.folds:
        worst = min(s.folds, key=lambda f: f.shrink if np.isfinite(f.shrink) else np.inf)
        words.append(
            f"Chosen and fitted anew without them, {len(s.folds)} parts of the data were predicted "
            f"to {percent(s.after)} (the best wrong effect {percent(s.placebo)}, noise "
            f"{percent(s.noise)})."
        )
        if np.isfinite(worst.shrink):
            goes = _from_to(worst.before, worst.after)
            words.append(f"Least well predicted: {worst.name}, {goes}.")
        if np.isfinite(s.entries_coverage):
            words.append(
                f"Of the held-out frequencies {_share(s.entries_coverage)} lay in their own 90 % "
                "intervals, stated before they were looked at."
            )
    if d.validation is not None:
        old, new = d.validation
        at = ", ".join(condition_value(x, d.condition[1]) for x in new.conditions)
        words.append(f"At {at}, never fitted, the gap goes {_from_to(old.rms, new.rms)}.")
    return " ".join(words)


# -- doubts ----------------------------------------------------------------------------------------


def _doubts(d: Diagnosis) -> list[str]:
    lead, s, words = leading(d), d.shrinkage, []
    if lead is not None:
        if lead.p_value < _LEVEL:
            words.append(
                "The leading explanation leaves more than noise and model error would: "
                f"{_p_value(lead.p_value)}."
            )
        elif lead.p_value > _TOO_GOOD:
            words.append("It fits better than it should: noise or discrepancy is stated too large.")
        if lead.at_bound:
            words.append(f"At a limit of their range: {_joined(lead.at_bound)}.")
        far = [p for p in lead.parameters if p["nuisance"] and abs(p["prior_sigmas"]) > _FAR]
        items = [f"{spaced(p['effect'])} ({p['prior_sigmas']:+.1f} s.d.)" for p in far]
        if items:
            words.append(f"Far from what was expected in any case: {_shortened(items)}.")
    if s is not None and s.folds and d.verdict == "cause":
        if np.isfinite(s.excess) and not s.claimed:
            words.append(
                "On held-out data the best wrong effect does nearly as well: how far the gap "
                "shrinks is no evidence for the cause."
            )
        if s.shrink < _HALF:
            words.append(
                f"Of the gap in frequency that noise lets go, {100 * (1 - max(s.shrink, 0)):.0f} % "
                "remains on held-out data: something else may be missing."
            )
        if s.coverage < _COVERAGE:
            words.append(
                f"Only {_share(s.coverage)} of the folds ended in the 90 % interval stated before."
            )
    if np.isfinite(d.model_error) and d.model_error > 0.5 * d.noise:
        words.append(
            f"The reduced model's error, up to {percent(d.model_error, 3)}, is not small against "
            f"the noise, {percent(d.noise, 3)}."
        )
    if any(not np.isfinite(n.log_evidence) or n.error > 0.5 for n in d.nested.values()):
        words.append("Nested sampling left an error of more than 0.5 in some ln evidence.")
    return words
