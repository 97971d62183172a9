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
    deviation_words,
    effect_classes,
    group_words,
    in_test,
    is_part,
    joined,
    kind_words,
    leading,
    members_in_words,
    mesh_error,
    named,
    p_value_words,
    parameter_name,
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
from fenics_joints.formatting import LEAST, MOST, error_percent, number, percent, probability
from fenics_joints.report.document import sentence

#: Nats of log odds up to which another region may be the right one as well: 20 to 1. Chosen.
_AS_PROBABLE = 3.0
#: Probability of a cause outside the library below which no sentence names it (that of two digits),
#: and relative error of the mesh from which on one does. Chosen: only words depend on them.
_REMOTE, _SEEN = 0.01, 5e-4
#: Parameters of a cause in its sentence: more would not be read.
_SIZES = 2


@dataclass(frozen=True)
class Explanation:
    """A diagnosis in words.

    Attributes:
        causes: Which effects cause the error, a heading and sentences for each.
        how_far: How far the error shrinks on data that were held out.
        apart: The measurement that would distinguish the causes that this test cannot distinguish,
            and the closest rival; "" without any.
        where: Where the model is wrong, if no cause is named; "" otherwise, since the cause says.
        start: What is compared with the test.
        points: The same in more words: questions, and their answers.
        doubts: What speaks against taking the answer at its word.
    """

    causes: tuple[tuple[str, str], ...]
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
    def which(self) -> str:
        """All causes in one text."""
        return " ".join(f"{heading}: {words}" for heading, words in self.causes)

    @property
    def sentences(self) -> tuple[tuple[str, str], ...]:
        """The sentences that there are, with their headings, the answer first."""
        found = (
            *self.causes,
            ("How far", self.how_far),
            ("Rivals", self.apart),
            ("Where", self.where),
            ("Compared", self.start),
        )
        return tuple((heading, words) for heading, words in found if words)

    def to_json(self) -> dict:
        """Texts only."""
        rest = asdict(self)
        del rest["causes"]
        return {"which": self.which, **rest, "doubts": list(self.doubts)}


def explain(d: Diagnosis) -> Explanation:
    """Put a diagnosis into words."""
    return Explanation(
        tuple(_causes(d)),
        _how_far(d),
        _apart(d),
        _where(d),
        _start(d),
        questions(d),
        tuple(doubts(d)),
    )


def _start(d: Diagnosis) -> str:
    measured = np.isfinite(d.before.test_hz)
    has = int((measured & np.isfinite(d.before.model_hz)).any(axis=0).sum())
    of, m = "the measured frequencies", int(measured.any(axis=0).sum())
    if has < m:
        of = f"the {has} of {m} measured frequencies that it has modes for"
    words = f"The RMS error of the baseline model{_JOINTS[d.joints]} is {percent(d.before.rms)}"
    off = mesh_error(d)
    mesh = f"; its discretisation error ({percent(off)}) is subtracted" if off > _SEEN else ""
    return f"{words} over {of}{mesh}."


_JOINTS = {
    "bonded": " (joints bonded)",
    "given": " (joints with the stiffness of the case)",
    "": "",
}


def _where(d: Diagnosis) -> str:
    """Where the model is wrong, unless the cause that is named says so itself."""
    found = d.location
    if d.verdict == NO_GAP:
        if found is None:
            return "Nowhere: there is no error beyond noise and tolerances."
        return (
            f"Nowhere beyond chance: chi-square of the baseline model is {found.misfit:.0f}, and "
            f"noise, tolerances and model error give about {found.n_data}."
        )
    if sure_causes(d):
        return sentence(inside) if (inside := in_test(d)) else ""
    point = "" if d.somewhere is None else point_mass_words(d.somewhere)
    return _most_probable(found) + (f" {sentence(point)}" if point else "")


