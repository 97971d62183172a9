"""What is said of an update."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from fenics_joints.case.notes import OF_MODEL
from fenics_joints.commands.update.pictures import (
    convergence_chart,
    function_charts,
    shown_functions,
)
from fenics_joints.commands.update.result import (
    Compared,
    Functions,
    ModeTable,
    Predicted,
    UpdateReport,
)
from fenics_joints.commands.update.view import UpdatedShapes
from fenics_joints.commands.update.words import (
    accuracy,
    decibel,
    in_words,
    ratio_words,
    start_words,
)
from fenics_joints.formatting import condition_value, hertz, number, percent, quantity, spread
from fenics_joints.measurements.gap import rms
from fenics_joints.report.document import (
    Beside,
    Document,
    Figure,
    Folded,
    Heading,
    Keys,
    OnPage,
    Remarks,
    Table,
    Text,
    Verdict,
    View,
)
from fenics_joints.report.mesh_pictures import measured_arrows, mode_shape, modes_view
from fenics_joints.report.panels import frequency_panels, parameter_panels
from fenics_joints.report.tables import facts_table, frequency_table, heat_table, mac_table

#: Modes that have a picture for paper.
_STILLS = 6
#: Rows of each table on the terminal.
_PARAMETERS, _MODES = 8, 10
#: The method in words.
_METHODS = {
    "log": "Maximum likelihood; frequencies, ratios and functions count by their logarithms",
    "weighted": "By the weighted equations of Machines 2022 (eqs. 15 to 20)",
}
_KINDS = {
    "frequencies": "frequencies",
    "shapes": "mode shapes",
    "damping": "damping ratios",
    "frfs": "functions",
}


def update_document(r: UpdateReport) -> Document:
    """What is said of an update."""
    end = "" if r.update.converged else ", not converged"
    end = end if r.failure is None else ": EXPLAINS NOTHING"
    at = f" at {words}" if (words := at_words(r)) else ""
    how = f"{r.update.evaluations} evaluations of the model; {r.update.message}."
    sentences = [("", words) for words in (verdict_words(r), how) if words]
    notes = [note if note.startswith(OF_MODEL) else f"but: {note}" for note in r.notes]
    return Document(
        r.title,
        "update",
        f"Model updating on measured {data_words(r)}",
        [
            Verdict(f"Update{at} on {data_words(r)}{end}", sentences),
            Remarks("But", notes),
            OnPage([Keys(_keys(r))]),
            *_parameters(r),
            *_modes(r),
            *_held(r),
            *_macs(r),
            *([] if r.functions is None else _functions(r.functions)),
            *_sweep(r),
            OnPage(_basis(r)),
        ],
        r.to_json,
    )


def _keys(r: UpdateReport) -> list[tuple[str, str, str]]:
    keys, modes = [], r.modes
    errors = None if modes is None else modes.rms()
    if errors is not None:
        before, after = map(percent, errors)
        words = f"error of the frequencies after, RMS (before {before})"
        keys.append(("gap-after", after, words))
    if modes is not None and modes.damping is not None:
        before, after = (percent(e, 1) for e in modes.damping.rms())
        words = f"error of the damping ratios after, RMS (before {before})"
        keys.append(("damping-after", after, words))
    if r.functions is not None:
        levels = {key: decibel(value) for key, value in r.functions.summary().items()}
        words = f"error of |H| after, RMS over all lines (before {levels['all_before']})"
        keys.append(("level-after", levels["all_after"], words))
        if r.functions.held.any():
            words = f"error of |H| where no fit looked (before {levels['held_before']})"
            keys.append(("level-held", levels["held_after"], words))
    if r.held:
        error = percent(rms(np.array([h.error for h in r.held])))
        keys.append(("held-rms", error, f"{_held_out(r)}: error of what was predicted, RMS"))
    dof, chi2 = r.update.degrees_of_freedom, r.update.chi2
    if dof > 0 and np.isfinite(chi2):
        words = "RMS residual in standard deviations of the noise; 1 if noise is all that is left"
        keys.append(("misfit", number(float(np.sqrt(chi2 / dof)), 2), words))
    if r.sweep is not None and r.sweep.curves:
        keys += [(f"curve-{key}", gap, words) for key, gap, words in _curve_gaps(r)]
    return keys


def _curve_gaps(r: UpdateReport) -> list[tuple[str, str, str]]:
    words = {
        "fitted": "gap on the curves, at the conditions they were fitted to",
        "heldout": "gap on the curves, at conditions held out",
        "validation": "gap on the curves, validation",
    }
    gaps = r.sweep.gaps()
    return [(key, percent(gaps[key]), said) for key, said in words.items() if gaps[key] is not None]


def data_words(r: UpdateReport) -> str:
    """The kinds of data, such as ``frequencies and functions``."""
    *others, last = [_KINDS[kind] for kind in r.kinds]
    return f"{', '.join(others)} and {last}" if others else last


def verdict_words(r: UpdateReport) -> str:
    """Errors before and after in a sentence; the MAC where shapes alone are data."""
    found = r.changes()
    if not found:
        return ""
    (what, before, after), *others = found
    if "MAC" in what:
        return f"The {what} {before} -> {after}."
    words = [f"The error of the {what} went from {before} to {after}"]
    words += [f"that of the {what} from {before} to {after}" for what, before, after in others]
    return f"{', '.join(words)}."


def at_words(r: UpdateReport) -> str:
    """The condition, such as ``torque 20 N·m``; empty without one."""
    if r.condition is None:
        return ""
    name, value, unit = r.condition
    return f"{name} {condition_value(value, unit)}"


# -- parameters ------------------------------------------------------------------------------------


def _parameters(r: UpdateReport) -> list:
    """What was identified, and what the data determine of it."""
    u, found, published = r.update, r.update.identifiability, r.published
    given = {} if published is None else published["parameters"]
    table = Table(
        [
            "parameter",
            ">start",
            ">identified",
            ">s.d.",
            *([f">{published['source'] or 'published'}"] if given else []),
        ],
        caption=_METHODS[u.method],
        id="values",
        most=_PARAMETERS,
        page_columns=int(bool(given)),
    )
    for p in r.parameters:
        start, value = (quantity(p[key], p["unit"], 4) for key in ("start", "value"))
        theirs = [quantity(given.get(p["name"]), p["unit"], 4)] if given else []
        table.add(p["name"], start, value, accuracy(p["sd"]), *theirs)
    words = [Text(line, "note") for line in in_words(found)]
    if r.failure is not None:
        words = [Text("This fit explains nothing of the test: do not use its values.", "bad")]
    pull, (before, after) = start_words(found, r.pull), r.conditions
    how = "weighted from left and right (eq. 18)" if u.method == "weighted" else "by logarithms"
    if len(r.parameters) > 1 and np.isfinite(before):
        said = (
            f"condition number of the sensitivities at the start: {number(before, 2)} in SI units"
        )
        words.append(Text(f"{said} (Machines 2022, eq. 16), {number(after, 2)} {how}", "note"))
    weakest = sorted(zip(found.names, found.weakest, strict=True), key=lambda p: -abs(p[1]))
    direction = ", ".join(f"{name} {share:+.2f}" for name, share in weakest)
    facts = Table(" | ")
    collinearity = "collinearity index at the end (1: independent; above 20: hardly told apart)"
    facts.add(collinearity, number(found.collinearity))
    facts.add("direction that the data determine least, by logarithms", direction)
    steps = "From the start to the end."
    if u.method == "log" and r.functions is not None:
        steps += (
            " First the functions' lines are moved along with the model's resonances, so that a "
            "resonance that is far off does not mislead; then they are fitted where they were "
            "measured."
        )
    return [
        Heading("Parameters", "parameters"),
        table,
        Heading("What the data determine", "identifiability", level=3),
        *words,
        *([] if pull is None else [Text(pull, "note", "pull")]),
        OnPage([facts]),
        Figure(lambda: convergence_chart(r), steps),
    ]


# -- modes -----------------------------------------------------------------------------------------


def _modes(r: UpdateReport) -> list:
    """Frequencies, shapes and damping ratios of the test's modes, before and after."""
    modes = r.modes
    if modes is None:
        return []
    macs, columns = None, []
    if modes.mac_after is not None:
        macs = [np.diag(modes.mac_after), np.diag(modes.mac_before)]
        columns = [">MAC", ">MAC before"]
    headings = ("mode", ">test, Hz", ">before, Hz", ">after, Hz", ">before", ">after", *columns)
    table = Table(headings, id="modes-fitted", most=_MODES, page_columns=len(columns) // 2)
    _add_compared(table, modes, modes.names, range(len(modes.names)), hertz, 2, macs)
    blocks = [Heading("Modes", "modes"), table]
    if not modes.fitted.all():
        blocks.append(Text(f"* its frequency was not fitted{_why_not(r)}", "note"))
    if r.shapes is not None:
        blocks.append(OnPage(lambda: _shapes_blocks(r.shapes, modes)))
    damping = modes.damping
    if damping is not None:
        headings = ("damping ratio", ">test", ">before", ">after", ">error before", ">error after")
        table = Table(headings, id="damping-ratios", most=_MODES)
        _add_compared(table, damping, modes.names, damping.measured, ratio_words, 1)
        blocks += [Heading("Damping ratios", "damping", level=3), table]
        if not damping.fitted[damping.measured].all():
            blocks.append(Text("* its damping ratio was not fitted", "note"))
    return [*blocks, *_published(r)]


def _add_compared(
    table: Table,
    found: Compared,
    names: Sequence[str],
    rows: Sequence[int],
    words: Callable[[float], str],
    digits: int,
    macs: Sequence[np.ndarray] | None = None,
) -> None:
    """Add a row for each mode, before and after."""
    for j in rows:
        numbers = (words(values[j]) for values in (found.test, found.before, found.after))
        errors = found.error_before[j], found.error_after[j]
        table.add(
            names[j] if found.fitted[j] else f"{names[j]} *",
            *numbers,
            *(percent(error, digits, sign=True) for error in errors),
            *(f"{mac[j]:.3f}" for mac in macs or ()),
        )


def _why_not(r: UpdateReport) -> str:
    """Why some frequencies were not fitted, behind a sentence that says so."""
    open_, left = set(np.flatnonzero(~r.modes.fitted).tolist()), set(r.update.widths.without)
    reasons = ["held out"] * bool(open_ - left and r.held)
    reasons += ["left out for the reason given above"] * bool(open_ & left)
    return f": {' or '.join(reasons)}" if reasons else ""


def _published(r: UpdateReport) -> list:
    """This model with somebody's parameters, beside that somebody's model."""
    published = r.published
    if published is None or not published["parameters"] or not theirs(r):
        return []
    source = published["source"] or "published"
    table = Table(
        "mode | >published model, Hz | >this model, Hz | >this over published | >measured, Hz",
        caption=f"This model with the published parameters ({source}) beside the published model: "
        "what differs is the models, not the parameters",
        id="published",
    )
    columns = (published[key] for key in ("frequencies_hz", "model_hz", "errors_percent"))
    for name, hz, own, error, test in zip(r.modes.names, *columns, r.modes.test, strict=True):
        ratio = None if error is None else error / 100
        table.add(name, hertz(hz), hertz(own), percent(ratio, 2, sign=True), hertz(test))
    return [OnPage([table])]


def theirs(r: UpdateReport) -> dict[str, float]:
    """Errors of the published frequencies, model over test minus one, by mode."""
    if r.published is None or r.modes is None:
        return {}
    return {
        name: f / test - 1
        for name, f, test in zip(
            r.modes.names, r.published["frequencies_hz"], r.modes.test, strict=False
        )
        if f is not None
    }


def _held_out(r: UpdateReport) -> str:
    in_turn = len(r.held) > 1 and all(h.alone for h in r.held)
    return "held out in turn" if in_turn else "held out"


def _held(r: UpdateReport) -> list:
    """What a fit predicted that did not see it."""
    if not r.held:
        return []
    published = theirs(r)
    table = Table(
        [
            _held_out(r),
            ">test, Hz",
            ">predicted, Hz",
            ">error",
            ">± s.d.",
            *([">published fit"] if published else []),
            ">before, Hz",
        ],
        id="held-modes",
        most=_MODES,
        page_columns=1,
    )
    ratios = Table(
        "damping ratio, held out | >test | >predicted | >error | >± s.d. | >before",
        id="held-ratios",
        most=_MODES,
        page_columns=1,
    )
    for h in r.held:
        error = [percent(published.get(h.name), 2, sign=True)] if published else []
        table.add(h.name, *_predicted(h, hertz, 2), *error, hertz(h.before))
        if (d := h.damping) is not None:
            ratios.add(h.name, *_predicted(d, ratio_words, 1), ratio_words(d.before))
    how = (
        "Each mode was left out in turn and the model fitted anew to all else."
        if "turn" in _held_out(r)
        else "These modes took no part in the fit."
    )
    note = (
        f"{how} The standard deviation is what the data's noise does to the prediction; an error "
        "well above it is one of the model."
    )
    return [
        Heading("Held out: predicted by a fit that did not see it", "held", level=3),
        table,
        *([ratios] if ratios.rows else []),
        OnPage([Text(note, "note")]),
    ]


def _predicted(found: Predicted, words: Callable[[float], str], digits: int) -> list[str]:
    error = percent(found.error, digits, sign=True)
    return [words(found.test), words(found.predicted), error, accuracy(found.sd)]


def _macs(r: UpdateReport) -> list:
    if r.modes is None or r.modes.mac_after is None:
        return []
    names, numbers = r.modes.names, range(1, len(r.modes.names) + 1)
    pairs = (("Before", r.modes.mac_before), ("After", r.modes.mac_after))
    tables = [mac_table(matrix, names, numbers, caption) for caption, matrix in pairs]
    heading = Heading("Modal assurance criterion, test by model", "mac", level=3)
    return [heading, Beside("pair", tables)]


# -- functions -------------------------------------------------------------------------------------


def _functions(functions: Functions) -> list:
    """Measured functions beside the model's."""
    found = functions.summary()
    levels = Table(
        "functions, rms of |H| in dB | >before | >after",
        caption="Root mean square of 20 lg |H model / H test|",
        id="levels",
    )
    kinds = {"all": "all lines", "fitted": "lines that were fitted", "held": "held out"}
    for key, words in kinds.items():
        if found[f"{key}_after"] is not None:
            levels.add(words, decibel(found[f"{key}_before"]), decibel(found[f"{key}_after"]))
    each = Table(
        "response | force | >before | >after | >FRAC before | >FRAC after",
        caption="FRAC: frequency response assurance criterion, 1 if alike but for a factor",
    )
    models = (functions.before, functions.after)
    fracs = [functions.frac(model) for model in models]
    pairs = np.argwhere(~np.isnan(functions.measured[0]))
    for i, j in pairs:
        one = np.zeros(functions.measured.shape, dtype=bool)
        one[:, i, j] = True
        held = " (held out)" if functions.held[:, i, j].all() else ""
        each.add(
            f"{functions.names[0][i]}{held}",
            functions.names[1][j],
            *(decibel(functions.decibels(model, one)) for model in models),
            *(f"{frac[i, j]:.3f}" for frac in fracs),
        )
    shown, words = len(shown_functions(functions)), ""
    if shown < len(pairs):
        words = f"{shown} of {len(pairs)} functions: those held out and those that fit least. "
    words += "Ticks are the lines that were fitted, most of them where the functions change most."
    return [
        Heading("Functions", "functions"),
        Figure(lambda: function_charts(functions), words),
        levels,
        Folded("Function by function", [each]),
    ]


# -- conditions ------------------------------------------------------------------------------------


def _sweep(r: UpdateReport) -> list:
    """Fits at all conditions, and curves over them."""
    if r.sweep is None:
        return []
    (name, _, unit), sweep, panels = r.condition, r.sweep, parameter_rows(r)
    blocks = [Heading(f"Over the {name}", "conditions")]
    if panels:
        caption = (
            "Each point was identified at its own condition; a bar beyond the panel means that the "
            "data there do not determine the parameter."
        )
        blocks.append(Figure(lambda: parameter_panels(panels, (name, unit)), caption))
    blocks.append(OnPage([_fits(r)]))
    if sweep.curves:
        gaps = [f"{gap} {words.partition(', ')[2]}" for _, gap, words in _curve_gaps(r)]
        said = f"On the curves over the {name} the gap is {', '.join(gaps)}."
        blocks += [Heading("Curves", level=3), OnPage([_curves(r)]), Text(said)]
    on = sweep.frequencies
    if on is not None:
        validation = None if sweep.validation is None else (None, sweep.validation)
        blocks += [
            Figure(
                lambda: frequency_panels(
                    None,
                    on,
                    (name, unit),
                    labels=("", "model on the curves"),
                    log_sd=sweep.log_sd,
                    held_out=sweep.held_out,
                    validation=validation,
                ),
                "Points are measured, lines are the model with its parameters on the curves.",
            ),
            OnPage([heat_table("Model on the curves", on, (name, unit))]),
        ]
    if sweep.validation is not None:
        names = ("", "model on the curves")
        table = frequency_table("Validation", None, sweep.validation, (name, unit), names)
        heading = Heading("Validation: data that were never fitted", "validation", level=3)
        blocks.append(OnPage([heading, table]))
    return blocks


def _fits(r: UpdateReport) -> Table:
    """What was identified at each condition, and the errors that were left."""
    name, _, unit = r.condition
    table = Table(
        [name, *(f">{p['name']}" for p in r.parameters), *(f">{mode}" for mode in r.modes.names)],
        caption="Identified at each condition, with the standard deviation, and what was left of "
        "the errors; * held out of the curves",
        id="fits",
    )
    for fit in r.sweep.fits:
        values = []
        for p in r.parameters:
            sd = fit["sd"].get(p["name"])
            sign = "± " if sd is not None and sd < 0.3 else ""
            value = quantity(fit["parameters"][p["name"]], p["unit"])
            values.append(f"{value} {sign}{spread(sd)}")
        errors = [None if e is None else e / 100 for e in fit["errors_percent"]]
        star = " *" if fit["held_out"] else ""
        table.add(
            f"{condition_value(fit['condition'], unit)}{star}",
            *values,
            *(percent(e, 2, sign=True) for e in errors),
        )
    return table


def _curves(r: UpdateReport) -> Table:
    unit = r.condition[2] or "its unit"
    caption = f"Fitted to the conditions that were not held out; T in {unit}"
    table, units = (
        Table("parameter | form | coefficients", caption=caption, id="curves"),
        {p["name"]: p["unit"] for p in r.parameters},
    )
    for curve in r.sweep.curves:
        numbers = (
            f"{key} = {number(value, 4)}"
            for key, value in curve.items()
            if isinstance(value, int | float)
        )
        unit = f", {units[curve['name']]}" if units.get(curve["name"]) else ""
        table.add(f"{curve['name']}{unit}", curve["form"], ", ".join(numbers))
    return table


def parameter_rows(r: UpdateReport) -> list[dict]:
    """What `parameter_panels` draws, a row for each parameter."""
    if r.sweep is None or len(r.sweep.fits) < 2:
        return []
    fits = sorted(r.sweep.fits, key=lambda fit: fit["condition"])
    x = np.array([fit["condition"] for fit in fits], dtype=float)
    by_name = {curve["name"]: curve for curve in r.sweep.curves}
    rows = []
    for parameter in r.parameters:
        name = parameter["name"]
        rows.append(
            {
                "name": name,
                "unit": parameter["unit"],
                "x": x,
                "value": np.array([fit["parameters"][name] for fit in fits]),
                "sd": np.array([fit["sd"].get(name, np.nan) for fit in fits], dtype=float),
                "held_out": np.array([bool(fit["held_out"]) for fit in fits]),
                "curve": curve_line(by_name.get(name), x),
            }
        )
    return rows


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
    """What the update rests on."""
    held = " and each parameter held near its start by update.regularisation" if r.pull else ""
    reduced = "The iteration took the model itself: nothing was reduced."
    if r.model.get("samples"):
        reduced = (
            "The reduced model of the iteration was checked against the full one at the identified "
            "values; all numbers and curves before and after are the full model's."
        )
    note = (
        "A standard deviation is relative, what the stated noise of the data does to the value, "
        f"the model taken as right{held}; where it is large it is given as the factor by which the "
        f"value may be smaller or larger. {reduced}"
    )
    heading = Heading("What this rests on", "rests-on")
    return [heading, facts_table(r.model), Text(note, "note")]


def _shapes_blocks(shapes: UpdatedShapes, modes: ModeTable) -> list:
    """The shapes, to be turned and played; pictures of the first ones for paper."""
    ways, titles, arrows, notes, stills = [], [], {}, {}, []
    for j, (motion, hz) in enumerate(zip(shapes.motions, shapes.frequencies_hz, strict=True)):
        way = np.eye(3)[int(np.argmax(np.sum(motion**2, axis=(0, 1))))]
        title = f"{modes.names[j]}, {hertz(float(hz))} Hz"
        ways.append(way)
        titles.append(title)
        if shapes.sensors is not None:
            arrows[j] = measured_arrows(shapes.sensors, shapes.test[:, j], shapes.model[:, j])
            alike = "" if modes.mac_after is None else f"; MAC {modes.mac_after[j, j]:.3f}"
            notes[j] = f"The test beside it, in the scale that brings both nearest{alike}."
        if j < _STILLS:
            alt = f"Shape of {title}."
            stills.append(Figure(mode_shape(shapes.vertices, motion, way, f"mode{j}", alt), title))
    view = modes_view(shapes.vertices, shapes.motions, titles, ways, arrows, notes)
    heading = Heading("Shapes of the updated model", "shapes", level=3)
    return [heading, View(view, [Beside("shapes", stills)])]
