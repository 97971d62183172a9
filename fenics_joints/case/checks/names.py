"""Checks of a case's names: its own, and those of the mesh's groups."""

from __future__ import annotations

from collections.abc import Iterable
from fnmatch import fnmatchcase

from fenics_joints.case.applied import APPLIED
from fenics_joints.case.case import Case
from fenics_joints.case.messages import did_you_mean, said
from fenics_joints.case.sections import Joint, Part
from fenics_joints.errors import MeshError
from fenics_joints.files import is_file, shown_path
from fenics_joints.structure.checked import MOST_POINTS

#: Laws of joints whose cells may be patterns.
PATTERNED = ("transition", "springs")


def check_names(case: Case) -> list[str]:
    """A line for each name, place or range of the case that does not go with the others."""
    seen: dict[str, str] = {}
    errors = []
    for table in (
        "parts",
        "joints",
        "contacts",
        "bolts",
        *APPLIED,
        "masses",
        "springs",
        "attached",
    ):
        for name in getattr(case, table):
            if name in seen:
                errors.append(f"{table}.{name}: the name is used by {seen[name]}; expected another")
            seen[name] = f"{table}.{name}"
    errors += _check_bolts(case)
    errors += _check_changed(case, seen)
    tables = case.masses, case.springs, case.attached
    points = sum(len(section.points) for table in tables for section in table.values())
    if points > MOST_POINTS:
        errors.append(
            f"masses, springs and attached have {points} points in all: expected at most "
            f"{MOST_POINTS}; what is spread out is a part's density, or a support"
        )
    for table in ("parts", "joints"):
        for name, section in getattr(case, table).items():
            errors += _check_bounds(f"{table}.{name}", section)
    return errors


def _check_changed(case: Case, taken: dict[str, str]) -> list[str]:
    """What was put on or taken off for a test after a change."""
    errors, there = [], [*case.masses, *case.springs]
    for name, section in ({} if case.test is None else case.test.changed).items():
        key = f"test.changed.{name}"
        if name in taken:
            errors.append(f"{key}: the name is used by {taken[name]}; expected another")
        for each in section.without:
            if each not in there:
                expected = f"expected one of masses and springs: {', '.join(there) or 'none'}"
                errors.append(said(f"{key}.without", each, expected))
    return errors


def _check_bolts(case: Case) -> list[str]:
    """The faces of bolts: one bolt that is there twice would press twice."""
    taken: dict[str, str] = {}
    errors = []
    for name, bolt in case.bolts.items():
        for side in ("lower", "upper"):
            face = getattr(bolt, side)
            if face in taken:
                expected = f"is a face of {taken[face]} already; expected each bolt once"
                errors.append(said(f"bolts.{name}.{side}", face, expected))
            taken.setdefault(face, f"bolts.{name}")
    return errors


def _check_bounds(key: str, section: Part | Joint) -> list[str]:
    values = section.nominal() | ({"width": 1.0} if isinstance(section, Part) else {})
    return [
        said(f"{key}.bounds.{name}", list(pair), f"expected a range that holds {values[name]:g}")
        for name, pair in section.bounds.model_dump(exclude_none=True).items()
        if values.get(name) is not None and not pair[0] <= values[name] <= pair[1]
    ]


def check_mesh(case: Case) -> list[str]:
    """Names of cells and facets against the builder's; a file's are checked when it is read."""
    if case.mesh.origin == "file":
        file = case.folder / case.mesh.file
        expected = f"no such file, expected a mesh at {shown_path(file)}"
        missing = said("mesh.file", case.mesh.file, expected)
        return [] if is_file(file) else [missing]
    try:
        groups = case.mesh.groups()
    except MeshError as error:
        return [f"mesh: {error}"]
    return unknown_groups(case, *groups)


def unknown_groups(case: Case, cells: Iterable[str], facets: Iterable[str]):
    """A line for each group that the case names and the mesh does not have.

    Args:
        case: The case.
        cells: Names of the mesh's groups of cells.
        facets: Names of the mesh's groups of facets.
    """
    cells, facets = list(cells), list(facets)
    named = [
        (f"{table}.{name}.cells", cell, cells)
        for table in ("parts", "joints")
        for name, section in getattr(case, table).items()
        for cell in section.cells
        if not (getattr(section, "law", "") in PATTERNED and matching(cell, cells))
    ] + [
        (f"{table}.{name}.facets", s.facets, facets)
        for table in ("supports", *APPLIED)
        for name, s in getattr(case, table).items()
        if s.facets is not None
    ]
    named += [
        (f"{table}.{name}.{side}", getattr(section, side), facets)
        for table in ("contacts", "bolts")
        for name, section in getattr(case, table).items()
        for side in ("lower", "upper")
    ]
    return [
        said(key, name, f"is not in the mesh{did_you_mean(name, there)}")
        for key, name, there in named
        if name not in there
    ]


def matching(pattern: str, names: Iterable[str]) -> list[str]:
    """Those of the names of cells that a pattern such as ``ring_*`` stands for, in their order."""
    names = list(names)
    if pattern in names:
        return [pattern]
    return [name for name in names if fnmatchcase(name, pattern)]
