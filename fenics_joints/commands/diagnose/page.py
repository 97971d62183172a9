"""The page of the ``diagnose`` command."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fenics_joints.commands.diagnose.explanation import explain
from fenics_joints.commands.diagnose.pictures import forecasts, gap_bars, level_panels
from fenics_joints.commands.diagnose.reading import (
    EffectClass,
    by_effect,
    by_reason,
    effect_classes,
    heading_of,
    leading,
    named,
    with_place,
)
from fenics_joints.commands.diagnose.view import diagnosis_view
from fenics_joints.commands.diagnose.words import (
    change_words,
    group_words,
    joined,
    value_words,
    zone_words,
)
from fenics_joints.diagnosis.evidence.classes import confusion
from fenics_joints.diagnosis.location import Location
from fenics_joints.diagnosis.result import Diagnosis
from fenics_joints.diagnosis.where.patches import PatchMap
from fenics_joints.diagnosis.where.score_tests import ScoreTest
from fenics_joints.formatting import LIMITS, condition_value
from fenics_joints.report import patch_map
from fenics_joints.report.beam_pictures import beam_patches
from fenics_joints.report.html import facts, heat_pair, render, svg
from fenics_joints.report.panels import frequency_panels

_FILTERS = {
    "named": named,
    "with_place": with_place,
    "zone_words": zone_words,
    "by_effect": by_effect,
    "by_reason": by_reason,
    "value_words": value_words,
}
#: What is known of the model and stands elsewhere in the page.
_SAID = ("notes", "order")
#: Hypotheses that get a row of their own.
_MOST_HYPOTHESES = 8
#: Classes of effects below this are folded away, but for so many.
_PROBABLE, _FEWEST_CLASSES = 1e-3, 5
#: A nuisance further from its expected value than this, in its standard deviations, is marked.
_FAR = 2.0


def diagnosis_html(
    d: Diagnosis, *, log_sd: np.ndarray | None = None, assumed: Sequence[tuple[str, str]] = ()
) -> str:
    """The diagnosis as a page.

    Args:
        d: The diagnosis; on rank 0, since the maps over the structure are there only.
        log_sd: Standard deviations of the measured ln f, shape (n, m), for error bars.
        assumed: Names and values of what it takes for granted, from `assumptions`.

    Returns:
        HTML without any reference to other files.
    """
    classes, found = effect_classes(d), d.location
    levels = level_panels(d, log_sd)
    shrunk = d.shrinkage if d.shrinkage is not None and d.shrinkage.folds else None
    return render(
        "diagnosis.html",
        _FILTERS,
        d=d,
        heading=heading_of(d),
        words=explain(d),
        lead=leading(d),
        bars=svg(_gap_picture(d)),
        patches=svg(_patch_picture(found.patches)) if _has_map(found) else None,
        view=diagnosis_view(found.patches if _has_map(found) else None),
        zones=[] if found is None else _zones(found),
        axes=[] if found is None else _axes(found, d.condition),
        heat=heat_pair(d.before, d.after, ("Nominal model", "Leading hypothesis")),
        classes=classes,
        shown=_worth_showing(classes),
        letters={c.name: c.letter for c in classes},
        hypotheses=d.hypotheses[:_MOST_HYPOTHESES],
        rest=d.hypotheses[_MOST_HYPOTHESES:],
        best=max((h.log_evidence for h in d.hypotheses), default=0.0),
        separations=[(s, confusion(s.distance)) for s in d.separations],
        shrunk=shrunk,
        forecasts=None if shrunk is None else svg(forecasts(shrunk)),
        curves=svg(
            frequency_panels(
                d.before,
                d.after,
                d.condition,
                labels=("nominal model", "leading hypothesis"),
                log_sd=log_sd,
                validation=d.validation,
                changed=np.array([bool(name) for name in d.row_names]) if d.row_names else None,
            )
        ),
        levels=None if levels is None else svg(levels),
        far=_FAR,
        limits=LIMITS,
        assumed=assumed,
        facts=facts(_with_error(d)),
    )


def _patch_picture(cells: PatchMap) -> str:
    draw = beam_patches if cells.side_view else patch_map
    return draw(cells)


def _has_map(found: Location | None) -> bool:
    patches = None if found is None else found.patches
    return patches is not None and patches.vertices is not None


def _zones(found: Location) -> list[tuple[str, list[tuple[str, str, ScoreTest]]]]:
    """Tables of score tests, the most probable first: their captions and rows."""
    tables = [("Regions of the model", found.regions), ("Joints zone by zone", found.zones)]
    return [
        (
            caption,
            [
                (zone_words(t.zone), joined(change_words(t)), t)
                for t in sorted(tests, key=lambda t: -t.log_evidence)
            ],
        )
        for caption, tests in tables
        if tests
    ]


def _axes(found: Location, condition: tuple[str, str]) -> list[tuple[str, list]]:
    """What each mode, band, condition and kind of data adds, axes of several groups only."""
    names = {"mode": "mode", "band": "band", "condition": condition[0], "kind": "kind of data"}
    tables = []
    for by, name in names.items():
        rows = [a for a in found.attribution if a.by == by]
        whole = sum(a.chi2 for a in rows)
        if len(rows) > 1:
            tables.append((name, [(group_words(a, condition[1]), a, a.chi2 / whole) for a in rows]))
    return tables


def _worth_showing(classes: Sequence[EffectClass]) -> int:
    """How many classes are shown at once: the probable ones, and a few at least."""
    probable = sum(c.probability >= _PROBABLE for c in classes)
    return min(max(probable, _FEWEST_CLASSES), len(classes))


def _gap_picture(d: Diagnosis) -> str:
    fitted = [("nominal model", d.before.rms, "nominal"), ("fitted", d.after.rms, "chosen")]
    held_out = [
        ("nominal model", d.heldout_before, "nominal"),
        ("best wrong effect", d.placebo_after, "placebo"),
        ("chosen effect", d.heldout_after, "chosen"),
    ]
    groups = [("All data, fitted", fitted), ("Held-out data, predicted", held_out)]
    if d.validation is not None:
        old, new = d.validation
        at = ", ".join(condition_value(x, d.condition[1]) for x in new.conditions)
        bars = [("nominal model", old.rms, "nominal"), ("chosen effect", new.rms, "chosen")]
        groups.append((f"Validation at {at}, never fitted", bars))
    return gap_bars(groups, d.noise)


def _with_error(d: Diagnosis) -> dict[str, object]:
    """A model that is its own reduced model has no error to speak of."""
    known = {key: value for key, value in d.model.items() if key not in _SAID}
    return {**known, "frequency_error": d.model_error} if "basis" in known else known
