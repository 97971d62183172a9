"""What speaks against taking a diagnosis at its word."""

from __future__ import annotations

import numpy as np

from fenics_joints.commands.diagnose.reading import (
    LEVEL,
    SHARE,
    in_words,
    leading,
    mesh_error,
    sure_causes,
)
from fenics_joints.commands.diagnose.words import joined, p_value_words, share_words
from fenics_joints.diagnosis.effects.damping import NAMES
from fenics_joints.diagnosis.evidence.evidence import UNSURE
from fenics_joints.diagnosis.evidence.scales import BETWEEN
from fenics_joints.diagnosis.result import Diagnosis
from fenics_joints.diagnosis.verdict import LIKELY, NAMED, unconfirmed
from fenics_joints.formatting import percent, probability, spaced

#: A nuisance further from its expected value, in standard deviations, is a doubt.
_FAR = 2.0
#: A p-value above this says that the stated noise and model error are too large.
_TOO_GOOD = 0.999
#: Of ten intervals of 90 %, seven hold with 99 % if they are right.
_COVERAGE = 0.7
#: Of the gap beyond noise, so much should be gone for a cause to be the whole of it.
_HALF = 0.5
#: So many effects in a class are hardly an answer.
_BROAD = 10
#: What changes between levels and is not explained is much at so many times what is expected.
_DRIFTS = 5.0


def doubts(d: Diagnosis) -> list[str]:
    """A sentence for each doubt."""
    lead, s, words = leading(d), d.shrinkage, []
    if d.verdict == LIKELY:
        words.append(f"Held-out data do not confirm the cause: {unconfirmed(s)}.")
    if lead is not None:
        if lead.p_value < LEVEL:
            words.append(
                "The leading explanation leaves more than noise and model error would: "
                f"{p_value_words(lead.p_value)}."
            )
        elif lead.p_value > _TOO_GOOD:
            words.append(
                "It fits better than it should: noise or discrepancy is stated too large"
                f"{_counted(d)}."
            )
        if lead.at_bound:
            words.append(f"At a limit of their range: {joined(lead.at_bound)}.")
        far = [p for p in lead.parameters if p["nuisance"] and abs(p["prior_sigmas"]) > _FAR]
        items = [f"{spaced(p['effect'])} ({p['prior_sigmas']:+.1f} s.d.)" for p in far]
        if items:
            words.append(f"Far from what was expected in any case: {joined(items)}.")
    if s is not None and s.folds and d.verdict in NAMED:
        if d.verdict != LIKELY and np.isfinite(s.excess) and not s.claimed:
            words.append(
                "On held-out data the best wrong effect does nearly as well: how far the gap "
                "shrinks is no evidence for the cause."
            )
        if s.after < s.before and s.shrink < _HALF:
            words.append(
                f"Of the gap in frequency beyond noise, {100 * (1 - s.shrink):.0f} % "
                "remains on held-out data: something else may be missing."
            )
        if s.coverage < _COVERAGE:
            words.append(
                f"Only {share_words(s.coverage)} of the parts held out ended as well as the 90 % "
                "interval that was stated before."
            )
    if d.model.get("order"):
        words.append(d.model["order"])
    words += [*_broad(d), *_of_functions(d), *_drifts(d), *_of_mesh(d)]
    if np.isfinite(d.model_error) and d.model_error > 0.5 * d.noise:
        words.append(
            f"The reduced model's error, up to {percent(d.model_error, 3)}, is not small against "
            f"the noise, {percent(d.noise, 3)}."
        )
    return words


def _broad(d: Diagnosis) -> list[str]:
    """That a class holds so much that it is hardly an answer."""
    return [
        f"Of {in_words(c.effects[0])} and its like there are {len(c.effects)} that this test "
        "cannot tell apart: it says little of what is to be changed in the model."
        for c in sure_causes(d)
        if len(c.effects) >= _BROAD
    ]


def _of_mesh(d: Diagnosis) -> list[str]:
    """That the mesh is too coarse for more to be told, where what is left of its error is much."""
    off = mesh_error(d)
    if UNSURE * off < SHARE * d.before.rms:
        return []
    return [
        f"The mesh alone makes an error of {percent(off)} (root mean square over the modes). It is "
        f"taken off, but what stays uncertain of it is "
        f"{share_words(UNSURE * off / d.before.rms)} of the gap: a finer one would tell more."
    ]


def _counted(d: Diagnosis) -> str:
    """How much of the discrepancies that the case states was counted, where it is not all."""
    kinds = zip(("frequencies", "shapes"), d.of_stated or (), strict=False)
    less = [f"{x:.2g} of it for {kind}" for kind, x in kinds if x < 1.0]
    return f", though no more than {joined(less)} was counted" if less else ""


def _of_functions(d: Diagnosis) -> list[str]:
    """That measured functions are off by more than is stated of them."""
    if (d.of_functions or 1.0) <= 1.0:
        return []
    return [
        f"The measured functions are taken to be {d.of_functions:.2g} times as much off as is "
        "stated of them (noise aside): calibration, places and directions of their sensors?"
    ]


def _drifts(d: Diagnosis) -> list[str]:
    """What changes from level to level by more than a structure's drift does, and is put there."""
    between = d.between or ()
    kinds = zip(("frequencies", "damping ratios"), between, BETWEEN.medians, strict=False)
    much = [
        f"{kind} by {percent(x, 0 if x > 0.1 else 2)}"
        for kind, x, median in kinds
        if x > _DRIFTS * median
    ]
    if not much:
        return []
    words = f"From level to level {joined(much)} are off beside what is explained, much for a drift"
    named = [
        f"{in_words(e)} ({probability(e.probability)})"
        for e in d.effects
        if e.name in NAMES and e.probability >= SHARE
    ]
    if not named:
        return [f"{words}."]
    return [f"{words}: {joined(named, 'or')} may be what these few levels cannot bear out."]
