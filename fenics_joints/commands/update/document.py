"""The document of an update: its sentences, tables and figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np

from fenics_joints.beams import BeamStructure
from fenics_joints.case import Case
from fenics_joints.commands.update.pictures import (
    convergence_chart,
    function_charts,
    shown_functions,
)
from fenics_joints.commands.update.result import Functions, ModeTable, UpdateReport
from fenics_joints.commands.update.words import accuracy, decibel, in_words, start_words
from fenics_joints.formatting import condition_value, hertz, number, percent, quantity, spread
from fenics_joints.measurements import Target
from fenics_joints.modal.modes import Modes
from fenics_joints.reduction.frf_basis import paired
from fenics_joints.report import document as doc
from fenics_joints.report.mesh_pictures import MeasuredModes, Shape, largest_axis, shapes_view
from fenics_joints.report.panels import frequency_panels, parameter_panels
from fenics_joints.report.tables import facts_table, frequency_table, heat_table, mac_table
from fenics_joints.structure import Structure

#: Modes that have a picture for paper: one sheet's worth.
_STILLS = 6
#: Rows of each table on the terminal, so that all of it fits on a screen.
_PARAMETERS, _MODES = 8, 10
#: The method in words.
_METHODS = {
    "log": "Maximum likelihood, on the logarithms of frequencies, damping ratios and FRFs",
    "weighted": "Weighted equations of Machines 2022 (eqs. 15 to 20)",
}
_KINDS = {
    "frequencies": "frequencies",
    "shapes": "mode shapes",
    "damping": "damping ratios",
    "frfs": "FRFs",
}
#: Ids on the page of the errors that have changed, and what they are errors of.
_CHANGES = {
    "frequencies": ("gap-after", "of the frequencies"),
    "damping ratios": ("damping-after", "of the damping ratios"),
    "FRFs": ("level-after", "of |H| over all lines"),
}


def update_document(r: UpdateReport) -> doc.Document:
    """The document of an update."""
    end = "" if r.update.converged else ", not converged"
    end = end if r.failure is None else ": EXPLAINS NOTHING"
    *others, last = [_KINDS[kind] for kind in r.kinds]
    data, at = f"{', '.join(others)} and {last}" if others else last, ""
    if r.condition is not None:
        name, value, unit = r.condition
        at = f" at {name} {condition_value(value, unit)}"
    how = f"{r.update.evaluations} evaluations of the model; {r.update.message}."
    held, worse = held_words(r)
    end += ", worse on held-out data" if worse else ""
    answers = [("Fitted" if held else "", verdict_words(r)), ("Held out", held)]
    sentences = [*(reversed(answers) if worse else answers), ("", how)]
    return doc.Document(
        r.title,
        "update",
        f"Model updating on measured {data}",
        [
            doc.Verdict(
                f"Update{at} on {data}{end}",
                [pair for pair in sentences if pair[1]],
                "v-likely" if worse else "",
                "bold yellow" if worse else "bold",
            ),
            doc.Remarks("Notes", r.notes, "note: "),
            doc.OnPage([doc.Keys(_keys(r))]),
            *_parameters(r),
            *([] if r.modes is None else _modes(r, r.modes)),
            *([] if not r.held else _held(r)),
            *([] if r.modes is None else _macs(r.modes)),
            *([] if r.functions is None else _functions(r.functions)),
            *([] if r.sweep is None else _sweep(r)),
            doc.OnPage(_basis(r)),
        ],
        r.to_json,
    )


def _keys(r: UpdateReport) -> list[tuple[str, str, str]]:
    keys = []
    for kind, (before, after) in r.changes().items():
        if kind in _CHANGES:
            key, words = _CHANGES[kind]
            keys.append((key, after, f"RMS error {words} after the update (before: {before})"))
    held = r.held_changes()
    if "FRFs" in held:
        before, after = map(decibel, held["FRFs"])
        keys.append(("level-held", after, f"RMS error of held-out |H| (before: {before})"))
    if "frequencies" in held:
        before, after = map(percent, held["frequencies"])
        words = f"RMS error of the frequencies {_held_out(r)} (before: {before})"
        keys.append(("held-rms", after, words))
    dof, chi2 = r.update.degrees_of_freedom, r.update.chi2
    if dof > 0 and np.isfinite(chi2):
        words = "RMS residual in standard deviations of the noise (1: only noise is left)"
        keys.append(("misfit", number(float(np.sqrt(chi2 / dof)), 2), words))
    if r.sweep is not None and r.sweep.curves:
        keys += [(f"curve-{k}", g, f"error on the curves, {words}") for k, g, words in _gaps(r)]
    return keys


def _gaps(r: UpdateReport) -> list[tuple[str, str, str]]:
    words = {
        "fitted": "at the conditions they were fitted to",
        "heldout": "at conditions held out",
        "validation": "validation",
    }
    gaps = r.sweep.gaps()
    return [(key, percent(gaps[key]), w) for key, w in words.items() if gaps[key] is not None]


def verdict_words(r: UpdateReport) -> str:
    """Errors before and after in a sentence; the MAC where shapes alone are data."""
    found = r.changes()
    if not found:
        return ""
    if "lowest MAC" in found:
        before, after = found["lowest MAC"]
        return f"The lowest MAC went from {before} to {after}."
    return f"{_went(found)}."


def held_words(r: UpdateReport) -> tuple[str, bool]:
    """Held-out errors before and after in a sentence or "", and whether any of them is larger."""
    changes = r.held_changes()
    if not changes:
        return "", False
    write = {"damping ratios": partial(percent, digits=1), "FRFs": decibel}
    words = _went({k: tuple(map(write.get(k, percent), pair)) for k, pair in changes.items()})
    if worse := any(after > before for before, after in changes.values()):
        words += ": the updated model predicts unseen data worse than the baseline model"
    return f"{words}.", worse


def _went(changes: Mapping[str, tuple[str, str]]) -> str:
    (what, (before, after)), *others = changes.items()
    words = [f"The error of the {what} went from {before} to {after}"]
    words += [f"that of the {what} from {before} to {after}" for what, (before, after) in others]
    return ", ".join(words)


# -- parameters ------------------------------------------------------------------------------------


def _parameters(r: UpdateReport) -> list:
    """Identified parameters, and which of them the data determine."""
    u, found = r.update, r.update.identifiability
    given = {} if r.published is None else r.published["parameters"]
    source = r.published["source"] if given else ""
    rows = []
    for p in r.parameters:
        sd = p["relative_standard_deviation"]
        row = {"name": p["name"], "sd": doc.Cell(accuracy(sd), value=sd)}
        values = {"start": p["start"], "value": p["value"]}
        values |= {"published": given.get(p["name"])} if given else {}
        rows.append(
            row | {k: doc.Cell(quantity(v, p["unit"], 4), value=v) for k, v in values.items()}
        )
    table = doc.Table.of(
        rows,
        {
            **{"name": "parameter", "start": ">start", "value": ">identified", "sd": ">s.d."},
            "published": f">{source or 'published'}",
        },
        caption=_METHODS[u.method],
        id="values",
        most=_PARAMETERS,
        on_page=("published",),
    )
    words = [doc.Text(line, "note") for line in in_words(found)]
    if r.failure is not None:
        words = [doc.Text("This fit explains nothing of the test: do not use its values.", "bad")]
    pull, (before, after) = start_words(found, r.pull), r.conditions
    if len(r.parameters) > 1 and np.isfinite(before):
        weighted = u.method == "weighted"
        how = "with rows and columns weighted (eq. 18)" if weighted else "in logarithms"
        said = f"Condition number of the sensitivities at the start: {number(before, 2)} in SI"
        said += f" units (Machines 2022, eq. 16), {number(after, 2)} {how}."
        words.append(doc.Text(said, "note"))
    weakest = sorted(zip(found.names, found.weakest, strict=True), key=lambda p: -abs(p[1]))
    direction = ", ".join(f"{name} {share:+.2f}" for name, share in weakest)
    facts = doc.Table(" | ")
    collinearity = (
        "collinearity index at the end (1: independent; above 20: hardly distinguishable)"
    )
    facts.add(collinearity, number(found.collinearity))
    facts.add("combination of logarithms that the data determine least", direction)
    steps = "Parameters over the steps of the fit."
    if u.method == "log" and r.functions is not None:
        steps += (
            " First the lines of the FRFs move along with the model's resonances, so that a "
            "resonance that is far off does not mislead the fit; then the FRFs are fitted at their "
            "measured frequencies."
        )
    return [
        doc.Heading("Parameters", "parameters"),
        table,
        doc.Heading("Which parameters the data determine", "identifiability", level=3),
        *words,
        *([] if pull is None else [doc.Text(pull, "note", "pull")]),
        doc.OnPage([facts]),
        doc.Figure(lambda: convergence_chart(r), steps),
    ]


# -- modes -----------------------------------------------------------------------------------------


def _written(key: str, value) -> str:
    """A number of an update by its key."""
    if isinstance(value, str) or value is None:
        return doc.by_unit(key, value)
    if key.endswith("standard_deviation_percent"):
        return accuracy(value / 100)
    if key.startswith(("mac", "frac")):
        return f"{value:.3f}"
    if key.endswith("_db"):
        return decibel(value)
    if key.startswith("damping"):
        tenth = key.endswith("percent")
        return percent(value / 100, 1, sign=True) if tenth else f"{number(100 * value)} %"
    return doc.by_unit(key, value)


def _modes(r: UpdateReport, modes: ModeTable) -> list:
    """Frequencies, shapes and damping ratios of the test's modes, before and after."""

    def starred(fitted: str) -> list[dict]:
        rows = modes.records()
        return [row | {"name": row["name"] + " *" * (not row[fitted])} for row in rows]

    table = doc.Table.of(
        starred("fitted"),
        "name: mode | test_hz: >test, Hz | before_hz: >before, Hz | after_hz: >after, Hz | "
        "error_before_percent: >before | error_after_percent: >after | mac_after: >MAC | "
        "mac_before: >MAC before",
        write=_written,
        id="modes-fitted",
        most=_MODES,
        on_page=("mac_before",),
    )
    blocks = [doc.Heading("Modes", "modes"), table]
    if not modes.fitted.all():
        open_, left = set(np.flatnonzero(~modes.fitted).tolist()), set(r.update.widths.without)
        reasons = ["held out"] * bool(open_ - left and r.held)
        reasons += ["left out for the reason given above"] * bool(open_ & left)
        why = f": {' or '.join(reasons)}" if reasons else ""
        blocks.append(doc.Text(f"* its frequency was not fitted{why}", "note"))
    if r.shapes is not None:
        blocks.append(doc.OnPage(r.shapes))
    if modes.damping is not None:
        rows = [row for row in starred("damping_fitted") if row["damping_test"] is not None]
        table = doc.Table.of(
            rows,
            "name: damping ratio | damping_test: >test | damping_before: >before | "
            "damping_after: >after | damping_error_before_percent: >error before | "
            "damping_error_after_percent: >error after",
            write=_written,
            id="damping-ratios",
            most=_MODES,
        )
        blocks += [doc.Heading("Damping ratios", "damping", level=3), table]
        if not all(row["damping_fitted"] for row in rows):
            blocks.append(doc.Text("* its damping ratio was not fitted", "note"))
    if r.published is not None and theirs(r):
        blocks.append(doc.OnPage([_published(r, modes)]))
    return blocks


