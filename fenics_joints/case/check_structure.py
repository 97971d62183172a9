"""Checks of a case's structure across its sections: names, faces, loads, beams."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from fnmatch import fnmatchcase

from fenics_joints.case.case import Case
from fenics_joints.case.mesh import OffsetBeamsMesh
from fenics_joints.case.messages import did_you_mean, message
from fenics_joints.case.preload import APPLIED
from fenics_joints.case.sections import JointSection, PartSection
from fenics_joints.case.values import AXES
from fenics_joints.errors import InputError, MeshError
from fenics_joints.files import is_file, shown_path
from fenics_joints.structure.assembly import MOST_POINTS

#: What can press bodies together, for messages.
PRESSES = (
    "expected a section [bolts.NAME], [loads.NAME] or [displacements.NAME], an obstacle's travel "
    "or force, or a negative gap"
)
#: Tables that share one set of names.
_NAMED = ("parts", "joints", "contacts", "bolts", *APPLIED, "masses", "springs", "attached")
#: Sections that beams cannot have, with what they need.
_SOLID = {
    **dict.fromkeys(("contacts", "bolts", *APPLIED), "faces of solid parts"),
    "nonlinear": "layers or contacts of solid parts",
}
#: How far a point may be beyond the ends of beams, as a share of their length: round-off.
_NEAR = 1e-9


def _items(case: Case, *tables: str) -> Iterator[tuple[str, object]]:
    """Sections of some tables, each with its key."""
    for table in tables:
        for name, section in getattr(case, table).items():
            yield f"{table}.{name}", section


def check_names(case: Case) -> Iterator[str]:
    """A line for each name or range of the case that does not go with the others."""
    seen: dict[str, str] = {}
    for key, _ in _items(case, *_NAMED):
        name = key.partition(".")[2]
        if name in seen:
            yield f"{key}: the name is used by {seen[name]}; expected another"
        seen[name] = key
    faces: dict[str, str] = {}
    for key, bolt in _items(case, "bolts"):
        for side in ("lower", "upper"):
            face = getattr(bolt, side)
            if face in faces:  # the bolt would press twice
                expected = f"is a face of {faces[face]} already; expected each bolt once"
                yield message(f"{key}.{side}", face, expected)
            faces.setdefault(face, key)
    there = [*case.masses, *case.springs]
    for name, section in ({} if case.test is None else case.test.changed).items():
        key = f"test.changed.{name}"
        if name in seen:
            yield f"{key}: the name is used by {seen[name]}; expected another"
        for each in section.without:
            if each not in there:
                expected = f"expected one of masses and springs: {', '.join(there) or 'none'}"
                yield message(f"{key}.without", each, expected)
    points = sum(
        len(section.points) for _, section in _items(case, "masses", "springs", "attached")
    )
    if points > MOST_POINTS:
        yield (
            f"masses, springs and attached have {points} points in all: expected at most "
            f"{MOST_POINTS}; what is spread out is a part's density, or a support"
        )
    for key, section in _items(case, "parts", "joints"):
        yield from _check_bounds(key, section)


def _check_bounds(key: str, section: PartSection | JointSection) -> Iterator[str]:
    values = section.nominal() | ({"width": 1.0} if isinstance(section, PartSection) else {})
    for name, (low, high) in section.bounds.model_dump(exclude_none=True).items():
        if values.get(name) is not None and not low <= values[name] <= high:
            expected = f"expected a range that holds {values[name]:g}"
            yield message(f"{key}.bounds.{name}", [low, high], expected)


def check_mesh(case: Case) -> list[str]:
    """Names of cells and facets against the builder's; others' are checked when they are read."""
    if case.mesh.origin == "file":
        file = case.folder / case.mesh.file
        expected = f"no such file, expected a mesh at {shown_path(file)}"
        return [] if is_file(file) else [message("mesh.file", case.mesh.file, expected)]
    if case.mesh.origin in ("own", "matrices"):
        return []
    try:
        groups = case.mesh.groups()
    except MeshError as error:
        return [f"mesh: {error}"]
    return unknown_groups(case, *groups)


def unknown_groups(case: Case, cells: Iterable[str], facets: Iterable[str]) -> list[str]:
    """A line for each group that the case names and the mesh does not have.

    Args:
        case: The case.
        cells: Names of the mesh's groups of cells.
        facets: Names of the mesh's groups of facets.
    """
    cells, facets = list(cells), list(facets)
    named = []
    for key, section in _items(case, "parts", "joints"):
        patterned = getattr(section, "is_patterned", False)
        wanted = [c for c in section.cells if not (patterned and matching(c, cells))]
        named += [(f"{key}.cells", cell, cells) for cell in wanted]
    for key, section in _items(case, "supports", *APPLIED):
        if section.facets is not None:
            named.append((f"{key}.facets", section.facets, facets))
    for key, section in _items(case, "contacts", "bolts"):
        named += [(f"{key}.{side}", getattr(section, side), facets) for side in ("lower", "upper")]
    return [
        message(key, name, f"is not in the mesh{did_you_mean(name, there)}")
        for key, name, there in named
        if name not in there
    ]


def matching(pattern: str, names: Iterable[str]) -> list[str]:
    """Names of cells that match a pattern such as ``ring_*``, in their order."""
    names = list(names)
    if pattern in names:
        return [pattern]
    return [name for name in names if fnmatchcase(name, pattern)]


def check_applied(case: Case) -> Iterator[str]:
    """What is wrong with obstacles, displacements and loads, a line each."""
    given = [table for table in APPLIED if getattr(case, table)]
    if not given:
        return
    if not (case.contacts or case.obstacles):
        yield (
            f"{' and '.join(given)}: expected sections [contacts.NAME] or [obstacles.NAME] too: "
            "they act in a preload, on what touches; a face that is held alone is one of [supports]"
        )
    elif not case.is_pressed:
        yield f"obstacles: nothing presses the bodies on them; {PRESSES}"
    if case.update is not None and case.update.cutoff is not None and case.obstacles:
        yield (
            "update.cutoff: expected no [obstacles]: before the preload it is not known where they "
            "touch, and so not what is stuck"
        )
    taken = {section.upper: key for key, section in _items(case, "contacts")}
    for key, bolt in _items(case, "bolts"):
        sides = {"beam": (bolt.lower, bolt.upper), "section": (bolt.upper,)}.get(bolt.kind, ())
        taken |= dict.fromkeys(sides, key)
    for key, section in _items(case, "obstacles", "displacements"):
        if section.facets in taken:
            expected = (
                f"{taken[section.facets]} governs this face already; expected each face in one "
                "of them, a contact's as its lower one"
            )
            yield message(f"{key}.facets", section.facets, expected)
        taken.setdefault(section.facets, key)
    for key, section in _items(case, "displacements"):
        moved = {axis for axis, v in zip(AXES, section.value, strict=False) if v is not None}
        for other, support in _items(case, "supports"):
            both = sorted(moved & set(support.directions))
            if support.facets == section.facets and both:
                yield (
                    f"{key}.value moves {section.facets!r} along {', '.join(both)}, "
                    f"in which {other} holds it; expected one of them"
                )


def refuse_applied(case: Case, what: str, tables: Iterable[str] = APPLIED) -> None:
    """Raise InputError if the case has sections of these tables, which ``what`` would ignore."""
    given = [f"[{table}]" for table in tables if getattr(case, table)]
    if given:
        raise InputError(
            f"{case.path}: {what} knows no {', '.join(given)}: expected none; preload, modes, and "
            "harmonic with a contact's law do"
        )


def refuse_beams(case: Case, what: str) -> None:
    """Raise InputError if the case has beams instead of a mesh, which ``what`` cannot use."""
    if case.mesh.origin == "beams":
        raise InputError(
            f"{case.path}: {what} needs solid parts: expected another mesh.builder than "
            "'offset_beams', or a file; modes, update and diagnose work on beams"
        )


def check_beams(case: Case) -> Iterator[str]:
    """A line for each thing that does not fit a case with beams, or needs them and has none."""
    if case.mesh.origin != "beams":
        needs = "expected it with mesh.builder = 'offset_beams' alone"
        for key, joint in _items(case, "joints"):
            if joint.law == "generic":
                yield message(f"{key}.law", joint.law, needs)
        for key, section in _items(case, "masses", "attached"):
            if getattr(section, "inertia", None) is not None:
                yield message(f"{key}.inertia", section.inertia, needs)
        return
    for key, what in _SOLID.items():
        if getattr(case, key):
            yield f"{key}: expected none with mesh.builder = 'offset_beams'; they need {what}"
    if case.harmonic is not None:
        yield "harmonic: expected none with mesh.builder = 'offset_beams'"
    for key, part in _items(case, "parts"):
        if part.normal != (0.0, 0.0, 1.0):
            yield message(f"{key}.normal", list(part.normal), "expected [0, 0, 1] for beams")
    for key, joint in _items(case, "joints"):
        if joint.law != "generic":
            expected = "expected 'generic' with mesh.builder = 'offset_beams'"
            yield message(f"{key}.law", joint.law, expected)
    if "degree" in case.mesh.model_fields_set:
        yield message("mesh.degree", case.mesh.degree, "beams have no cells; expected none")
    yield from _owners(case)
    short = list(_short(case.mesh))
    yield from short or _places(case)


def _short(mesh: OffsetBeamsMesh) -> Iterator[str]:
    """Beams that are no longer than their laps."""
    laps = [0.0, *mesh.of("laps"), 0.0]
    for i, length in enumerate(mesh.lengths):
        both = laps[i] + laps[i + 1]
        if not length > both:
            expected = f"expected more than the sum of its laps, {both:g} m"
            yield message(f"mesh.lengths[{i}]", length, expected)


def _owners(case: Case) -> Iterator[str]:
    """Every beam belongs to one part, every lap to one joint."""
    for cell in case.mesh.groups()[0]:
        table, other = ("parts", "joints") if cell.startswith("beam_") else ("joints", "parts")
        for key, section in _items(case, other):
            if cell in section.cells:
                yield f"{key}.cells names {cell!r}: expected it in {table}"
        owners = [name for name, section in getattr(case, table).items() if cell in section.cells]
        if len(owners) != 1:
            found = f"in {', '.join(owners)}" if owners else "in none"
            yield f"{table}: {cell!r} is {found}; expected it in one section [{table}.NAME]"


def _places(case: Case) -> Iterator[str]:
    """Points beside the beams, and directions across the plane in which beams move."""
    moves = "beams move in x and z; expected a direction that is not y alone"
    for key, section in _items(case, "springs", "attached"):
        direction = getattr(section, "direction", None)
        if direction is not None and not any(direction[::2]):
            yield message(f"{key}.direction", list(direction), moves)
    for key, section in _items(case, "supports"):
        if set(section.directions) == {"y"}:
            yield message(f"{key}.directions", section.directions, moves)
        if section.facets is None:
            expected = "beams are held at their ends; expected facets"
            yield message(f"{key}.points", section.points, expected)
    sees, end = case.test and case.test.sees, sum(case.mesh.lengths) - sum(case.mesh.of("laps"))
    if sees is None:
        return
    for i, (point, direction) in enumerate(zip(sees.points(), sees.directions(), strict=True)):
        where = f"test.sees: point {i + 1} at {{}} = {{:g}} m is beside the beams; expected"
        if not any(direction[::2]):
            yield message("test.sees.direction", list(direction), moves)
            return
        for axis, off in zip("yz", point[1:], strict=True):
            if abs(off) > end:  # a beam is a line here; its width is not checked
                yield f"{where.format(axis, off)} a point on a beam, {axis} near 0"
                return
        if not -_NEAR * end <= point[0] <= (1 + _NEAR) * end:
            yield f"{where.format('x', point[0])} x from 0 to {end:g} m"
