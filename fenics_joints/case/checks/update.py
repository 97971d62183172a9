"""Checks of ``[update]`` against the rest of a case."""

from __future__ import annotations

from fenics_joints.case.case import Case
from fenics_joints.case.messages import did_you_mean, said
from fenics_joints.errors import InputError
from fenics_joints.units import parameter_unit, to_si

__all__ = ["check_update"]


def _check_cutoff(case: Case) -> list[str]:
    cutoff, errors = case.update.cutoff, []
    contacts = [name for name, section in case.contacts.items() if not section.bonded]
    if not contacts or not case.bolts:
        return ["update.cutoff: expected [contacts] that can open, and [bolts] that press them"]
    for i, name in enumerate(cutoff.contacts or []):
        if name not in contacts:
            expected = f"no such contact{did_you_mean(name, contacts)}"
            errors.append(said(f"update.cutoff.contacts[{i}]", name, expected))
    if case._measured is None:
        errors.append("update.cutoff: expected a section [test] with frequencies")
    if cutoff.calibrate is not None:
        names = {
            "parameter": list(case.nominal()),
            "mode": list(case._measured.mode_names) if case._measured else [],
        }
        for key, known in names.items():
            value = getattr(cutoff.calibrate, key)
            if known and value not in known:
                expected = f"no such {key}{did_you_mean(value, known)}"
                errors.append(said(f"update.cutoff.calibrate.{key}", value, expected))
    return errors


def check_update(case: Case) -> list[str]:
    update, measured = case.update, case._measured
    errors = [] if update.cutoff is None else _check_cutoff(case)
    known = case.nominal(damping=True)
    for i, name in enumerate(update.parameters):
        if name not in known:
            key = f"update.parameters[{i}]"
            errors.append(said(key, name, f"no such parameter{did_you_mean(name, list(known))}"))
    sources = [("update.start", update.start, case._start)]
    if update.published is not None:
        sources.append(
            ("update.published.parameters", update.published.parameters, case._published)
        )
    for table, given, into in sources:
        for name, value in given.items():
            key = f"{table}.{name}"
            if name not in update.parameters:
                hint = did_you_mean(name, update.parameters)
                errors.append(said(key, value, f"is not in update.parameters{hint}"))
                continue
            try:
                into[name] = to_si(value, parameter_unit(name))
            except InputError as error:
                errors.append(said(key, value, str(error)))
    if measured is None:
        return errors
    theirs = update.published.frequencies if update.published else []
    if theirs and len(theirs) != len(measured.mode_names):
        expected = f"expected {len(measured.mode_names)} frequencies, one for each mode of the test"
        errors.append(said("update.published.frequencies", theirs, expected))
    given = [] if update.at is None else [("update.at", update.at)]
    given += [(f"update.hold_out[{i}]", c) for i, c in enumerate(update.hold_out)]
    for key, condition in given:
        try:
            measured.row(condition)
        except InputError as error:
            errors.append(said(key, condition, str(error)))
    if not errors and not len(measured.without(update.hold_out)):
        expected = f"expected some {measured.condition_name} left to fit"
        errors.append(said("update.hold_out", update.hold_out, expected))
    return errors
