"""What is said of a diagnosis: the answer, then the numbers behind it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fenics_joints.case import labelled
from fenics_joints.commands.diagnose.explanation import FAR, explain
from fenics_joints.commands.diagnose.pictures import forecasts, gap_bars, level_panels
from fenics_joints.commands.diagnose.view import diagnosis_view
from fenics_joints.commands.diagnose.words import (
    EffectClass,
    along,
    by_effect,
    change_words,
    deviation_words,
    effect_classes,
    effect_name,
    group_words,
    heading_of,
    joined,
    leading,
    named,
    parameter_name,
    parameter_words,
    silent_blocks,
    value_words,
    with_place,
    zone_words,
)
from fenics_joints.diagnosis.evidence.classes import confusion
from fenics_joints.diagnosis.location import Location
from fenics_joints.diagnosis.result import Diagnosis, HypothesisResult
from fenics_joints.diagnosis.shrinkage import Fold, Shrinkage
from fenics_joints.diagnosis.verdict import NAMED, NO_GAP, UNKNOWN
from fenics_joints.diagnosis.where.score_tests import ScoreTest
from fenics_joints.formatting import (
    LIMITS,
    MISSING,
    bounded,
    condition_value,
    error_percent,
    number,
    p_value,
    percent,
    probability,
)
from fenics_joints.report import document as doc
from fenics_joints.report import patch_map
from fenics_joints.report.beam_pictures import beam_patches
from fenics_joints.report.panels import frequency_panels
from fenics_joints.report.tables import facts_table, frequency_table, heat_table, largest_error

#: Facts of the model that are shown elsewhere.
_SHOWN = ("notes", "order")
#: Rows on the terminal of regions, of parameters, of effects with their classes, and of further
#: measurements.
_REGIONS, _PARAMETERS, _EFFECTS, _SPLITS = 3, 3, 8, 2
#: Hypotheses with a row: those behind have next to no probability.
_MOST_HYPOTHESES = 8
#: Probability of classes of effects below which they are folded away, and how many never are.
#: Chosen: only the page depends on them.
_PROBABLE, _FEWEST_CLASSES = 1e-3, 5
_STYLES = {
    "cause": "bold cyan",
    "likely": "bold yellow",
    "no gap": "bold green",
    "ambiguous": "bold yellow",
}
_TERMS = (
    ("Baseline model", "The model of the case, before any effect is added."),
    (
        "Error",
        "Root mean square (RMS) of (model frequency / measured frequency - 1) over all modes and "
        "conditions.",
    ),
    (
        "Chi-square",
        "Sum of the squared errors, each divided by the variance that noise, tolerances and model "
        "error give it.",
    ),
    (
        "Effect, cause",
        "Something real that the baseline model lacks, such as a compliant joint. An effect that "
        "is probable enough is called a cause.",
    ),
    (
        "Class",
        "Effects that this test cannot distinguish. Only the probability of the class counts.",
    ),
    (
        "Leading hypothesis",
        "The effect, or the effects together, with the highest probability. This page shows its "
        "fit.",
    ),
    (
        "Held out",
        "Data that were set aside while the cause was chosen and fitted, and then predicted. A "
        "model that is only fitted to the data fails here.",
    ),
    (
        "Placebo",
        "The best alternative explanation without the cause, fitted to the same data. A cause must "
        "do better, since any added parameter reduces the error somewhat.",
    ),
    (
        "Noise",
        "Scatter that repeating the test would show. The noise floor of held-out data has also the "
        "scatter of the preload. No model can do better.",
    ),
    (
        "S*",
        "Share of the held-out error beyond noise that is gone: (baseline - with the cause) / "
        "(baseline - noise floor).",
    ),
    (
        "p",
        "How often noise, tolerances and model error alone give as large a chi-square. Adjusted p: "
        "corrected for the number of places tested (Holm).",
    ),
    (
        "k_n, k_t, beta",
        "Normal and tangential stiffness of a joint per area, at the last level of the test; "
        "beta is the exponent of their growth with the preload.",
    ),
    (
        "Outer zone",
        "The part of a joint outside the zones around its bolts; the inner zone is around them.",
    ),
)
_LINEAR = {
    True: "The structure is linear at each level and lightly damped. Changes with the level follow "
    "a power law, and the level moves the joint by another factor in each mode. Other changes from "
    "level to level (drift) have a size that is inferred from the data, for frequencies and for "
    "damping.",
    False: "The structure is linear and undamped; the stiffness of a joint follows a power law of "
    "the preload.",
}
_ASSUMPTIONS = (
    "Errors of the test are normal in the logarithm of frequency, with the noise and resolution "
    "that the case file states. Every model of the structure has an additional error, the same at "
    "all conditions for a mode.",
    "The ranges of the parameters come from physics, not from this test. The probabilities hold "
    "among the listed effects and a cause outside the library. How often such a cause is mistaken "
    "for an effect of the library is measured in simulated tests with known causes.",
    "Probabilities are sums over Gaussian cells of each prior. In each cell the model is linear "
    "about its most probable point; cells that count are split until the evidence changes by less "
    "than 0.1.",
    "Tests of regions take the model as linear in small changes about the baseline. The held-out "
    "parts overlap, so the intervals of S* are approximate.",
)


def diagnosis_document(
    d: Diagnosis, *, log_sd: np.ndarray | None = None, assumed: Sequence[tuple[str, str]] = ()
) -> doc.Document:
    """What is said of a diagnosis.

    Args:
        d: The diagnosis.
        log_sd: Standard deviations of the measured ln f, shape (n, m), for error bars.
        assumed: Names and values of its assumptions, from `assumptions`.
    """
    words, kind = explain(d), f"v-{d.verdict.replace(' ', '-')}"
    verdict = doc.Verdict(heading_of(d), words.sentences, kind, _STYLES.get(d.verdict, "bold red"))
    notes = [labelled(note) for note in d.model.get("notes", ())]
    lead = leading(d)
    return doc.Document(
        d.title,
        "diagnosis",
        "Diagnosis of model against vibration test",
        [
            verdict,
            doc.Remarks("Before you rely on it", words.doubts, "but: ", id="doubts"),
            doc.OnTerminal([_error_table(d)]),
            doc.OnPage(
                [
                    *_map(d.location),
                    doc.Keys(_keys(d)),
                    doc.Heading("In plain words", "in-words"),
                    doc.Terms(list(words.points.items()), "words"),
                    doc.Folded("What the words mean", [doc.Terms(_TERMS)]),
                ]
            ),
            doc.Heading("Where the model is wrong", "where"),
            _regions(d),
            *_places(d.location, d.condition),
            _errors(d),
            doc.Heading("Which effect causes it", "which"),
            *_effects(d),
            *_fitted(d),
            _hypotheses(d),
            doc.Heading("How far the error shrinks: before and after", "how-far"),
            doc.Figure(lambda: gap_bars(_gaps(d), d.noise)),
            *_held_out(d),
            doc.Figure(
                lambda: level_panels(d, log_sd),
                "The same over the level, without the baseline model, whose distance would hide "
                "how the modes change.",
            ),
            *_validation(d),
            _frequencies(d, log_sd),
            doc.Heading("What to measure next", "next"),
            *_next(d),
            doc.Heading("What this rests on", "rests-on"),
            doc.Folded(
                "Statements of the case, the model, tolerances, and assumptions",
                [*_stated(d, assumed), *([] if lead is None else _nuisances(lead)), *_taken(d)],
            ),
            doc.OnTerminal([doc.Remarks("", notes)]),
        ],
        lambda: {**d.to_json(), "in_words": words.to_json()},
    )


def _keys(d: Diagnosis) -> list[tuple[str, str, str]]:
    lead = leading(d)
    fitted = "" if lead is None else f": {named(lead)}"
    wrong = f" ({_label(d.placebo)})" if d.placebo else ""
    before = error_percent(d.heldout_before)
    rows = (
        ("before", d.before.rms, "error of the baseline model"),
        ("after", d.after.rms, f"error of the leading hypothesis, fitted{fitted}"),
        ("heldout", d.heldout_after, f"its error on held-out data (baseline {before})"),
        ("placebo", d.placebo_after, f"error of the placebo on held-out data{wrong}"),
        ("noise", d.noise, "measurement noise"),
    )
    return [(f"gap-{id}", error_percent(gap), words) for id, gap, words in rows]


def _label(label: str) -> str:
    """A hypothesis' label, names of effects with + between them, for people."""
    return " + ".join(map(effect_name, label.split(" + ")))


