"""Packages whose names are imported when they are first asked for."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module


def lazy(package: str, files: Mapping[str, Sequence[str]]) -> Callable[[str], object]:
    """A package's ``__getattr__``.

    Args:
        package: Its name.
        files: Modules of the package, or of another by their full names, that may hold each name;
            they are imported in their order until one has it. A module's own name stands for the
            module.
    """

    def imported(name: str) -> object:
        for file in files.get(name, ()):
            module = import_module(
                file if file.startswith("fenics_joints.") else f"{package}.{file}"
            )
            if file == name:
                return module
            if hasattr(module, name):
                return getattr(module, name)
        raise AttributeError(f"module {package!r} has no attribute {name!r}")

    return imported