def _most_probable(found: Location | None) -> str:
    """The place that the score tests put first, and those that may as well be it."""
    ranked = () if found is None else found.ranked
    if found is None or not ranked:
        return "The test does not show where: no place explains more of chi-square than chance."
    first = ranked[0]
    words = (
        f"The error lies most probably in {place_words(found, first)}. A change there alone "
        f"explains {percent(first.share, 0)} of chi-square ({p_value_words(first.p_adjusted)})."
    )
    least = first.log_odds - _AS_PROBABLE
    regions = {t.region: None for t in ranked if t.log_odds > least and t.region != first.region}
    if regions:
        names = shortened([f'"{zone_words(name)}"' for name in regions], "or")
        return f"{words} {names} cannot be ruled out."
    return words


def _causes(d: Diagnosis) -> Iterator[tuple[str, str]]:
    """A heading and sentences for each cause, or for the reason that none is named."""
    if d.verdict == NO_GAP:
        yield "Cause", _no_cause(d)
    elif d.verdict == "unknown":
        yield "Cause", _unknown(d)
        return
    elif d.verdict in (CAUSE, LIKELY) and sure_causes(d):
        yield from _named_causes(d)
    else:
        yield from _candidates(d)
        return
    p = probability_of(d, UNKNOWN)
    if p >= _REMOTE:
        yield "Otherwise", f"{probability(p)} is left for a cause that is not in the library."


def _no_cause(d: Diagnosis) -> str:
    p = probability(probability_of(d, NO_GAP))
    words = f"None is needed: the baseline model within its tolerances has a probability of {p}."
    found = causes(d)
    if not found:
        return words
    most = f"{with_place(found[0].effects[0].key)} ({probability(found[0].probability)})"
    return f"{words} The most probable cause would be {most}."


def _unknown(d: Diagnosis) -> str:
    lead, n = leading(d), sum(len(c.effects) for c in causes(d))
    fits = lead is not None and lead.p_value >= MISFIT
    does = "is as probable as a cause outside the library" if fits else "explains the whole test"
    words = [f"None of the {n} effects considered {does}."]
    if lead is not None:
        p = p_value_words(lead.p_value)
        words.append(
            f"The best, {named(lead)}, leaves an error of {error_percent(lead.gap)}, which noise "
            f"and model error {'can' if fits else 'do not'} explain ({p})."
        )
        if not fits and d.at_once is not None:
            words.append(_at_once(d.at_once))
    if is_part(d):
        words.append(
            "It predicts held-out data better than the baseline model and the placebo, so it is "
            "probably a part of the cause."
        )
    p = probability(probability_of(d, UNKNOWN))
    return " ".join([*words, f"A cause outside the library has a probability of {p}."])


def _at_once(p_value: float) -> str:
    """Whether all effects at once could explain what the best few do not."""
    p = p_value_words(p_value)
    if p_value < MISFIT:
        return f"All effects together do not explain it either ({p}): the cause is of another kind."
    return f"All effects together can explain it ({p}): several of them may act at once."


def _named_causes(d: Diagnosis) -> Iterator[tuple[str, str]]:
    sure = sure_causes(d)
    for i, group in enumerate(sure, start=1):
        heading = f"Cause {i}" if len(sure) > 1 else "Cause"
        yield f"{heading} ({probability(group.probability)})", _with_size(d, group)
    weak = doubtful(d.effects, d.shrinkage)
    for group in causes(d):
        if group.name in weak and d.verdict == CAUSE:
            words = sentence(members_in_words(group))
            yield (
                f"Perhaps also ({probability(group.probability)})",
                f"{words} Held-out data do not confirm it.",
            )


def _candidates(d: Diagnosis) -> Iterator[tuple[str, str]]:
    rows = [c for c in effect_classes(d) if c.probability >= 0.02][: LISTED + 1]
    yield "Cause", "Undecided: this test does not decide between the following."
    for i, group in enumerate(rows, start=1):
        yield f"Candidate {i} ({probability(group.probability)})", _members(group)


