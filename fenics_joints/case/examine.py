"""All that is wrong with a case file at once, also where it cannot be read as a whole."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from fenics_joints.case.case import Case
from fenics_joints.case.load import finish_case, read_case, read_part
from fenics_joints.case.messages import describe
from fenics_joints.errors import InputError
from fenics_joints.files import is_file, shown_path

#: Stands for a mesh that cannot be read, or for parts of which none can.
_NO_MESH = {"file": "no mesh.msh"}
_NO_PARTS = {"none": {"cells": "none", "E": 1e11, "nu": 0.3, "rho": 1e3}}


@dataclass(frozen=True, eq=False)
class Examined:
    """What `examine_case` found.

    Attributes:
        path: The case file.
        case: The case; or what can be read of it, for a picture and for masses; None if nothing.
        errors: A line for each thing that is wrong.
        whole: Whether nothing was left out of it.
        has_mesh: Whether its mesh is the file's.
    """

    path: Path
    case: Case | None
    errors: tuple[str, ...]
    whole: bool = True
    has_mesh: bool = True


def examine_case(path: str | Path) -> Examined:
    """Read a case as `load_case` does; what is wrong does not end it, as far as it can go on.

    A key that cannot be read is left out, then its section, then its table, so that the other
    sections, and the files that they name, are looked at all the same. Needs no MPI.
    """
    try:
        path, raw = read_case(path)
    except InputError as error:
        return Examined(Path(path), None, (str(error),))
    try:
        case = Case.model_validate(raw)
    except ValidationError as error:
        return _partly(path, raw, error)
    try:
        errors = finish_case(case, path, raw)
    except InputError as error:
        errors = [_without(path, str(error))]
    return Examined(path, case, _all_of(case, errors))


def _partly(path: Path, raw: dict, error: ValidationError) -> Examined:
    """What can be read of a case with errors."""
    errors = [describe(e, Case) for e in error.errors()]
    kept = copy.deepcopy(raw)
    for level in (None, 2, 1):
        for e in error.errors():
            _drop(kept, e["loc"], level)
        kept.setdefault("mesh", dict(_NO_MESH))
        kept["parts"] = kept.get("parts") or dict(_NO_PARTS)
        try:
            case = Case.model_validate(kept)
            break
        except ValidationError as again:
            error = again
    else:
        return Examined(path, None, tuple(errors), whole=False)
    has_mesh = kept["mesh"] != _NO_MESH
    if kept["parts"] == _NO_PARTS:
        case = case.model_copy(update={"parts": {}})
    found = read_part(case, path, has_mesh)
    return Examined(path, case, (*errors, *_all_of(case, found)), whole=False, has_mesh=has_mesh)


def _drop(raw: dict, loc: tuple, level: int | None) -> None:
    """Take a place of pydantic's out of what a file says: the very one, or the first levels."""
    keys = [key for key in loc if not (isinstance(key, str) and key.startswith(("<", "[")))]
    keys = keys if level is None else keys[:level]
    inside: Any = raw
    for key in keys[:-1]:
        if isinstance(inside, list) and isinstance(key, int):
            keys = keys[: keys.index(key)]  # lists are left out as a whole
            return _drop(raw, tuple(keys), None)
        if not isinstance(inside, dict) or key not in inside:
            return None
        inside = inside[key]
    if isinstance(inside, list):
        return _drop(raw, tuple(keys[:-1]), None)
    if isinstance(inside, dict) and keys:
        inside.pop(keys[-1], None)
    return None


def _all_of(case: Case, errors: list[str]) -> tuple[str, ...]:
    """The errors, and files that are not there and that none of them names: readers end at one."""
    missing = [
        f"{path.name}: no such file, expected one at {shown_path(path)}"
        for path in case.files()[1:]
        if not is_file(path)
        and path.name != _NO_MESH["file"]
        and not any(path.name in error for error in errors)
    ]
    return (*errors, *missing)


def _without(path: Path, message: str) -> str:
    return message.removeprefix(f"{path}: ")