def _macs(modes: ModeTable) -> list:
    """MAC of the test by the model, before and after."""
    if modes.mac_after is None:
        return []
    numbers = range(1, len(modes.names) + 1)
    pairs = (("Before", modes.mac_before), ("After", modes.mac_after))
    tables = [mac_table(matrix, modes.names, numbers, caption) for caption, matrix in pairs]
    heading = doc.Heading("Modal assurance criterion, test by model", "mac", level=3)
    return [heading, doc.Beside("pair", tables)]


def _published(r: UpdateReport, modes: ModeTable) -> doc.Table:
    """This model with somebody's parameters, beside that somebody's model."""
    published, source = r.published, r.published["source"] or "published"
    numbers = {key: published[key] for key in ("frequencies_hz", "model_hz", "errors_percent")}
    rows = [
        dict(zip(("name", "test_hz", *numbers), row, strict=True))
        for row in zip(modes.names, modes.test.tolist(), *numbers.values(), strict=True)
    ]
    return doc.Table.of(
        rows,
        "name: mode | frequencies_hz: >published model, Hz | model_hz: >this model, Hz | "
        "errors_percent: >this over published | test_hz: >measured, Hz",
        caption=f"This model and the published one, both with the published parameters ({source}): "
        "any difference comes from the models",
        id="published",
    )


