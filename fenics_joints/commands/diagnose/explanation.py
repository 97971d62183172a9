"""A diagnosis in words: the answer, questions that stand behind it, and what to doubt.

Every number is one of the `Diagnosis`; nothing is computed here but ratios of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from textwrap import shorten

import numpy as np

from fenics_joints.commands.diagnose.words import (
    LISTED,
    SHARE,
    EffectClass,
    along,
    attached_words,
    best_without,
    by_effect,
    causes,
    effect_classes,
    from_to,
    group_words,
    in_test,
    is_part,
    joined,
    leading,
    members_in_words,
    mesh_error,
    named,
    p_value_words,
    parameter_words,
    place_words,
    point_mass_words,
    priors_in_words,
    probability_of,
    shortened,
    sure_causes,
    with_place,
    zone_words,
)
from fenics_joints.diagnosis.effects.damping import NAMES
from fenics_joints.diagnosis.evidence.classes import APART
from fenics_joints.diagnosis.evidence.evidence import UNSURE
from fenics_joints.diagnosis.evidence.misattribution import SAID
from fenics_joints.diagnosis.evidence.scales import BETWEEN
from fenics_joints.diagnosis.location import Location
from fenics_joints.diagnosis.result import Diagnosis, HypothesisResult
from fenics_joints.diagnosis.thresholds import MISFIT
from fenics_joints.diagnosis.verdict import (
    CAUSE,
    LIKELY,
    NAMED,
    NO_GAP,
    UNKNOWN,
    doubtful,
    unconfirmed,
)
from fenics_joints.diagnosis.where.score_tests import LEVEL
from fenics_joints.formatting import (
    LEAST,
    MOST,
    error_percent,
    number,
    percent,
    probability,
    spaced,
)
from fenics_joints.report.document import sentence

#: Nats of log odds up to which another region may be the right one as well: 20 to 1. Chosen.
_AS_PROBABLE = 3.0
#: Probability of a cause outside the library below which no sentence names it (that of two digits),
#: and relative error of the mesh from which on one does. Chosen: only words depend on them.
_REMOTE, _SEEN = 0.01, 5e-4
_COUNT = {2: "two", 3: "three"}
#: Parameters of a cause in its sentence: more would not be read.
_SIZES = 2
_HELD = "On data held out while the cause was chosen and fitted,"
_MISFIT = "misfit (the gap weighed by noise)"


@dataclass(frozen=True)
class Explanation:
    """A diagnosis in words.

    Attributes:
        which: Which effect causes the gap, with its place and size.
        how_far: How far the gap shrinks on data that were held out.
        apart: Causes that cannot be told apart, and the measurement that would; "" without any.
        where: Where the model is wrong, if no cause is named; "" otherwise, since the cause says.
        start: What is compared with the test.
        points: The same in more words: questions, and their answers.
        doubts: What speaks against taking the answer at its word.
    """

    which: str
    how_far: str
    apart: str
    where: str
    start: str
    points: dict[str, str]
    doubts: tuple[str, ...]

    def __repr__(self) -> str:
        more = f"{len(self.points)} points, {len(self.doubts)} doubts"
        return f"Explanation({shorten(self.which, 60)!r}, {more})"

    @property
    def sentences(self) -> tuple[tuple[str, str], ...]:
        """The sentences that there are, with their headings, the answer first."""
        found = (
            ("Cause", self.which),
            ("How far", self.how_far),
            ("Rivals", self.apart),
            ("Where", self.where),
            ("Compared", self.start),
        )
        return tuple((heading, sentence) for heading, sentence in found if sentence)

    def to_json(self) -> dict:
        """Texts only."""
        return {**asdict(self), "doubts": list(self.doubts)}


def explain(d: Diagnosis) -> Explanation:
    """Put a diagnosis into words."""
    return Explanation(
        _which(d), _how_far(d), _apart(d), _where(d), _start(d), questions(d), tuple(doubts(d))
    )


def _start(d: Diagnosis) -> str:
    measured = np.isfinite(d.before.test_hz)
    has = int((measured & np.isfinite(d.before.model_hz)).any(axis=0).sum())
    of, m = "the measured frequencies", int(measured.any(axis=0).sum())
    if has < m:
        of = f"the {has} of {m} measured frequencies that it has modes for"
    off = f"is {percent(d.before.rms)} off {of} (root mean square{_mesh(d)})"
    return f"The nominal model{_JOINTS[d.joints]} {off}; that is the gap."


def _mesh(d: Diagnosis) -> str:
    """The mesh's error, which is not in the gap."""
    off = mesh_error(d)
    return f", after the mesh's own {percent(off)} is taken off" if off > _SEEN else ""


