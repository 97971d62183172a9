"""Eight questions on a diagnosis, and their answers with the numbers behind them."""

from __future__ import annotations

import numpy as np

from fenics_joints.commands.diagnose.reading import (
    SHARE,
    EffectClass,
    along,
    best_without,
    by_effect,
    causes,
    in_test,
    in_words,
    is_loud,
    leading,
    named,
    priors_in_words,
    probability_of,
    sure_causes,
)
from fenics_joints.commands.diagnose.words import (
    NAMED,
    from_to,
    group_words,
    joined,
    p_value_words,
    place_words,
    point_mass_words,
    sentence,
    share_words,
    shortened,
    value_words,
)
from fenics_joints.diagnosis.evidence.classes import APART
from fenics_joints.diagnosis.evidence.misattribution import SAID
from fenics_joints.diagnosis.result import Diagnosis
from fenics_joints.diagnosis.verdict import NO_GAP, UNKNOWN
from fenics_joints.formatting import condition_value, error_percent, percent, probability, spaced

#: Differences of ln evidence beyond this say no more: models of this kind are not that exact.
_FAR_LOWER = 10.0


def questions(d: Diagnosis) -> dict[str, str]:
    """Those of the questions that a diagnosis has an answer to, with the answers."""
    answers = (
        ("Is there more than chance?", _beyond_chance(d)),
        ("In which data?", _in_which_data(d)),
        ("In which part?", _in_which_part(d)),
        ("What was fitted?", _fitted(d)),
        ("Why this and not another?", _why(d)),
        ("What if it is something else?", _something_else(d)),
        ("What can these data not tell?", _not_told(d)),
        ("Does it predict?", _predicts(d)),
    )
    return {question: answer for question, answer in answers if answer}


def _beyond_chance(d: Diagnosis) -> str:
    found = d.location
    if found is None:
        return ""
    words = (
        f"The nominal model misses the {found.n_data} data by a squared misfit of "
        f"{found.misfit:.0f}, in standard deviations of noise, tolerances and model error; "
        f"chance alone makes about {found.n_data}."
    )
    kinds = [f"{a.label} {a.chi2:.0f} for {a.expected}" for a in along(found, "kind")]
    return f"{words} By kind: {', '.join(kinds)}." if len(kinds) > 1 else words


def _in_which_data(d: Diagnosis) -> str:
    if d.location is None:
        return ""
    words = []
    for by, many in (("mode", "modes"), ("condition", f"values of the {d.condition[0]}")):
        parts = along(d.location, by)
        loud = sorted((a for a in parts if is_loud(a, parts)), key=lambda a: -a.chi2)
        if not parts:
            continue
        labels = joined([group_words(a, d.condition[1]) for a in loud])
        if not loud:
            none = f"None of {len(parts)} {many}" if len(parts) > 1 else f"The only {by} does not"
            verb = "misfits" if len(parts) > 1 else "misfit"
            words.append(f"{none} {verb} by more than chance.")
        elif len(loud) == len(parts) == 1:
            words.append(f"The only {by} misfits by more than chance.")
        elif len(loud) == len(parts):
            words.append(
                f"All {len(parts)} {many} misfit by more than chance, most of them "
                f"{group_words(loud[0], d.condition[1])}."
            )
        else:
            words.append(f"Of {len(parts)} {many} these misfit by more than chance: {labels}.")
    return " ".join(words)


def _in_which_part(d: Diagnosis) -> str:
    found = d.location
    if found is None or d.verdict == NO_GAP:
        return ""
    if in_test(d):
        return "What a region seems to ask for may be the echo of what is wrong in the test."
    if not found.ranked:
        return ""
    first, words = found.ranked[0], []
    inside = [t for t in found.ranked if t.region == first.region and t is not first]
    if inside:
        others = shortened([place_words(found, t) for t in inside])
        words.append(f"Within {spaced(first.region)} also more than chance: {others}.")
    if not first.sufficient:
        words.append(
            "It is not all, or it is large: the tests are of the first order and say where, not "
            "how much."
        )
    if found.patches is not None:
        n, several = int(found.patches.significant.sum()), int(found.patches.sufficient.sum())
        words.append(
            f"Of {len(found.patches.tests)} patches of the map {n} explain more than chance, and "
            f"{several} could each be the only one."
        )
    return " ".join(words)


def _fitted(d: Diagnosis) -> str:
    lead = leading(d)
    if lead is None or not by_effect(lead.parameters):
        return ""
    items = [
        f"{p['name']} = {value} ({span})" if span else f"{p['name']}: {value}"
        for _, rows in by_effect(lead.parameters)
        for p in rows
        for value, span in [value_words(p)]
    ]
    more = f" and {len(items) - 2 * NAMED} more" if len(items) > 2 * NAMED else ""
    return (
        f"{sentence(named(lead))[:-1]}: {', '.join(items[: 2 * NAMED])}{more}, with 68 % "
        f"intervals. The gap goes {from_to(d.before.rms, d.after.rms)}, noise is "
        f"{percent(d.noise)}, and a misfit as large as what is left would come about with "
        f"{p_value_words(lead.p_value)}."
    )