def _gaps(d: Diagnosis) -> list[tuple[str, float, float, float]]:
    """Errors of the baseline model, of the placebo and with the cause, by the data; nan where there
    is none."""
    rows = [
        ("All data, fitted", d.before.rms, np.nan, d.after.rms),
        ("Held-out data, predicted", d.heldout_before, d.placebo_after, d.heldout_after),
    ]
    if d.validation is not None:
        old, new = d.validation
        at = ", ".join(condition_value(x, d.condition[1]) for x in new.conditions)
        rows.append((f"Validation at {at}, never fitted", old.rms, np.nan, new.rms))
    return rows


def _error_table(d: Diagnosis) -> doc.Table:
    last = "with the cause" if d.verdict in NAMED else "best fit"
    table = doc.Table(f"RMS relative error | >baseline | >placebo | >{last}")
    for name, *gaps in _gaps(d):
        cells = ("" if np.isnan(gap) else error_percent(gap) for gap in gaps)
        table.add(name, *cells, style="lead" if name.startswith("Held") else "")
    table.add("Noise of the test", "", "", percent(d.noise))
    return table


# -- where -----------------------------------------------------------------------------------------


def _map(found: Location | None) -> list:
    """The map of patches, to be looked at from all sides; nothing without their cells."""
    patches = None if found is None else found.patches
    if patches is None or patches.vertices is None:
        return []
    draw = beam_patches if patches.side_view else patch_map
    seen = "The structure taken apart."
    if patches.side_view:
        seen = (
            "The beams, and between them the elements of the laps, seen from the side; patches are "
            "numbered by region."
        )
    little = (
        ""
        if patches.significant.any()
        else (" No patch explains more than chance: the colours mean little.")
    )
    caption = (
        f"{seen} The colour is the share of chi-square that a change of stiffness or mass in this "
        "patch alone explains: red where the patch is softer or heavier than in the model, blue "
        f"where it is stiffer or lighter.{little}"
    )
    return [doc.View(diagnosis_view(patches), [doc.Figure(lambda: draw(patches), caption)])]


