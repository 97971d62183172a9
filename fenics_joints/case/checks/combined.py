"""Checks of what a case says of an update to frequencies, shapes, damping and functions."""

from __future__ import annotations

import numpy as np

from fenics_joints.case.case import Case
from fenics_joints.case.messages import did_you_mean, indexed, said, unknown


def check_combined(case: Case) -> list[str]:
    """A line for each thing in ``[damping]``, ``[test.frfs]`` and ``[update]`` that cannot be."""
    errors = [*_check_damping(case), *_check_noise(case)]
    update = case.update
    if update is None:
        return errors
    keys = update.combined_keys()
    if update.cutoff is not None:
        return errors + [f"update.{key}: expected it only with update.parameters" for key in keys]
    if _is_unread(case):
        return errors
    if not case.combined():
        return errors + _without_effect(case)
    if case.test is None:
        errors.append("update: expected a section [test]")
        return errors
    errors += [
        said(f"update.parameters[{i}]", name, "expected each parameter once")
        for i, name in enumerate(update.parameters)
        if name in update.parameters[:i]
    ]
    errors += _check_data(case)
    errors += _check_conditions(case)
    errors += _check_held(case)
    return errors


def _is_unread(case: Case) -> bool:
    """Whether some data could not be read, which is said already."""
    test = case.test
    if test is None:
        return False
    return (test.has_modes and case.measured is None) or (
        test.frfs is not None and case.frfs() is None
    )


def _without_effect(case: Case) -> list[str]:
    """Parameters of damping that no data of the update depend on."""
    if {"damping", "frfs"} & set(case.fitted_data()):
        return []
    expected = (
        "undamped frequencies and shapes do not depend on damping; expected 'damping' or 'frfs' in "
        "update.data: measured damping ratios (test.damping) or functions (test.frfs)"
    )
    own = case.damping_names()
    return [
        said(f"update.parameters[{i}]", name, expected)
        for i, name in enumerate(case.update.parameters)
        if name in own
    ]


def _check_ratios(case: Case) -> list[str]:
    """Measured damping ratios as data."""
    update, data, errors = case.update, case.measured, []
    if update.method == "weighted":
        expected = "expected no damping in update.data: the paper's equations have none"
        errors.append(said("update.method", update.method, expected))
    if not case.is_damped:
        errors.append(
            "damping is missing: expected a section [damping], or the c of a lap of beams, without "
            "which the model's damping ratios are 0"
        )
    at = case.row() if case.has_ratios() else None
    if at is not None:
        errors += [
            f"test.damping: {name} = 0 at {data.condition_name} = {data.conditions[at]:g}: "
            "expected a ratio above 0, or an empty cell where none was measured"
            for name, ratio in zip(data.mode_names, data.damping[at], strict=True)
            if ratio == 0
        ]
    return errors


def _check_damping(case: Case) -> list[str]:
    damping = case.damping
    if damping is None:
        return []
    errors, known = [], [*case.parts, *case.joints]
    for table in ("viscous", "hysteretic"):
        for name, value in getattr(damping, table).items():
            if name not in known:
                expected = f"no such part or joint{did_you_mean(name, known)}"
                errors.append(said(f"damping.{table}.{name}", value, expected))
    for table in ("parts", "joints", "masses", "springs", "attached"):
        if "damping" in getattr(case, table):
            errors.append(
                f"{table}.damping: the name is that of the section [damping]; expected another"
            )
    return errors


def _check_noise(case: Case) -> list[str]:
    section = None if case.test is None else case.test.frfs
    if section is None or case.frfs() is None or section.averages is None:
        return []
    coherence, measured = case.frfs().coherence, case.frfs().measured
    if coherence is None or np.isnan(coherence[:, measured]).any():
        expected = "expected the coherence of every function in the files, or noise instead"
        return [said("test.frfs.averages", section.averages, expected)]
    return []


def _check_data(case: Case) -> list[str]:
    """Whether there is what is to be fitted, and a model of it."""
    update, measured, errors = case.update, case.measured, []
    lacking = {
        "frequencies": (measured is None, "test.frequencies, or [test.frfs.identify]"),
        "shapes": (
            measured is None or measured.shapes is None,
            "test.shapes, with [test.sees] if they are in a table",
        ),
        "damping": (
            not case.has_ratios(),
            "test.damping, with ratios at the condition of the update",
        ),
        "frfs": (case.frfs() is None, "a section [test.frfs]"),
    }
    wanted = case.fitted_data()
    for i, kind in enumerate(update.data or ()):
        missing, where = lacking[kind]
        if missing:
            errors.append(said(f"update.data[{i}]", kind, f"there are none: expected {where}"))
    if not wanted:
        errors.append("update: expected measured frequencies, shapes or functions in [test]")
    if "frequencies" in wanted and measured is not None and np.any(measured.log_sd() == 0):
        expected = "expected it or test.resolution above 0: it is what frequencies weigh"
        errors.append(f"test.noise = 0: {expected}")
    if update.step_limit is not None and update.method != "weighted":
        expected = "expected it only with update.method = 'weighted'"
        errors.append(said("update.step_limit", update.step_limit, expected))
    if "shapes" in wanted and update.method == "weighted":
        expected = "expected no shapes in update.data: the paper's equations have none"
        errors.append(said("update.method", update.method, expected))
    if "damping" in wanted:
        errors += _check_ratios(case)
    if "frfs" in wanted:
        if not case.is_damped and "damping" not in wanted:
            errors.append(
                "damping is missing: expected a section [damping], without which the model's "
                "functions are infinite at its resonances"
            )
    else:
        errors += _without_effect(case)
        errors += [
            f"update.{key}: expected it only with 'frfs' in update.data"
            for key, given in _of_functions(update)
            if given is not None
        ]
    return errors + (_check_lines(case) if "frfs" in wanted and case.frfs() is not None else [])