_JOINTS = {
    "bonded": ", with its joints bonded to the parts,",
    "given": ", with its joints as stiff as the case gives them,",
    "": "",
}


def _where(d: Diagnosis) -> str:
    """Where the model is wrong, unless the cause that is named says so itself."""
    found = d.location
    if d.verdict == NO_GAP:
        if found is None:
            return "Nowhere: there is no gap beyond noise and tolerances."
        return (
            "Nowhere beyond chance: noise, tolerances and the error of any model would make a "
            f"misfit of {found.n_data}, and there is one of {found.misfit:.0f}."
        )
    if sure_causes(d):
        return sentence(inside) if (inside := in_test(d)) else ""
    point = "" if d.somewhere is None else point_mass_words(d.somewhere)
    return sentence(_most_probable(found) + (f"; {point}" if point else ""))


def _most_probable(found: Location | None) -> str:
    """The place that the score tests put first, and those that may as well be it."""
    ranked = () if found is None else found.ranked
    if found is None or not ranked:
        return "the test does not say where: no place explains more of the misfit than chance"
    first = ranked[0]
    words = (
        f"the gap lies most probably in {place_words(found, first)}; a change there alone explains "
        f"{percent(first.share, 0)} of the {_MISFIT} (by chance {p_value_words(first.p_adjusted)})"
    )
    least = first.log_odds - _AS_PROBABLE
    regions = {t.region: None for t in ranked if t.log_odds > least and t.region != first.region}
    if regions:
        names = shortened([f'"{zone_words(name)}"' for name in regions], "or")
        return f"{words}; {names} cannot be ruled out"
    return words


def _which(d: Diagnosis) -> str:
    say = {NO_GAP: _no_cause, "unknown": _unknown, CAUSE: _cause, LIKELY: _cause}
    return sentence(say.get(d.verdict, _undecided)(d))


def _outside(d: Diagnosis) -> str:
    """What is left for causes outside the library, where that is not the answer itself."""
    p = probability_of(d, UNKNOWN)
    if p < _REMOTE:
        return ""
    return f"; {probability(p)} is left for a cause outside the library"


def _no_cause(d: Diagnosis) -> str:
    p = probability_of(d, NO_GAP)
    words = f"none is needed: the nominal model within its tolerances has {probability(p)}"
    found = causes(d)
    if not found:
        return words + _outside(d)
    most = (
        f"the most probable cause, {members_in_words(found[0])}, "
        f"{probability(found[0].probability)}"
    )
    return f"{words}, {most}{_outside(d)}"


def _unknown(d: Diagnosis) -> str:
    lead, n = leading(d), sum(len(c.effects) for c in causes(d))
    fits = lead is not None and lead.p_value >= MISFIT
    words = "is as probable as one that was not" if fits else "explains all of the test"
    words = f"none of the {n} effects that were considered {words}"
    if lead is not None:
        words += f": the best, {named(lead)}, leaves a gap of {error_percent(lead.gap)}"
        p = p_value_words(lead.p_value)
        words += (
            f", as noise and model error may ({p})"
            if fits
            else (f" and would give such a misfit with {p}{_at_once(d)}")
        )
    if is_part(d):
        words += (
            "; it predicts held-out data better than the nominal model and better than any wrong "
            "effect does, and so is likely a part of the cause"
        )
    p = probability(probability_of(d, UNKNOWN))
    return f"{words}; that something else is at work{' too' if is_part(d) else ''} has {p}"


def _at_once(d: Diagnosis) -> str:
    """Whether all effects at once could explain what the best few do not."""
    if d.at_once is None:
        return ""
    p = p_value_words(d.at_once)
    if d.at_once < MISFIT:
        return f"; nor would all of them at once ({p}), so that something of another kind is there"
    return f"; all of them at once may leave as much ({p}), so that it can also be several of them"


def _cause(d: Diagnosis) -> str:
    sure = sure_causes(d)
    if not sure:
        return _undecided(d)
    several = f"{_COUNT.get(len(sure), len(sure))} causes: " if len(sure) > 1 else ""
    words = "; and ".join(_with_size(d, c) for c in sure)
    weak = doubtful(d.effects, d.shrinkage)
    perhaps = "".join(
        f"; perhaps also {members_in_words(c)}, {probability(c.probability)}, which held-out data "
        "do not bear out"
        for c in causes(d)
        if c.name in weak and d.verdict == CAUSE
    )
    return several + words + perhaps + _outside(d)