def _members(group: EffectClass) -> str:
    """A class in sentences: what its members have in common, and which they are."""
    words = sentence(members_in_words(group))
    kind = kind_words(group) if len(group.effects) > 1 else ""
    return f"{kind}. {words}" if kind else words


def _with_size(d: Diagnosis, group: EffectClass) -> str:
    """A cause with its size, and where it is unless its name says so."""
    lead, keys = leading(d), [e.key for e in group.effects]
    words = [_members(group)]
    for key, rows in [] if lead is None else by_effect(lead.parameters):
        if key not in keys:
            continue
        of = "" if key == keys[0] else f" of {with_place(key)}"
        if attached := attached_words(rows):
            words.append(f"Best fit{of}: {attached}.")
            continue
        sizes = [p for p in rows if not p.get("at")][:_SIZES]
        known = [p for p in sizes if p.get("identified", True)]
        unknown = [parameter_name(p) for p in sizes if p not in known]
        if known:
            words.append(f"Best fit{of} (68 % interval): {parameter_words(known)}.")
        if unknown:
            words.append(f"Not identified by this test: {joined(unknown)}.")
    return " ".join(words)


def _apart(d: Diagnosis) -> str:
    """The one measurement that would distinguish the members of a class, and the closest rival."""
    sure, words = sure_causes(d), []
    classes = {c.name: c for c in causes(d) if len(c.effects) > 1 and c.probability >= SHARE}
    split = next((s for s in d.separations if s.class_name in classes), None)
    if split is not None:
        letter = classes[split.class_name].letter
        best = f"{split.measurement} would best distinguish the effects of class {letter}"
        words.append(sentence(f"{best}: {deviation_words(split.distance)}"))
    lead, other = leading(d), best_without(d, sure)
    if sure and lead is not None and other is not None:
        ratio, most = lead.probability / max(other.probability, 1e-300), round(MOST / LEAST)
        times = f"{number(ratio, 2)} times" if ratio <= most else f"more than {most} times"
        numbered = [f"cause {i}" for i in range(1, len(sure) + 1)]
        lacks = "this cause" if len(sure) == 1 else joined(numbered, "or")
        words.append(
            f"The best explanation that lacks {lacks}, {named(other)}, is {times} less probable."
        )
    return " ".join(words)


def _how_far(d: Diagnosis) -> str:
    s = d.shrinkage
    if s is None or not s.folds:
        if not np.isfinite(d.heldout_after):
            errors = _errors("Fitted error", d.before.rms, d.after.rms)
            return f"Nothing could be held out. {errors}."
        return f"{_errors('Held-out error', d.heldout_before, d.heldout_after)}."
    others = [f"placebo {error_percent(s.placebo)}"] if np.isfinite(s.placebo) else []
    others += [f"noise floor {error_percent(s.noise)}"] if np.isfinite(s.noise) else []
    words = _errors("Held-out error", s.before, s.after)
    words += f" ({', '.join(others)})" if others else ""
    if s.after >= s.before:
        return f"{words}. It grows: the fit without these data does not predict them."
    if not np.isfinite(s.before):
        return f"{words}. The baseline model has none of these modes."
    if not np.isfinite(s.shrink):
        return f"{words}. The baseline model is already as good as noise allows."
    low, high = (f"{100 * share:.0f}" for share in s.shrink_interval)
    words += (
        f": {100 * s.shrink:.0f} % of the error beyond noise is gone (90 % interval {low} to "
        f"{high} %)"
    )
    lead = leading(d)
    if lead is not None and lead.label == NO_GAP:
        return f"{words}, by changes within tolerance alone."
    unsure = np.isfinite(s.placebo) and not s.claimed
    return f"{words}.{' The placebo is not significantly worse.' if unsure else ''}"


