"""Checks of obstacles, displacements and loads against the rest of a case."""

from __future__ import annotations

from collections.abc import Iterable

from fenics_joints.case.applied import APPLIED
from fenics_joints.case.case import Case
from fenics_joints.case.messages import said
from fenics_joints.case.values import AXES
from fenics_joints.errors import InputError

#: What can press bodies together, for messages.
PRESSES = (
    "expected a section [bolts.NAME], [loads.NAME] or [displacements.NAME], an obstacle's travel "
    "or force, or a negative gap"
)


def check_applied(case: Case) -> list[str]:
    """What is wrong with obstacles, displacements and loads, a line each."""
    given = [table for table in APPLIED if getattr(case, table)]
    if not given:
        return []
    errors = []
    if not (case.contacts or case.obstacles):
        errors.append(
            f"{' and '.join(given)}: expected sections [contacts.NAME] or [obstacles.NAME] too: "
            "they act in a preload, on what touches; a face that is held alone is one of [supports]"
        )
    elif not case.is_pressed:
        errors.append(f"obstacles: nothing presses the bodies on them; {PRESSES}")
    if case.update is not None and case.update.cutoff is not None and case.obstacles:
        errors.append(
            "update.cutoff: expected no [obstacles]: before the preload it is not known where they "
            "touch, and so not what is stuck"
        )
    return errors + _owned_twice(case) + _held(case)


def _owned_twice(case: Case) -> list[str]:
    """Faces whose vertices two sections would govern."""
    taken = {section.upper: f"contacts.{name}" for name, section in case.contacts.items()}
    for name, bolt in case.bolts.items():
        sides = {"beam": (bolt.lower, bolt.upper), "section": (bolt.upper,)}.get(bolt.kind, ())
        taken |= dict.fromkeys(sides, f"bolts.{name}")
    errors = []
    for table in ("obstacles", "displacements"):
        for name, section in getattr(case, table).items():
            if section.facets in taken:
                expected = (
                    f"{taken[section.facets]} governs this face already; expected each face in one "
                    "of them, a contact's as its lower one"
                )
                errors.append(said(f"{table}.{name}.facets", section.facets, expected))
            taken.setdefault(section.facets, f"{table}.{name}")
    return errors


def _held(case: Case) -> list[str]:
    """Faces that are moved in a direction in which a support holds them."""
    errors = []
    for name, section in case.displacements.items():
        moved = {axis for axis, v in zip(AXES, section.value, strict=False) if v is not None}
        for other, support in case.supports.items():
            both = sorted(moved & set(support.directions))
            if support.facets == section.facets and both:
                errors.append(
                    f"displacements.{name}.value moves {section.facets!r} along {', '.join(both)}, "
                    f"in which supports.{other} holds it; expected one of them"
                )
    return errors


def refuse_applied(case: Case, what: str, tables: Iterable[str] = APPLIED) -> None:
    """Raise InputError, naming what was asked for, if sections of these tables would not count."""
    given = [f"[{table}]" for table in tables if getattr(case, table)]
    if given:
        raise InputError(
            f"{case.path}: {what} knows no {', '.join(given)}: expected none; preload, modes, and "
            "harmonic with a contact's law do"
        )
