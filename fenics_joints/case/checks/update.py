"""Checks of ``[update]`` against the rest of a case."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from functools import partial

from fenics_joints.case.case import Case
from fenics_joints.case.messages import did_you_mean, indexed, refused, said, unknown
from fenics_joints.case.parameters import parameters as case_parameters
from fenics_joints.errors import InputError, real
from fenics_joints.structure import Parameter
from fenics_joints.units import parameter_unit, to_si


def _check_cutoff(case: Case) -> list[str]:
    cutoff, errors = case.update.cutoff, []
    contacts = [name for name, section in case.contacts.items() if not section.bonded]
    if not contacts or not case.is_pressed:
        return [
            "update.cutoff: expected [contacts] that can open, and [bolts] or [loads] that press "
            "them"
        ]
    errors += unknown(
        indexed("update.cutoff.contacts", cutoff.contacts), contacts, "no such contact"
    )
    if case.measured is None:
        errors.append("update.cutoff: expected a section [test] with frequencies")
    if cutoff.calibrate is not None:
        known = {"parameter": case.nominal()}
        known |= {"mode": case.measured.mode_names} if case.measured else {}
        for key, names in known.items():
            given = [(f"update.cutoff.calibrate.{key}", getattr(cutoff.calibrate, key))]
            errors += unknown(given, names, f"no such {key}")
    return errors


def _check_value(value: float | str, parameter: Parameter | None, name: str) -> None:
    """Refuse a value that its parameter cannot have; one beyond its bounds is moved there."""
    number = real(name, to_si(value, parameter_unit(name)))
    if parameter is None:
        return
    if parameter.log and number <= 0:
        raise InputError(f"expected a value above 0 {parameter.unit}".rstrip())
    if name.endswith(".nu") and not -1 < number < 0.5:
        raise InputError("expected a ratio with -1 < nu < 0.5")


def _check_values(
    case: Case, table: str, given: Mapping[str, float | str], parameters
) -> list[str]:
    """Values of parameters that are to be updated, as people write them."""
    errors, known = [], {}
    with suppress(InputError):  # bounds without the nominal value are said elsewhere
        known = {p.name: p for p in case_parameters(case, damping=True)}
    for name, value in given.items():
        if name in parameters:
            read = partial(_check_value, value, known.get(name), name)
            errors += refused(f"{table}.{name}", value, read)
        else:
            hint = did_you_mean(name, list(parameters))
            errors.append(said(f"{table}.{name}", value, f"is not in update.parameters{hint}"))
    return errors


def check_update(case: Case) -> list[str]:
    """What is wrong with an update, a line each."""
    update, measured = case.update, case.measured
    errors = [] if update.cutoff is None else _check_cutoff(case)
    known = case.nominal(damping=True)
    errors += unknown(indexed("update.parameters", update.parameters), known, "no such parameter")
    errors += _check_values(case, "update.start", update.start, update.parameters)
    if update.published is not None:
        key = "update.published.parameters"
        errors += _check_values(case, key, update.published.parameters, update.parameters)
    if measured is None:
        return errors
    theirs = update.published.frequencies if update.published else []
    if theirs and len(theirs) != len(measured.mode_names):
        expected = f"expected {len(measured.mode_names)} frequencies, one for each mode of the test"
        errors.append(said("update.published.frequencies", theirs, expected))
    given = [] if update.at is None else [("update.at", update.at)]
    given += [(f"update.hold_out[{i}]", c) for i, c in enumerate(update.hold_out)]
    for key, condition in given:
        errors += refused(key, condition, partial(measured.row, condition))
    if not errors and not len(measured.without(update.hold_out)):
        expected = f"expected some {measured.condition_name} left to fit"
        errors.append(said("update.hold_out", update.hold_out, expected))
    return errors