def theirs(r: UpdateReport) -> dict[str, float]:
    """Errors of the published frequencies in per cent, by mode; empty without parameters."""
    if r.published is None or r.modes is None or not r.published["parameters"]:
        return {}
    rows = zip(r.modes.names, r.published["frequencies_hz"], r.modes.test, strict=False)
    return {name: 100 * (f / test - 1) for name, f, test in rows if f is not None}


def _held_out(r: UpdateReport) -> str:
    in_turn = len(r.held) > 1 and all(h["alone"] for h in r.held)
    return "held out in turn" if in_turn else "held out"


def _held(r: UpdateReport) -> list:
    """Modes that were held out, as the fit predicts them."""
    published = theirs(r)
    rows = [
        h | ({"published_percent": published.get(h["name"])} if published else {}) for h in r.held
    ]

    table = doc.Table.of(
        rows,
        f"name: {_held_out(r)} | test_hz: >test, Hz | predicted_hz: >predicted, Hz | "
        "error_percent: >error | standard_deviation_percent: >± s.d. | "
        "published_percent: >published fit | before_hz: >before, Hz",
        write=_written,
        id="held-modes",
        most=_MODES,
        on_page=("before_hz",),
    )
    ratios = doc.Table.of(
        [h for h in rows if "damping_test" in h],
        "name: damping ratio, held out | damping_test: >test | "
        "damping_predicted: >predicted | damping_error_percent: >error | "
        "damping_standard_deviation_percent: >± s.d. | damping_before: >before",
        write=_written,
        id="held-ratios",
        most=_MODES,
        on_page=("damping_before",),
    )
    how = (
        "Each mode was left out in turn and the model refitted to the remaining data."
        if "turn" in _held_out(r)
        else "These modes were not used in the fit."
    )
    note = (
        f"{how} The standard deviation covers the noise of the data only; an error well above it "
        "is an error of the model."
    )
    return [
        doc.Heading("Held-out modes, predicted by a fit to the other data", "held", level=3),
        table,
        *([ratios] if ratios.rows else []),
        doc.OnPage([doc.Text(note, "note")]),
    ]