def _of_functions(update):
    held = update.held
    yield "lines", update.lines
    yield "held.bands", None if held is None else held.bands
    yield "held.responses", None if held is None else held.responses


def _check_lines(case: Case) -> list[str]:
    lines, f = case.update.lines, case.frfs().frequencies_hz
    if isinstance(lines, int):
        if lines > len(f):
            return [said("update.lines", lines, f"expected at most the {len(f)} measured lines")]
        return []
    return [
        said(f"update.lines[{i}]", line, f"expected a frequency from {f[0]:g} to {f[-1]:g} Hz")
        for i, line in enumerate(lines or ())
        if not f[0] <= line <= f[-1]
    ]


def _check_conditions(case: Case) -> list[str]:
    """Everything must have been measured at one condition, that of the update."""
    update, data, errors = case.update, case.measured, []
    if update.hold_out:
        errors.append(
            said(
                "update.hold_out",
                update.hold_out,
                "conditions are held out of curves of "
                "frequencies only; expected [update.held] with modes, bands or responses",
            )
        )
    if data is None:
        if update.at is not None:
            errors.append(said("update.at", update.at, "expected it only with test.frequencies"))
        return errors
    at = case.row()
    if at is None:
        return errors  # said already
    places = []
    wanted = case.fitted_data()
    if "shapes" in wanted and data.shapes is not None:
        places.append(("test.shapes_at", data.shape_row))
    if "frfs" in wanted and case.test.frfs is not None and case.test.frequencies is not None:
        places.append(("test.frfs.at", data.row(case.test.frfs.at)))
    for key, row in places:
        if row != at:
            expected = (
                f"expected the condition of the update, {data.conditions[at]:g} "
                f"{data.condition_unit}".rstrip()
            )
            errors.append(said(key, float(data.conditions[row]), expected))
    return errors


def _check_held(case: Case) -> list[str]:
    held = case.update.held
    if held is None:
        return []
    errors, data, frfs = [], case.measured, case.frfs()
    if not any((held.modes, held.bands, held.responses)):
        errors.append("update.held: expected modes, bands or responses")
    if held.modes:
        errors += _check_held_modes(case, held.modes, data)
    if held.responses and frfs is not None:
        names = list(frfs.response_names)
        given = indexed("update.held.responses", held.responses)
        errors += unknown(given, names, "no such response")
        if set(names) <= set(held.responses):
            errors.append(said("update.held.responses", held.responses, "expected some left"))
    if held.bands and frfs is not None:
        out = frfs.lines_in(held.bands)
        if not out.any():
            errors.append(said("update.held.bands", held.bands, "expected measured lines in them"))
        if out.all():
            errors.append(said("update.held.bands", held.bands, "expected some lines left to fit"))
    return errors


def _check_held_modes(case: Case, modes, data) -> list[str]:
    key = "update.held.modes"
    wanted = case.fitted_data()
    alone = "damping" in wanted and "frfs" not in wanted
    if data is None or not ("frequencies" in wanted or alone):
        # The band that a mode's lines are in lies between the frequencies of its neighbours.
        return [
            f"{key}: expected it only with 'frequencies' in update.data, or 'damping' without "
            "'frfs'"
        ]
    row = case.row()
    if row is None:
        return []  # said already
    there = np.isfinite(data.frequencies_hz[row])
    measured = {name for name, is_there in zip(data.mode_names, there, strict=True) if is_there}
    if case.update.held.each:
        few = len(measured) < 2
        return [said(key, modes, "expected two modes or more in the test")] if few else []
    errors = unknown(indexed(key, modes), data.mode_names, "no such mode")
    errors += [
        said(f"{key}[{i}]", name, "its frequency was not measured: expected one to compare with")
        for i, name in enumerate(modes)
        if name in data.mode_names and name not in measured
    ]
    left = np.array([name not in modes for name in data.mode_names])
    fitted = there if "frequencies" in wanted else np.isfinite(data.damping[row])
    if not np.any(fitted & left):
        errors.append(said(key, modes, "expected some modes left to fit"))
    return errors
