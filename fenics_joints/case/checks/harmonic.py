"""Checks of nonlinear joints and of the response to sinusoidal forces."""

from __future__ import annotations

from functools import partial

from fenics_joints.case.case import Case
from fenics_joints.case.contact_laws import ContactSection
from fenics_joints.case.harmonic import identifiable
from fenics_joints.case.messages import did_you_mean, indexed, refused, said, unknown
from fenics_joints.files import is_file, shown_path
from fenics_joints.units import to_si


def check_harmonic(case: Case) -> list[str]:
    """What is wrong with a case's nonlinear joints and their response, a line each."""
    errors = []
    for name, section in case.nonlinear.items():
        errors += _check_nonlinear(case, name, section)
    if case.harmonic is None:
        return errors
    if not case.nonlinear:
        errors.append("harmonic: expected a nonlinear joint, in a section [nonlinear.NAME]")
    identify = case.harmonic.identify
    known = identifiable(case.nonlinear)
    if identify is None:
        return errors
    given = indexed("harmonic.identify.parameters", identify.parameters)
    errors += unknown(given, known, "no such parameter")
    errors += _check_start(case, known)
    if identify.level is not None and case.harmonic.measured is None:
        errors.append("harmonic.identify: expected measured curves, harmonic.measured = 'FILE.csv'")
    return errors + (_check_amplitude(case) if identify.by_amplitude else [])


def _check_amplitude(case: Case) -> list[str]:
    """Whether the mode over its amplitude is there that an identification takes."""
    identify, there = case.harmonic.identify, case.backbones()
    if not there:
        if case.test is not None and case.test.amplitude:
            return []  # what is wrong with them is said already
        return [
            "harmonic.identify: expected level, that of a curve in harmonic.measured, or a mode "
            "over its amplitude, [test.amplitude]"
        ]
    if identify.mode is not None and identify.mode not in there:
        hint = did_you_mean(identify.mode, list(there))
        return [said("harmonic.identify.mode", identify.mode, f"no such mode by amplitude{hint}")]
    if identify.mode is None and len(there) > 1:
        return [f"harmonic.identify.mode: expected one of {', '.join(there)}"]
    taken = there[identify.mode or next(iter(there))]
    if len(taken) < 2:
        return ["harmonic.identify: the mode was measured at one amplitude; expected two or more"]
    if taken.response == "force" and case.harmonic.force is None:
        return ["harmonic.identify: the amplitudes are of force; expected harmonic.force, no base"]
    return []


def _check_nonlinear(case: Case, name: str, section) -> list[str]:
    key = f"nonlinear.{name}"
    if name in case.contacts:
        if section.needs_modulus():
            what = "stress = 'shear' and an elastic modulus"
            return [f"{key}: expected {what}, since a contact has no moduli of its own"]
        if isinstance(section, ContactSection):
            if section.presses and section.gap > 0 and case.is_pressed:
                expected = "expected none: the preload says it"
                return [said(f"{key}.gap", section.gap, expected)]
            return []
        if section.thickness is None:
            return [f"{key}.thickness: expected that of the layer whose strain is slip / thickness"]
        return []
    if name not in case.joints:
        known = did_you_mean(name, [*case.joints, *case.contacts])
        return [f"{key}: no joint or contact has that name{known}"]
    if isinstance(section, ContactSection):
        return [said(f"{key}.law", section.law, "expected a contact of that name, not a layer")]
    if case.joints[name].law == "transition":
        return [f"{key}: joints.{name} has law = 'transition', expected a layer with E and G"]
    return []


def _check_start(case: Case, known) -> list[str]:
    errors, identify = [], case.harmonic.identify
    for name, value in identify.start.items():
        key = f"harmonic.identify.start.{name}"
        if name not in identify.parameters:
            hint = did_you_mean(name, identify.parameters)
            errors.append(said(key, value, f"is not in identify.parameters{hint}"))
        if name in known:
            errors += refused(key, value, partial(to_si, value, known[name][1]))
    if identify.loops is not None and not is_file(case.folder / identify.loops):
        expected = f"no such file, expected a table at {shown_path(case.folder / identify.loops)}"
        errors.append(said("harmonic.identify.loops", identify.loops, expected))
    return errors