def updated_shapes(
    case: Case, full: Structure | BeamStructure, target: Target, modes: Modes, table: ModeTable
) -> Callable[[], list] | None:
    """Draws the shapes of the test's modes, beside what was measured of them. Collective.

    Args:
        case: The case, whose measured shapes stand beside.
        full: The full model, whose cells are drawn.
        target: The test's data.
        modes: Modes of the updated model, in full.
        table: The test's modes.

    Returns:
        A function that makes the blocks; None on other ranks than 0, and without modes of the full
        model.
    """
    if not len(target) or modes.model.n_dofs != full.n_dofs:
        return None
    pairing, test = paired(modes, target), case.measurements().shapes
    vertices, motions = full.corner_motion([modes.vector(int(i)) for i in pairing.index])
    sensors = None if test is None else target.shape_sensors
    seen = None if sensors is None else modes.at(sensors)[:, pairing.index]
    if not len(vertices):
        return None

    def blocks() -> list:
        measured, shapes = None, []
        if seen is not None and sensors.points.shape[1] == 3:
            measured = MeasuredModes(table.names, sensors, test)
        for j, (i, motion) in enumerate(zip(pairing.index, motions, strict=True)):
            title = f"{table.names[j]}, {hertz(float(modes.frequencies_hz[i]))} Hz"
            at_sensors = None if measured is None else seen[:, j]
            shapes.append(Shape(title, motion, largest_axis(motion), at_sensors, j))
        heading = doc.Heading("Shapes of the updated model", "shapes", level=3)
        return [heading, shapes_view(vertices, shapes, _STILLS, measured=measured)]

    return blocks


