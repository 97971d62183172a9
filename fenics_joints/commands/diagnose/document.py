"""What is said of a diagnosis: the answer, then the numbers behind it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from fenics_joints.case import labelled
from fenics_joints.commands.diagnose.explanation import FAR, explain
from fenics_joints.commands.diagnose.pictures import forecasts, gap_bars, level_panels
from fenics_joints.commands.diagnose.view import diagnosis_view
from fenics_joints.commands.diagnose.words import (
    EffectClass,
    by_effect,
    by_reason,
    change_words,
    effect_classes,
    group_words,
    heading_of,
    in_words,
    joined,
    leading,
    named,
    sure_causes,
    value_words,
    with_place,
    zone_words,
)
from fenics_joints.diagnosis.evidence.classes import APART, confusion
from fenics_joints.diagnosis.location import Location
from fenics_joints.diagnosis.result import Diagnosis, HypothesisResult
from fenics_joints.diagnosis.shrinkage import Shrinkage
from fenics_joints.diagnosis.verdict import NO_GAP, UNKNOWN
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
    spaced,
)
from fenics_joints.report import patch_map
from fenics_joints.report.beam_pictures import beam_patches
from fenics_joints.report.document import (
    Beside,
    Cell,
    Document,
    Figure,
    Folded,
    Heading,
    Items,
    Keys,
    OnPage,
    OnTerminal,
    Remarks,
    Table,
    Terms,
    Text,
    Verdict,
    View,
    bar,
)
from fenics_joints.report.panels import frequency_panels
from fenics_joints.report.tables import facts_table, frequency_table, heat_table, largest_error

#: What is known of the model and stands elsewhere.
_SAID = ("notes", "order")
#: Rows on the terminal of regions, parameters, classes of effects (named causes besides), and
#: members of a class.
_REGIONS, _PARAMETERS, _CLASSES, _MEMBERS = 3, 3, 2, 3
#: Hypotheses that get a row of their own.
_MOST_HYPOTHESES = 8
#: Classes of effects below this are folded away, but for so many.
_PROBABLE, _FEWEST_CLASSES = 1e-3, 5
_STYLES = {
    "cause": "bold cyan",
    "likely": "bold yellow",
    "no gap": "bold green",
    "ambiguous": "bold yellow",
}
_TERMS = (
    (
        "Gap",
        "Root mean square of (model frequency / measured frequency - 1) over all modes and "
        "conditions.",
    ),
    (
        "Misfit",
        "The same differences by standard deviations of noise, tolerances and what any model errs, "
        "squared and summed.",
    ),
    (
        "Leading hypothesis",
        "The effect, or effects together, with the highest probability: what is fitted on this "
        "page.",
    ),
    (
        "Held out",
        "Data put aside while the cause was chosen and fitted, then predicted. A fit that only "
        "bends itself to the data fails here.",
    ),
    (
        "Best wrong effect",
        "The best other effect, given the same chance on the same data. A cause must beat it, for "
        "any added freedom shrinks a gap somewhat.",
    ),
    ("Noise", "What the test cannot resolve. No model can be shown to be better than this."),
    (
        "S*",
        "The share of the gap beyond noise that is gone, (nominal - chosen) / (nominal - noise), "
        "on held-out data.",
    ),
    (
        "By chance",
        "p: how often noise, tolerances and the error of any model alone would make as much. "
        "Adjusted p: among all that were tested (Holm).",
    ),
)
_LINEAR = {
    True: "The structure is linear at each level and lightly damped; what changes with the level "
    "follows a power of it, and the level moves the joint by a factor of its own in each mode. "
    "What changes from level to level beside that (drift) has a size that the data infer, of "
    "frequencies and of damping.",
    False: "The structure is linear and undamped; a joint's stiffness follows a power law of the "
    "preload.",
}
_ASSUMPTIONS = (
    "Errors of the test are normal in the logarithm of frequency, with the noise and resolution "
    "that the case file states; every model of the structure has besides an error of its own, the "
    "same at all conditions for a mode.",
    "The ranges of the parameters were set from physics before the test was looked at, and the "
    "probabilities hold among the listed effects and none of these. How often a cause outside the "
    "library looks like one inside is taken from simulated tests with known causes.",
    "Probabilities come from sums over Gaussian cells of each prior, in each of which the model is "
    "linear about its own most probable point; cells that count are split until the evidence moves "
    "by less than 0.1.",
    "Tests of regions take the model as linear in small changes about the nominal one; the parts "
    "overlap, so that the intervals of S* are a guide.",
)


def diagnosis_document(
    d: Diagnosis, *, log_sd: np.ndarray | None = None, assumed: Sequence[tuple[str, str]] = ()
) -> Document:
    """What is said of a diagnosis.

    Args:
        d: The diagnosis.
        log_sd: Standard deviations of the measured ln f, shape (n, m), for error bars.
        assumed: Names and values of what it takes for granted, from `assumptions`.
    """
    words, kind = explain(d), f"v-{d.verdict.replace(' ', '-')}"
    verdict = Verdict(heading_of(d), words.sentences, kind, _STYLES.get(d.verdict, "bold red"))
    notes = [labelled(note) for note in d.model.get("notes", ())]
    lead = leading(d)
    return Document(
        d.title,
        "diagnosis",
        "Diagnosis of model against vibration test",
        [
            verdict,
            Remarks("Before you rely on it", words.doubts, "but: ", id="doubts"),
            OnTerminal([_gaps(d)]),
            OnPage(
                [
                    *_map(d.location),
                    Keys(_keys(d)),
                    Heading("In plain words", "in-words"),
                    Terms(list(words.points.items()), "words"),
                    Folded("What the words mean", [Terms(_TERMS)]),
                ]
            ),
            Heading("Where the model is wrong", "where"),
            _regions(d),
            *_places(d.location, d.condition),
            _errors(d),
            Heading("Which effect causes it", "which"),
            OnTerminal(_effects_shortly(d)),
            OnPage(_effects(d)),
            *_fitted(d),
            _hypotheses(d),
            Heading("How far the error shrinks: before and after", "how-far"),
            Figure(lambda: _gap_picture(d)),
            *_held_out(d),
            Figure(
                lambda: level_panels(d, log_sd),
                "The same over the level, without the nominal model, whose distance hides how the "
                "modes change.",
            ),
            *_validation(d),
            _frequencies(d, log_sd),
            Heading("What to measure next", "next"),
            OnPage(_next(d)),
            Heading("What this rests on", "rests-on"),
            Folded(
                "What was stated beforehand, the model, what was free in any case, and assumptions",
                [*_stated(d, assumed), *([] if lead is None else _nuisances(lead)), *_taken(d)],
            ),
            OnTerminal([Remarks("", notes)]),
        ],
        lambda: {**d.to_json(), "in_words": words.to_json()},
    )


def _keys(d: Diagnosis) -> list[tuple[str, str, str]]:
    lead = leading(d)
    fitted = "" if lead is None else f": {named(lead)}"
    wrong = f", {d.placebo}" if d.placebo else ""
    nominal = error_percent(d.heldout_before)
    return [
        ("gap-before", error_percent(d.before.rms), "gap of the nominal model"),
        (
            "gap-after",
            error_percent(d.after.rms),
            f"gap with the leading hypothesis fitted{fitted}",
        ),
        (
            "gap-heldout",
            error_percent(d.heldout_after),
            f"gap on held-out data, predicted (nominal {nominal})",
        ),
        (
            "gap-placebo",
            error_percent(d.placebo_after),
            f"the same with the best wrong effect{wrong}",
        ),
        ("gap-noise", percent(d.noise), "noise of the measurement itself"),
    ]


def _gaps(d: Diagnosis) -> Table:
    table = Table("gap (RMS relative error) | >nominal | >best wrong | >chosen")
    rows = [
        ("all data, fitted", d.before.rms, None, d.after.rms),
        ("held out, predicted", d.heldout_before, d.placebo_after, d.heldout_after),
    ]
    if d.validation is not None:
        old, new = d.validation
        rows.append((f"validation, {_validated(d)}", old.rms, None, new.rms))
    for name, *gaps in rows:
        cells = ("" if gap is None else error_percent(gap) for gap in gaps)
        table.add(name, *cells, style="lead" if name.startswith("held") else "")
    table.add("noise of the test", "", "", percent(d.noise))
    return table


def _validated(d: Diagnosis) -> str:
    """The conditions of the validation data."""
    return ", ".join(condition_value(x, d.condition[1]) for x in d.validation[1].conditions)


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
        else (" None explains more than chance: the colours say little.")
    )
    caption = (
        f"{seen} The colour is the share of the misfit that a change of stiffness or mass in a "
        "patch alone explains, against noise and tolerances: red where the patch is softer or "
        f"heavier than in the model, blue where it is stiffer or lighter.{little}"
    )
    return [View(diagnosis_view(patches), [Figure(lambda: draw(patches), caption)])]


def _regions(d: Diagnosis) -> Table:
    table = Table(
        "where | >share | ",
        caption="What a change in each region explains of the misfit: the most probable region "
        "first, then the next of what is left; all of them and the rest make 100 %",
        id="shares",
        most=_REGIONS,
    )
    for zone in d.where:
        style = "dim" if zone.region == "unexplained" else ""
        table.add(spaced(zone.region), percent(zone.share, 1), bar(zone.share), style=style)
    return table


def _places(found: Location | None, condition: tuple[str, str]) -> list[Folded]:
    """Tests of regions and zones, and in which data the misfit is."""
    if found is None:
        return []
    how = (
        "Each place was tested by itself: what of the misfit a change of its stiffness or mass "
        "alone explains, and whether what it leaves is no more than chance. Places stand in the "
        "order of their evidence, that of a change of the expected size above that of none."
    )
    tests = [
        ("tests", "Regions of the model: tests against chance", found.regions, [Text(how)]),
        ("zones", "Joints zone by zone: tests against chance", found.zones, []),
    ]
    blocks = [
        Folded(caption, [*words, _score_tests(id, caption, each)])
        for id, caption, each, words in tests
        if each
    ]
    axes = _axes(found, condition)
    if axes:
        words = (
            "The squared misfit of the nominal model in standard deviations, and what chance alone "
            "would make. Each row counts what it adds to the rows above it."
        )
        blocks.append(Folded("In which data the misfit is", [Text(words), Beside("pair", axes)]))
    return blocks


def _score_tests(id: str, caption: str, tests: Sequence[ScoreTest]) -> Table:
    table = Table(
        "where | most probably | >explains |  | >adjusted p | >p of the rest | >ln evidence",
        caption=caption,
        id=id,
    )
    for t in sorted(tests, key=lambda t: -t.log_evidence):
        if not t.dof:
            table.add(zone_words(t.zone), "not seen by this test", style="dim")
            continue
        table.add(
            zone_words(t.zone),
            joined(change_words(t)),
            percent(t.share, 1),
            bar(t.share),
            p_value(t.p_adjusted),
            p_value(t.rest_p),
            f"{t.log_evidence:.1f}",
        )
    return table


def _axes(found: Location, condition: tuple[str, str]) -> list[Table]:
    """What each mode, band, condition and kind of data adds, axes of several groups only."""
    names = {"mode": "mode", "band": "band", "condition": condition[0], "kind": "kind of data"}
    tables = []
    for by, name in names.items():
        rows = [a for a in found.attribution if a.by == by]
        if len(rows) < 2:
            continue
        whole = sum(a.chi2 for a in rows)
        table = Table([f"by {name}", ">misfit", ">by chance", ">p", ""], kind="axis")
        for a in rows:
            numbers = (f"{a.chi2:.1f}", str(a.expected), p_value(a.p))
            table.add(group_words(a, condition[1]), *numbers, bar(a.chi2 / whole))
        tables.append(table)
    return tables


def _errors(d: Diagnosis) -> Folded:
    """Errors by mode and condition, on one scale of colours."""
    largest = largest_error(d.before, d.after)
    pairs = (("Nominal model", d.before), ("Leading hypothesis", d.after))
    tables = [
        heat_table(name, gap, d.condition, largest=largest, row_names=d.row_names)
        for name, gap in pairs
    ]
    words = (
        "Red: the model is too stiff (or too light). Blue: too soft (or too heavy). Both tables "
        "share one colour scale."
    )
    summary = f"Errors by mode and {d.condition[0]}, before and after"
    return Folded(summary, [Text(words), Beside("pair", tables)])


# -- which effect ----------------------------------------------------------------------------------


def _effects_shortly(d: Diagnosis) -> list:
    """The first classes of effects, what would split them, and what is not seen."""
    classes, often = effect_classes(d), Counter(effect.name for effect in d.effects)
    table = Table("which effect | class | >probability | ")
    # Every cause that is named has its row; a class takes one of its own beside its members'.
    sure, shown = {group.name for group in sure_causes(d)}, 0
    for i, group in enumerate(classes):
        if i >= _CLASSES and group.name not in sure:
            continue
        members, indent = group.effects[: _MEMBERS if group.letter else 1], 0
        if group.letter:
            p, indent = group.probability, 2
            name = f"one of {len(group.effects)} in"
            table.add(name, group.letter, probability(p), bar(bounded(p)))
        for e in members:
            # Which of several of one name, as the loose bolts.
            name = Cell(e.name if often[e.name] == 1 else in_words(e), indent=indent)
            p = e.probability
            table.add(name, group.letter, probability(p), bar(bounded(p)))
        shown += len(members)
    if (left := len(d.effects) - shown) > 0:
        table.add(f"and {left} more", "", "", "", style="dim")
    letters = {group.name: group.letter for group in classes if group.letter}
    splits = [s for s in d.separations if s.class_name in letters][:2]
    blocks = [table]
    for s in splits:
        apart = f"to tell class {letters[s.class_name]} apart: {s.measurement}"
        blocks.append(Text(f"{apart} (up to {s.distance:.1f} standard deviations)"))
    for reason, names in by_reason(d.silent):
        blocks.append(Text(f"this test says nothing of {', '.join(names)}: {reason}", "note"))
    return blocks


def _effects(d: Diagnosis) -> list:
    """All effects by class; the improbable ones folded away."""
    words = (
        "Each effect was put into the model with its physically likely range, alone and together "
        "with others, and fitted. Its probability weighs how well it explains the test against how "
        "freely it had to be tuned. Effects that this test cannot tell apart form one class: "
        f"believe the class's number, not the split within it. {LIMITS}"
    )
    caption = (
        "Probability that an effect is at work; several may be, so the numbers need not add up to "
        "100 %"
    )
    classes = effect_classes(d)
    probable = sum(c.probability >= _PROBABLE for c in classes)
    shown = min(max(probable, _FEWEST_CLASSES), len(classes))
    blocks = [Text(words), _effect_table("effects", caption, classes[:shown], lead=True)]
    if rest := classes[shown:]:
        table = _effect_table("effects-rest", "", rest)
        count = sum(len(c.effects) for c in rest)
        blocks.append(Folded(f"{count} more effects, less probable than these", [table]))
    return blocks


def _effect_table(id: str, caption: str, classes: Sequence[EffectClass], lead=False) -> Table:
    names = ("class", "effect", "region", ">probability", "", "in this test")
    table = Table(names, caption=caption, id=id)
    for i, group in enumerate(classes):
        style = "lead" if lead and i == 0 else ""
        if group.letter:
            words = f"one of these {len(group.effects)}, which this test cannot tell apart"
            p = group.probability
            cells = (words, "", probability(p), bar(bounded(p)), "")
            table.add(group.letter, *cells, style=style)
            style = ""
        for e in group.effects:
            seen = "visible" if e.detectable else "too small to see"
            if e.name in (NO_GAP, UNKNOWN):
                seen = MISSING
            table.add(
                group.letter,
                Cell(e.name, note=e.describe),
                spaced(e.region) or MISSING,
                probability(e.probability),
                bar(bounded(e.probability)),
                Cell(seen, kind="nowrap"),
                style=style,
            )
    return table


def _fitted(d: Diagnosis) -> list[Table]:
    """Parameters of the leading hypothesis."""
    lead = leading(d)
    if lead is None:
        return []
    return [
        _parameters(
            by_effect(lead.parameters),
            f"Fitted in the leading hypothesis, {named(lead)}",
            "fitted",
            "none of its own",
        )
    ]


def _parameters(
    effects: Sequence[tuple[str, list[dict]]], caption: str, id: str, nothing: str
) -> Table:
    names = ("effect", "fitted", ">value", ">68 % interval", ">from expected, s.d.")
    table = Table(names, caption=caption, id=id, most=_PARAMETERS, page_columns=1)
    for effect, rows in effects:
        for p in rows:
            sigmas = p["prior_sigmas"]
            far = "flag" if p["nuisance"] and abs(sigmas) > FAR else ""
            off = Cell(f"{sigmas:+.2f}", kind=far)
            table.add(with_place(effect), p["name"], *value_words(p), off)
    if not table.rows:
        table.add(nothing)
    return table


def _hypotheses(d: Diagnosis) -> Folded:
    """All hypotheses: evidence, gap, p-value, fitted parameters."""
    lead, best = leading(d), max((h.log_evidence for h in d.hypotheses), default=0.0)
    shown, rest = d.hypotheses[:_MOST_HYPOTHESES], d.hypotheses[_MOST_HYPOTHESES:]
    words = (
        "Evidence is the probability of the measured data under a hypothesis, averaged over the "
        "range its parameters may have: a good fit raises it, needless freedom lowers it. Three "
        "units of ln evidence are odds of 20 to 1. The p-value is how often a misfit as large as "
        "this would come about if the hypothesis were right; below 1 % it fails, whatever its rank."
    )
    table = Table(
        "hypothesis | >probability | >ln evidence | >below best | >gap | >p-value | "
        "at a limit of its range",
        caption=f"The {len(shown)} most probable of {len(d.hypotheses)}; the leading one, whose "
        "gap and frequencies this page shows, in bold",
        id="hypotheses",
    )
    others = Table(
        "hypothesis | fitted parameters (68 % interval)",
        caption="Fitted parameters of the other hypotheses",
        id="others",
    )
    for h in shown:
        p = f"{h.p_value:.2f}"
        if h.p_value < 0.01:
            p = Cell("< 0.001" if h.p_value < 0.001 else f"{h.p_value:.3f}", kind="flag")
        table.add(
            named(h),
            probability(h.probability),
            f"{h.log_evidence:.1f}",
            f"{best - h.log_evidence:.1f}",
            error_percent(h.gap),
            p,
            Cell(", ".join(h.at_bound), kind="flag") if h.at_bound else MISSING,
            style="lead" if h is lead else "",
        )
        if h is not lead:
            others.add(named(h), _values(h) or MISSING)
    blocks = [Text(words), table]
    if rest:
        total = probability(sum(h.probability for h in rest))
        blocks.append(Text(f"{len(rest)} more hypotheses have {total} together.", "note"))
    if lead is not None:
        blocks.append(others)
    return Folded("All hypotheses: evidence, gap, p-value, fitted parameters", blocks)


def _values(h: HypothesisResult) -> str:
    """Fitted parameters of a hypothesis with their intervals, effect by effect."""
    effects = []
    for _, rows in by_effect(h.parameters):
        each = [(p["name"], *value_words(p)) for p in rows]
        words = (f"{n}: {value}{f' ({span})' if span else ''}" for n, value, span in each)
        effects.append(", ".join(words))
    return "; ".join(effects)


# -- how far ---------------------------------------------------------------------------------------


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
        bars = [("nominal model", old.rms, "nominal"), ("chosen effect", new.rms, "chosen")]
        groups.append((f"Validation at {_validated(d)}, never fitted", bars))
    return gap_bars(groups, d.noise)


def _held_out(d: Diagnosis) -> list:
    """Held-out data part by part."""
    s = d.shrinkage
    if s is None or not s.folds:
        return [OnPage([Text("Nothing could be held out.")])]
    how = (
        "Each row puts some data aside, chooses and fits without them, states what they will show, "
        "and is then scored on them. Chosen is what was chosen without that part."
    )
    caption = (
        "Bars were stated before the held-out data were looked at; the round points should lie in "
        "nine of ten of them, or to the left, which is better than stated."
    )
    share = (
        "S* is the share of the gap beyond noise that is gone, on held-out data: 0 is nothing, 1 "
        "all but the noise, which no model can take away. The best wrong effect is the best of "
        "those that are not the cause, given the same chance on the same data."
    )
    blocks = [
        Text(how),
        Figure(lambda: forecasts(s), caption),
        Text(share),
        _folds(s, d.placebo),
        _shrinkage(s),
    ]
    summary = "Held-out data part by part, and how much of the gap beyond noise is gone"
    return [Folded(summary, blocks)]


def _folds(s: Shrinkage, placebo: str) -> Table:
    table = Table(
        "held out | >points | >nominal | >chosen | >stated before | >best wrong | >noise | >S* | "
        "chosen effects",
        caption="Held-out data, part by part; intervals of 90 %",
        id="folds",
    )
    for f in s.folds:
        low, high = map(error_percent, f.predicted_after)
        ended = ": better" if f.better else "" if f.covered else ": missed"
        table.add(
            f.name,
            str(f.n),
            error_percent(f.before),
            error_percent(f.after),
            Cell(f"{low} to {high}{ended}", kind="" if f.held else "flag"),
            error_percent(f.placebo),
            error_percent(f.noise),
            number(f.shrink, 2),
            f.chosen,
        )
    table.add(
        "together",
        str(sum(f.n for f in s.folds)),
        error_percent(s.before),
        error_percent(s.after),
        "",
        error_percent(s.placebo),
        error_percent(s.noise),
        number(s.shrink, 2),
        f"best wrong: {placebo or MISSING}",
        style="lead",
        foot=True,
    )
    return table


def _shrinkage(s: Shrinkage) -> Table:
    caption = "How much of the gap beyond noise is gone, with what was stated before"
    table = Table(" | >share | >90 % interval", caption=caption, id="shrinkage")
    for name, share, span in (
        ("S*, the chosen effects", s.shrink, s.shrink_interval),
        ("the same of the best wrong effect", s.placebo_shrink, s.placebo_interval),
        ("excess", s.excess, s.excess_interval),
    ):
        low, high = (number(x, 2) for x in span)
        style = "lead" if name == "excess" else ""
        table.add(name, number(share, 2), f"{low} to {high}", style=style)
    better = f" ({percent(s.better, 0)} better)" if s.better else ""
    for name, share in (
        (f"parts in the interval stated before, or better{better}", s.coverage),
        ("held-out frequencies in theirs", s.entries_coverage),
    ):
        table.add(name, percent(share, 0), "90 % asked")
    return table


def _validation(d: Diagnosis) -> list:
    if d.validation is None:
        return []
    old, new = d.validation
    gaps = f"{error_percent(old.rms)} with the nominal model, {error_percent(new.rms)} with the"
    table = frequency_table("Validation", old, new, d.condition, ("nominal", "leading hypothesis"))
    title = "Validation: data that were never fitted and never used to choose"
    return [
        Heading(title, "validation", level=3),
        OnPage([Text(f"Gap {gaps} leading hypothesis.")]),
        Folded("Validation, frequency by frequency", [table]),
    ]


def _frequencies(d: Diagnosis, log_sd: np.ndarray | None) -> Folded:
    """All frequencies and damping ratios: curves and tables."""

    def curves() -> str:
        return frequency_panels(
            d.before,
            d.after,
            d.condition,
            labels=("nominal model", "leading hypothesis"),
            log_sd=log_sd,
            validation=d.validation,
            changed=np.array([bool(name) for name in d.row_names]) if d.row_names else None,
        )

    caption = "All frequencies, Hz, and relative errors"
    names = ("nominal", "leading hypothesis")
    blocks = [
        Figure(
            curves,
            "Points are measured, lines are modelled. Where the test's resolution is coarse, its "
            "points step.",
        ),
        frequency_table(caption, d.before, d.after, d.condition, names, d.row_names),
    ]
    if d.damping is not None:
        table = Table(
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
    return Folded(f"All frequencies{also}: curves and table", blocks)


# -- what next, and what it rests on ---------------------------------------------------------------


def _next(d: Diagnosis) -> list:
    """Measurements that would split a class, and what this test says nothing about."""
    letters = {c.name: c.letter for c in effect_classes(d)}
    table = Table(
        "class | members | measurement | >separation | >confusion",
        caption="The expected separation of the members' predictions in standard deviations; "
        f"{APART:.2f} leaves 1 % chance to take one for the other",
        id="separations",
    )
    for s in d.separations:
        alone = "the best there is, but not enough alone" if s.distance < APART else ""
        table.add(
            letters.get(s.class_name) or s.class_name,
            "; ".join(s.members),
            Cell(s.measurement, note=alone),
            f"{s.distance:.2f}",
            probability(confusion(s.distance)),
        )
    blocks = [Heading("What would tell a class apart", level=3), table]
    if not d.separations:
        words = "No likely class of effects has several members that a further measurement would "
        blocks = [Text(f"{words}have to split.")]
    if d.silent:
        lines = [f"{'; '.join(names)}: {reason}." for reason, names in by_reason(d.silent)]
        blocks.append(Folded("What this test says nothing about", [Items(lines)], "silent"))
    words = (
        "fenics-joints diagnose --plan says for every effect, likely or not, which added "
        "measurement would tell it from the others."
    )
    return [*blocks, Text(words, "note")]


def _stated(d: Diagnosis, assumed: Sequence[tuple[str, str]]) -> list[Table]:
    """What the case states, and facts on the model; one that is its own has no error."""
    facts = {key: value for key, value in d.model.items() if key not in _SAID}
    if "basis" in facts:
        facts["frequency_error"] = d.model_error
    caption = "Stated by the case file before the test was looked at"
    table = Table(" | ", caption=caption, id="assumed")
    for name, value in assumed:
        table.add(name, value)
    return [*([table] if assumed else []), facts_table(facts)]


def _nuisances(lead: HypothesisResult) -> list:
    """Where what is uncertain in any case ended."""
    words = (
        "Known only within a tolerance, these were free in every hypothesis. One that ends more "
        f"than {number(FAR, 2)} standard deviations from its expected value is marked: then "
        "something else may be at work."
    )
    rows = [(p["effect"], [p]) for p in lead.parameters if p["nuisance"]]
    limits = ", ".join(lead.at_bound) or "none"
    return [
        Heading("Uncertain in any case", level=3),
        Text(words),
        _parameters(rows, f"Where they ended under {named(lead)}", "nuisances", "none"),
        Text(f"Parameters at a limit of their range: {limits}."),
    ]


def _taken(d: Diagnosis) -> list:
    """Assumptions."""
    return [Heading("Assumptions", level=3), Items([_LINEAR[d.by_level], *_ASSUMPTIONS])]
