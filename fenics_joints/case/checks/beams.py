"""What a case with ``builder = "offset_beams"`` must have, and what it cannot have."""

from __future__ import annotations

from fenics_joints.case.case import Case
from fenics_joints.case.mesh import OffsetBeamsMesh
from fenics_joints.case.messages import said
from fenics_joints.errors import InputError

#: Sections of solid bodies, and what they need.
_SOLID = {
    "contacts": "faces of solid parts",
    "bolts": "faces of solid parts",
    "obstacles": "faces of solid parts",
    "displacements": "faces of solid parts",
    "loads": "faces of solid parts",
    "nonlinear": "layers or contacts of solid parts",
}
_UP = (0.0, 0.0, 1.0)
#: How far a place may be beside the ends, as a share of the length: by round-off.
_NEAR = 1e-9


def check_beams(case: Case) -> list[str]:
    """A line for each thing that does not fit a case with beams, or needs them and has none."""
    if case.mesh.origin != "beams":
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
    if "degree" in case.mesh.model_fields_set:
        errors.append(said("mesh.degree", case.mesh.degree, "beams have no cells; expected none"))
    short = _short(case.mesh)
    return errors + _one_owner(case) + (short or _places(case))


def refuse_beams(case: Case, what: str) -> None:
    """Raise InputError, naming what was asked for, if a case has beams in place of a mesh."""
    if case.mesh.origin == "beams":
        raise InputError(
            f"{case.path}: {what} needs solid parts: expected another mesh.builder than "
            "'offset_beams', or a file; modes, update and diagnose work on beams"
        )


def _short(mesh: OffsetBeamsMesh) -> list[str]:
    """Beams that are no longer than their laps."""
    laps, errors = [0.0, *mesh.of("laps"), 0.0], []
    for i, length in enumerate(mesh.lengths):
        both = laps[i] + laps[i + 1]
        if not length > both:
            expected = f"expected more than the sum of its laps, {both:g} m"
            errors.append(said(f"mesh.lengths[{i}]", length, expected))
    return errors


def _places(case: Case) -> list[str]:
    """What stands beside the beams, or moves across the plane in which they move."""
    errors, end = [], sum(case.mesh.lengths) - sum(case.mesh.of("laps"))
    moves = "beams move in x and z; expected a direction that is not y alone"
    springs = {f"springs.{name}": s for name, s in case.springs.items()}
    springs |= {f"attached.{name}": s for name, s in case.attached.items()}
    for key, section in springs.items():
        direction = getattr(section, "direction", None)
        if direction is not None and not any(direction[::2]):
            errors.append(said(f"{key}.direction", list(direction), moves))
    for name, section in case.supports.items():
        if set(section.directions) == {"y"}:
            errors.append(said(f"supports.{name}.directions", section.directions, moves))
        if section.facets is None:
            errors.append(
                said(
                    f"supports.{name}.points",
                    section.points,
                    "beams are held at their ends; expected facets",
                )
            )
    sees = None if case.test is None else case.test.sees
    if sees is None:
        return errors
    for i, (point, direction) in enumerate(zip(sees.points(), sees.directions(), strict=True)):
        if not any(direction[::2]):
            return [*errors, said("test.sees.direction", list(direction), moves)]
        for axis, off in zip("yz", point[1:], strict=True):
            if abs(off) > end:  # a beam is a line here; its width is not checked
                where = f"test.sees: point {i + 1} at {axis} = {off:g} m is beside the beams"
                return [*errors, f"{where}; expected a point on a beam, {axis} near 0"]
        if not -_NEAR * end <= point[0] <= (1 + _NEAR) * end:
            where = f"test.sees: point {i + 1} at x = {point[0]:g} m is beside the beams"
            errors.append(f"{where}; expected x from 0 to {end:g} m")
    return errors


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