# -- functions -------------------------------------------------------------------------------------


def _functions(functions: Functions) -> list:
    """Measured functions beside the model's."""
    found, models = functions.summary(), ("before", "after")
    kinds = {"all": "all lines", "fitted": "lines that were fitted", "held": "held out"}
    levels = doc.Table.of(
        [
            {"kind": words, **{f"{m}_db": found[f"{key}_{m}"] for m in models}}
            for key, words in kinds.items()
            if found[f"{key}_after"] is not None
        ],
        "kind: FRFs, error of the level | before_db: >before | after_db: >after",
        write=_written,
        caption="Root mean square of 20 lg |H model / H test|",
        id="levels",
    )
    rows = []
    for i, j in np.argwhere(~np.isnan(functions.measured[0])):
        one = np.zeros(functions.measured.shape, dtype=bool)
        one[:, i, j] = True
        held = " (held out)" if functions.held[:, i, j].all() else ""
        row = {"response": f"{functions.names[0][i]}{held}", "force": functions.names[1][j]}
        for name in models:
            model = getattr(functions, name)
            row[f"{name}_db"] = functions.decibels(model, one)
            row[f"frac_{name}"] = float(functions.frac(model)[i, j])
        rows.append(row)
    each = doc.Table.of(
        rows,
        "response: response | force: force | before_db: >before | after_db: >after | "
        "frac_before: >FRAC before | frac_after: >FRAC after",
        write=_written,
        caption="FRAC: frequency response assurance criterion (1: equal up to a factor)",
    )
    shown, words = len(shown_functions(functions)), ""
    if shown < len(rows):
        words = f"{shown} of {len(rows)} FRFs: those held out, then the worst fits. "
    words += "Ticks mark the fitted lines, most of them where the FRFs change most."
    return [
        doc.Heading("Frequency response functions", "functions"),
        doc.OnPage(lambda: [function_charts(functions), doc.Text(words, "note")]),
        levels,
        doc.Folded("Each FRF", [each]),
    ]


# -- conditions ------------------------------------------------------------------------------------


def _sweep(r: UpdateReport) -> list:
    """Fits at all conditions, and curves over them."""
    (name, _, unit), sweep, panels = r.condition, r.sweep, parameter_rows(r)
    blocks = [doc.Heading(f"Over the {name}", "conditions")]
    if panels:
        caption = (
            "Each point was identified at one condition; a bar that leaves the panel means that "
            "the data at this condition do not determine the parameter."
        )
        blocks.append(doc.Figure(lambda: parameter_panels(panels, (name, unit)), caption))
    blocks.append(doc.OnPage([_fits(r)]))
    if sweep.curves:
        gaps = ", ".join(f"{gap} {words}" for _, gap, words in _gaps(r))
        said = f"On the curves over the {name} the error is {gaps} (RMS)."
        blocks += [doc.Heading("Curves", level=3), doc.OnPage([_curves(r)]), doc.Text(said)]
    on, labels = sweep.frequencies, ("", "model on the curves")
    if on is not None:
        validation = None if sweep.validation is None else (None, sweep.validation)

        def draw() -> str:
            more = {"log_sd": sweep.log_sd, "held_out": sweep.held_out, "validation": validation}
            return frequency_panels(None, on, (name, unit), labels=labels, **more)

        blocks += [
            doc.Figure(
                draw, "Points are measured, lines are the model with its parameters on the curves."
            ),
            doc.OnPage([heat_table("Model on the curves", on, (name, unit))]),
        ]
    if sweep.validation is not None:
        table = frequency_table("Validation", None, sweep.validation, (name, unit), labels)
        heading = doc.Heading("Validation: data that were never fitted", "validation", level=3)
        blocks.append(doc.OnPage([heading, table]))
    return blocks