def _with_size(d: Diagnosis, group: EffectClass) -> str:
    """A cause with its probability, its size, and where it is unless its name says so."""
    lead, keys = leading(d), {e.key for e in group.effects}
    words = [f"{members_in_words(group)}, {probability(group.probability)}"]
    for key, rows in [] if lead is None else by_effect(lead.parameters):
        if key in keys:
            sizes = [p for p in rows if not p.get("at")][:_SIZES]
            words.append(attached_words(rows) or parameter_words(sizes))
    return ": ".join(filter(None, words))


def _apart(d: Diagnosis) -> str:
    """What else it can be, and the one measurement that would tell."""
    sure, words = sure_causes(d), []
    classes = {c.name: c for c in causes(d) if len(c.effects) > 1 and c.probability >= SHARE}
    split = next((s for s in d.separations if s.class_name in classes), None)
    if split is not None:
        names = shortened([with_place(e.key) for e in classes[split.class_name].effects])
        enough = "" if split.distance >= APART else ", which is not enough alone"
        words.append(
            f"{names} would be told apart best by {split.measurement} (up to "
            f"{split.distance:.1f} standard deviations{enough})"
        )
    lead, other = leading(d), best_without(d, sure)
    if sure and lead is not None and other is not None:
        ratio, most = lead.probability / max(other.probability, 1e-300), round(MOST / LEAST)
        times = f"{number(ratio, 2)} times" if ratio <= most else f"more than {most} times"
        words.append(f"the closest rival, {named(other)}, is {times} less probable")
    return sentence("; ".join(words)) if words else ""


def _undecided(d: Diagnosis) -> str:
    rows = [c for c in effect_classes(d) if c.probability >= 0.02][: LISTED + 1]
    items = [f"{members_in_words(c)} ({probability(c.probability)})" for c in rows]
    return f"undecided between {joined(items)}" if items else "undecided"


def _how_far(d: Diagnosis) -> str:
    s = d.shrinkage
    if s is None or not s.folds:
        if not np.isfinite(d.heldout_after):
            fitted = from_to(d.before.rms, d.after.rms)
            return f"Nothing could be held out; fitted, the gap goes {fitted}."
        return f"{_HELD} the gap goes {from_to(d.heldout_before, d.heldout_after)}."
    best = f"the best wrong effect leaves {error_percent(s.placebo)}"
    if s.after >= s.before:
        words = f"{_HELD} the gap grows {from_to(s.before, s.after)}"
        wrong = f"; {best}" if np.isfinite(s.placebo) else ""
        return f"{words}: what is chosen without them does not predict them{wrong}."
    words = f"{_HELD} the gap goes {from_to(s.before, s.after)}"
    if not np.isfinite(s.before):
        return f"{words}; the nominal model has none of these modes."
    if not np.isfinite(s.shrink):
        return f"{words}; the nominal model is already as good as noise allows."
    low, high = (f"{100 * share:.0f}" for share in s.shrink_interval)
    words += (
        f": {100 * s.shrink:.0f} % of the gap beyond noise is gone (90 % interval: {low} to "
        f"{high} %)"
    )
    lead = leading(d)
    if lead is not None and lead.label == NO_GAP:
        return f"{words}, by what is within tolerance alone."
    if not np.isfinite(s.placebo):
        return f"{words}."
    return f"{words}; {best}{'' if s.claimed else ', which is not surely worse'}."


#: Nats of ln evidence beyond which a difference says no more: no model of this kind is that exact.
#: Chosen: only words depend on it.
_FAR_LOWER = 10.0


def questions(d: Diagnosis) -> dict[str, str]:
    """The questions that a diagnosis answers beside the sentences above, with the answers."""
    answers = {
        "Is there more than chance?": _beyond_chance(d),
        "In which data?": _in_which_data(d),
        "In which part?": _in_which_part(d),
        "Why this and not another?": _why(d),
        "What if it is something else?": _something_else(d),
        "What can these data not tell?": _not_told(d),
    }
    found = {question: " ".join(sentences) for question, sentences in answers.items()}
    return {question: answer for question, answer in found.items() if answer}


def _beyond_chance(d: Diagnosis) -> Iterator[str]:
    found = d.location
    if found is None:
        return
    yield (
        f"The nominal model misses the {found.n_data} data by a squared misfit of "
        f"{found.misfit:.0f}, in standard deviations of noise, tolerances and model error; "
        f"chance alone makes about {found.n_data}."
    )
    kinds = [f"{a.label} {a.chi2:.0f} for {a.expected}" for a in along(found, "kind")]
    if len(kinds) > 1:
        yield f"By kind: {', '.join(kinds)}."


