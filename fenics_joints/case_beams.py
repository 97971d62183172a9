"""What a case with ``builder = "offset_beams"`` must have, and what it cannot have."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fenics_joints.case_mesh import OffsetBeamsMesh
from fenics_joints.case_messages import said

if TYPE_CHECKING:
    from fenics_joints.case import Case

__all__ = ["check_beams"]

#: Sections of solid bodies, and what they need.
_SOLID = {
    "contacts": "faces of solid parts",
    "bolts": "faces of solid parts",
    "nonlinear": "layers or contacts of solid parts",
}
_UP = (0.0, 0.0, 1.0)


def check_beams(case: Case) -> list[str]:
    """A line for each thing that does not fit a case with beams, or needs them and has none."""
    if not isinstance(case.mesh, OffsetBeamsMesh):
        return _without(case)
    errors = [
        f"{key}: expected none with mesh.builder = 'offset_beams'; they need {what}"
        for key, what in _SOLID.items()
        if getattr(case, key)
    ]
    if case.harmonic is not None:
        errors.append("harmonic: expected none with mesh.builder = 'offset_beams'")
    for name, section in case.parts.items():
        if tuple(section.normal) != _UP:
            errors.append(
                said(f"parts.{name}.normal", list(section.normal), "expected [0, 0, 1] for beams")
            )
    for name, section in case.joints.items():
        if section.law != "generic":
            expected = "expected 'generic' with mesh.builder = 'offset_beams'"
            errors.append(said(f"joints.{name}.law", section.law, expected))
    return errors + _one_owner(case)


def _without(case: Case) -> list[str]:
    needs = "expected it with mesh.builder = 'offset_beams' alone"
    errors = [
        said(f"joints.{name}.law", section.law, needs)
        for name, section in case.joints.items()
        if section.law == "generic"
    ]
    for table in ("masses", "attached"):
        for name, section in getattr(case, table).items():
            if getattr(section, "inertia", None) is not None:
                errors.append(said(f"{table}.{name}.inertia", section.inertia, needs))
    return errors


def _one_owner(case: Case) -> list[str]:
    """Every beam in one part, every lap in one joint."""
    errors = []
    for cell in case.mesh.groups()[0]:
        table = "parts" if cell.startswith("beam_") else "joints"
        other = "joints" if table == "parts" else "parts"
        owners = [n for n, s in getattr(case, table).items() if cell in s.cells]
        wrong = [n for n, s in getattr(case, other).items() if cell in s.cells]
        if wrong:
            errors.append(f"{other}.{wrong[0]}.cells names {cell!r}: expected it in {table}")
        if len(owners) != 1:
            found = f"in {', '.join(owners)}" if owners else "in none"
            errors.append(
                f"{table}: {cell!r} is {found}; expected it in one section [{table}.NAME]"
            )
    return errors