def _regions(d: Diagnosis) -> doc.Table:
    table = doc.Table(
        "region | >share of chi-square | ",
        caption="Share of chi-square that a change in each region explains: the most probable "
        "region first, then the next of the remainder; the sum is 100 %",
        id="shares",
        most=_REGIONS,
    )
    for zone in d.where:
        style = "dim" if zone.region == "unexplained" else ""
        table.add(zone_words(zone.region), percent(zone.share, 1), doc.bar(zone.share), style=style)
    return table


def _places(found: Location | None, condition: tuple[str, str]) -> list[doc.Folded]:
    """Tests of regions and zones, and the data with the largest errors."""
    if found is None:
        return []
    how = (
        "Each place was tested alone: how much of chi-square a change of its stiffness or mass "
        "explains, and whether the rest is no more than chance. Places are listed by evidence for "
        "a change of the expected size."
    )
    tests = [
        ("tests", "Regions of the model: tests against chance", found.regions, [doc.Text(how)]),
        ("zones", "Joints zone by zone: tests against chance", found.zones, []),
    ]
    blocks = [
        doc.Folded(caption, [*words, _score_tests(id, caption, each)])
        for id, caption, each, words in tests
        if each
    ]
    axes = _axes(found, condition)
    if axes:
        words = (
            "Chi-square of the baseline model, and its value by chance alone. Each row counts what "
            "it adds to the rows above it."
        )
        blocks.append(
            doc.Folded("In which data the error is", [doc.Text(words), doc.Beside("pair", axes)])
        )
    return blocks


def _score_tests(id: str, caption: str, tests: Sequence[ScoreTest]) -> doc.Table:
    table = doc.Table(
        "place | change | >explains |  | >adjusted p | >p of the rest | >ln evidence",
        caption=caption,
        id=id,
    )
    for t in sorted(tests, key=lambda t: -t.log_evidence):
        if not t.dof:
            table.add(zone_words(t.zone), "not visible to this test", style="dim")
            continue
        table.add(
            zone_words(t.zone),
            joined(change_words(t)),
            percent(t.share, 1),
            doc.bar(t.share),
            p_value(t.p_adjusted),
            p_value(t.rest_p),
            f"{t.log_evidence:.1f}",
        )
    return table


def _axes(found: Location, condition: tuple[str, str]) -> list[doc.Table]:
    """What each mode, band, condition and kind of data adds, axes of several groups only."""
    names = {"mode": "mode", "band": "band", "condition": condition[0], "kind": "kind of data"}
    tables = []
    for by, name in names.items():
        rows = along(found, by)
        if len(rows) < 2:
            continue
        whole = sum(a.chi2 for a in rows)
        table = doc.Table([f"by {name}", ">chi-square", ">by chance", ">p", ""], kind="axis")
        for a in rows:
            numbers = (f"{a.chi2:.1f}", str(a.expected), p_value(a.p))
            table.add(group_words(a, condition[1]), *numbers, doc.bar(a.chi2 / whole))
        tables.append(table)
    return tables