def _errors(of: str, before: float, after: float) -> str:
    """Two errors: ``Error: 5.00 % before, 1.00 % after``."""
    return f"{of}: {error_percent(before)} before, {error_percent(after)} after"


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
        f"Chi-square of the baseline model is {found.misfit:.0f} for {found.n_data} data; noise, "
        f"tolerances and model error alone give about {found.n_data}."
    )
    kinds = [f"{a.label} {a.chi2:.0f} for {a.expected}" for a in along(found, "kind")]
    if len(kinds) > 1:
        yield f"By kind: {', '.join(kinds)}."


def _in_which_data(d: Diagnosis) -> Iterator[str]:
    """The modes and conditions with more error than chance, all of their kind considered
    (Bonferroni), the worst first."""
    for by, kind in (("mode", "modes"), ("condition", f"values of the {d.condition[0]}")):
        parts = [] if d.location is None else along(d.location, by)
        loud = sorted((a for a in parts if a.p * len(parts) < LEVEL), key=lambda a: -a.chi2)
        labels = joined([group_words(a, d.condition[1]) for a in loud]) or "none"
        if len(parts) > 1:
            yield (
                f"Of {len(parts)} {kind}, these add more error than chance to what the others "
                f"show: {labels}."
            )


def _in_which_part(d: Diagnosis) -> Iterator[str]:
    found = d.location
    if found is None or d.verdict == NO_GAP or not (in_test(d) or found.ranked):
        return
    if in_test(d):
        yield "The error that the tests find in regions may come from the fault in the test."
        return
    first = found.ranked[0]
    inside = [t for t in found.ranked if t.region == first.region and t is not first]
    if inside:
        others = shortened([place_words(found, t) for t in inside])
        yield f"Within {zone_words(first.region)}, more than chance is also explained by {others}."
    if not first.sufficient:
        yield (
            "A change there does not explain everything, or it is large: the tests are linear and "
            "say where, not how much."
        )
    if found.patches is not None:
        n, several = int(found.patches.significant.sum()), int(found.patches.sufficient.sum())
        only = f"{several} of them could" if several else "none of them can"
        yield (
            f"Of the {len(found.patches.tests)} patches of the map, {n} explain more than chance; "
            f"{only} be the only place of the error."
        )


