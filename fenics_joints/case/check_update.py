"""Checks of ``[update]``, ``[damping]``, ``[nonlinear]`` and ``[harmonic]`` against the data."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from functools import partial

import numpy as np

from fenics_joints.case.bayes import check_bayes
from fenics_joints.case.case import Case
from fenics_joints.case.harmonic import ContactLawSection, Hysteretic, identifiable
from fenics_joints.case.messages import did_you_mean, indexed, message, refused, unknown
from fenics_joints.case.parameters import parameters as case_parameters
from fenics_joints.case.update import HeldSection
from fenics_joints.errors import InputError, real
from fenics_joints.files import is_file, shown_path
from fenics_joints.structure import Parameter
from fenics_joints.units import to_si


def check_update(case: Case) -> list[str]:
    """What is wrong with ``[update]``, a line each."""
    update, measured = case.update, case.measured
    if update is None:
        return []
    errors = [] if update.cutoff is None else list(_check_cutoff(case))
    known = case.nominal(damping=True)
    errors += unknown(indexed("update.parameters", update.parameters), known, "no such parameter")
    errors += _check_values(case, "update.start", update.start)
    if update.published is not None:
        errors += _check_values(case, "update.published.parameters", update.published.parameters)
    if measured is not None:
        theirs = update.published.frequencies if update.published else []
        if theirs and len(theirs) != len(measured.mode_names):
            count = len(measured.mode_names)
            expected = f"expected {count} frequencies, one for each mode of the test"
            errors.append(message("update.published.frequencies", theirs, expected))
        given = [] if update.at is None else [("update.at", update.at)]
        given += [(f"update.hold_out[{i}]", c) for i, c in enumerate(update.hold_out)]
        for key, condition in given:
            errors += refused(key, condition, partial(measured.row, condition))
        if not errors and not len(measured.without(update.hold_out)):
            expected = f"expected some {measured.condition_name} left to fit"
            errors.append(message("update.hold_out", update.hold_out, expected))
    return [*errors, *check_bayes(case)]


def _check_cutoff(case: Case) -> Iterator[str]:
    cutoff = case.update.cutoff
    contacts = [name for name, section in case.contacts.items() if not section.bonded]
    if not contacts or not case.is_pressed:
        yield (
            "update.cutoff: expected [contacts] that can open, and [bolts] or [loads] that press "
            "them"
        )
        return
    yield from unknown(
        indexed("update.cutoff.contacts", cutoff.contacts), contacts, "no such contact"
    )
    if case.measured is None:
        yield "update.cutoff: expected a section [test] with frequencies"
    if cutoff.calibrate is not None:
        known = {"parameter": case.nominal()}
        known |= {"mode": case.measured.mode_names} if case.measured else {}
        for key, names in known.items():
            given = [(f"update.cutoff.calibrate.{key}", getattr(cutoff.calibrate, key))]
            yield from unknown(given, names, f"no such {key}")


def _check_value(value: float | str, parameter: Parameter | None, name: str, unit: str) -> None:
    """Refuse a value that its parameter cannot have; one beyond its bounds is moved there."""
    number = real(name, to_si(value, unit))
    if parameter is None:
        return
    if parameter.log and number <= 0:
        raise InputError(f"expected a value above 0 {parameter.unit}".rstrip())
    if name.endswith(".nu") and not -1 < number < 0.5:
        raise InputError("expected a ratio with -1 < nu < 0.5")


def _check_values(case: Case, table: str, given: Mapping[str, float | str]) -> Iterator[str]:
    """Values of parameters that are to be updated, as people write them."""
    names, known = case.update.parameters, {}
    with suppress(InputError):  # bounds without the nominal value are said elsewhere
        known = {p.name: p for p in case_parameters(case, damping=True)}
    for name, value in given.items():
        if name in names:
            read = partial(_check_value, value, known.get(name), name, case.unit_of(name))
            yield from refused(f"{table}.{name}", value, read)
        else:
            hint = did_you_mean(name, list(names))
            yield message(f"{table}.{name}", value, f"is not in update.parameters{hint}")


# -- updates to several kinds of data --------------------------------------------------------------


def check_combined(case: Case) -> Iterator[str]:
    """A line for each thing in ``[damping]``, ``[test.frfs]`` and ``[update]`` that cannot be."""
    yield from _check_damping(case)
    update, test, frfs = case.update, case.test, case.frfs()
    section = None if test is None else test.frfs
    if section is not None and frfs is not None and section.averages is not None:
        if frfs.coherence is None or np.isnan(frfs.coherence[:, frfs.measured]).any():
            expected = "expected the coherence of every FRF in the files, or noise instead"
            yield message("test.frfs.averages", section.averages, expected)
    if update is None:
        return
    if update.cutoff is not None:
        return
    if test is not None and (
        (test.has_modes and case.measured is None) or (section is not None and frfs is None)
    ):
        return  # that they cannot be read is said already
    if not case.combined():
        yield from _without_effect(case)
        return
    if test is None:
        yield "update: expected a section [test]"
        return
    for i, name in enumerate(update.parameters):
        if name in update.parameters[:i]:
            yield message(f"update.parameters[{i}]", name, "expected each parameter once")
    yield from _check_data(case)
    yield from _check_conditions(case)
    if update.held is not None:
        yield from _check_held(case, update.held)


def _check_damping(case: Case) -> Iterator[str]:
    damping = case.damping
    if damping is None:
        return
    known = [*case.parts, *case.joints]
    for table in ("viscous", "hysteretic"):
        for name, value in getattr(damping, table).items():
            if name not in known:
                expected = f"no such part or joint{did_you_mean(name, known)}"
                yield message(f"damping.{table}.{name}", value, expected)
    for table in ("parts", "joints", "masses", "springs", "attached"):
        if "damping" in getattr(case, table):
            yield f"{table}.damping: the name is that of the section [damping]; expected another"


def _without_effect(case: Case) -> Iterator[str]:
    """Parameters of damping that no data of the update depend on."""
    if {"damping", "frfs"} & set(case.fitted_data()):
        return
    own = case.damping_names()
    for i, name in enumerate(case.update.parameters):
        if name in own:
            yield message(
                f"update.parameters[{i}]",
                name,
                "undamped frequencies and shapes do not depend on damping; expected 'damping' or "
                "'frfs' in update.data: measured damping ratios (test.damping) or FRFs "
                "(test.frfs)",
            )


def _check_data(case: Case) -> Iterator[str]:
    """Whether there is what is to be fitted, and a model of it."""
    update, measured, frfs = case.update, case.measured, case.frfs()
    there = {
        "frequencies": measured is not None,
        "shapes": measured is not None and measured.shapes is not None,
        "damping": case.has_ratios(),
        "frfs": frfs is not None,
    }
    keys = {
        "frequencies": "test.frequencies, or [test.frfs.identify]",
        "shapes": "test.shapes, with [test.sees] if they are in a table",
        "damping": "test.damping, with ratios at the condition of the update",
        "frfs": "a section [test.frfs]",
    }
    for i, kind in enumerate(update.data or ()):
        if not there[kind]:
            yield message(f"update.data[{i}]", kind, f"there are none: expected {keys[kind]}")
    wanted = case.fitted_data()
    if not wanted:
        yield "update: expected measured frequencies, shapes or FRFs in [test]"
    if "frequencies" in wanted and measured is not None and np.any(measured.log_sd() == 0):
        yield "test.noise = 0: expected it or test.resolution above 0, to weight the frequencies"
    if update.method == "weighted":
        for kind in {"shapes", "damping"} & set(wanted):
            expected = f"expected no {kind} in update.data: the paper's equations have none"
            yield message("update.method", update.method, expected)
    if "damping" in wanted:
        yield from _check_ratios(case)
    if "frfs" in wanted:
        if not case.is_damped and "damping" not in wanted:
            yield (
                "damping is missing: expected a section [damping], without which the model's "
                "FRFs are infinite at its resonances"
            )
        if frfs is not None:
            yield from _check_lines(update.lines, frfs.frequencies_hz)
        return
    yield from _without_effect(case)
    of_functions = {"lines": update.lines}
    if update.held is not None:
        of_functions |= {f"held.{key}": getattr(update.held, key) for key in ("bands", "responses")}
    for key, given in of_functions.items():
        if given is not None:
            yield f"update.{key}: expected it only with 'frfs' in update.data"


def _check_ratios(case: Case) -> Iterator[str]:
    """Measured damping ratios as data."""
    if not case.is_damped:
        yield (
            "damping is missing: expected a section [damping], or the c of a lap of beams, without "
            "which the model's damping ratios are 0"
        )
    data, at = case.measured, case.row() if case.has_ratios() else None
    for name, ratio in () if at is None else zip(data.mode_names, data.damping[at], strict=True):
        if ratio == 0:
            yield (
                f"test.damping: {name} = 0 at {data.condition_name} = {data.conditions[at]:g}: "
                "expected a ratio above 0, or an empty cell where none was measured"
            )


def _check_lines(lines: int | list[float] | None, hertz: np.ndarray) -> Iterator[str]:
    if isinstance(lines, int):
        if lines > len(hertz):
            expected = f"expected at most the {len(hertz)} measured lines"
            yield message("update.lines", lines, expected)
        return
    low, high = hertz[0], hertz[-1]
    for i, line in enumerate(lines or ()):
        if not low <= line <= high:
            expected = f"expected a frequency from {low:g} to {high:g} Hz"
            yield message(f"update.lines[{i}]", line, expected)


def _check_conditions(case: Case) -> Iterator[str]:
    """Everything must have been measured at one condition, that of the update."""
    update, data = case.update, case.measured
    if update.hold_out:
        yield message(
            "update.hold_out",
            update.hold_out,
            "conditions are held out of curves of frequencies only; expected [update.held] with "
            "modes, bands or responses",
        )
    if data is None:
        if update.at is not None:
            yield message("update.at", update.at, "expected it only with test.frequencies")
        return
    at, frfs = case.row(), case.test.frfs
    if at is None:
        return  # said already
    places, wanted = {}, case.fitted_data()
    if "shapes" in wanted and data.shapes is not None:
        places["test.shapes_at"] = data.shape_row
    if "frfs" in wanted and frfs is not None and case.test.frequencies is not None:
        places["test.frfs.at"] = data.row(frfs.at)
    condition = f"{data.conditions[at]:g} {data.condition_unit}".rstrip()
    for key, row in places.items():
        if row != at:
            expected = f"expected the condition of the update, {condition}"
            yield message(key, float(data.conditions[row]), expected)


def _check_held(case: Case, held: HeldSection) -> Iterator[str]:
    frfs = case.frfs()
    if not any((held.modes, held.bands, held.responses)):
        yield "update.held: expected modes, bands or responses"
    if held.modes:
        yield from _check_held_modes(case, held)
    if held.responses and frfs is not None:
        names = list(frfs.response_names)
        given = indexed("update.held.responses", held.responses)
        yield from unknown(given, names, "no such response")
        if set(names) <= set(held.responses):
            yield message("update.held.responses", held.responses, "expected some left")
    if held.bands and frfs is not None:
        out = frfs.lines_in(held.bands)
        if not out.any():
            yield message("update.held.bands", held.bands, "expected measured lines in them")
        if out.all():
            yield message("update.held.bands", held.bands, "expected some lines left to fit")


def _check_held_modes(case: Case, held: HeldSection) -> Iterator[str]:
    key, modes, data, wanted = "update.held.modes", held.modes, case.measured, case.fitted_data()
    by_damping = "damping" in wanted and "frfs" not in wanted
    if data is None or not ("frequencies" in wanted or by_damping):
        # The band that a mode's lines are in lies between the frequencies of its neighbours.
        yield (
            f"{key}: expected it only with 'frequencies' in update.data, or 'damping' without "
            "'frfs'"
        )
        return
    row = case.row()
    if row is None:
        return  # said already
    there = np.isfinite(data.frequencies_hz[row])
    measured = {name for name, is_there in zip(data.mode_names, there, strict=True) if is_there}
    if held.each:
        if len(measured) < 2:
            yield message(key, modes, "expected two modes or more in the test")
        return
    yield from unknown(indexed(key, modes), data.mode_names, "no such mode")
    for i, name in enumerate(modes):
        if name in data.mode_names and name not in measured:
            expected = "its frequency was not measured: expected one to compare with"
            yield message(f"{key}[{i}]", name, expected)
    left = np.array([name not in modes for name in data.mode_names])
    fitted = there if "frequencies" in wanted else np.isfinite(data.damping[row])
    if not np.any(fitted & left):
        yield message(key, modes, "expected some modes left to fit")


# -- nonlinear joints and their response -----------------------------------------------------------


def check_harmonic(case: Case) -> Iterator[str]:
    """What is wrong with a case's nonlinear joints and their response, a line each."""
    for name, section in case.nonlinear.items():
        yield from _check_nonlinear(case, name, section)
    if case.harmonic is None:
        return
    if not case.nonlinear:
        yield "harmonic: expected a nonlinear joint, in a section [nonlinear.NAME]"
    identify, known = case.harmonic.identify, identifiable(case.nonlinear)
    if identify is None:
        return
    given = indexed("harmonic.identify.parameters", identify.parameters)
    yield from unknown(given, known, "no such parameter")
    for name, value in identify.start.items():
        key = f"harmonic.identify.start.{name}"
        if name not in identify.parameters:
            hint = did_you_mean(name, identify.parameters)
            yield message(key, value, f"is not in identify.parameters{hint}")
        if name in known:
            yield from refused(key, value, partial(to_si, value, known[name][1]))
    loops = identify.loops and case.folder / identify.loops
    if loops is not None and not is_file(loops):
        expected = f"no such file, expected a table at {shown_path(loops)}"
        yield message("harmonic.identify.loops", identify.loops, expected)
    if identify.level is not None and case.harmonic.measured is None:
        yield "harmonic.identify: expected measured curves, harmonic.measured = 'FILE.csv'"
    if identify.by_amplitude:
        yield from _check_amplitude(case)


