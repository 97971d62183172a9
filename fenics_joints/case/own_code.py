"""Laws, effects and meshes of your own, which a case names as ``module:name``.

A case from a stranger must not run anything. So a name is taken from an installed package that
declares it as an entry point of the group ``fenics_joints``; from a module beside the case only
where the user allows it (``--allow-code``, ``load_case(path, allow_code=True)``), and then for that
case alone.
"""

from __future__ import annotations

import importlib.util
import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from importlib.metadata import EntryPoint, entry_points, packages_distributions
from pathlib import Path
from typing import Any

from fenics_joints.errors import InputError, raised

#: Group of entry points by which a package brings what is its own.
GROUP = "fenics_joints"
_NAME = re.compile(r"[A-Za-z_][\w-]*(\.\w+)*(:[A-Za-z_]\w*)?")
#: Whether ``--allow-code`` was given.
_trusted: list[bool] = []
#: Of each case that is being read: its folder if its modules may run, else None.
_reading: list[Path | None] = []
#: Objects of modules beside cases, by what named them.
_found: dict[str, Any] = {}
#: Where each object that was used is from.
_used: dict[str, str] = {}


def trust_cases() -> None:
    """Let every case that this process reads name objects of the modules beside it."""
    _trusted.append(True)


def forbid_code() -> None:
    """Take back what was allowed, and forget what was found; what has run stays."""
    for kept in (_trusted, _reading, _found, _used):
        kept.clear()
    _declared_points.cache_clear()


@contextmanager
def reading(folder: str | Path, allow_code: bool = False) -> Iterator[None]:
    """While a case is read: whether modules in its folder may run."""
    _reading.append(Path(folder).resolve() if allow_code or _trusted else None)
    try:
        yield
    finally:
        _reading.pop()


def references() -> list[str]:
    """What was taken from modules beside cases, for `find_again` on other ranks."""
    return list(_found)


def find_again(names: Sequence[str], folder: str | Path) -> None:
    """Take objects from modules in a folder, as rank 0 did."""
    with reading(folder):
        for name in names:
            if name not in _found:
                _beside(name)


def declared() -> list[str]:
    """Names under which packages declare objects."""
    return list(_declared_points())


def is_reference(name: str) -> bool:
    """Whether a word of a case file may name an object: ``module:name``, or an entry point."""
    return (":" in name and bool(_NAME.fullmatch(name))) or name in _declared_points()


def find(reference: str, kind: type, what: str) -> Any:
    """The object that a case names.

    Args:
        reference: ``module:name``, or the name of an entry point.
        kind: What it must be an instance of.
        what: That, in words.

    Raises:
        InputError: If there is no such object, it is of another kind, its module fails, or it may
            not run.
    """
    if not _NAME.fullmatch(reference):
        raise InputError(f"{reference!r}: expected module:name, or a name that a package declares")
    point = _declared_points().get(reference)
    if point is not None:
        try:
            found = point.load()
        except Exception as error:  # whatever a module of somebody's own may raise
            raise InputError(raised(reference, error)) from error
        _used[reference] = f"the package {point.dist.name}"
    elif not _reading and reference in _found:
        found = _found[reference]
    else:
        found = _beside(reference)
    if not isinstance(found, kind):
        raise InputError(f"{reference}: is {type(found).__name__}, expected {what}")
    return found


def find_all(names: Sequence[str]) -> None:
    """Find those of some words that name objects, for later."""
    for name in names:
        if is_reference(name):
            find(name, object, "")


def used() -> Iterator[str]:
    """A note for each object of somebody's own that was used: its name and where it is from."""
    for reference, where in _used.items():
        yield f"{reference} is code from {where}"


@cache
def _declared_points() -> dict[str, EntryPoint]:
    """Entry points by their names and by what they name; not those of the working folder, where a
    case may lie."""
    found, here = {}, Path.cwd().resolve()
    for point in entry_points(group=GROUP):
        if point.dist is not None and Path(str(point.dist.locate_file(""))).resolve() != here:
            found |= {point.name: point, point.value: point}
    return found


def _beside(reference: str) -> Any:
    """The object of a module in the folder of the case that is being read."""
    module, _, name = reference.partition(":")
    folder = _reading[-1] if _reading else None
    if not name:
        raise InputError(f"{reference!r}: no package declares it, expected module:name")
    if folder is None and (dists := packages_distributions().get(module.partition(".")[0])):
        raise InputError(
            f"{reference}: the installed package {dists[0]} does not declare it: expected it among "
            f'its entry points, [project.entry-points.{GROUP}] {name} = "{reference}"'
        )
    if folder is None:
        raise InputError(
            f"{reference}: is code beside the case, which runs only with --allow-code; add that if "
            "you trust it"
        )
    path = folder.joinpath(*module.split(".")).with_suffix(".py")
    if not path.is_file():
        raise InputError(f"{reference}: there is no {path}")
    try:
        found = getattr(_module(module, path), name)
    except InputError:
        raise
    except Exception as error:
        raise InputError(raised(reference, error)) from error
    _found[reference], _used[reference] = found, str(path)
    return found


def _module(name: str, path: Path):
    """The module of a file; run once. While it runs it may import what stands beside it."""
    there = sys.modules.get(name)
    if there is not None:
        if getattr(there, "__file__", None) != str(path):
            raise InputError(f"{path}: a module {name!r} is there already: expected another name")
        return there
    spec = importlib.util.spec_from_file_location(name, path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    sys.path.insert(0, str(path.parent))
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    finally:
        sys.path.remove(str(path.parent))
    return module