def _why(d: Diagnosis) -> Iterator[str]:
    """The error of the best explanation without each cause, and its evidence."""
    lead = leading(d)
    for group in [] if lead is None else sure_causes(d):
        other = best_without(d, [group])
        if other is not None:
            of = with_place(group.effects[0].key)
            of = f"class {group.letter}" if group.letter else of
            yield (
                f"The best explanation without {of}, {named(other)}, leaves an error of "
                f"{percent(other.gap)} ({p_value_words(other.p_value)}). Its ln evidence is "
                f"{_beside(lead.log_evidence - other.log_evidence)}."
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
            yield f"Which of these it is: {names}. {priors_in_words(group)}"
    unseen = [with_place(e.key) for c in causes(d) for e in c.effects if not e.detectable]
    if unseen:
        yield f"Effects too small to detect at their expected size: {shortened(unseen)}."
    if d.between is not None:
        kinds = zip(("frequencies", "damping ratios"), (2, 0), d.between, strict=False)
        items = joined([f"{kind} by {percent(x, n)}" for kind, n, x in kinds])
        yield (
            f"Why {items} (one s.d.) change from level to level beyond noise and the explanation: "
            "this is taken for drift."
        )


def _something_else(d: Diagnosis) -> Iterator[str]:
    p, simulated = probability_of(d, UNKNOWN), d.misattribution
    yield f"A cause outside the library has a probability of {probability(p)}."
    if simulated is not None:
        yield (
            f"Before the test it had {percent(simulated.prior, 0)}. In {simulated.tests} simulated "
            "tests of this structure with these sensors, the true cause was removed from the "
            f"library; {percent(simulated.rate, 0)} of them were mistaken for other effects."
        )
        if simulated.answers:
            low, high = (round(100 * x) for x in SAID)
            yield (
                f"With the cause in the library, {simulated.right} of {simulated.answers} answers "
                f"given as {low} to {high} % were right."
            )
    if p >= SHARE and d.somewhere is not None:
        point = point_mass_words(d.somewhere)
        yield (
            "If there is one, the probability that it is a change of stiffness or mass in one "
            f"place is {probability(d.somewhere.probability)}{point and f'; {point}'}."
        )


#: Standard deviations from its expected value beyond which a nuisance is a doubt: 5 % by chance.
FAR = 2.0
#: A p-value above this says that the stated noise and model error are too large: one test in a
#: thousand fits as well by chance.
_TOO_GOOD = 0.999
#: Share of right intervals of 90 % below which there is a doubt: of ten, seven hold with 99 %.
_COVERAGE = 0.7
#: Share of the error beyond noise that a whole cause should remove at least: more than it leaves.
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
                "On held-out data the placebo does nearly as well: the reduction of the error is "
                "no evidence for the cause."
            )
        if s.after < s.before and s.shrink < _HALF:
            yield (
                f"On held-out data, {100 * (1 - s.shrink):.0f} % of the frequency error beyond "
                "noise remains: something else may be missing."
            )
        if s.coverage < _COVERAGE:
            yield (
                f"Only {percent(s.coverage, 0)} of the held-out parts ended in the 90 % interval "
                "predicted for them, or better."
            )
    if d.model.get("order"):
        yield d.model["order"]
    for c in sure_causes(d):
        if len(c.effects) >= _BROAD:
            yield (
                f"This test cannot distinguish the {len(c.effects)} effects of class {c.letter} "
                f"({with_place(c.effects[0].key)} and others): it hardly shows what to change in "
                "the model."
            )
    if (d.of_functions or 1.0) > 1.0:
        yield (
            f"The errors of the measured FRFs are taken to be {d.of_functions:.2g} times the "
            "stated ones (noise aside): check calibration, places and directions of the sensors."
        )
    yield from _drifts(d)
    off = mesh_error(d)
    if off and UNSURE * off >= SHARE * d.before.rms:
        left = percent(UNSURE * off / d.before.rms, 0)
        yield (
            f"The discretisation error is {percent(off)} (RMS over the modes). It is subtracted, "
            f"but its uncertainty is {left} of the error of the model: use a finer mesh."
        )
    if np.isfinite(d.model_error) and d.model_error > 0.5 * d.noise:
        yield (
            f"The error of the reduced model, up to {percent(d.model_error, 3)}, is not small "
            f"compared with the noise, {percent(d.noise, 3)}."
        )


def _of_leader(d: Diagnosis, lead: HypothesisResult) -> Iterator[str]:
    """Doubts of the fit of the leading hypothesis."""
    if lead.p_value < LEVEL:
        p = p_value_words(lead.p_value)
        yield f"The best fit leaves more than noise and model error explain: {p}."
    elif lead.p_value > _TOO_GOOD:
        kinds = zip(("frequencies", "shapes"), d.of_stated or (), strict=False)
        less = [f"{x:.2g} of it for {kind}" for kind, x in kinds if x < 1.0]
        counted = f", although only {joined(less)} was used" if less else ""
        yield f"The fit is too good: noise or discrepancy is stated too large{counted}."
    if lead.at_bound:
        yield f"Parameters at a limit of their range: {joined(lead.at_bound)}."
    far = [p for p in lead.parameters if p["nuisance"] and abs(p["prior_sigmas"]) > FAR]
    if far:
        items = [f"{with_place(p['effect'])} ({p['prior_sigmas']:+.1f} s.d.)" for p in far]
        yield f"The fit moves known quantities far from their expected values: {joined(items)}."


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
        perhaps = perhaps and f". The cause may be {perhaps}, which these few levels do not confirm"
        yield (
            f"Beyond the explanation, {joined(much)} change from level to level, which is much for "
            f"a drift{perhaps}."
        )