def _check_amplitude(case: Case) -> Iterator[str]:
    """Whether the mode over its amplitude is there that an identification takes."""
    identify, there = case.harmonic.identify, case.backbones()
    if not there:
        if case.test is None or not case.test.amplitude:  # else it is said already
            yield (
                "harmonic.identify: expected level, that of a curve in harmonic.measured, or a "
                "mode over its amplitude, [test.amplitude]"
            )
        return
    if identify.mode is None and len(there) > 1:
        yield f"harmonic.identify.mode: expected one of {', '.join(there)}"
        return
    if identify.mode is not None and identify.mode not in there:
        hint = did_you_mean(identify.mode, list(there))
        yield message("harmonic.identify.mode", identify.mode, f"no such mode by amplitude{hint}")
        return
    taken = there[identify.mode or next(iter(there))]
    if len(taken) < 2:
        yield "harmonic.identify: the mode was measured at one amplitude; expected two or more"
    elif taken.response == "force" and case.harmonic.force is None:
        yield "harmonic.identify: the amplitudes are of force; expected harmonic.force, no base"


def _check_nonlinear(case: Case, name: str, section) -> Iterator[str]:
    key, of_contact = f"nonlinear.{name}", isinstance(section, ContactLawSection)
    if name in case.contacts:
        if section.needs_modulus():
            yield (
                f"{key}: expected stress = 'shear' and an elastic modulus, since a contact has no "
                "moduli of its own"
            )
        elif isinstance(section, Hysteretic) and section.thickness is None:
            yield f"{key}.thickness: expected that of the layer whose strain is slip / thickness"
        elif of_contact and section.presses and section.gap > 0 and case.is_pressed:
            yield message(f"{key}.gap", section.gap, "expected none: the preload says it")
    elif name not in case.joints:
        known = did_you_mean(name, [*case.joints, *case.contacts])
        yield f"{key}: no joint or contact has that name{known}"
    elif of_contact:
        yield message(f"{key}.law", section.law, "expected a contact of that name, not a layer")
    elif case.joints[name].law == "transition" or case.joints[name].own_law is not None:
        law = case.joints[name].law
        yield f"{key}: joints.{name} has law = {law!r}, expected a layer with E and G, or springs"