def _errors(d: Diagnosis) -> doc.Folded:
    """Errors by mode and condition, on one scale of colours."""
    largest = largest_error(d.before, d.after)
    pairs = (("Baseline model", d.before), ("Leading hypothesis", d.after))
    tables = [
        heat_table(name, gap, d.condition, largest=largest, row_names=d.row_names)
        for name, gap in pairs
    ]
    words = (
        "Red: the model is too stiff or too light. Blue: too soft or too heavy. Both tables have "
        "the same colour scale."
    )
    summary = f"Errors by mode and {d.condition[0]}, before and after"
    return doc.Folded(summary, [doc.Text(words), doc.Beside("pair", tables)])


# -- which effect ----------------------------------------------------------------------------------


def _effects(d: Diagnosis) -> list:
    """All effects by class; the improbable ones folded away."""
    words = (
        "Each effect was added to the model within its physically likely range, alone and together "
        "with others, and fitted. Its probability rewards a good fit and penalises needless "
        "freedom. Effects that this test cannot distinguish form one class: rely on the "
        f"probability of the class, not on the split within it. {LIMITS}"
    )
    caption = (
        "Probability that an effect is present; several may be, so the numbers need not add up to "
        "100 %"
    )
    classes = effect_classes(d)
    probable = sum(c.probability >= _PROBABLE for c in classes)
    shown = min(max(probable, _FEWEST_CLASSES), len(classes))
    blocks = [doc.OnPage([doc.Text(words)]), _effect_table("effects", caption, classes[:shown])]
    if rest := classes[shown:]:
        table = _effect_table("effects-rest", "", rest)
        count = sum(len(c.effects) for c in rest)
        blocks.append(doc.Folded(f"{count} more effects, less probable than these", [table]))
    return blocks


def _effect_table(id: str, caption: str, classes: Sequence[EffectClass]) -> doc.Table:
    names = ("effect", "class", ">probability", "", "in this test")
    table = doc.Table(names, caption=caption, id=id, most=_EFFECTS, page_columns=1)
    for group in classes:
        style, indent, p = "" if table.rows else "lead", 0, group.probability
        if group.letter:
            name, indent = f"any of these {len(group.effects)}", 2
            table.add(name, group.letter, probability(p), doc.bar(bounded(p)), "", style=style)
            style = ""
        for e in group.effects:
            seen = "detectable" if e.detectable else "too small to detect"
            if e.name in (NO_GAP, UNKNOWN):
                seen = MISSING
            table.add(
                doc.Cell(with_place(e.key), note=e.describe, indent=indent),
                group.letter,
                probability(e.probability),
                doc.bar(bounded(e.probability)),
                doc.Cell(seen, kind="nowrap"),
                style=style,
            )
    return table


def _fitted(d: Diagnosis) -> list[doc.Table]:
    """Parameters of the leading hypothesis."""
    lead = leading(d)
    if lead is None:
        return []
    return [
        _parameters(
            by_effect(lead.parameters),
            f"Fitted in the leading hypothesis, {named(lead)}",
            "fitted",
            "no parameter",
        )
    ]


def _parameters(
    effects: Sequence[tuple[str, list[dict]]], caption: str, id: str, nothing: str
) -> doc.Table:
    names = ("effect", "parameter", ">value", ">68 % interval", ">from expected, s.d.")
    table = doc.Table(names, caption=caption, id=id, most=_PARAMETERS, page_columns=1)
    for effect, rows in effects:
        for p in rows:
            sigmas = p["prior_sigmas"]
            far = "flag" if p["nuisance"] and abs(sigmas) > FAR else ""
            off = doc.Cell(f"{sigmas:+.2f}", kind=far)
            table.add(with_place(effect), parameter_name(p), *value_words(p), off)
    if not table.rows:
        table.add(nothing)
    return table