def _in_which_data(d: Diagnosis) -> Iterator[str]:
    """The modes and conditions that misfit by more than chance, all of their kind considered
    (Bonferroni), the worst first."""
    for by, kind in (("mode", "modes"), ("condition", f"values of the {d.condition[0]}")):
        parts = [] if d.location is None else along(d.location, by)
        loud = sorted((a for a in parts if a.p * len(parts) < LEVEL), key=lambda a: -a.chi2)
        labels = joined([group_words(a, d.condition[1]) for a in loud]) or "none"
        if len(parts) > 1:
            yield f"Of {len(parts)} {kind} these misfit by more than chance: {labels}."


def _in_which_part(d: Diagnosis) -> Iterator[str]:
    found = d.location
    if found is None or d.verdict == NO_GAP or not (in_test(d) or found.ranked):
        return
    if in_test(d):
        yield "What a region seems to ask for may be the echo of what is wrong in the test."
        return
    first = found.ranked[0]
    inside = [t for t in found.ranked if t.region == first.region and t is not first]
    if inside:
        others = shortened([place_words(found, t) for t in inside])
        yield f"Within {spaced(first.region)} also more than chance: {others}."
    if not first.sufficient:
        yield (
            "It is not all, or it is large: the tests are of the first order and say where, not "
            "how much."
        )
    if found.patches is not None:
        n, several = int(found.patches.significant.sum()), int(found.patches.sufficient.sum())
        yield (
            f"Of {len(found.patches.tests)} patches of the map {n} explain more than chance, and "
            f"{several} could each be the only one."
        )


def _why(d: Diagnosis) -> Iterator[str]:
    """What the best explanation without each cause leaves, and its evidence."""
    lead = leading(d)
    for group in [] if lead is None else sure_causes(d):
        other = best_without(d, [group])
        if other is not None:
            like = " or its like" if len(group.effects) > 1 else ""
            yield (
                f"The best explanation without {with_place(group.effects[0].key)}{like}, "
                f"{named(other)}, leaves {percent(other.gap)} ({p_value_words(other.p_value)}), "
                f"and its ln evidence is {_beside(lead.log_evidence - other.log_evidence)}."
            )


def _beside(lower: float) -> str:
    """How a rival's ln evidence stands to the leader's, which may lead by its odds alone."""
    if lower > _FAR_LOWER:
        return f"more than {_FAR_LOWER:.0f} lower"
    if lower >= 0.05:
        return f"{lower:.1f} lower"
    words = f"{-lower:.1f} higher" if lower <= -0.05 else "the same"
    return f"{words}, but it was less likely before the test"


def _not_told(d: Diagnosis) -> Iterator[str]:
    for group in causes(d):
        if len(group.effects) > 1 and group.probability >= SHARE:
            names = shortened([with_place(e.key) for e in group.effects], "or")
            yield f"Which it is of {names}. {priors_in_words(group)}"
    unseen = [with_place(e.key) for c in causes(d) for e in c.effects if not e.detectable]
    if unseen:
        yield f"Too small to be seen at their expected size: {shortened(unseen)}."
    if d.between is not None:
        kinds = zip(("frequencies", "damping ratios"), (2, 0), d.between, strict=False)
        items = joined([f"{kind} by {percent(x, n)}" for kind, n, x in kinds])
        yield (
            f"Why, beside what is explained and noise, {items} (one s.d.) are off from level to "
            "level: that is taken for drift."
        )


def _something_else(d: Diagnosis) -> Iterator[str]:
    p, simulated = probability_of(d, UNKNOWN), d.misattribution
    yield f"A cause outside the library has {probability(p)}."
    if simulated is not None:
        yield (
            f"Before the test it had {percent(simulated.prior, 0)}. In {simulated.tests} "
            "simulated tests of this structure with these sensors the cause was taken out of the "
            f"library: {percent(simulated.rate, 0)} of them were taken for other effects of it."
        )
        if simulated.answers:
            low, high = (round(100 * x) for x in SAID)
            yield (
                f"With the cause in it, {simulated.right} of {simulated.answers} answers given as "
                f"{low} to {high} % were right."
            )
    if p >= SHARE and d.somewhere is not None:
        point = point_mass_words(d.somewhere)
        yield (
            "If there is one, it is a change of stiffness or mass in one place with "
            f"{probability(d.somewhere.probability)}{point and f': {point}'}."
        )


