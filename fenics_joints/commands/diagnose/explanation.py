"""A diagnosis in words: three sentences, what stands behind them, and what to doubt.

Every number is one of the `Diagnosis`; nothing is computed here but ratios of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from textwrap import shorten

import numpy as np

from fenics_joints.commands.diagnose.doubts import doubts
from fenics_joints.commands.diagnose.questions import questions
from fenics_joints.commands.diagnose.reading import (
    EffectClass,
    best_without,
    by_effect,
    causes,
    effect_classes,
    in_test,
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
    sentence,
    share_words,
    shortened,
    span,
    times_words,
    zone_words,
)
from fenics_joints.diagnosis.location import Location
from fenics_joints.diagnosis.result import Diagnosis
from fenics_joints.diagnosis.shrinkage import Shrinkage
from fenics_joints.diagnosis.verdict import CAUSE, LIKELY, MISFIT, NO_GAP, UNKNOWN, doubtful
from fenics_joints.formatting import error_percent, percent, probability

__all__ = ["Explanation", "explain"]

#: Difference of log odds up to which another region may be the one as well.
_AS_PROBABLE = 3.0
#: Probability of a look-alike that is not worth a word; error of the mesh that is.
_REMOTE, _SEEN = 0.01, 5e-4
_COUNT = {2: "two", 3: "three"}
#: Words of the diagnosis with what they mean, where they first stand.
_HELD = "On data held out while the cause was chosen and fitted,"
_WRONG = "the best wrong effect, one that is not the cause but had the same chance"
_MISFIT = "misfit (the gap weighed by noise)"


@dataclass(frozen=True)
class Explanation:
    """A diagnosis in words.

    Attributes:
        start: What is compared with the test.
        where: Where the model is wrong, one sentence.
        which: Which effect causes it, and what rivals it.
        how_far: How far the gap shrinks on data that were held out.
        points: The same in more words: questions, and their answers.
        doubts: What speaks against taking the answer at its word.
    """

    start: str
    where: str
    which: str
    how_far: str
    points: dict[str, str]
    doubts: tuple[str, ...]

    def __repr__(self) -> str:
        more = f"{len(self.points)} points, {len(self.doubts)} doubts"
        return f"Explanation({shorten(self.where, 60)!r}, {more})"

    @property
    def sentences(self) -> tuple[tuple[str, str], ...]:
        """What is compared, and the three sentences, with their headings."""
        return (
            ("Start", self.start), ("Where", self.where), ("Which", self.which),
            ("How far", self.how_far),
        )  # fmt: skip

    def to_json(self) -> dict:
        """Texts only."""
        return {
            "start": self.start,
            "where": self.where,
            "which": self.which,
            "how_far": self.how_far,
            "points": self.points,
            "doubts": list(self.doubts),
        }


def explain(d: Diagnosis) -> Explanation:
    """Put a diagnosis into words."""
    return Explanation(
        _start(d), _where(d), _which(d), _how_far(d), questions(d), tuple(doubts(d))
    )  # fmt: skip


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
    found = d.location
    if d.verdict == NO_GAP:
        if found is None:
            return "Nowhere: there is no gap beyond noise and tolerances."
        return (
            "Nowhere beyond chance: noise, tolerances and the error of any model would make a "
            f"misfit of {found.n_data}, and there is one of {found.misfit:.0f}."
        )
    inside = in_test(d)
    if inside and not inside.startswith("in part"):
        return sentence(inside)
    words = _most_probable(found)
    return sentence(f"{inside}; {words}" if inside else words)


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


def _look_alike(d: Diagnosis) -> str:
    """What is left for causes outside the library, where that is not the answer itself."""
    p = probability_of(d, UNKNOWN)
    if p < _REMOTE:
        return ""
    return f"; {probability(p)} is left for a cause that was not considered"


def _no_cause(d: Diagnosis) -> str:
    p = probability_of(d, NO_GAP)
    words = f"none is needed: the nominal model within its tolerances has {probability(p)}"
    found = causes(d)
    if not found:
        return words + _look_alike(d)
    most = (
        f"the most probable cause, {members_in_words(found[0])}, "
        f"{probability(found[0].probability)}"
    )
    return f"{words}, {most}{_look_alike(d)}"


def _unknown(d: Diagnosis) -> str:
    lead, n = leading(d), sum(len(c.effects) for c in causes(d))
    fits = lead is not None and lead.p_value >= MISFIT
    words = "is as probable as one that was not" if fits else "explains all of the test"
    words = f"none of the {n} effects that were considered {words}"
    if lead is not None:
        words += f": the best, {named(lead)}, leaves a gap of {error_percent(lead.gap)}"
        p = p_value_words(lead.p_value)
        words += f", as noise and model error may ({p})" if fits else (
            f" and would give such a misfit with {p}{_at_once(d)}"
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
    words = "; and ".join(f"{members_in_words(c)}, {probability(c.probability)}" for c in sure)
    several = f"{_COUNT.get(len(sure), len(sure))} causes: " if len(sure) > 1 else ""
    weak = doubtful(d.effects, d.shrinkage)
    perhaps = "".join(
        f"; perhaps also {members_in_words(c)}, {probability(c.probability)}, which held-out data "
        "do not bear out" for c in causes(d) if c.name in weak and d.verdict == CAUSE
    )
    rival, lead = _rival(d, sure), leading(d)
    found = [] if lead is None else [attached_words(rows) for _, rows in by_effect(lead.parameters)]
    words += "".join(f", {where}" for where in found if where)
    return several + words + perhaps + _look_alike(d) + (f"; {rival}" if rival else "")


def _rival(d: Diagnosis, sure: Sequence[EffectClass]) -> str:
    """The best hypothesis that lacks one of the causes."""
    lead, other = leading(d), best_without(d, sure)
    if lead is None or other is None:
        return ""
    ratio = lead.probability / max(other.probability, 1e-300)
    return f"the closest rival, {named(other)}, is {times_words(ratio)} less probable"


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
    words = f"{_HELD} the gap goes {from_to(s.before, s.after)}"
    if s.after >= s.before:
        best = f" (to {error_percent(s.placebo)} with {_WRONG})" if np.isfinite(s.placebo) else ""
        words = f"{_HELD} the gap grows {from_to(s.before, s.after)}{best}"
        return f"{words}: what is chosen without them does not predict them{_folds(s)}."
    lead = leading(d)
    if np.isfinite(s.shrink) and lead is not None and lead.label == NO_GAP:
        return f"{words}: {_shrunk(s)}, by what is within tolerance alone{_folds(s)}."
    if not np.isfinite(s.before):
        return f"{words}; the nominal model has none of these modes{_folds(s)}."
    if not np.isfinite(s.shrink):
        return f"{words}; the nominal model is already as good as noise allows."
    words += f": {_shrunk(s)}"
    gain = 100 * s.excess
    if s.claimed:
        points = "point" if f"{gain:.0f}" == "1" else "points"
        words += f", {gain:.0f} {points} more than with {_WRONG} ({_points(s)})"
    elif np.isfinite(gain):
        words += f", which is not surely more than with {_WRONG} ({_points(s)} points)"
    return f"{words}{_folds(s)}."


def _folds(s: Shrinkage) -> str:
    held, better = sum(f.held for f in s.folds), sum(f.better for f in s.folds)
    words = f"; {held} of {len(s.folds)} parts held out ended in the interval stated before"
    return f"{words}{f' or better ({better} better)' if better else ''}"


def _shrunk(s: Shrinkage) -> str:
    share = f"{100 * s.shrink:.0f} %"
    return f"{share} of the gap beyond noise is gone (90 % interval: {span(s.shrink_interval)})"


def _points(s: Shrinkage) -> str:
    low, high = s.excess_interval
    return f"90 %: {100 * low:.0f} to {100 * high:.0f}"