def _why(d: Diagnosis) -> str:
    lead = leading(d)
    if lead is None:
        return ""
    words, sure = [], sure_causes(d)
    for group in sure:
        other = best_without(d, [group])
        if other is None:
            continue
        like = " or its like" if len(group.effects) > 1 else ""
        without = f" without {in_words(group.effects[0])}{like}"
        words.append(
            f"The best explanation{without}, {named(other)}, leaves {percent(other.gap)} "
            f"({p_value_words(other.p_value)}), and its ln evidence is "
            f"{_beside(lead.log_evidence - other.log_evidence)}."
        )
    return " ".join(words)


def _beside(lower: float) -> str:
    """How a rival's ln evidence stands to the leader's, which may lead by its odds alone."""
    if lower > _FAR_LOWER:
        return f"more than {_FAR_LOWER:.0f} lower"
    if lower >= 0.05:
        return f"{lower:.1f} lower"
    words = f"{-lower:.1f} higher" if lower <= -0.05 else "the same"
    return f"{words}, but it was less likely before the test"


def _not_told(d: Diagnosis) -> str:
    words = []
    for group in causes(d):
        if len(group.effects) > 1 and group.probability >= SHARE:
            names = shortened([in_words(e) for e in group.effects], "or")
            words.append(f"Which it is of {names}. {priors_in_words(group)}{_split(d, group)}")
    unseen = [e for c in causes(d) for e in c.effects if not e.detectable]
    if unseen:
        names = shortened([in_words(e) for e in unseen])
        words.append(f"Too small to be seen at their expected size: {names}.")
    if d.between is not None:
        kinds = zip(("frequencies", "damping ratios"), (2, 0), d.between, strict=False)
        items = joined([f"{kind} by {percent(x, n)}" for kind, n, x in kinds])
        words.append(
            f"Why, beside what is explained and noise, {items} (one s.d.) are off from level to "
            "level: that is taken for drift."
        )
    if d.silent:
        names = shortened([spaced(s.effect) for s in d.silent])
        words.append(f"Nothing at all is said of {names}.")
    return " ".join(words)


def _something_else(d: Diagnosis) -> str:
    p, simulated = probability_of(d, UNKNOWN), d.misattribution
    words = [f"A cause outside the library has {probability(p)}."]
    if simulated is not None:
        words.append(
            f"Before the test it had {share_words(simulated.prior)}. In {simulated.tests} "
            "simulated tests of this structure with these sensors the cause was taken out of the "
            f"library: {share_words(simulated.rate)} of them were taken for other effects of it."
        )
        if simulated.answers:
            low, high = (round(100 * x) for x in SAID)
            words.append(
                f"With the cause in it, {simulated.right} of {simulated.answers} answers given as "
                f"{low} to {high} % were right."
            )
    if p >= SHARE and d.somewhere is not None:
        point = point_mass_words(d.somewhere)
        words.append(
            "If there is one, it is a change of stiffness or mass in one place with "
            f"{probability(d.somewhere.probability)}{f': {point}' if point else ''}."
        )
    return " ".join(words)


def _split(d: Diagnosis, group: EffectClass) -> str:
    """What measurement would tell the members of a class apart, and whether it is enough."""
    found = next((s for s in d.separations if s.class_name == group.name), None)
    if found is None:
        return ""
    enough = "" if found.distance >= APART else ", which is not enough alone"
    return (
        f" Of further measurements this would split them best: {found.measurement} "
        f"(up to {found.distance:.1f} standard deviations{enough})."
    )


def _predicts(d: Diagnosis) -> str:
    s, words = d.shrinkage, []
    if s is not None and s.folds:
        worst = min(s.folds, key=lambda f: f.shrink if np.isfinite(f.shrink) else np.inf)
        words.append(
            f"Chosen and fitted anew without them, {len(s.folds)} parts of the data were predicted "
            f"to {error_percent(s.after)} (the best wrong effect {error_percent(s.placebo)}, noise "
            f"{percent(s.noise)})."
        )
        if np.isfinite(worst.shrink):
            goes = from_to(worst.before, worst.after)
            words.append(f"Least well predicted: {worst.name}, {goes}.")
        if np.isfinite(s.entries_coverage):
            words.append(
                f"Of the held-out frequencies {share_words(s.entries_coverage)} lay in their own "
                "90 % intervals, stated before they were looked at."
            )
    if d.validation is not None:
        old, new = d.validation
        at = ", ".join(condition_value(x, d.condition[1]) for x in new.conditions)
        words.append(f"At {at}, never fitted, the gap goes {from_to(old.rms, new.rms)}.")
    return " ".join(words)