def _hypotheses(d: Diagnosis) -> doc.Folded:
    """All hypotheses: evidence, error, p-value, fitted parameters."""
    lead, best = leading(d), max((h.log_evidence for h in d.hypotheses), default=0.0)
    shown, rest = d.hypotheses[:_MOST_HYPOTHESES], d.hypotheses[_MOST_HYPOTHESES:]
    words = (
        "Evidence is the probability of the measured data under a hypothesis, averaged over the "
        "range of its parameters: a good fit raises it, needless freedom lowers it. Three units of "
        "ln evidence are odds of 20 to 1. The p-value is how often chi-square would be as large if "
        "the hypothesis were right; below 1 % the hypothesis fails, whatever its rank."
    )
    table = doc.Table(
        "hypothesis | >probability | >ln evidence | >below best | >error | >p-value | "
        "at a limit of its range",
        caption=f"The {len(shown)} most probable of {len(d.hypotheses)}, with their fitted "
        "parameters (68 % interval); the leading one, whose error and frequencies this page shows, "
        "in bold",
        id="hypotheses",
    )
    for h in shown:
        p = f"{h.p_value:.2f}"
        if h.p_value < 0.01:
            p = doc.Cell("< 0.001" if h.p_value < 0.001 else f"{h.p_value:.3f}", kind="flag")
        fitted = "; ".join(parameter_words(rows) for _, rows in by_effect(h.parameters))
        table.add(
            doc.Cell(named(h), note=fitted),
            probability(h.probability),
            f"{h.log_evidence:.1f}",
            f"{best - h.log_evidence:.1f}",
            error_percent(h.gap),
            p,
            doc.Cell(", ".join(h.at_bound), kind="flag") if h.at_bound else MISSING,
            style="lead" if h is lead else "",
        )
    blocks = [doc.Text(words), table]
    if rest:
        total = probability(sum(h.probability for h in rest))
        words = f"The other {len(rest)} hypotheses have a probability of {total} together."
        blocks.append(doc.Text(words, "note"))
    return doc.Folded("All hypotheses: evidence, error, p-value, fitted parameters", blocks)


# -- how far ---------------------------------------------------------------------------------------


def _held_out(d: Diagnosis) -> list:
    """Held-out data part by part."""
    s = d.shrinkage
    if s is None or not s.folds:
        return [doc.OnPage([doc.Text("Nothing could be held out.")])]
    how = (
        "In each row some data are held out: the cause is chosen and fitted without them, their "
        "error is predicted, and only then compared. The last column has the effects that were "
        "chosen without these data."
    )
    caption = (
        "Bars are intervals predicted before the held-out data were compared. Nine of ten round "
        "points should lie in them, or to the left, which is better than predicted."
    )
    blocks = [
        doc.Text(how),
        doc.Figure(lambda: forecasts(s), caption),
        _folds(s, d.placebo),
        _shrinkage(s),
    ]
    summary = "Held-out data part by part, and how much of the error beyond noise is gone"
    return [doc.Folded(summary, blocks)]


def _folds(s: Shrinkage, placebo: str) -> doc.Table:
    table = doc.Table(
        "held out | >points | >baseline | >with the cause | >predicted interval | >placebo | "
        ">noise floor | >S* | chosen effects",
        caption="Held-out data, part by part; intervals of 90 %",
        id="folds",
    )

    def add(
        name: str, n: int, of: Fold | Shrinkage, stated: doc.Cell, chosen: str, **style
    ) -> None:
        before, after = error_percent(of.before), error_percent(of.after)
        others = error_percent(of.placebo), error_percent(of.noise), number(of.shrink, 2)
        table.add(name, str(n), before, after, stated, *others, chosen, **style)

    for f in s.folds:
        low, high = map(error_percent, f.predicted_after)
        ended = ": better" if f.better else "" if f.covered else ": missed"
        stated = doc.Cell(f"{low} to {high}{ended}", kind="" if f.held else "flag")
        add(f.name, f.n, f, stated, _label(f.chosen))
    total, wrong = sum(f.n for f in s.folds), f"placebo: {_label(placebo) or MISSING}"
    add("together", total, s, doc.Cell(), wrong, style="lead", foot=True)
    return table


def _shrinkage(s: Shrinkage) -> doc.Table:
    caption = "How much of the error beyond noise is gone, and how good the predictions were"
    table = doc.Table(" | >share | >90 % interval", caption=caption, id="shrinkage")
    for name, share, span in (
        ("S* with the cause", s.shrink, s.shrink_interval),
        ("S* of the placebo", s.placebo_shrink, s.placebo_interval),
        ("difference", s.excess, s.excess_interval),
    ):
        low, high = (number(x, 2) for x in span)
        style = "lead" if name == "difference" else ""
        table.add(name, number(share, 2), f"{low} to {high}", style=style)
    better = f" ({percent(s.better, 0)} better)" if s.better else ""
    for name, share in (
        (f"parts in their predicted interval, or better{better}", s.coverage),
        ("held-out frequencies in their predicted interval", s.entries_coverage),
    ):
        table.add(name, percent(share, 0), "90 % expected")
    return table