def _fits(r: UpdateReport) -> doc.Table:
    """Parameters identified at each condition, and the remaining errors."""
    name, _, unit = r.condition
    rows = []
    for fit in r.sweep.fits:
        star = " *" if fit["held_out"] else ""
        row = {"condition": f"{condition_value(fit['condition'], unit)}{star}"}
        for p in r.parameters:
            sd = fit["sd"].get(p["name"])
            sign = "± " if sd is not None and sd < 0.3 else ""
            value = fit["parameters"][p["name"]]
            words = f"{quantity(value, p['unit'])} {sign}{spread(sd)}"
            row[p["name"]] = doc.Cell(words, value=value)
        errors = zip(r.modes.names, fit["errors_percent"], strict=True)
        rows.append(row | {f"{mode}, error_percent": error for mode, error in errors})
    columns = {"condition": name, **{p["name"]: f">{p['name']}" for p in r.parameters}}
    return doc.Table.of(
        rows,
        columns | {f"{mode}, error_percent": f">{mode}" for mode in r.modes.names},
        caption="Identified at each condition with its standard deviation, and the remaining "
        "errors; * held out of the curves",
        id="fits",
    )


def _curves(r: UpdateReport) -> doc.Table:
    units, rows = {p["name"]: p["unit"] for p in r.parameters}, []
    for curve in r.sweep.curves:
        numbers = {k: v for k, v in curve.items() if isinstance(v, int | float)}
        words = ", ".join(f"{key} = {number(value, 4)}" for key, value in numbers.items())
        unit = f", {units[curve['name']]}" if units.get(curve["name"]) else ""
        row = {"name": f"{curve['name']}{unit}", "form": curve["form"], "coefficients": words}
        rows.append(row)
    return doc.Table.of(
        rows,
        "name: parameter | form: form | coefficients: coefficients",
        caption="Fitted to the conditions that were not held out; T in "
        f"{r.condition[2] or 'its unit'}",
        id="curves",
    )


def parameter_rows(r: UpdateReport) -> list[dict]:
    """Input of `parameter_panels`, a row for each parameter."""
    if r.sweep is None or len(r.sweep.fits) < 2:
        return []
    fits = sorted(r.sweep.fits, key=lambda fit: fit["condition"])
    x = np.array([fit["condition"] for fit in fits], dtype=float)
    by_name = {curve["name"]: curve for curve in r.sweep.curves}
    return [
        {
            "name": p["name"],
            "unit": p["unit"],
            "x": x,
            "value": np.array([fit["parameters"][p["name"]] for fit in fits]),
            "sd": np.array([fit["sd"].get(p["name"], np.nan) for fit in fits], dtype=float),
            "held_out": np.array([bool(fit["held_out"]) for fit in fits]),
            "curve": curve_line(by_name.get(p["name"]), x),
        }
        for p in r.parameters
    ]


def curve_line(curve: Mapping | None, x: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Points on a parameter's curve, or None if it is not known how it runs.

    Args:
        curve: Row of ``Sweep.curves``. Its ``samples``, pairs (condition, value), are taken
            if it has any; a pure power law is evaluated; other formulas are not guessed at.
        x: Conditions to span, shape (n,), ascending.
    """
    if curve is None:
        return None
    if curve.get("samples"):
        points = np.asarray(curve["samples"], dtype=float)
        return points[:, 0], points[:, 1]
    if curve["form"] != "a (T/T0)^b" or np.any(x <= 0):
        return None
    fine = np.geomspace(x[0], x[-1], 60)
    return fine, curve["a"] * (fine / curve["T0"]) ** curve["b"]


def _basis(r: UpdateReport) -> list:
    """The model and the assumptions of the update."""
    held = " and that update.regularisation keeps each parameter near its start" if r.pull else ""
    reduced = "The fit used the full model, without reduction."
    if r.model.get("samples"):
        reduced = (
            "The fit used a reduced model, which was checked against the full one at the "
            "identified values; all numbers and curves before and after come from the full model."
        )
    note = (
        "Standard deviations are relative and follow from the stated noise of the data; they "
        f"assume that the model is correct{held}. A large one is given as the factor by which the "
        f"value may be smaller or larger. {reduced}"
    )
    heading = doc.Heading("Model and assumptions", "rests-on")
    return [heading, facts_table(r.model), doc.Text(note, "note")]
