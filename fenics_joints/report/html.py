"""Reports as HTML: one page each that holds its own style and pictures and needs nothing else."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import jinja2
import numpy as np
from markupsafe import Markup

import fenics_joints
from fenics_joints import formatting
from fenics_joints.diagnosis.evidence.classes import confusion
from fenics_joints.formatting import spaced
from fenics_joints.measurements.gap import Gap
from fenics_joints.report import beam_pictures, diagnosis_pictures, mesh_pictures
from fenics_joints.report import style as pictures
from fenics_joints.report.explanation import explain, group_words, zone_words
from fenics_joints.report.reading import (
    EffectClass,
    by_effect,
    by_reason,
    effect_classes,
    leading,
    named,
    sampled,
    with_place,
)

if TYPE_CHECKING:
    from fenics_joints.diagnosis.location import Location
    from fenics_joints.diagnosis.result import Diagnosis
    from fenics_joints.diagnosis.where.localise import CellMap
    from fenics_joints.diagnosis.where.patches import PatchMap
    from fenics_joints.diagnosis.where.zone_tests import ZoneTest

__all__ = ["HeatCell", "diagnosis_html", "facts", "heat_map", "render", "svg"]

#: Verdicts as headings.
VERDICTS = {
    "cause": "Cause found",
    "no gap": "No gap",
    "unknown": "Cause unknown",
    "ambiguous": "Ambiguous",
}
#: Hypotheses that get a row of their own.
_MOST_HYPOTHESES = 8
#: Classes of effects below this are folded away, but for so many.
_PROBABLE, _FEWEST_CLASSES = 1e-3, 5
#: A nuisance further from its expected value than this, in its standard deviations, is marked.
_FAR = 2.0


def _environment() -> jinja2.Environment:
    env = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent / "templates"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    env.globals["version"] = fenics_joints.__version__
    env.filters.update(
        percent=formatting.percent,
        probability=formatting.probability,
        hertz=formatting.hertz,
        number=formatting.number,
        quantity=formatting.quantity,
        interval=formatting.interval,
        spaced=spaced,
        named=named,
        with_place=with_place,
        zone_words=zone_words,
        p_value=formatting.p_value,
        spread=formatting.spread,
        by_effect=by_effect,
        by_reason=by_reason,
        at=formatting.condition_value,
    )
    return env


def render(template: str, **values) -> str:
    """A page from one of the templates."""
    return _environment().get_template(template).render(**values)


# -- shared parts ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class HeatCell:
    """A cell of a heat map: its text, and its colours as CSS."""

    text: str
    style: str


def heat_map(gap: Gap, largest: float | None = None) -> list[list[HeatCell]]:
    """Relative errors as coloured cells, shape (n, m).

    Args:
        gap: The gap.
        largest: Relative error that gets the full colour; by default its own largest.
    """
    largest = _largest(gap) if largest is None else largest
    return [[_heat_cell(e, largest) for e in row] for row in np.atleast_2d(gap.relative)]


def _heat_cell(error: float, largest: float) -> HeatCell:
    if not np.isfinite(error):
        return HeatCell(formatting.MISSING, "")
    # A square root, so that errors of a tenth of the largest still show.
    strength = math.copysign(math.sqrt(min(abs(error) / largest, 1.0)), error) if largest else 0.0
    colour = mesh_pictures.diverging(0.5 + 0.5 * 0.9 * strength)[:3]
    background = "#" + "".join(f"{round(255 * c):02x}" for c in colour)
    # White on dark, at the luminance where both inks have the same contrast (WCAG 2.1).
    ink = "#ffffff" if _luminance(colour) < 0.18 else "#14181d"
    style = f"background:{background};color:{ink}"
    return HeatCell(formatting.percent(error, 1, sign=True), style)


def _luminance(colour: Sequence[float]) -> float:
    """Relative luminance of an sRGB colour (WCAG 2.1)."""
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in colour]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def _largest(*gaps: Gap) -> float:
    """Largest error of several gaps: the common scale of their heat maps."""
    return max(float(np.nanmax(np.abs(g.relative), initial=0.0)) for g in gaps)


def _heat_pair(before: Gap, after: Gap, names: tuple[str, str]) -> list[dict]:
    largest = _largest(before, after)
    return [
        {"name": name, "gap": gap, "cells": heat_map(gap, largest)}
        for name, gap in zip(names, (before, after), strict=True)
    ]


def svg(text: str) -> Markup:
    """A picture that `pictures` made, which escapes what it is given."""
    return Markup(text)


# -- diagnosis -------------------------------------------------------------------------------------


def diagnosis_html(
    d: Diagnosis,
    *,
    log_sd: np.ndarray | None = None,
    assumed: Sequence[tuple[str, str]] = (),
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
    shrunk = d.shrinkage if d.shrinkage is not None and d.shrinkage.folds else None
    return render(
        "diagnosis.html",
        d=d,
        heading=VERDICTS.get(d.verdict, d.verdict),
        words=explain(d),
        lead=leading(d),
        bars=svg(_gap_picture(d)),
        patches=svg(_patch_picture(found.patches)) if _has_map(found) else None,
        map=None if d.cells is None else svg(_cell_picture(d.cells)),
        zones=[] if found is None else _zones(found),
        axes=[] if found is None else _axes(found, d.condition),
        heat=_heat_pair(d.before, d.after, ("Nominal model", "Leading hypothesis")),
        classes=classes,
        shown=_worth_showing(classes),
        letters={c.name: c.letter for c in classes},
        hypotheses=d.hypotheses[:_MOST_HYPOTHESES],
        rest=d.hypotheses[_MOST_HYPOTHESES:],
        best=max((h.log_evidence for h in d.hypotheses), default=0.0),
        sampled=[(h, sampled(d, h)) for h in d.hypotheses if sampled(d, h) is not None],
        separations=[(s, confusion(s.distance)) for s in d.separations],
        shrunk=shrunk,
        forecasts=None if shrunk is None else svg(diagnosis_pictures.forecasts(shrunk)),
        curves=svg(
            pictures.frequency_panels(
                d.before, d.after, d.condition,
                labels=("nominal model", "leading hypothesis"), log_sd=log_sd,
                validation=d.validation,
            )
        ),
        far=_FAR,
        assumed=assumed,
        facts=facts(_with_error(d)),
    )  # fmt: skip


def _patch_picture(cells: PatchMap) -> str:
    draw = beam_pictures.beam_patches if cells.side_view else mesh_pictures.patch_map
    return draw(cells)


def _cell_picture(cells: CellMap) -> str:
    draw = beam_pictures.beam_cells if cells.side_view else mesh_pictures.cell_map
    return draw(cells)


def _has_map(found: Location | None) -> bool:
    patches = None if found is None else found.patches
    return patches is not None and patches.vertices is not None


def _zones(found: Location) -> list[tuple[str, list[tuple[str, ZoneTest]]]]:
    """Tables of zone tests, the most telling first: their captions and rows."""
    tables = [("Regions of the model", found.regions), ("Joints zone by zone", found.zones)]
    return [
        (caption, [(zone_words(t.zone), t) for t in sorted(tests, key=lambda t: -t.share)])
        for caption, tests in tables if tests
    ]  # fmt: skip


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
        at = ", ".join(formatting.condition_value(x, d.condition[1]) for x in new.conditions)
        bars = [("nominal model", old.rms, "nominal"), ("chosen effect", new.rms, "chosen")]
        groups.append((f"Validation at {at}, never fitted", bars))
    return pictures.gap_bars(groups, d.noise)


#: Facts on the model, in words.
_FACTS = {
    "dofs": "degrees of freedom of the finite-element model",
    "basis": "vectors of the reduced model's basis",
    "samples": "parameter sets the basis was made from",
    "frequency_error": "largest frequency error of the reduced model against the full one",
    "solutions": "eigenproblems solved",
    "seconds": "seconds that the diagnosis took",
    "reduced_solutions": "eigenproblems of the reduced model solved",
    "not_converged": "conditions at which the identification did not converge, left out",
    "crossing_modes": "modes of the test that change places in the model (followed by MAC)",
}


def _with_error(d: Diagnosis) -> dict[str, object]:
    """A model that is its own reduced model has no error to speak of."""
    return {**d.model, "frequency_error": d.model_error} if "basis" in d.model else d.model


def facts(model: Mapping[str, object]) -> list[tuple[str, str]]:
    """Facts on a model for the page: names in words, and values."""
    return [(_FACTS.get(key, spaced(key)), _fact(key, value)) for key, value in model.items()]


def _fact(key: str, value) -> str:
    if key == "frequency_error":
        return formatting.percent(float(value), 4)
    if isinstance(value, list):
        return ", ".join(value) or "none"
    if isinstance(value, bool) or not isinstance(value, int | float | np.number):
        return str(value)
    if key == "seconds":
        return f"{value:.1f}"
    whole = float(value).is_integer()
    return f"{int(value):,}".replace(",", "\N{NO-BREAK SPACE}") if whole else f"{value:.4g}"


