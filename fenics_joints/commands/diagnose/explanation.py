"""A diagnosis in words: the answer, what stands behind them, and what to doubt.

Every number is one of the `Diagnosis`; nothing is computed here but ratios of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from textwrap import shorten

import numpy as np

from fenics_joints.commands.diagnose.doubts import doubts
from fenics_joints.commands.diagnose.questions import questions
from fenics_joints.commands.diagnose.reading import (
    SHARE,
    EffectClass,
    best_without,
    by_effect,
    causes,
    effect_classes,
    in_test,
    in_words,
    leading,
    members_in_words,
    mesh_error,
    named,
    probability_of,
    sure_causes,
)
from fenics_joints.commands.diagnose.words import (
    NAMED,
    attached_words,
    chance_words,
    from_to,
    is_part,
    joined,
    p_value_words,
    place_words,
    point_mass_words,
    sentence,
    share_words,
    shortened,
    times_words,
    value_words,
    zone_words,
)
from fenics_joints.diagnosis.evidence.classes import APART
from fenics_joints.diagnosis.location import Location
from fenics_joints.diagnosis.result import Diagnosis
from fenics_joints.diagnosis.thresholds import MISFIT
from fenics_joints.diagnosis.verdict import CAUSE, LIKELY, NO_GAP, UNKNOWN, doubtful
from fenics_joints.formatting import error_percent, percent, probability

#: Difference of log odds up to which another region may be the one as well.
_AS_PROBABLE = 3.0
#: Probability of a cause outside the library that is not worth a word; error of the mesh that is.
_REMOTE, _SEEN = 0.01, 5e-4
_COUNT = {2: "two", 3: "three"}
#: Parameters of a cause that stand in its sentence.
_SIZES = 2
_HELD = "On data held out while the cause was chosen and fitted,"
_MISFIT = "misfit (the gap weighed by noise)"


@dataclass(frozen=True)
class Explanation:
    """A diagnosis in words.

    Attributes:
        which: Which effect causes the gap, with its place and size.
        how_far: How far the gap shrinks on data that were held out.
        apart: What cannot be told apart, and the measurement that would; "" if that is nothing.
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
    """What the mesh adds to the gap no more."""
    off = mesh_error(d)
    return f", after the mesh's own {percent(off)} is taken off" if off > _SEEN else ""


_JOINTS = {
    "bonded": ", with its joints bonded, as one with the parts,",
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
        f"{share_words(first.share)} of the {_MISFIT}, by chance {chance_words(first.p_adjusted)}"
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
    own = [] if lead is None else [rows for key, rows in by_effect(lead.parameters) if key in keys]
    found = [attached_words(rows) or _sizes(rows) for rows in own]
    head = f"{members_in_words(group)}, {probability(group.probability)}"
    return ": ".join([head, *(words for words in found if words)])


def _sizes(rows: Sequence[dict]) -> str:
    """The first parameters of an effect."""
    known = [(p["name"], *value_words(p)) for p in rows if not p.get("at")][:_SIZES]
    return ", ".join(
        f"{name} {value} ({span})" if span else f"{name} {value}" for name, value, span in known
    )


def _apart(d: Diagnosis) -> str:
    """What else it can be, and the one measurement that would tell."""
    sure, words = sure_causes(d), ""
    lead, other = leading(d), best_without(d, sure)
    if sure and lead is not None and other is not None:
        ratio = lead.probability / max(other.probability, 1e-300)
        words = f"the closest rival, {named(other)}, is {times_words(ratio)} less probable"
    classes = {c.name: c for c in causes(d) if len(c.effects) > 1 and c.probability >= SHARE}
    split = next((s for s in d.separations if s.class_name in classes), None)
    if split is not None:
        names = shortened([in_words(e) for e in classes[split.class_name].effects], "and")
        enough = "" if split.distance >= APART else ", which is not enough alone"
        tell = (
            f"{names} would be told apart best by {split.measurement} (up to "
            f"{split.distance:.1f} standard deviations{enough})"
        )
        words = f"{tell}; {words}" if words else tell
    return sentence(words) if words else ""


def _undecided(d: Diagnosis) -> str:
    rows = [c for c in effect_classes(d) if c.probability >= 0.02][: NAMED + 1]
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