def _validation(d: Diagnosis) -> list[doc.Folded]:
    if d.validation is None:
        return []
    names = ("baseline", "leading hypothesis")
    table = frequency_table("Validation", *d.validation, d.condition, names)
    title = "Validation: data that were never fitted and never used to choose"
    return [doc.Folded(title, [table], "validation")]


def _frequencies(d: Diagnosis, log_sd: np.ndarray | None) -> doc.Folded:
    """All frequencies and damping ratios: curves and tables."""

    def curves() -> str:
        return frequency_panels(
            d.before,
            d.after,
            d.condition,
            labels=("baseline model", "leading hypothesis"),
            log_sd=log_sd,
            validation=d.validation,
            changed=np.array([bool(name) for name in d.row_names]) if d.row_names else None,
        )

    caption = "All frequencies, Hz, and relative errors"
    names = ("baseline", "leading hypothesis")
    blocks = [
        doc.Figure(
            curves,
            "Points are measured, lines are modelled. Steps in the points come from the frequency "
            "resolution of the test.",
        ),
        frequency_table(caption, d.before, d.after, d.condition, names, d.row_names),
    ]
    if d.damping is not None:
        table = doc.Table(
            [d.condition[0], "mode", ">measured", ">leading hypothesis"],
            caption="Damping ratios, which were fitted with the frequencies",
            id="damping",
        )
        measured, model = d.damping
        for i, j in np.ndindex(d.after.test_hz.shape):
            at = condition_value(d.after.conditions[i], d.condition[1])
            ratios = (percent(ratio[i, j], 3) for ratio in (measured, model))
            table.add(at, d.after.mode_names[j], *ratios)
        blocks.append(table)
    also = "" if d.damping is None else " and damping ratios"
    return doc.Folded(f"All frequencies{also}: curves and table", blocks)


# -- what next, and what it rests on ---------------------------------------------------------------


def _next(d: Diagnosis) -> list:
    """Measurements that would distinguish a class, and effects that this test cannot show."""
    letters = {c.name: c.letter for c in effect_classes(d)}
    lines = [
        f"To distinguish class {letters.get(s.class_name) or s.class_name} "
        f"({'; '.join(map(_label, s.members))}), measure {s.measurement}: "
        f"{deviation_words(s.distance)} (one is taken for the other in "
        f"{probability(confusion(s.distance))})."
        for s in d.separations
    ]
    more = (
        "fenics-joints diagnose --plan names, for every effect, the added measurement that would "
        "best distinguish it from the others."
    )
    if not lines:
        more = f"No likely class of effects has several members. {more}"
    first, rest = map(doc.Text, lines[:_SPLITS]), map(doc.Text, lines[_SPLITS:])
    return [*first, doc.OnPage([*rest, doc.Text(more, "note")]), *silent_blocks(d.silent)]


def _stated(d: Diagnosis, assumed: Sequence[tuple[str, str]]) -> list[doc.Table]:
    """Statements of the case, and facts on the model; the error of a reduced one among them."""
    facts = {key: value for key, value in d.model.items() if key not in _SHOWN}
    if "basis" in facts:
        facts["frequency_error"] = d.model_error
    caption = "Stated by the case file"
    table = doc.Table(" | ", caption=caption, id="assumed")
    for name, value in assumed:
        table.add(name, value)
    return [*([table] if assumed else []), facts_table(facts)]


def _nuisances(lead: HypothesisResult) -> list:
    """Fitted values of the nuisances."""
    words = (
        "These quantities are known within a tolerance and free in every hypothesis. One that ends "
        f"more than {number(FAR, 2)} standard deviations from its expected value is marked: then "
        "another cause may be present."
    )
    rows = [(p["effect"], [p]) for p in lead.parameters if p["nuisance"]]
    limits = ", ".join(lead.at_bound) or "none"
    return [
        doc.Heading("Tolerances", level=3),
        doc.Text(words),
        _parameters(rows, f"Their fitted values with {named(lead)}", "nuisances", "none"),
        doc.Text(f"Parameters at a limit of their range: {limits}."),
    ]


def _taken(d: Diagnosis) -> list:
    """Assumptions."""
    return [doc.Heading("Assumptions", level=3), doc.Items([_LINEAR[d.by_level], *_ASSUMPTIONS])]
