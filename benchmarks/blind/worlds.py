"""The worlds that make cases: which one a geometry is of, and what scoring asks of it.

A world has `GEOMETRIES`, `EFFECTS` by geometry, `LIBRARY`, `UNKNOWN`, `plan`, `generate` and
`clean`. Answers name a geometry, and geometries are of one world each.
"""

from __future__ import annotations

from types import ModuleType

from benchmarks.blind.seal import SealError

#: Names on the command line, and the packages' beside this file.
WORLDS = {"first": "world", "calculix": "calculix"}


def folder_of(name: str) -> str:
    """The sources of a world, from the root.

    Raises:
        SealError: If there is no such world.
    """
    if name not in WORLDS:
        raise SealError(f"--world {name}: expected one of {', '.join(WORLDS)}")
    return f"benchmarks/blind/{WORLDS[name]}"


def world_named(name: str) -> ModuleType:
    """The world's package.

    Raises:
        SealError: If there is no such world, or what it needs is missing.
    """
    folder_of(name)
    if name == "first":
        from benchmarks.blind import world

        return world
    from benchmarks.blind import calculix

    return calculix


def world_of(geometry: str) -> ModuleType:
    """The world that has a geometry.

    Raises:
        SealError: If none has it.
    """
    for name in WORLDS:
        found = world_named(name)
        if geometry in found.GEOMETRIES:
            return found
    raise SealError(f"no world has a geometry {geometry!r}")


def geometries() -> list[str]:
    """Of all worlds."""
    return [geometry for name in WORLDS for geometry in world_named(name).GEOMETRIES]


def library() -> dict[str, tuple[str, ...]]:
    """What the diagnosis calls the causes of all worlds, by their names there; patterns."""
    found = {}
    for name in WORLDS:
        for cause, names in world_named(name).LIBRARY.items():
            names = (names,) if isinstance(names, str) else tuple(names)
            found[cause] = tuple(dict.fromkeys((*found.get(cause, ()), *names)))
    return found