#: Standard deviations from its expected value beyond which a nuisance is a doubt: 5 % by chance.
FAR = 2.0
#: A p-value above this says that the stated noise and model error are too large: one test in a
#: thousand fits as well by chance.
_TOO_GOOD = 0.999
#: Share of right intervals of 90 % below which there is a doubt: of ten, seven hold with 99 %.
_COVERAGE = 0.7
#: Share of the gap beyond noise that a whole cause should remove at least: more than it leaves.
_HALF = 0.5
#: Effects from which on a class is hardly an answer. Chosen: only words depend on it.
_BROAD = 10
#: Times the expected drift from level to level from which on it is large. Chosen: only words depend
#: on it.
_DRIFTS = 5.0


def doubts(d: Diagnosis) -> Iterator[str]:
    """A sentence for each doubt."""
    lead, s = leading(d), d.shrinkage
    if d.verdict == LIKELY:
        yield f"Held-out data do not confirm the cause: {unconfirmed(s)}."
    if lead is not None:
        yield from _of_leader(d, lead)
    if s is not None and s.folds and d.verdict in NAMED:
        if d.verdict != LIKELY and np.isfinite(s.excess) and not s.claimed:
            yield (
                "On held-out data the best wrong effect does nearly as well: how far the gap "
                "shrinks is no evidence for the cause."
            )
        if s.after < s.before and s.shrink < _HALF:
            yield (
                f"Of the gap in frequency beyond noise, {100 * (1 - s.shrink):.0f} % "
                "remains on held-out data: something else may be missing."
            )
        if s.coverage < _COVERAGE:
            yield (
                f"Only {percent(s.coverage, 0)} of the parts held out ended as well as the 90 % "
                "interval that was stated before."
            )
    if d.model.get("order"):
        yield d.model["order"]
    for c in sure_causes(d):
        if len(c.effects) >= _BROAD:
            yield (
                f"Of {with_place(c.effects[0].key)} and its like there are {len(c.effects)} that "
                "this test cannot tell apart: it says little of what is to be changed in the model."
            )
    if (d.of_functions or 1.0) > 1.0:
        yield (
            f"The measured functions are taken to be {d.of_functions:.2g} times as much off as is "
            "stated of them (noise aside): calibration, places and directions of their sensors?"
        )
    yield from _drifts(d)
    off = mesh_error(d)
    if off and UNSURE * off >= SHARE * d.before.rms:
        left = percent(UNSURE * off / d.before.rms, 0)
        yield (
            f"The mesh alone makes an error of {percent(off)} (root mean square over the modes). "
            f"It is taken off, but what stays uncertain of it is {left} of the gap: a finer one "
            "would tell more."
        )
    if np.isfinite(d.model_error) and d.model_error > 0.5 * d.noise:
        yield (
            f"The reduced model's error, up to {percent(d.model_error, 3)}, is not small against "
            f"the noise, {percent(d.noise, 3)}."
        )


def _of_leader(d: Diagnosis, lead: HypothesisResult) -> Iterator[str]:
    """Doubts of the fit of the leading hypothesis."""
    if lead.p_value < LEVEL:
        p = p_value_words(lead.p_value)
        yield f"The leading explanation leaves more than noise and model error would: {p}."
    elif lead.p_value > _TOO_GOOD:
        kinds = zip(("frequencies", "shapes"), d.of_stated or (), strict=False)
        less = [f"{x:.2g} of it for {kind}" for kind, x in kinds if x < 1.0]
        counted = f", though no more than {joined(less)} was counted" if less else ""
        yield f"It fits better than it should: noise or discrepancy is stated too large{counted}."
    if lead.at_bound:
        yield f"At a limit of their range: {joined(lead.at_bound)}."
    far = [p for p in lead.parameters if p["nuisance"] and abs(p["prior_sigmas"]) > FAR]
    if far:
        items = [f"{spaced(p['effect'])} ({p['prior_sigmas']:+.1f} s.d.)" for p in far]
        yield f"Far from what was expected in any case: {joined(items)}."


def _drifts(d: Diagnosis) -> Iterator[str]:
    """That modes change from level to level by more than a structure usually drifts."""
    kinds = zip(("frequencies", "damping ratios"), d.between or (), BETWEEN.medians, strict=False)
    much = [
        f"{kind} by {percent(x, 0 if x > 0.1 else 2)}"
        for kind, x, median in kinds
        if x > _DRIFTS * median
    ]
    if much:
        dissipating = [
            f"{with_place(e.key)} ({probability(e.probability)})"
            for e in d.effects
            if e.name in NAMES and e.probability >= SHARE
        ]
        perhaps = joined(dissipating, "or")
        perhaps = perhaps and f": {perhaps} may be what these few levels cannot bear out"
        yield (
            f"From level to level {joined(much)} are off beside what is explained, much for a drift"
            f"{perhaps}."
        )
