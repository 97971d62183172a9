"""Laws, effects, meshes and readers of your own, which a case names as ``module:name``.

A case from a stranger must not run anything. So a name is taken from a package that was installed
and declares it as an entry point of the group ``fenics_joints``; from a module beside the case only
after `allow_code`, which ``--allow-code`` and ``load_case(path, allow_code=True)`` call.
"""

from __future__ import annotations

import importlib.util
import re
import sys
from collections.abc import Iterator
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from textwrap import shorten
from typing import Any

from fenics_joints.errors import InputError

#: Group of entry points by which a package brings what is its own.
GROUP = "fenics_joints"
_NAME = re.compile(r"[A-Za-z]\w*(\.\w+)*(:[A-Za-z]\w*)?")
#: Folders whose modules may run.
_folders: list[Path] = []
#: Whether the folder of every case that is read may be one of them.
_trusted: list[bool] = []
#: Where each name that was used was found.
_used: dict[str, str] = {}


def allow_code(folder: str | Path) -> None:
    """Let cases name objects of the modules in a folder. Their code then runs."""
    folder = Path(folder).resolve()
    if folder not in _folders:
        _folders.insert(0, folder)


def trust_cases() -> None:
    """Let every case that this process reads name objects of the modules beside it."""
    _trusted.append(True)


def allow_if_trusted(folder: str | Path) -> None:
    """`allow_code`, if `trust_cases` was called."""
    if _trusted:
        allow_code(folder)


def forbid_code() -> None:
    """Take back what `allow_code` and `trust_cases` allowed; what has run stays."""
    _folders.clear()
    _trusted.clear()


def is_reference(name: str) -> bool:
    """Whether a word of a case file may name an object: ``module:name``, or an entry point."""
    return ":" in name or any(point.name == name for point in entry_points(group=GROUP))


def find(reference: str, kind: type | tuple[type, ...], what: str) -> Any:
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
    found, where = _declared(reference) or _beside(reference)
    if not isinstance(found, kind):
        raise InputError(f"{reference}: is {type(found).__name__}, expected {what}")
    _used[reference] = where
    return found


def used() -> Iterator[str]:
    """A note for each object of somebody's own that was used: its name and where it is from."""
    for reference, where in _used.items():
        yield f"{reference} is code from {where}"


def _declared(reference: str) -> tuple[Any, str] | None:
    """The object of an entry point, and where it is from."""
    for point in entry_points(group=GROUP):
        if reference in (point.name, point.value):
            package = getattr(point.dist, "name", "an installed package")
            return _loaded(reference, point), f"the package {package}"
    return None


def _loaded(reference: str, point: EntryPoint) -> Any:
    try:
        return point.load()
    except Exception as error:  # whatever a module of somebody's own may raise
        raise _failed(reference, error) from error


def _beside(reference: str) -> tuple[Any, str]:
    """The object of a module in one of the folders that may run, and its file."""
    module, _, name = reference.partition(":")
    known = ", ".join(sorted(point.name for point in entry_points(group=GROUP)))
    also = f", or one of {known}" if known else ""
    if not name:
        raise InputError(
            f"{reference!r}: no installed package declares it: expected module:name{also}"
        )
    if not _folders:
        raise InputError(
            f"{reference}: is code beside the case, which runs only with --allow-code; add that if "
            f"you trust it{also}"
        )
    for folder in _folders:
        path = folder.joinpath(*module.split(".")).with_suffix(".py")
        if path.is_file():
            try:
                return getattr(_module(module, path), name), str(path)
            except InputError:
                raise
            except Exception as error:
                raise _failed(reference, error) from error
    folders = ", ".join(map(str, _folders))
    raise InputError(f"{reference}: there is no {module.replace('.', '/')}.py in {folders}{also}")


def _module(name: str, path: Path):
    """The module of a file; run once."""
    there = sys.modules.get(name)
    if there is not None:
        if getattr(there, "__file__", None) != str(path):
            raise InputError(f"{path}: a module {name!r} is there already: expected another name")
        return there
    spec = importlib.util.spec_from_file_location(name, path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module


def _failed(reference: str, error: Exception) -> InputError:
    return InputError(shorten(f"{reference}: {type(error).__name__}: {error}", 300))
